"""SMALBE-M around MPRGP to a certified answer.

`solve_as_in_the_paper` is the algorithm of Kružík et al. (2020): the rules of its section
5.1, MPRGP with the named expansion, from zero, no preconditioner. `solve_by_smalbe` goes on from
the last active set where active sets do not settle. It uses rules of this solver and the
preconditioner of the active sets, and tries active sets once more between its outer iterations.
Friction is no part of the paper: with it `solver.method: smalbe` does the same from zero and
without active sets.

With friction the friction forces lie in discs whose radii are the slip limits. With given limits
the problem is convex, as without friction. The limits of Coulomb's law follow from the contact
forces: an outer iteration begins with new limits once the contact forces under the present limits
are accurate enough (`solver.contact.slip_limits`). The certificate of the answer is judged by the
limits of the answer itself.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from solver.contact.active_set import Start
from solver.contact.bodies import body_lengths
from solver.contact.checkpoint import Saver
from solver.contact.slip_limits import SlipLimits
from solver.contact.solution import Solution
from solver.contact.solve_on_set import Outcome
from solver.problem.task import Task
from solver.qp.operators import estimate_norm
from solver.qp.outer_state import Hooks, OuterState, Restart
from solver.qp.result import Counts, Reason
from solver.qp.separable_qp import SeparableQP
from solver.qp.smalbe import SMALBE, OuterIterations
from solver.tfeti.active_set_problem import State
from solver.tfeti.admissible import admissible_set
from solver.tfeti.dual import DualProblem
from solver.tfeti.methods.answers import certified_answer
from solver.tfeti.methods.by_active_sets import solve_from
from solver.tfeti.preconditioner import DualPreconditioner
from solver.tfeti.projected import ProjectorEquality
from solver.tfeti.recovery import interface_displacements, kernel_coefficients
from solver.vectors import Array

METHOD = "smalbe"


@dataclass(frozen=True)
class SmalbeOptions:
    """The tuned numbers of SMALBE-M between active sets and with friction."""

    norm_accuracy: float = 1e-2
    """Relative change at which the power method for ‖PFP‖ ends; accurate enough for penalty and
    M."""
    settling: float = 0.2
    """Accuracy of contact forces from which the slip limits s follow: μ λ_n changes by less than
    this share of |s - μ λ_n|, and forces out of balance are below this share of the contact forces.
    Without the latter a plate that touches a block without any load and is moved along it was not
    certified."""
    patience: int = 16
    """Outer iterations after which active sets are tried once more; after each failure twice as
    many. Tried after every 16 they took 8,304 operator applications in an increment that ended
    without a certificate (`fuzz_histories 1 --first 710042`)."""


OPTIONS = SmalbeOptions()


def solve_as_in_the_paper(task: Task[DualProblem]) -> Solution:
    """The paper's algorithm from zero, or from the state of an interrupted solve (collective)."""
    problem = task.problem
    assert problem.coarse is not None
    norm, multiplications = estimate_norm(problem.projected)
    saver = Saver(task.checkpoint, Counts(norm_estimation=multiplications))
    rules = SMALBE.paper(replace(task.inner, norm=norm, atol=problem.round_off))
    frozen = _Frozen(
        problem,
        rules,
        ProjectorEquality(problem.coarse),
        Hooks(task.monitor, saver, lambda: saver.due),
    )
    answer = _to_a_certificate(task, frozen, frozen.begin(None, None, task.restart()), None)
    return replace(answer, counts=Counts(norm_estimation=multiplications) + answer.counts)


