"""Sets of an augmented Lagrangian, each of which lowers a measured function.

An active set that constrains a body too weakly, for instance a ball that can roll in its groove,
moves it far. It then enters other bodies, and the next set is far from the set of the solution. A
bearing of four balls takes sixty sets in this way and does not settle. Here the contact rows are
one-sided springs, as stiff as K is against each row, beside the contact forces λ of the last
iterate:

    L(u) = ½ uᵀ K u - fᵀ u + ½ Σ max(0, λ_i + W_i (C u - c)_i)² / W_i.

1. The rows that press, λ + W (C u - c) > 0, are the set of a Newton step, active with a compliance
   1/W and a traction λ. Faint springs hold the other rows where they are, stiffer ones after short
   steps (Levenberg and Marquardt). Every step of its conjugate gradients is a direction of descent
   of L.
2. An exact line search goes to the least sum of L and the energy of the faint springs along it, so
   that a body stops where it meets others. Along a free motion L is constant, so that rounding
   errors would decide where L alone is least. L is convex and bounded below if the problem has an
   equilibrium, so the steps end (D. Sun, J. Han, 1997).
3. If the set stays the same, it is tried with equality. If its answer needs no other set, it is the
   solution. Otherwise, and where the gradient of L is small beside that at the first step with
   these forces, λ becomes the force of the springs, which is the method of multipliers: it
   converges for every convex problem (R. T. Rockafellar, 1976). The set itself need not settle: if
   an unloaded roller lies loosely between its races, other rows press in each step.

Friction has springs that yield at the slip limit (`solver.primal.augmented_rows`). The limits of
Coulomb's law change with λ, and with the forces of a set that holds with equality, where Newton's
method with limits that follow the springs (`solver.primal.coupled`) does not succeed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver.backend import Statuses
from solver.contact.active_set import ActiveSetMethod
from solver.contact.active_set_update import ActiveSetUpdate, SetRules
from solver.contact.monitoring import on_active_set
from solver.contact.solve_on_set import Outcome, StoppingTest, solve_on_set
from solver.errors import QPError
from solver.primal.augmented_rows import rows_of
from solver.primal.backend import Multigrid, PrimalSet
from solver.primal.factor import row_stiffness
from solver.primal.line_search import minimum_along
from solver.primal.products import multiply, multiply_transposed
from solver.primal.projector import Projector
from solver.primal.state import PrimalState
from solver.primal.step import Position
from solver.qp.mprgp import MPRGP
from solver.qp.result import Counts, Monitor, Reason
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class AugmentedOptions:
    """The tuned numbers of the method."""

    stiffness: float = 1.0
    """W over the stiffness of K against a row. With stiffer springs conjugate gradients converge
    more slowly."""
    reduction: float = 0.3
    """Reduction of the residual in a Newton step."""
    faint: float = 1e-8
    stiffest: float = 0.1
    """Least and largest stiffness over W of the springs that hold open rows in their last position:
    a proximal term. Without it steps along nearly free motions are so long that they leave no
    digits; with stiffer springs bodies need many steps to their places. Half a bearing of seven
    rollers in the plane was not certified by line searches without them."""
    short: float = 0.1
    long: float = 0.5
    """Step lengths below and above which these springs become ten times as stiff or as soft."""
    first: float = 1e-3
    balanced: float = 0.1
    least_gradient: float = 1e-10
    """Gradient of L, over the load, up to which the first forces are kept; later gradients, over
    that after a change of the forces; and gradient, over the load, that is always small enough.
    Half a bearing of three rollers, of three balls and of four balls (`tests/bearings.py`) had no
    answer by multigrid if the set had to settle, and takes 137, 50 and 45 operator applications
    now."""
    far: float = 0.1
    """Gradient of L, over the load, down to which the limits of Coulomb's law follow the forces in
    each step, and no set is tried with equality. Half a bearing of three rollers takes 58 operator
    applications; with limits that follow until λ changes first it takes 66."""
    most_far: int = 20
    """Number of steps after which the limits follow λ alone: a hook that all points of a peg let
    slide was as far after 300 steps, since limits that change lower nothing. With 12 and 20 steps
    it takes the same."""
    settling: float = 0.1
    """Change of μ λ_n since the last change of forces, over its distance to the limits, below which
    the limits move on."""
    full: float = 1e-2
    """Largest distance of a step length from one at which the set of the step counts as settled."""
    least: float = 1e-12
    """Step length up to which the set counts as settled, too: rounding errors leave no direction of
    descent."""
    most_stuck: int = 4
    """Number of such steps in a row after which no digits are left."""
    most_steps: int = 300
    """Largest number of Newton steps."""


@dataclass(frozen=True, eq=False)
class LagrangianIterate(Position):
    """A displacement and the contact forces of its Lagrangian."""

    forces: Array  # (rows,)
    """λ."""


class AugmentedLagrangian:
    """The method for one problem, after active sets that did not settle.

    Parameters
    ----------
    sets
        The method of these sets: its test, limit and monitor serve here, too.
    """

    def __init__(
        self,
        backend: Multigrid,
        sets: ActiveSetMethod[PrimalState],
        options: AugmentedOptions | None = None,
    ) -> None:
        self.backend, self.system = backend, backend.system
        self._sets, self.test = sets, sets.test
        self.options = options or AugmentedOptions()
        stiffness = self.options.stiffness * row_stiffness(self.system)
        self.rows = rows_of(self.system, stiffness, sets.law)
        levels = backend.hierarchy(coarsened=False)
        update = ActiveSetUpdate(backend, levels, sets.law, sets.options, early_release=False)
        self._rules = SetRules(update, sets.options.first_reduction, coarsened=True)
        self._tied = Projector(self.system, self.system.equality)
        self._counts, self._steps, self._faint = Counts(), 0, self.options.faint

    def solve(self, u: Array) -> Outcome[PrimalState]:
        """Take Newton steps from a displacement until an answer is accepted (collective).

        Parameters
        ----------
        u : (unknowns,)

        Returns
        -------
        The last outcome, with all work; its reason is None after the largest number of steps.
        """
        self._counts, backend, tied = self._sets.work_before, self.backend, self._tied
        u = u - tied.lifting((multiply(self.system.C, u) - self.system.c)[tied.rows])
        backend.begin_at(u)
        now = self._iterate(u, backend.left(), np.zeros(len(self.system.rows)))
        return self._descend(now)

    def _descend(self, now: LagrangianIterate) -> Outcome[PrimalState]:
        """The steps of `solve` (collective)."""
        backend, rows, far = self.backend, self.rows, self.rows.moves
        rows.begin(rows.forces(self._p(now)))
        outcome: Outcome[PrimalState] = Outcome(None, None, self._statuses(now), self._counts)
        load, stuck = self._norm(self.system.load), 0
        limit = self.options.first * load
        for number in range(1, self.options.most_steps + 1):
            self._steps = number
            firm = rows.firm(self._p(now))
            solved = self._on_set(now)
            if solved.reason is not None or solved.state is None:
                return solved
            outcome, length = solved, self._length(now, solved.state)
            now = self._moved(now, solved.state, length)
            self._damp(length)
            stuck = stuck + 1 if length <= self.options.least else 0
            full = abs(length - 1.0) <= self.options.full
            settled = full and not self._differ(firm, rows.firm(self._p(now)))
            forces, exact, gradient = rows.forces(self._p(now)), None, self._gradient(now)
            far = far and gradient > self.options.far * load and number < self.options.most_far
            if far:
                rows.begin(forces)
            if not stuck and not settled and gradient > limit:
                continue
            state = self._last.state_at(now.u, now.left, rows.admissible(forces))
            if settled and not far:
                solved, exact = self._with_equality(now)
                if solved.reason is not None:
                    return solved
            if self.test.required_reduction(state) <= 1.0 and self.test.accept(state):
                return replace(outcome, state=state, reason=Reason.ACCEPTED, counts=self._counts)
            if stuck > self.options.most_stuck:  # rounding errors leave no direction of descent
                break
            now = exact or replace(now, forces=forces)
            backend.begin_at(now.u, now.left)
            rows.advance(now.forces, self.options.settling, accurate=exact is not None)
            limit = self.options.balanced * self._gradient(now)
            limit = max(limit, self.options.least_gradient * load)
        return replace(outcome, counts=self._counts)

    def _norm(self, x: Array) -> float:
        """The 2-norm of local parts (collective)."""
        return math.sqrt(self.system.comm.allreduce(float(x @ x)))

    def _gradient(self, now: LagrangianIterate) -> float:
        """2-norm of the gradient of L on displacements that leave tied rows alone (collective)."""
        forces = multiply_transposed(self.system.C, self.rows.forces(self._p(now)))
        return self._norm(self._tied.apply_transpose(now.left - forces))

    def _damp(self, length: float) -> None:
        """Choose the faint springs of the next step by the length of the last one."""
        options = self.options
        if length < options.short:
            self._faint = min(10.0 * self._faint, options.stiffest)
        elif length > options.long:
            self._faint = max(0.1 * self._faint, options.faint)

    def _iterate(self, u: Array, left: Array, forces: Array) -> LagrangianIterate:
        return LagrangianIterate(u, left, multiply(self.system.C, u) - self.system.c, forces)

    def _p(self, now: LagrangianIterate) -> Array:
        """λ + W (C u - c), (rows,)."""
        return np.asarray(now.forces + self.rows.W * now.jumps)

    def _differ(self, one: Mask, other: Mask) -> bool:
        """Whether any row differs (collective)."""
        return bool(self.system.comm.allreduce(int((one != other).any())))

    def _statuses(self, now: LagrangianIterate) -> Statuses:
        """Rows with a compliance; those without a spring hold their last position (collective)."""
        on_all_rows, rows, jumps = self.system.on_all_rows, self.rows, now.jumps
        forces, springs, turn = rows.springs(self._p(now))
        springs = np.maximum(springs, self._faint * rows.W)
        if turn is not None:
            jumps = turn.turned(on_all_rows(jumps))[self.system.rows]
        compliance = np.divide(1.0, springs, out=np.zeros_like(springs), where=rows.rows)
        return Statuses(
            on_all_rows(rows.rows.astype(float)) > 0.5,
            tractions=on_all_rows(np.where(rows.rows, forces - springs * jumps, 0.0)),
            turn=turn,
            compliance=on_all_rows(compliance),
        )

    def _on_set(
        self, now: LagrangianIterate, solve: Callable[[PrimalSet], Reason] | None = None
    ) -> Outcome[PrimalState]:
        """The solution on the set of an iterate, without a state where nothing holds some body.

        Collective. By a few conjugate gradients unless another solve is given.
        """
        statuses = self._statuses(now)
        try:
            self._last = on_set = self.backend.on_set(statuses, None)
            ended = (solve or self._iterated)(on_set)
        except (ArithmeticError, QPError):
            return Outcome(None, None, statuses, self._counts)
        self._counts = self._counts + on_set.counts
        self.backend.release()
        goes_on = ended.converged or ended is Reason.ROUND_OFF
        return Outcome(None if goes_on else ended, on_set.state(), statuses, self._counts)

    def _iterated(self, on_set: PrimalSet) -> Reason:
        tolerance = self.options.reduction * on_set.residual
        return on_set.solve(self._inner(), tolerance, self._monitor(on_set.statuses))

    def _with_equality(
        self, now: LagrangianIterate
    ) -> tuple[Outcome[PrimalState], LagrangianIterate | None]:
        """The solve on the firm rows with equality, and its iterate if its law moves (collective).

        No iterate where the set is another one than that of the solution under this law.
        """
        rows, system = self.rows, self.system
        on_all_rows, law, p = system.on_all_rows, rows.law, self._p(now)
        active = on_all_rows((rows.normal & rows.firm(p)).astype(float)) > 0.5
        forces, jumps = on_all_rows(rows.forces(p)), on_all_rows(now.jumps)
        statuses = law.initial(active, forces, ahead=False, jumps=jumps)
        test = StoppingTest[PrimalState](lambda _: 1.0, lambda _: True) if rows.moves else self.test
        try:
            on_set = self.backend.on_set(statuses, None)
            rules = replace(self._rules, update=replace(self._rules.update, law=law))
            outcome = solve_on_set(on_set, rules, test, self._inner(), self._monitor(statuses))
        except (ArithmeticError, QPError):
            return Outcome(None, None, statuses, self._counts), None
        self._counts = self._counts + on_set.counts
        self.backend.release()
        outcome, state = replace(outcome, counts=self._counts), outcome.state
        if not rows.moves or outcome.reason not in (None, Reason.ACCEPTED) or state is None:
            return outcome, None
        outcome = replace(outcome, reason=None)
        if self._differ(outcome.following.holding, statuses.holding):
            return outcome, None
        if self.test.required_reduction(state) <= 1.0 and self.test.accept(state):
            return replace(outcome, reason=Reason.ACCEPTED), None
        forces = rows.forces(np.where(rows.rows, state.multiplier[system.rows], 0.0))
        return outcome, self._iterate(state.u, self.backend.left(), forces)

    def _inner(self) -> MPRGP:
        inner = self._sets.inner
        return replace(inner, max_iterations=inner.max_iterations - self._counts.inner)

    def _monitor(self, statuses: Statuses) -> Monitor | None:
        rows = int(self.system.comm.allreduce(int(statuses.active.sum())))
        return on_active_set(self._sets.monitor, self._steps, rows, self._counts.inner)

    def _length(self, now: LagrangianIterate, state: PrimalState) -> float:
        """The share of a step with the least L and energy of faint springs (collective)."""
        comm, step, normal, p = self.system.comm, state.u - now.u, self.rows.normal, self._p(now)
        image = multiply(self.system.C, state.u) - self.system.c - now.jumps
        rates = self.rows.W * image
        faint = self._faint * float(np.where(self.rows.firm(p), 0.0, rates) @ image)
        slope = -float(step @ now.left)
        curvature = float(step @ (now.left - self.backend.left())) + faint
        friction = self.rows.along(p, rates)

        def rest(t: float) -> tuple[float, float]:
            """Slope and curvature without the springs of contact."""
            more, bend = friction(t)
            return slope + curvature * t + more, curvature + bend

        return minimum_along(comm, rest, p[normal], rates[normal], image[normal])

    def _moved(
        self, now: LagrangianIterate, state: PrimalState, length: float
    ) -> LagrangianIterate:
        """The iterate after a share of a step, from which the next set begins (collective)."""
        u = now.u + length * (state.u - now.u)
        left = now.left + length * (self.backend.left() - now.left)
        self.backend.begin_at(u, left)
        return self._iterate(u, left, now.forces)
