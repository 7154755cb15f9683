"""The dual problem on an active set: active contact rows are equalities, the others are left out.

This problem has no bounds and needs no augmented Lagrangian. The coarse problem contains the active
contact rows and not the others, and projected conjugate gradients solve

    min ½ λᵀ F λ - λᵀ d  over  G λ = e  in the rows that hold with equality.

The preconditioner is that of the dual problem, deflated by search directions of earlier sets.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solver.backend import SetState, Statuses
from solver.qp.box_qp import BoxQP
from solver.qp.iterate import Iterate, Watch
from solver.qp.mprgp import MPRGP
from solver.qp.preconditioner import Preconditioner
from solver.qp.result import Counts, Monitor, Reason
from solver.tfeti.changed_frames import BalancedPreconditioner, ChangedDirections, RowFrame
from solver.tfeti.coupled import CoupledRows
from solver.tfeti.derived import beginning_at, turned, with_active
from solver.tfeti.directions import Directions
from solver.tfeti.dual import DualProblem
from solver.tfeti.preconditioner import DualPreconditioner, ScaledPreconditioner
from solver.tfeti.recovery import add_motions
from solver.tfeti.recycling import DeflatedPreconditioner, RecordedOperator, Recycled
from solver.vectors import Array, Mask

STALLED = 2
"""Steps on an active set, over its unknowns, after which the residual counts as rounding errors: in
exact arithmetic conjugate gradients need at most as many steps as unknowns."""

OUTSIDE = 10.0
"""Smallest attainable residual, over the part of the right-hand side outside the range of P:
rounding errors make this part, and no step of conjugate gradients can remove it."""

SOFTENED = 0.3
"""Stiffness against a row of several nodes with elastic surroundings, relative to that by the
diagonal of K: 1 took 8 % more operator applications on blocks of tetrahedra, 0.1 as many."""

SHORT = 4
"""Steps on an active set up to which that part is not computed: it costs a projection."""

ROUNDED = 2.0 * float(np.finfo(np.float64).eps)
"""Rounding errors of F λ over ‖F‖ ‖λ‖."""


@dataclass(frozen=True, eq=False)
class State(SetState):
    """A multiplier in equilibrium with the loads, and its displacements."""

    motions: Array  # (kernels,)
    """α that makes the jumps of the rows that hold with equality smallest."""
    displacements: Array  # (interface,)
    """u."""

    def homogenised(self, problem: DualProblem) -> tuple[Array, Array]:
        """x = λ - λ̃ and t = Cᵀ μ = Q (F λ - d) - Gᵀ α, for SMALBE to go on from."""
        coarse = problem.coarse
        assert coarse is not None
        force, kernel_part = np.empty(problem.size), np.empty(problem.size)
        coarse.extend(self.motions, kernel_part)
        coarse.apply(kernel_part - self.jumps, force)
        return self.multiplier - problem.offset, force - kernel_part


class ActiveSetProblem:
    """Conjugate gradients with active contact rows as equalities, without the others.

    Parameters
    ----------
    statuses
        The active set, and the multipliers of the other contact rows.
    multiplier : (dual,)
        The iteration begins at the multiplier in equilibrium nearest to this one; at the smallest
        multiplier in equilibrium if None.
    directions
        Search directions of earlier active sets, which are used again; those of this set are added.
    coupled
        The coupled rows of the problem, if they are known already.

    Raises
    ------
    ArithmeticError
        The active rows do not hold every body in place.
    """

    def __init__(
        self,
        problem: DualProblem,
        statuses: Statuses,
        multiplier: Array | None = None,
        directions: Directions | None = None,
        coupled: CoupledRows | None = None,
    ) -> None:
        self.statuses, self._compliance = statuses, statuses.compliance
        turn, active = statuses.turn, statuses.active
        changed = turn is not None or self._compliance is not None
        self.problem = problem = problem if turn is None else turned(problem, turn)
        self._tractions = _outside(statuses, problem)
        rows = None if self._compliance is None else _scalings(problem, self._compliance)
        self._scale = None if rows is None else rows[0]
        frame = RowFrame(turn, self._scale)
        directions = directions or Directions(problem.B, problem.conditional)
        directions.begin(frame.original if changed else None)
        if changed and directions.suffice:
            directions.settle()
        start = None if multiplier is None else self._start(multiplier)
        self.reduced = with_active(problem, active, start, self._tractions, self._scale)
        recycled = None if changed else Recycled(directions, active)
        if recycled is not None and not recycled.empty:
            self.reduced = beginning_at(self.reduced, *recycled.best(self.reduced.rhs))
        assert self.reduced.coarse is not None
        self._coarse = self.reduced.coarse
        if not problem.held_without_contact:
            self._check_coarse_problem()
        scaled, rhs = self._compliant_terms()
        operator = RecordedOperator(self.reduced, directions, scaled)
        # no penalty: steps out of the range of P would have no curvature, and none occur
        # coupled rows belong to the original frames and lengths
        coupled_rows = (
            None if changed or coupled is None else coupled.on(active | ~problem.conditional)
        )
        base = DualPreconditioner(self.reduced, math.inf, coupled_rows)
        inner: Preconditioner = base if rows is None else ScaledPreconditioner(base, rows[1])
        if recycled is None and directions.count:
            near = ChangedDirections(directions, problem, statuses, frame, scaled, self._coarse)
            inner = BalancedPreconditioner(inner, near)
        preconditioner = DeflatedPreconditioner(inner, recycled, operator)
        self._iterate = it = Iterate(BoxQP(operator, rhs), preconditioner=preconditioner)
        it.largest = directions.largest  # rounding errors come from F, not from its projection
        it.measure_b()
        it.begin()
        it.counts.hessian += 1  # of the right-hand side
        self._weight = it.reduction.norm(self.reduced.offset)
        self._most, self._stalls = STALLED * problem.comm.allreduce(problem.size), False

    def _start(self, multiplier: Array) -> Array:
        """A multiplier of the whole problem as one of this set, in its frames."""
        turn = self.statuses.turn
        result = multiplier if turn is None else turn.turned(multiplier)
        if self._tractions is not None:
            result = result - self._tractions
        if self._compliance is not None:
            # in the answer these components are zero, and C times them may be large
            result = np.where(self._compliance > 0.0, 0.0, result)
        return result

    def _compliant_terms(self) -> tuple[Array | None, Array]:
        """The scaled compliance of the rows, None without, and the right-hand side (dual,)."""
        rhs = self.reduced.rhs
        if self._compliance is None or self._scale is None:
            return None, rhs
        scaled = self._scale**2 * self._compliance
        compliant = scaled * self.reduced.offset
        self._coarse.project_transpose(compliant, compliant)
        return scaled, rhs - compliant

    @property
    def active(self) -> Mask:
        """The active set, (dual,)."""
        return self.statuses.active

    def _check_coarse_problem(self) -> None:
        """Check that the rows of the set hold every body, which a factor of G Gᵀ may not show."""
        probe = np.where(self.problem.conditional & ~self.active, 0.0, self.problem.d)
        if not self._coarse.is_regular(probe):
            raise ArithmeticError("the coarse problem of an active set is singular")

    @property
    def residual(self) -> float:
        """Norm of the residual of conjugate gradients over that of the right-hand side."""
        it = self._iterate
        return it.projected_gradient_norm / (it.b_norm or 1.0)

    def error(self, strained: float) -> float:
        """Estimate of the error of the multipliers in energy norm, over that of the strains.

        The preconditioner M stands for F⁻¹ in rᵀ F⁻¹ r, the square of the error.
        """
        it = self._iterate
        square = max(self.problem.comm.allreduce(float(it.z @ it.free)), 0.0)
        return math.sqrt(square / strained) if strained > 0.0 else float(square > 0.0)

    @property
    def at_round_off(self) -> bool:
        """Whether rounding errors keep the residual from becoming smaller."""
        it = self._iterate
        return it.at_round_off() or it.projected_gradient_norm <= self._smallest or self._stalls

    @property
    def _smallest(self) -> float:
        """Residual that rounding errors of the right-hand side and of its terms leave."""
        it = self._iterate
        floor = max(self.reduced.round_off, ROUNDED * it.largest * self._weight)
        return floor if it.counts.cg <= SHORT else max(floor, OUTSIDE * self._outside)

    @cached_property
    def _outside(self) -> float:
        """Norm of the right-hand side outside the range of P (collective)."""
        outside = np.empty(self.problem.size)
        self._coarse.apply_transpose(self._iterate.qp.b, outside)
        return self._iterate.reduction.norm(outside)

    @property
    def counts(self) -> Counts:
        """Work so far."""
        return replace(self._iterate.counts)

    def solve(
        self, inner: MPRGP, residual: float, monitor: Monitor | None, watch: Watch | None = None
    ) -> Reason:
        """Go on to a relative residual; `inner` limits all iterations on this set.

        `watch` is called with each iterate.
        """
        self._iterate.watch = watch

        def stop(it: Iterate) -> Reason | None:
            tolerance = max(residual * it.b_norm, self._smallest)
            if it.projected_gradient_norm <= tolerance and it.drift > 0.5 * tolerance:
                it.evaluate()  # the recurrences have lost the digits that the tolerance asks for
            if it.projected_gradient_norm <= tolerance:
                return Reason.CONVERGED
            self._stalls = it.counts.cg >= self._most
            return Reason.ROUND_OFF if self._stalls else None

        try:
            return inner.minimise(self._iterate, stop, monitor)
        finally:
            self._iterate.watch = None  # break the circle of references

    def state(self) -> State:
        """The state of the whole problem at the iterate (collective).

        Takes no operator application: the displacements of the directions are stored.
        """
        problem, it = self.problem, self._iterate
        assert problem.coarse is not None
        scale = 1.0 if self._scale is None else self._scale
        of_set = scale * (self.reduced.offset + it.x)
        multiplier = of_set if self._tractions is None else of_set + self._tractions
        assert it.image is not None
        u = self.reduced.displacements_of_offset - it.image
        jumps = problem.residual(u)  # d - F λ
        strained = problem.strain_energy(multiplier, jumps)
        left = jumps if self._compliance is None else scale * (jumps - self._compliance * of_set)
        alpha = -self._coarse.coefficients(left)
        kernel_part = np.empty(problem.size)
        problem.coarse.extend(alpha, kernel_part)
        jumps += kernel_part
        add_motions(problem, alpha, u)
        sizes = problem.spread * problem.bodies.of_rows(problem.lengths(u))
        turn = self.statuses.turn
        if turn is not None:
            multiplier, jumps = turn.back(multiplier), turn.back(jumps)
        return State(multiplier, self.statuses.holding, jumps, sizes, strained, alpha, u)


def _scalings(problem: DualProblem, compliance: Array) -> tuple[Array, Array]:
    """Factors on the rows of the problem, and of the preconditioner, (dual,) (collective).

    A row has a compliance C, and K has a stiffness k against the row; in series they have the
    stiffness k / (1 + C k). Scaled by the root of this reduction, the row counts for less in the
    coarse problem, and the scaled F + C is as stiff as F was. The preconditioner removes the
    scaling again. Where rows of several nodes, which `CoupledRows` weighs, are in the problem, the
    reduction is in the preconditioner alone: scaled rows took no fewer operator applications there.
    """
    rows, result = compliance > 0.0, np.ones(problem.size)
    some_wide = problem.comm.allreduce(int(problem.constraints.wide.any()))
    stiff = (SOFTENED if some_wide else 1.0) * problem.row_stiffness(rows)
    result[rows] = 1.0 / np.sqrt(1.0 + compliance[rows] * stiff)
    return (np.ones(problem.size), result) if some_wide else (result, 1.0 / result)


def _outside(statuses: Statuses, problem: DualProblem) -> Array | None:
    """The prescribed multipliers (dual,), zero on the rows that hold with equality."""
    if statuses.tractions is None:
        return None
    return np.where(problem.conditional & ~statuses.holding, statuses.tractions, 0.0)