def solve_by_smalbe(
    task: Task[DualProblem],
    before: Outcome[State] | None,
    restart: Restart | None,
    active_sets: bool = True,
) -> Solution:
    """Go on where active sets did not settle, or from an interrupted SMALBE (collective).

    Parameters
    ----------
    before
        Last state of the active sets, and their work.
    active_sets
        Whether to try active sets between outer iterations.
    """
    problem = task.problem
    assert problem.coarse is not None
    norm, multiplications = estimate_norm(problem.projected, OPTIONS.norm_accuracy)
    norm = norm or 1.0  # F is zero if only held nodes touch a rigid body
    set_work = before.counts if before is not None else Counts()
    counts = set_work + Counts(norm_estimation=multiplications)
    preconditioner = DualPreconditioner(problem, norm)
    inner = replace(
        task.inner,
        norm=norm,
        atol=problem.round_off,
        preconditioner=preconditioner,
        max_iterations=task.inner.max_iterations - counts.inner,
    )
    start = before.state if before is not None else None
    # with friction and -d, touching bodies that no load moves stay in place and end at once
    rest = -problem.d if problem.friction.acts else None
    x0, multiplier0 = start.homogenised(problem) if start else (None, rest)
    saver = Saver(task.checkpoint, counts)
    sets = _ActiveSetsBetween(replace(task, inner=inner), saver) if active_sets else None
    frozen = _Frozen(
        problem,
        SMALBE(inner),
        ProjectorEquality(problem.coarse, preconditioner.set_penalty),
        Hooks(
            task.monitor,
            lambda state: saver.after(sets.set_work if sets else Counts())(state),
            lambda: saver.due,
        ),
    )
    answer = _to_a_certificate(task, frozen, frozen.begin(x0, multiplier0, restart), sets)
    return replace(answer, counts=counts + answer.counts)


class _Frozen:
    """The quadratic programs of a problem: one without friction, otherwise one per slip limits."""

    def __init__(
        self, problem: DualProblem, rules: SMALBE, equality: ProjectorEquality, hooks: Hooks
    ) -> None:
        self.rules = rules
        self._problem, self._equality, self._hooks = problem, equality, hooks
        self._limits: SlipLimits | None = None

    def begin(
        self, x0: Array | None, multiplier0: Array | None, restart: Restart | None
    ) -> OuterIterations:
        """Outer iterations from an initial iterate, whose contact forces give the slip limits."""
        problem = self._problem
        if problem.friction.acts:
            first = x0 if restart is None else restart.x
            force = problem.offset if first is None else problem.offset + first
            self._limits = SlipLimits(problem.friction, problem.comm, force)
        return self._program(x0, multiplier0, restart)

    def following(self, iterations: OuterIterations, state: OuterState) -> OuterIterations | None:
        """Outer iterations with the next slip limits, if these are due (collective)."""
        limits, problem = self._limits, self._problem
        if limits is None or not limits.depend_on_forces:
            return None
        force = problem.offset + state.x
        pressing_forces = force[problem.inequality]
        pressing = math.sqrt(problem.comm.allreduce(float(pressing_forces @ pressing_forces)))
        share = OPTIONS.settling
        if state.residual_norm > share * pressing or not limits.settles(force, share):
            return None
        limits.advance(force)
        return self._program(None, None, iterations.with_another_set())

    def _program(
        self, x0: Array | None, multiplier0: Array | None, restart: Restart | None
    ) -> OuterIterations:
        problem, limits = self._problem, self._limits
        feasible = admissible_set(problem, None if limits is None else limits.values)
        return self.rules.begin(
            SeparableQP(problem.projected, problem.rhs, feasible), self._equality,
            x0=x0, multiplier0=multiplier0, restart=restart, hooks=self._hooks,
        )  # fmt: skip


def _to_a_certificate(
    task: Task[DualProblem],
    frozen: _Frozen,
    iterations: OuterIterations,
    sets: "_ActiveSetsBetween | None",
) -> Solution:
    """Run outer iterations until their answer, or that of active sets between them, is certified.

    Parameters
    ----------
    sets
        Active sets to try between outer iterations; None for none.
    """
    judge, reason = _Judge(task), Reason.MAX_OUTER_ITERATIONS
    set_work = Counts()
    while iterations.outer < frozen.rules.max_outer:
        state = iterations.step(own_test=True)
        ended = iterations.interrupted
        if ended is None and judge.accepts(state):
            ended = Reason.ACCEPTED
        if ended is None and sets is not None and sets.are_due(state):
            outcome, answer = sets.solve_from(state)
            set_work = sets.set_work
            if answer is not None and outcome.reason is not None:
                counts = set_work + iterations.result(outcome.reason).counts
                return replace(answer, counts=counts, reason=outcome.reason, method=METHOD)
        ended = ended or iterations.ended(own_test=True)
        if ended is not None:
            reason = ended
            break
        iterations.update()
        iterations = frozen.following(iterations, state) or iterations
    result = iterations.result(reason)
    answer = judge.answer
    if answer is None or reason is not Reason.ACCEPTED:
        answer = judge.certify(result.x, result.multiplier)
    return replace(answer, counts=set_work + result.counts, reason=reason, method=METHOD)


