"""Multigrid on the undecomposed problem as a backend of the active-set loop.

On a set, conjugate gradients solve K u = f - C_Aᵀ λ, C_A u = c_A in the displacements that leave
the active rows alone: every residual is projected by Πᵀ, every correction of the V-cycle by Π
(`solver.primal.projector`). A set begins where the last one ended. Prescribed multipliers, for
instance of sliding points, are loads; rows with a compliance are springs (`solver.primal.springs`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from solver.backend import ConstraintHierarchy, SharedPlace, Statuses
from solver.contact.bodies import body_lengths, largest
from solver.errors import QPError
from solver.primal.blocks import in_blocks
from solver.primal.cycle import Cycle, CycleOnSets
from solver.primal.factor import Factor, FactorOptions, row_stiffness
from solver.primal.factor_on_sets import FactorOnSets
from solver.primal.first_set import FirstSet, corrected_set, find_first_set
from solver.primal.gmres import GMRESLimits, gmres
from solver.primal.lanczos import Lanczos
from solver.primal.matrices import Matrices, free_matrices
from solver.primal.merged import MergedSystem, bodies_alone
from solver.primal.preconditioner import Preconditioner
from solver.primal.products import multiply, multiply_transposed
from solver.primal.projector import Projector
from solver.primal.rigid_space import OPTIONS, RigidSpace, lifts_of_means
from solver.primal.springs import CoupledStiffness, Coupling, ProjectedStiffness, Springs
from solver.primal.state import PrimalState
from solver.primal.step import Position, shortened
from solver.problem.constraint_hierarchy import constraint_hierarchy
from solver.problem.constraints.matrix import REDUNDANT
from solver.problem.decomposed import DecomposedProblem
from solver.qp.box_qp import BoxQP
from solver.qp.iterate import Iterate, Watch
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class IterationOptions:
    """The tuned numbers of conjugate gradients on one set."""

    safety: float = 0.5
    """Factor on the smallest Ritz value that estimates the smallest eigenvalue of M⁻¹ K. The Ritz
    value itself is an upper bound."""
    short: int = 6
    unknown: float = 0.1
    """Number of steps from which on the Ritz value is used, and assumed smallest eigenvalue before
    any set has taken so many."""
    stalled: int = 500
    stalled_with_factor: int = 100
    """Steps on one set after which the solve counts as stalled, by rounding errors or a poor cycle;
    with a factor few are needed where the active rows hold all bodies."""


class Multigrid:
    """Solves active sets of one unfactored problem; made for one run of the loop.

    Attributes
    ----------
    u : (unknowns,)
        Initial displacement of the next set.
    patience
        Iterations on a set before a factor may replace the V-cycle.
    """

    def __init__(
        self,
        problem: DecomposedProblem,
        factors: FactorOptions | None = None,
        place: SharedPlace | None = None,
    ) -> None:
        """Matrices of a problem under other loads are taken from the place, or left there."""
        self.problem = problem
        self.comm, self.contact_rows, self.c = problem.comm, problem.inequality, problem.c
        self.factors, self.iterations = factors or FactorOptions(), IterationOptions()
        self._place = place or SharedPlace()
        self.matrices = Matrices.shared(self._place, problem, self.factors)
        self.system: MergedSystem = self.matrices.system
        self.direct = self.matrices.direct
        self.begin_at(self.system.at_rest)
        self._cycle: Cycle | CycleOnSets | None = None
        self._factor: FactorOnSets | None = None
        self._first_set: FirstSet | None = None
        self.motions = self.matrices.floating
        self.smallest_eigenvalue = self.iterations.unknown
        step = self.factors.least_step + self.factors.step * self.system.K.getSize()[0]
        self.patience = max(self.factors.slow, self.matrices.seconds / step)

    def begin_at(self, u: Array, left: Array | None = None) -> None:
        """Set the initial displacement of the next set and, if known, f - K u."""
        self.u, self._left = u, left

    def position(self, jumps: Array) -> Position | None:
        """The initial displacement of the next set with C u - c (rows,), if f - K u is known."""
        return None if self._left is None else Position(self.u, self._left, jumps)

    def left(self) -> Array:
        """f - K u of the initial displacement of the next set (collective)."""
        if self._left is None:
            self._left = self.system.load - self.elastic_forces(self.u)
        return self._left

    def corrected_contact(self, multiplier: Array) -> Mask | None:
        """Contact rows (dual,) that close after a correction on the coarse levels (collective).

        The next set begins with this correction. None where no V-cycle solves.
        """
        cycle, system = self._cycle, self.system
        if system.has_rigid_bodies or not isinstance(cycle, CycleOnSets):
            return None
        begin = Position(self.u, self.left(), multiply(system.C, self.u) - system.c)
        levels, forces = self.matrices.hierarchy, multiplier[system.rows]
        first = corrected_set(system, levels, cycle, begin, forces)
        self.begin_at(first.u)
        self.release()
        return self.closed_in(first)

    def elastic_forces(self, u: Array) -> Array:
        """K u without the rounding errors of rigid motions, (unknowns,) (collective)."""
        return multiply(in_blocks(self.system.K), self.matrices.floating.without(u))

    def first_set(self) -> FirstSet:
        """Contact on coarse levels; all rows if a constraint hierarchy applies (collective)."""
        if self.matrices.peels and self.matrices.direct:
            return FirstSet(np.ones(len(self.system.rows), bool), self.u)
        if self._first_set is None:
            first = find_first_set(self.system, self.matrices.hierarchy)
            if self._cycle is None and first.cycle is not None and not self.direct:
                self._cycle = CycleOnSets(self.system, self.matrices.hierarchy, first.cycle)
            self._first_set = replace(first, cycle=None)  # the cycle changes with the sets
            self.release()
        return self._first_set

    def estimated_contact(self) -> Mask:
        """Contact rows (dual,) that close on coarse levels (collective).

        The next set begins with the displacement of the coarse levels.
        """
        first = self.first_set()
        self.begin_at(first.u)
        return self.closed_in(first)

    def closed_in(self, first: FirstSet) -> Mask:
        """Contact rows (dual,) that are active in a first set."""
        return self.contact_rows & (self.system.on_all_rows(first.active.astype(float)) > 0.5)

    def on_set(self, statuses: Statuses, multiplier: Array | None) -> "PrimalSet":
        """Conjugate gradients on a set, from where the last set ended (collective)."""
        return PrimalSet(self, statuses)

    def cycle(self, projector: Projector) -> Cycle | CycleOnSets:
        """The V-cycle that follows a set; `Cycle` if K is the only level (collective)."""
        if self._cycle is None:
            levels = self.matrices.hierarchy
            alone = not levels.prolongations
            self._cycle = (
                Cycle(levels.operators, (), levels.options)
                if alone
                else CycleOnSets(self.system, levels)
            )
        if isinstance(self._cycle, CycleOnSets):
            self._cycle.adapt_to(projector)
        return self._cycle

    def factor(self, projector: Projector) -> FactorOnSets:
        """The factor that follows the sets (collective).

        Raises
        ------
        ArithmeticError
            The matrix of the set has no factor.
        """
        if self._factor is None:
            self._factor = FactorOnSets(self.system, self.factors)
        self._factor.adapt_to(projector)
        return self._factor

    def prepare_motions(self, projector: Projector, springs: Springs) -> int:
        """Add lifts of means to the rigid motions before the first set (collective).

        Without friction rigid motions lift the means well enough. Problems under other loads share
        the lifts: any displacement will do, and the rigid space adapts all to its set.

        Returns
        -------
        The number of operator applications.
        """
        if self.motions.lifts_means or self.direct or not self.problem.friction.acts:
            return 0
        means = self.comm.allreduce(int(self.system.means.sum()))
        if not 0 < means <= OPTIONS.most_means:
            return 0
        soft = springs.softened(projector)
        lifts = lifts_of_means(self.cycle(soft), soft.narrow)
        self.motions = self.motions.with_lifts(self.system, lifts)
        self._place.leave(replace(self.matrices, floating=self.motions))
        return means

    def give_up_multigrid(self) -> bool:
        """Replace the V-cycle by factors from now on, if affordable; return whether."""
        if self.direct or self.matrices.seconds > self.factors.slow_seconds:
            return False
        self.direct, self._cycle = True, None
        return True

    def hierarchy(self, coarsened: bool) -> ConstraintHierarchy:
        """The constraint hierarchy of thin bodies, whose contact may peel off (collective)."""
        coarsened = coarsened and self.matrices.peels
        if coarsened:
            self.give_up_multigrid()
        return constraint_hierarchy(self.problem, coarsened)

    def release(self) -> None:
        """Free the matrices of the last set: petsc4py leaves them for later."""
        free_matrices(self.comm)

    def forget(self) -> None:
        """Begin at rest: displacements of sets that hardly hold a body are rounding errors."""
        self.begin_at(self.system.at_rest)


class PrimalSet:
    """Conjugate gradients with the contact rows of an active set as equalities.

    Raises
    ------
    ArithmeticError
        The active rows have no factor.
    """

    def __init__(self, backend: Multigrid, statuses: Statuses) -> None:
        self._backend, self.statuses, self._options = backend, statuses, backend.iterations
        turn, system = statuses.turn, backend.system
        self._system = system = system if turn is None else system.turned(turn)
        held = statuses.holding[system.rows] | system.equality
        self._projector = projector = Projector(system, held)
        self._springs = springs = Springs(system, statuses)
        self._prescribed = np.zeros(len(system.rows))
        if statuses.tractions is not None:
            self._prescribed = np.where(held, 0.0, statuses.tractions[system.rows])
        self._load = system.load
        if system.comm.allreduce(int(self._prescribed.any())):
            self._load = system.load - multiply_transposed(system.C, self._prescribed)
        self._stiffness = operator = ProjectedStiffness(system, projector, springs)
        applied = backend.prepare_motions(projector, springs)
        self._rigid = rigid = RigidSpace(system, projector, backend.motions, springs)
        closing = projector.narrow if rigid.holds_means else projector
        jumps = multiply(system.C, backend.u) - system.c
        lifting = -closing.lifting(jumps[closing.rows])
        if rigid.holds_means:
            lifting = rigid.hold_means(backend.u + lifting, system.c) - backend.u
        self._start = backend.u + lifting
        if not rigid.empty:
            left = backend.left() + (self._load - system.load) - springs.forces_at(backend.u)
            self._start += rigid.balance(left, lifting)
        left = self._load - backend.elastic_forces(self._start)
        self._left = left if springs.empty else left - springs.forces_at(self._start)
        self._before: Position | None = None
        if not (backend.direct or backend.problem.friction.acts or system.has_rigid_bodies):
            self._before = backend.position(jumps) or Position(
                self._start, self._left, multiply(system.C, self._start) - system.c
            )
        self._preconditioner = self._make_preconditioner()
        rhs = projector.apply_transpose(self._left)
        may_leave = system.has_rigid_bodies or backend.problem.friction.acts or projector.empty
        if may_leave and rigid.leaves(rhs, system.load):
            raise ArithmeticError("the active rows leave a body that the load drives")
        self._iterate = it = Iterate(BoxQP(operator, rhs), preconditioner=self._preconditioner)
        it.measure_b()
        it.begin()
        it.counts.hessian += 1 + applied  # of the right-hand side
        self._scale = it.reduction.norm(system.load) or it.b_norm or 1.0
        self._first_norm = it.projected_gradient_norm
        # redundant rows leave this share of their forces
        self._held = it.reduction.norm(self._left - rhs)
        self._start_norm = it.reduction.norm(self._start)
        self._lanczos = Lanczos(self._preconditioner.square)
        self._steps, self._stalls, self._before_factor = 0, False, 0

    def _make_preconditioner(self) -> Preconditioner:
        backend, projector, springs = self._backend, self._projector, self._springs
        if backend.direct and springs.empty and self._system is backend.system:
            factor = backend.factor(projector)
            return Preconditioner(factor, projector, self._rigid, False)
        if backend.direct:
            alone = Factor(self._system, projector, backend.factors, springs.stiffness)
            return Preconditioner(alone, projector, self._rigid, False)
        soft = springs.softened(projector)
        cycle = backend.cycle(soft)
        if self._rigid.holds_means:
            soft = soft.narrow
        return Preconditioner(cycle, soft, self._rigid, self._rigid.holds_means)

    @property
    def residual(self) -> float:
        """2-norm of K u - f + Cᵀ λ over that of the load."""
        return self._iterate.projected_gradient_norm / self._scale

    @property
    def at_round_off(self) -> bool:
        """Whether no step can make the residual smaller."""
        return self._stalls or self._iterate.projected_gradient_norm <= self._rounding

    @property
    def _rounding(self) -> float:
        it, eps = self._iterate, float(np.finfo(np.float64).eps)
        moved = self._start_norm + math.sqrt(it.x_square)
        return max(it.round_off, 0.1 * eps * it.largest * moved, 2.0 * REDUNDANT * self._held)

    @property
    def counts(self) -> Counts:
        """Work so far; an application is one of K."""
        return self._iterate.counts

    def error(self, strained: float) -> float:
        """Estimate of the error in energy norm, over that of the strains (collective)."""
        square = self._error_square(self._iterate.free, self._iterate.z)
        return math.sqrt(square / strained) if strained > 0.0 else float(square > 0.0)

    def _error_square(self, r: Array, z: Array) -> float:
        """rᵀ z over the smallest eigenvalue of M⁻¹ K, for z = M⁻¹ r (collective).

        It bounds rᵀ K⁻¹ r. A Ritz value bounds that eigenvalue from above.
        """
        square = float(self._system.comm.allreduce(float(z @ r)))
        return max(square, 0.0) / (self._options.safety * self._smallest_eigenvalue())

    def _smallest_eigenvalue(self) -> float:
        if len(self._lanczos.lengths) >= self._options.short:
            ritz_value = self._lanczos.smallest_ritz_value()
            smallest = self._backend.smallest_eigenvalue
            if ritz_value > 0.0:
                self._backend.smallest_eigenvalue = min(smallest, ritz_value)
        return self._backend.smallest_eigenvalue

    def solve(
        self, inner: MPRGP, residual: float, monitor: Monitor | None, watch: Watch | None = None
    ) -> Reason:
        """Go on to a relative residual; `inner` limits all iterations on this set (collective)."""
        options = self._options

        def see(it: Iterate) -> None:
            if it.counts.cg > self._steps and it.curvature > 0.0:  # also called at the start
                self._lanczos.add(it.slope / it.curvature, self._preconditioner.square)
            self._steps = it.counts.cg
            if watch is not None:
                watch(it)

        def stop(it: Iterate) -> Reason | None:
            tolerance = max(residual * self._scale, self._rounding)
            if it.projected_gradient_norm <= tolerance and it.drift > 0.5 * tolerance:
                it.evaluate()
                self._lanczos = Lanczos(self._preconditioner.square)
            if it.projected_gradient_norm <= tolerance:
                return Reason.CONVERGED
            if self._is_slow() and self._backend.give_up_multigrid():
                self._preconditioner = it.preconditioner = self._make_preconditioner()
                it.evaluate()
                self._lanczos = Lanczos(self._preconditioner.square)
                self._backend.smallest_eigenvalue = options.unknown
                self._before_factor = it.counts.cg
            most = options.stalled_with_factor if self._backend.direct else options.stalled
            self._stalls = it.counts.cg - self._before_factor >= most
            if self._stalls and it.projected_gradient_norm > self._first_norm:
                raise QPError(
                    "the active rows constrain a body too weakly: rounding errors exceed its "
                    "resistance"
                )
            return Reason.ROUND_OFF if self._stalls else None

        self._iterate.watch = see
        try:
            return inner.minimise(self._iterate, stop, monitor)
        finally:
            self._iterate.watch = None

    def solve_coupled(
        self, coupling: Coupling, offset: Array, limits: GMRESLimits, monitor: Monitor | None
    ) -> bool:
        """Solve with friction that follows jumps; return whether the monitor stops (collective).

        Parameters
        ----------
        offset : (rows,); C u of a displacement without such friction.
        """
        it, A = self._iterate, CoupledStiffness(self._stiffness, coupling)
        rhs = it.qp.b - A.forces(multiply(self._system.C, self._start) - offset)
        M = self._preconditioner.coupled(coupling, self._springs)
        steps, shares = gmres(self._system.comm, A.product, M, rhs, limits)
        assert it.image is not None
        it.x += shares @ np.array(steps)
        it.image = it.image + shares @ np.array(A.images)
        it.counts = it.counts + Counts(hessian=len(steps), cg=len(steps))
        it.iterations += len(steps)
        return it.record("cg", monitor)

    def _is_slow(self) -> bool:
        """Whether the set has taken many steps, and many for each digit of the residual."""
        it, options = self._iterate, self._backend.factors
        if it.counts.cg < self._backend.patience or not it.projected_gradient_norm > 0.0:
            return False
        digits = math.log10(max(self._first_norm / it.projected_gradient_norm, 1.0))
        return it.counts.cg >= options.slow_digit * digits

    def state(self) -> PrimalState:
        """Present state of the solve (collective)."""
        backend, system, it = self._backend, self._system, self._iterate
        assert it.image is not None
        u, left = self._start + it.x, self._left - it.image
        left_without_rows = (
            left + (system.load - self._load) + self._springs.forces_at(u)
        )  # f - K u
        backend.begin_at(u, left_without_rows)
        multiplier = self._prescribed.copy()
        multiplier[self._projector.rows] = self._projector.multipliers(left)
        multiplier[self._springs.rows] += self._springs.multipliers(u)
        state = self._state(u, left_without_rows, multiplier, (it.free, it.z))
        return state if self._before is None or backend.direct else self._shortened(state)

    def _shortened(self, state: PrimalState) -> PrimalState:
        """A state with the rows that its shortened step meets; the next set begins there."""
        backend, system = self._backend, self._system
        assert self._before is not None
        is_open = system.normal & ~self.statuses.active[system.rows]
        after = Position(state.u, backend.left(), state.jumps[system.rows])
        end, met = shortened(system.comm, row_stiffness(system), is_open, self._before, after)
        if met is None:
            return state
        backend.begin_at(end.u, end.left)
        return replace(state, met=system.on_all_rows(met.astype(float)) > 0.5)

    def state_at(self, u: Array, left: Array, multiplier: Array) -> PrimalState:
        """State of a displacement near that of this set (collective).

        Parameters
        ----------
        u, left : (unknowns,)
            The displacement and f - K u.
        multiplier : (rows,)
            λ of the rows that do not hold with equality, in frames that are not turned; zero on the
            others.
        """
        system, held, turn = self._system, self._projector, self.statuses.turn
        if turn is not None:
            multiplier = turn.turned(system.on_all_rows(multiplier))[system.rows]
        left_on_rows = left - multiply_transposed(system.C, multiplier)
        forces = multiplier.copy()
        forces[held.rows] = held.multipliers(left_on_rows)
        residual, z = held.apply_transpose(left_on_rows), np.empty_like(u)
        self._preconditioner.apply(residual, np.zeros(0, bool), z)
        return self._state(u, left, forces, (residual, z))

    def _state(
        self, u: Array, left: Array, multiplier: Array, residual: tuple[Array, Array]
    ) -> PrimalState:
        """The state of a displacement with f - K u = left (collective).

        Parameters
        ----------
        residual
            f - K u - Cᵀ λ and its product with M⁻¹.
        """
        backend, system, r = self._backend, self._system, residual[0]
        problem, turn = system.problem, self.statuses.turn
        jumps = multiply(system.C, u) - system.c
        moved = system.largest_in_bodies(u)
        lengths = body_lengths(problem.bodies, largest(system.comm, moved), problem.free_lengths)
        forces, distances = system.on_all_rows(multiplier), system.on_all_rows(jumps)
        square = self._error_square(*residual)
        return PrimalState(
            multiplier=forces if turn is None else turn.back(forces),
            active=self.statuses.holding,
            jumps=distances if turn is None else turn.back(distances),
            sizes=problem.spread * problem.bodies.of_rows(lengths),
            strained=backend.system.strained(u, left),
            lengths=lengths,
            u=u,
            error_square=square,
            errors=self._shares(square, *residual),
            imbalance=math.sqrt(system.comm.allreduce(float(r @ r))),
        )

    def _shares(self, square: float, r: Array, z: Array) -> Array:
        """Share of each body in the squared error of its group, (bodies,) (collective)."""
        bodies = self._system.problem.bodies
        parts = bodies_alone(self._system, z * r)
        by_group = np.maximum(bodies.sum_by_group(parts), 0.0)
        total = float(by_group.sum())
        return np.asarray(square * (by_group / total if total > 0.0 else by_group))[bodies.groups]
