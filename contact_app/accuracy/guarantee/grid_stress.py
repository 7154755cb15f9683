"""Symmetric stresses on a grid of boxes whose tractions pass from cell to cell.

The space is that of J. Hu, H. Man, J. Wang & S. Zhang, *The simplest nonconforming mixed finite
element method for linear elasticity in the symmetric formulation on n-rectangular grids* (Comput.
Math. Appl. 71, 2016). σ_ii is quadratic along x_i and constant across, with one value on each face
normal to x_i and a bubble 1 - ξ² in each cell; σ_ij is bilinear in x_i, x_j, with one value on each
edge along the other axis, shared by the cells around it (in the plane on each node). In a cell

    (div σ)_i = Δ_i σ_ii / h_i + Σ_j Δ_j mean_i σ_ij / h_j
              - 4 ξ b_i / h_i + ½ ξ Σ_j Δ_i Δ_j σ_ij / h_j,      -1 ≤ ξ ≤ 1 along x_i.

For a force that is constant in the cell the second line is zero, which gives the bubbles
b_i = h_i/8 Σ_j Δ_i Δ_j σ_ij / h_j. Forces are always constant here, so a stress is given by its
values s on faces and edges. All matrices are sums of Kronecker products of one-dimensional
matrices, also on uneven grids.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import combinations, combinations_with_replacement

import numpy as np
from scipy import sparse

from meshes.arrays import Array, Ints

Pair = tuple[int, int]


@dataclass(frozen=True, eq=False)
class GridStress:
    """A stress."""

    faces: list[Array]
    """σ_ii: along x_i on the grid planes, across by cell."""
    bubbles: list[Array]  # d arrays (cells…)
    """Coefficients of 1 - ξ²."""
    edges: dict[Pair, Array]
    """σ_ij: along x_i and x_j on the grid lines, else by cell."""

    def at(self, cells: Ints, local: Array, pairs: Sequence[Pair]) -> Array:
        """Values at points.

        Parameters
        ----------
        cells : (n, d)
            Places of cells on the grid.
        local : (n, q, d)
            Points in them, from 0 to 1 along each axis.
        pairs
            The shear components wanted.

        Returns
        -------
        (n, q, d + pairs)
        """
        d, place = len(self.faces), tuple(cells.T)
        result = np.empty((*local.shape[:2], d + len(pairs)))
        for i in range(d):
            x = local[..., i]
            low, high = (self.faces[i][_next(place, i, by)][:, None] for by in (0, 1))
            bubble = self.bubbles[i][place][:, None]
            result[..., i] = (1.0 - x) * low + x * high + 4.0 * x * (1.0 - x) * bubble
        for column, (i, j) in enumerate(pairs, d):
            ends = ((1.0 - local[..., i], local[..., i]), (1.0 - local[..., j], local[..., j]))
            result[..., column] = sum(
                ends[0][a] * ends[1][b] * self.edges[i, j][_next(_next(place, i, a), j, b)][:, None]
                for a, b in np.ndindex(2, 2)
            )
        return result


def _next(place: tuple, axis: int, by: int) -> tuple:
    """Places moved along an axis."""
    return (*place[:axis], place[axis] + by, *place[axis + 1 :])


class GridStresses:
    """The space of these stresses on a grid.

    Parameters
    ----------
    axes
        Ascending grid coordinates along each axis.

    Attributes
    ----------
    pairs
        Axes of the shear components, which follow the d normal ones.
    size
        Values on faces and edges.
    """

    def __init__(self, axes: Sequence[Array]) -> None:
        self.axes = list(axes)
        self.widths = [np.diff(x) for x in axes]
        self.cells = tuple(len(h) for h in self.widths)
        self.dimension = d = len(self.cells)
        self.pairs: list[Pair] = list(combinations(range(d), 2))
        self._along = [(i,) for i in range(d)] + self.pairs
        self.shapes = [
            tuple(n + (k in along) for k, n in enumerate(self.cells)) for along in self._along
        ]
        starts = np.cumsum([0, *(int(np.prod(shape)) for shape in self.shapes)])
        self.parts = [slice(int(a), int(b)) for a, b in zip(starts[:-1], starts[1:], strict=True)]
        self.size = int(starts[-1])

    def rows_on_face(self, component: int, face: int) -> Ints:
        """Numbers of the values of a component on a face of the grid (x-, x+, y-, …).

        Values of σ_ii are numbered by facet; σ_ij has one more value along the other of its axes.
        """
        axis, end = divmod(face, 2)
        part = self.parts[component]
        rows = np.arange(part.start, part.stop).reshape(self.shapes[component])
        return np.asarray(np.moveaxis(rows, axis, 0)[-end])

    def facet_areas(self, axis: int) -> Array:
        """Areas of the facets normal to an axis."""
        across = [h for k, h in enumerate(self.widths) if k != axis]
        return np.asarray(reduce(np.multiply.outer, across))

    def stress(self, s: Array) -> GridStress:
        """The stress of values on faces and edges."""
        d = self.dimension
        values = [
            s[part].reshape(shape) for part, shape in zip(self.parts, self.shapes, strict=True)
        ]
        bubbles = [(bubble @ s).reshape(self.cells) for bubble in self._bubbles]
        return GridStress(values[:d], bubbles, dict(zip(self.pairs, values[d:], strict=True)))

    def from_means(self, means: Array) -> Array:
        """Values on faces and edges from means over the cells around, (cells…, components)."""
        result = np.empty(self.size)
        for component, along in enumerate(self._along):
            field = means[..., component]
            for axis in along:
                wide = np.moveaxis(field, axis, 0)
                wide = np.concatenate([wide[:1], wide, wide[-1:]])
                field = np.moveaxis(0.5 * (wide[1:] + wide[:-1]), 0, axis)
            result[self.parts[component]] = field.ravel()
        return result

    @cached_property
    def divergence(self) -> sparse.csr_matrix:
        """Means of (div σ)_i over cells, axis by axis, (d · cells, size)."""
        rows = []
        for i in range(self.dimension):
            row = self._product({i: self._slope(i)}) @ self._selection(i)
            row = row + self._shear_slopes(i, 0.5 * abs(self._difference(i)))
            rows.append(row)
        return sparse.csr_matrix(sparse.vstack(rows))

    def energy_matrix(self, compliance: Array) -> sparse.csr_matrix:
        """A of ∫ σ : C⁻¹ : σ = sᵀ A s, (size, size).

        Parameters
        ----------
        compliance : (components, components)
            C⁻¹, components xx, yy, … and then as `pairs`, engineering shear; isotropic.
        """
        d, masses = self.dimension, [self._masses(k) for k in range(self.dimension)]
        full = [self._hats_and_bubbles(i) for i in range(d)]
        total = sparse.csr_matrix((self.size, self.size))
        for i, j in combinations_with_replacement(range(d), 2):
            factors = {k: sparse.diags(h) for k, h in enumerate(self.widths) if k not in (i, j)}
            if i == j:
                factors[i] = masses[i][0]
            else:
                factors[i], factors[j] = masses[i][1], masses[j][1].T
            part = compliance[i, j] * (full[i].T @ self._product(factors) @ full[j])
            total = total + (part if i == j else part + part.T)
        for component, pair in enumerate(self.pairs, d):
            factors = {
                k: self._linear_mass(k) if k in pair else sparse.diags(h)
                for k, h in enumerate(self.widths)
            }
            selection = self._selection(component)
            mass = selection.T @ self._product(factors) @ selection
            total = total + compliance[component, component] * mass
        return sparse.csr_matrix(total)

    def _product(self, factors: dict[int, sparse.spmatrix]) -> sparse.csr_matrix:
        """Kronecker product of matrices along the axes, the identity where none is given."""
        along = [factors.get(k, sparse.identity(n)) for k, n in enumerate(self.cells)]
        return sparse.csr_matrix(reduce(lambda a, b: sparse.kron(a, b, "csr"), along))

    def _selection(self, component: int) -> sparse.csr_matrix:
        """Matrix that selects the values of one component from s."""
        part = self.parts[component]
        rows = np.arange(part.stop - part.start)
        shape = (len(rows), self.size)
        return sparse.csr_matrix((np.ones(len(rows)), (rows, rows + part.start)), shape=shape)

    def _difference(self, k: int) -> sparse.csr_matrix:
        """Matrix of the differences Δ between grid planes, for each cell."""
        n = self.cells[k]
        return sparse.diags([-np.ones(n), np.ones(n)], [0, 1], shape=(n, n + 1), format="csr")

    def _slope(self, k: int) -> sparse.csr_matrix:
        return sparse.csr_matrix(sparse.diags(1.0 / self.widths[k]) @ self._difference(k))

    def _shear_slopes(self, i: int, along: sparse.spmatrix) -> sparse.csr_matrix:
        """Σ_j ∂_j σ_ij after an operator along x_i is applied to σ_ij."""
        total = sparse.csr_matrix((int(np.prod(self.cells)), self.size))
        for component, pair in enumerate(self.pairs, self.dimension):
            if i in pair:
                (j,) = set(pair) - {i}
                slope = self._product({i: along, j: self._slope(j)})
                total = total + slope @ self._selection(component)
        return total

    @cached_property
    def _bubbles(self) -> list[sparse.csr_matrix]:
        """Matrix that maps s to the bubbles of each axis."""
        return [
            self._shear_slopes(i, sparse.diags(self.widths[i] / 8.0) @ self._difference(i))
            for i in range(self.dimension)
        ]

    def _hats_and_bubbles(self, i: int) -> sparse.csr_matrix:
        """Matrix that maps s to σ_ii: along x_i first values on grid planes, then bubbles."""
        shape = tuple(2 * n + 1 if k == i else n for k, n in enumerate(self.cells))
        place = np.arange(int(np.prod(shape))).reshape(shape)
        planes, cells = np.split(place, [self.cells[i] + 1], axis=i)
        order = np.argsort(np.concatenate([planes.ravel(), cells.ravel()]))
        return sparse.vstack([self._selection(i), self._bubbles[i]], format="csr")[order]

    def _linear_mass(self, k: int) -> sparse.csr_matrix:
        """Mass matrix of the hat functions of the grid planes."""
        D, h = self._difference(k), sparse.diags(self.widths[k] / 12.0)
        both = abs(D)
        return sparse.csr_matrix(3.0 * (both.T @ h @ both) + D.T @ h @ D)

    def _masses(self, k: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        """Mass matrices along x_k of hats and bubbles, and of these with constants on cells."""
        h, both = self.widths[k], abs(self._difference(k))
        mixed = both.T @ sparse.diags(h / 3.0)
        mass = sparse.bmat([[self._linear_mass(k), mixed], [mixed.T, sparse.diags(8.0 / 15.0 * h)]])
        constant = sparse.vstack([both.T @ sparse.diags(h / 2.0), sparse.diags(2.0 / 3.0 * h)])
        return sparse.csr_matrix(mass), sparse.csr_matrix(constant)