class _Judge:
    """Certify answers of outer iterations.

    An answer is certified only if its jumps and its penetration are small enough.

    Attributes
    ----------
    answer
        The last answer that was certified, or None.
    """

    def __init__(self, task: Task[DualProblem]) -> None:
        self.answer: Solution | None = None
        self._problem, self._rule = task.problem, task.rule
        self._lengths: Array | None = None
        self._next_certificate = self._failures = 0

    def certify(self, x: Array, force: Array) -> Solution:
        """The certified answer of an iterate and its force Cᵀ μ."""
        answer = certified_answer(self._problem, x, force, self._rule.tolerance)
        self._lengths = body_lengths(
            self._problem.bodies, answer.measures.deformations, self._problem.free_lengths
        )
        self.answer = self._rule.judge(answer)
        return self.answer

    def accepts(self, state: OuterState) -> bool:
        """Whether the answer of an outer iteration meets the tolerance (collective)."""
        if not self._is_near(state) or state.counts.hessian < self._next_certificate:
            return False
        tolerance = self._rule.tolerance
        if self.certify(state.x, state.transposed_multiplier).converged:
            return True
        if self._rule.tolerance == tolerance:
            pause = min(self._failures, self._rule.patience)
            self._next_certificate = state.counts.hessian + pause
            self._failures += 1
        return False

    def _is_near(self, state: OuterState) -> bool:
        """Whether jumps and penetration, -gradient by the recovery's identity, are small enough."""
        problem = self._problem
        gap = np.where(problem.inequality, np.maximum(-state.gradient, 0.0), np.abs(state.gradient))
        gap[problem.friction.sliding(problem.offset + state.x)] = 0.0
        if self._lengths is None:
            self._lengths = _lengths(problem, state)
        share = gap / (problem.spread * problem.bodies.of_rows(self._lengths))
        worst = problem.comm.allreduce(float(share.max(initial=0.0)), op=MPI.MAX)
        return worst <= self._rule.tolerance


class _ActiveSetsBetween:
    """Active sets that begin with the active set of an outer iteration.

    They are tried after the first outer iteration if contact alone holds a body (the sets before
    had begun with a guess), and later if SMALBE is slow.

    Attributes
    ----------
    set_work
        Work of the active sets so far.
    """

    def __init__(self, task: Task[DualProblem], saver: Saver) -> None:
        self.set_work = Counts()
        self._task, self._saver = task, saver
        self._residuals: list[float] = []

    def are_due(self, state: OuterState) -> bool:
        """Whether to try active sets after this outer iteration."""
        self._residuals.append(state.residual_norm)
        sizes, outer = self._residuals, len(self._residuals)
        patience = OPTIONS.patience
        tries, rest = divmod(outer, patience)
        slow = not rest and tries.bit_count() == 1 and sizes[-1] > 0.1 * sizes[-patience // 2]
        return slow or (outer == 1 and not self._task.problem.held_without_contact)

    def solve_from(self, state: OuterState) -> tuple[Outcome[State], Solution | None]:
        """The outcome of the active sets, and the answer if they settle (collective)."""
        problem = self._task.problem
        assert problem.lower is not None

        def save(set_state: Callable[[], State], set_work: Counts) -> None:
            if self._saver.due:
                self._saver(
                    Restart(
                        state.iteration, *set_state().homogenised(problem), state.rho, state.M,
                        state.target, -math.inf, (), state.counts + set_work,
                    )
                )  # fmt: skip

        active = problem.inequality & (state.x > problem.lower)
        start = Start(active, problem.offset + state.x)
        outcome, answer = solve_from(self._task, start, save)
        self.set_work = self.set_work + outcome.counts
        return outcome, answer


def _lengths(problem: DualProblem, state: OuterState) -> Array:
    """Estimate of the displacement of each body, (bodies,), from an iterate far from the answer."""
    multiplier = problem.offset + state.x
    alpha = kernel_coefficients(problem, multiplier, state.transposed_multiplier)
    return problem.lengths(interface_displacements(problem, multiplier, alpha))
