"""Search directions of earlier active sets on a set with turned frames or compliant rows.

Where the slip directions of points turn, hardly any direction of an earlier set vanishes on the
rows that are prescribed now, and `solver.tfeti.recycling` finds nothing admissible. But most of a
direction stays valid. Let V be earlier directions in the rows of the original frames, Z the
restriction to the rows that are active in the present frames, C the compliances of these rows, and
L the part that the restriction loses. The products F V are known, so that

    W = Z V,    Y = Z F V + C W,    E = Vᵀ F V + Wᵀ C W + Lᵀ Ω L

approximate a basis, its products and its Gram matrix; Ω is the compliance of a row alone, so that a
direction counts the less, the more of it is lost. The preconditioner M is balanced with this basis:

    (I - W E⁻¹ Yᵀ) M (I - Y E⁻¹ Wᵀ) + W E⁻¹ Wᵀ,

which is symmetric and positive definite whatever the errors of Y and E are. It equals the update of
a quasi-Newton method with pairs of an earlier system (J. L. Morales, J. Nocedal, *Automatic
preconditioning by limited memory quasi-Newton updating*, SIAM J. Optim. 10, 2000). With exact
products it is the deflation of `solver.tfeti.recycling`. The simpler z + W E⁻¹ (Wᵀ r - Yᵀ z), z = M
r, is not symmetric: with it conjugate gradients did not converge between two meshes.
"""

from dataclasses import dataclass

import numpy as np

from solver.backend import Statuses, Turn
from solver.problem.decomposed import DecomposedProblem
from solver.qp.preconditioner import Preconditioner
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.directions import Directions
from solver.vectors import Array, Mask

LOST = 10.0
"""Weight of lost parts, Ω times the stiffness against a row. With 1 to 1000 the scenes of
`contact_app.studies.friction_cost` take up to a third more or fewer operator applications, without
a trend."""

DEPENDENT = 1e-8
"""Eigenvalues of the scaled E, over the largest, below which directions are left out."""


@dataclass(frozen=True, eq=False)
class RowFrame:
    """Frames and lengths of the rows of a set."""

    turn: Turn | None
    """Turned frames; None where no frame is turned."""
    scale: Array | None  # (dual,)
    """Factors on the rows; None for one."""

    def turned(self, vectors: Array) -> Array:
        """Vectors (k, dual) in the turned frames, without the factors."""
        if self.turn is None:
            return vectors
        return np.array([self.turn.turned(x) for x in vectors]).reshape(vectors.shape)

    def original(self, multiplier: Array) -> Array:
        """A multiplier (dual,) of the set in the original frames and lengths."""
        scaled = multiplier if self.scale is None else self.scale * multiplier
        return scaled if self.turn is None else self.turn.back(scaled)


class ChangedDirections:
    """W, Y and E⁻¹ of one set.

    Parameters
    ----------
    directions
        Directions of earlier sets; settled.
    problem
        The problem in the original frames.
    compliance : (dual,)
        C, in the rows of the set; None for zero.
    coarse
        Coarse problem of the set.
    """

    def __init__(
        self,
        directions: Directions,
        problem: DecomposedProblem,
        statuses: Statuses,
        frame: RowFrame,
        compliance: Array | None,
        coarse: CoarseProblem,
    ) -> None:
        self._comm, self._coarse = directions.comm, coarse
        conditional = problem.conditional
        active = ~conditional | statuses.active
        scale = np.ones(problem.size) if frame.scale is None else frame.scale
        softness = np.zeros(problem.size) if compliance is None else compliance
        vectors = frame.turned(directions.vectors)
        self._basis = vectors * (active / scale)
        self._products = frame.turned(directions.applied) * (active * scale)
        self._products += softness * self._basis
        stiffness = problem.row_stiffness(conditional)
        weight = np.zeros(problem.size)
        weight[conditional] = np.divide(
            LOST, stiffness, out=np.zeros(len(stiffness)), where=stiffness > 0.0
        )
        lost = vectors * ~active
        gram = (self._basis * softness) @ self._basis.T + (lost * weight) @ lost.T
        self._inverse = self._inverted(directions.gram + self._comm.allreduce(gram))

    def _inverted(self, gram: Array) -> Array:
        """E⁻¹ on the directions that are independent to working precision (collective)."""
        result = np.zeros_like(gram)
        if len(gram) and not self._comm.rank:
            scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(np.float64).tiny))
            sizes, modes = np.linalg.eigh(0.5 * (gram + gram.T) * scale * scale[:, None])
            good = sizes > DEPENDENT * sizes.max(initial=0.0)
            half = scale[:, None] * modes[:, good] / np.sqrt(sizes[good])
            result = half @ half.T
        return np.asarray(self._comm.bcast(result))

    def balanced(self, base: Preconditioner, r: Array, free: Mask, out: Array) -> None:
        """Put the balanced preconditioner times r into out, r in the range of Pᵀ (collective)."""
        part = self._inverse @ self._comm.allreduce(self._basis @ r)
        rest = part @ self._products
        self._coarse.project_transpose(rest, rest)
        base.apply(np.subtract(r, rest, out=rest), free, out)
        part -= self._inverse @ self._comm.allreduce(self._products @ out)
        out += part @ self._basis
        self._coarse.project(out, out)


class BalancedPreconditioner:
    """A preconditioner balanced with directions of earlier sets."""

    def __init__(self, base: Preconditioner, changed: ChangedDirections) -> None:
        self._base, self._changed = base, changed

    def apply(self, r: Array, free_mask: Mask, out: Array) -> None:
        """Put z into out."""
        self._changed.balanced(self._base, r, free_mask, out)
