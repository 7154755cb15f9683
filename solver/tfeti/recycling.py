"""Use of the search directions of earlier active sets on the present set.

`solver.tfeti.directions` stores the directions and derives the method.
"""

from solver.qp.preconditioner import Preconditioner
from solver.tfeti.directions import Directions
from solver.tfeti.dual import DualProblem
from solver.tfeti.projected import RangeOperator
from solver.vectors import Array, Mask


class RecordedOperator(RangeOperator):
    """The operator of a set; it stores the directions that it is applied to.

    Parameters
    ----------
    compliance : (dual,)
        Addition to the diagonal of F; None for zero.
    """

    def __init__(
        self, reduced: DualProblem, directions: Directions, compliance: Array | None = None
    ) -> None:
        assert reduced.coarse is not None
        super().__init__(reduced.F, reduced.coarse)
        self._compliance = compliance
        self._directions, self._first = directions, directions.stored
        self._applied = 0

    def apply(self, x: Array, out: Array) -> None:
        """P F x."""
        if self._compliance is None:
            super().apply(x, out)
        else:
            self.F.apply(x, out)
            out += self._compliance * x
            self.coarse.project_transpose(out, out)
        self._applied += 1
        if self._directions.stores_step(self._applied):
            self._directions.store(x, self.image, out)

    def orthogonalise(self, z: Array) -> None:
        """Make z F-orthogonal to the directions that the operator was applied to."""
        self._directions.orthogonalise(z, self._first)


class Recycled:
    """The directions of earlier sets, used on one set.

    Parameters
    ----------
    active : (dual,)
        The active set.
    """

    def __init__(self, directions: Directions, active: Mask) -> None:
        if directions.suffice:
            directions.settle()
        self._of, self._comm = directions, directions.comm
        self._closed = ~directions.conditional | active
        self._inverse = directions.on_set(active)

    @property
    def empty(self) -> bool:
        """Whether no combination of the directions is admissible on the set."""
        return not self._inverse.any()

    def best(self, residual: Array) -> tuple[Array, Array]:
        """The best change of the multiplier for a residual, and K⁺ Bᵀ times this change."""
        y = self._inverse @ self._comm.allreduce(self._of.vectors @ residual)
        return (y @ self._of.vectors) * self._closed, y @ self._of.motions

    def orthogonalise(self, z: Array) -> None:
        """Make z F-orthogonal to the directions."""
        y = self._inverse @ self._comm.allreduce(self._of.applied @ z)
        z -= (y @ self._of.vectors) * self._closed


class DeflatedPreconditioner:
    """A preconditioner whose result is F-orthogonal to the directions of this and earlier sets.

    Parameters
    ----------
    recycled
        The directions of earlier sets; None where none is admissible on this set.
    """

    def __init__(
        self, base: Preconditioner, recycled: Recycled | None, operator: RecordedOperator
    ) -> None:
        self._base, self._recycled, self._operator = base, recycled, operator

    def apply(self, r: Array, free_mask: Mask, out: Array) -> None:
        """Put z into out."""
        self._base.apply(r, free_mask, out)
        if self._recycled is not None and not self._recycled.empty:
            self._recycled.orthogonalise(out)
        self._operator.orthogonalise(out)
