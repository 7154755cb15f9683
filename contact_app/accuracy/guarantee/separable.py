"""A fast inverse of nearly separable matrices on the cells of a grid.

Along each axis k an equation for values on cells is a three-point stencil T_k = Δ W_k⁻¹ Δᵀ with
the dual widths W_k, and a sum of these is inverted by the eigenvectors of each,

    (Σ_k c_k T_k)⁻¹ = Q (Σ_k c_k Λ_k)⁻¹ Qᵀ,      Q = Q_x ⊗ Q_y ⊗ Q_z

(R. E. Lynch, J. R. Rice & D. H. Thomas, Numer. Math. 6, 1964): a few products with small dense
matrices on any grid. The matrix of equilibrium B diag⁻¹ Bᵀ is spectrally close to one such sum for
each component of the multiplier (Korn's inequality). The sums precondition conjugate gradients.
"""

from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np

from contact_app.accuracy.guarantee.grid_stress import GridStresses
from meshes.arrays import Array

SOFTEST = 0.1
"""Smallest eigenvalue, relative to the smallest nonzero one along any axis: it regularises a body
without supports."""

DIVERGED = 1e3
"""Residual, relative to the first, that shows that equations have no solution."""


class EquilibriumPreconditioner:
    """Approximates (B diag Bᵀ)⁻¹ for the divergence B of a space of stresses.

    Parameters
    ----------
    inverse : (size,)
        The diagonal of the inverse; zero where a value is known.
    """

    def __init__(self, space: GridStresses, inverse: Array) -> None:
        self._shape = (space.dimension, *space.cells)
        self._root = np.sqrt(_outer(space.widths))
        self._parts = [self._separated(space, i, inverse) for i in range(space.dimension)]

    def _separated(self, space: GridStresses, i: int, inverse: Array) -> tuple[list[Array], Array]:
        """Eigenvectors along each axis and sums of eigenvalues, for component i."""
        vectors, sums, softest = [], np.zeros(space.cells), np.inf
        for k, h in enumerate(space.widths):
            component = i if k == i else space.dimension + space.pairs.index((min(i, k), max(i, k)))
            shape = space.shapes[component]
            volumes = _outer(
                [w if n == len(w) else _dual(w) for w, n in zip(space.widths, shape, strict=True)]
            )
            values = inverse[space.parts[component]].reshape(shape)
            free = np.moveaxis(values > 0.0, k, 0).reshape(len(h) + 1, -1).mean(axis=1)
            some = values > 0.0
            stiffness = float(np.median((values * volumes)[some])) if some.any() else 0.0
            difference = np.diff(np.eye(len(h) + 1), axis=0) / np.sqrt(h)[:, None]
            T = stiffness * (difference * (free / _dual(h))) @ difference.T
            along, basis = np.linalg.eigh(T)
            vectors.append(basis)
            others = [axis for axis in range(space.dimension) if axis != k]
            sums = sums + np.expand_dims(np.maximum(along, 0.0), others)
            if len(h) > 1:
                softest = min(softest, float(along[1]))
        if not np.isfinite(softest) or softest <= 0.0:
            softest = float(sums.max()) or 1.0
        return vectors, np.maximum(sums, SOFTEST * softest)

    def __call__(self, right: Array) -> Array:
        """Apply the preconditioner to a vector (d · cells,)."""
        result = np.empty(self._shape)
        for part, (vectors, sums), out in zip(
            right.reshape(self._shape), self._parts, result, strict=True
        ):
            values = _transformed(part * self._root, [q.T for q in vectors]) / sums
            out[...] = _transformed(values, vectors) * self._root
        return result.ravel()


def conjugate_gradients(
    matrix: Callable[[Array], Array],
    preconditioner: Callable[[Array], Array],
    right: Array,
    tolerance: float,
    most: int,
) -> Array:
    """Solve to a residual relative to the right-hand side; the matrix may be singular.

    If there is no solution, or rounding errors keep the residual from falling, it ends early and
    returns the iterate with the smallest residual.
    """
    x, residual = np.zeros_like(right), right.copy()
    start = least = float(np.linalg.norm(right))
    best, direction, square = x.copy(), np.zeros_like(right), 1.0
    for _ in range(most):
        if least <= tolerance * start:
            break
        z = preconditioner(residual)
        before, square = square, float(residual @ z)
        direction = z + square / before * direction
        moved = matrix(direction)
        curvature = float(direction @ moved)
        if curvature <= 0.0:
            break
        x += square / curvature * direction
        residual -= square / curvature * moved
        size = float(np.linalg.norm(residual))
        if size < least:
            least, best = size, x.copy()
        elif size > DIVERGED * start:
            break
    return best


def _outer(factors: Sequence[Array]) -> Array:
    return np.asarray(reduce(np.multiply.outer, factors))


def _dual(widths: Array) -> Array:
    """Widths about grid planes: half of the cells on either side."""
    return 0.5 * (np.append(widths, 0.0) + np.append(0.0, widths))


def _transformed(values: Array, matrices: Sequence[Array]) -> Array:
    """Apply one matrix along each axis."""
    for axis, matrix in enumerate(matrices):
        values = np.moveaxis(np.tensordot(matrix, values, (1, axis)), 0, axis)
    return values
