"""Active sets with multigrid on the undecomposed problem, to a certified answer."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from petsc4py import PETSc

from solver.backend import SharedPlace, Statuses
from solver.contact.active_set import Start
from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.checkpoint import Saver
from solver.contact.law import ContactLaw
from solver.contact.retries import solve_with_retries
from solver.contact.solution import Guess, Solution
from solver.contact.solve_on_set import Outcome
from solver.contact.stopping import CertificateTest, StoppingRule
from solver.primal.augmented import AugmentedLagrangian
from solver.primal.backend import Multigrid
from solver.primal.coupled import CoupledLagrangian
from solver.primal.factor import FactorOptions
from solver.primal.first_set import FirstSet
from solver.primal.matrices import freed_matrices
from solver.primal.products import multiply
from solver.primal.recovery import recover
from solver.primal.state import PrimalState
from solver.problem.answer import certified, without_rounded_forces
from solver.problem.certify import friction_residual
from solver.problem.contact_law import SURE
from solver.problem.decomposed import DecomposedProblem
from solver.problem.task import Task, saved_by
from solver.qp.outer_state import Restart
from solver.qp.result import Counts, Reason
from solver.vectors import Array, Mask

METHOD = "primal"


@dataclass(frozen=True)
class MultigridSetOptions:
    """The numbers of `ActiveSetOptions` that multigrid changes."""

    first_reduction: float = 0.1
    """A V-cycle takes two or three steps for it; decisions with a larger residual are often
    undone."""
    sets_before_levels: int = 0
    """Each set costs a factor. A slender strip that lifts off takes 48 operator applications if it
    first tries eight sets on all rows, and 34 with the hierarchy."""
    significant: float = 0.01
    """Without friction. The estimate of the error bounds it on the whole body; at the contact it is
    mostly far smaller. With 0.1 and 0.01 a bolted flange takes 49 and 41 operator applications, of
    degree 2 48 and 44, three bodies 58 and 50, a ribbed panel of 30,135 unknowns 104 and 79, a bar
    in a vee 67 and 64. Some take more: the pin in a lug 36 and 39, a ribbed panel of 128,112
    unknowns 109 and 119, an eye on a pin 41 and 47, a graded block 98 and 105. None of 25 parts
    takes more than one set more."""
    negligible: float = 0.03
    """Without friction, on one body, over the tolerance of the certificate, of which no more than
    1e-6 counts. Of several bodies each is certified by its own load. A slotted tube that can turn
    in a vee (9,801 unknowns) carries 1e-10 of its largest contact force in the node that stops it:
    it takes 34 operator applications, and 126 if this releases the node."""
    peeling: int = 2
    """Sets of large thin bodies, which then go on by factors on the constraint hierarchy. In four
    sets in a row a lifted plate of degree 2 (72,225 unknowns) may gain some rows: it took 513
    operator applications then, and takes 49."""
    most_sets: int = 40
    """With friction: a belt that friction does not quite hold takes more than 36 before it is known
    to slide, and none of 51 random scenes and of 16 drawn assemblies whose sets settle takes more
    than 24. Where they do not settle, the augmented Lagrangian takes over."""
    settling: int = 5
    """With friction. After eight sets half a bearing takes 62 operator applications, and 56 after
    five; a hook on a peg with a coefficient of 0.3 44 and 28, a collet 64 and 58."""

    def of(self, sets: ActiveSetOptions, backend: Multigrid, tolerance: float) -> ActiveSetOptions:
        """The options of all sets of a solve to a tolerance of the certificate."""
        first, levels, matrices = self.first_reduction, self.sets_before_levels, backend.matrices
        options = replace(sets, first_reduction=first, sets_before_levels=levels)
        if backend.problem.friction.acts:
            return replace(
                options,
                most_sets=min(sets.most_sets, self.most_sets),
                settling=min(sets.settling, self.settling),
                insists=False,
                may_peel=not matrices.peels,
            )
        slow, alone = backend.factors.slow_seconds, backend.problem.bodies.count == 1
        return replace(
            options,
            significant=self.significant,
            negligible=self.negligible * min(tolerance, 1e-6) if alone else sets.negligible,
            may_peel=matrices.peels or matrices.seconds > slow,
            peeling=sets.peeling if matrices.peeling(slow) is None else self.peeling,
        )


def solve_by_multigrid(
    task: Task[DecomposedProblem],
    guess: Guess | None,
    restart: Restart | None,
    factors: FactorOptions | None = None,
) -> Solution:
    """Solve by active sets, from the contact on coarse levels or from a guess (collective).

    A guess whose sets fail is dropped: under other loads its rows may leave bodies without support.

    Parameters
    ----------
    guess
        The answer to a nearly equal problem.
    restart
        State of an interrupted solve.
    factors
        Limits for the use of a factor in place of the V-cycle.

    Raises
    ------
    ArithmeticError
        The active sets found no answer, or a node with friction is tied to a moving rigid body.
    """
    if _rubs_at_tied_nodes(task.problem):
        raise ArithmeticError(
            "friction at nodes that are tied to a moving rigid body has two rows for one motion, "
            "which multigrid does not tell apart"
        )
    with freed_matrices(task.problem.comm):
        try:
            if guess is None or restart is not None:
                return _solve(task, None, restart, factors)
            try:
                return _solve(task, guess, None, factors)
            except ArithmeticError:
                return _solve(task, None, None, factors)
        except PETSc.Error as error:  # a factor of a coarse level or of the active rows
            raise ArithmeticError("a matrix of the multigrid has no factor") from error


def _rubs_at_tied_nodes(problem: DecomposedProblem) -> bool:
    """Whether a node with friction is tied to a rigid body that may move (collective).

    The tied row and the tangential rows of a node differ in the motions of the rigid body alone,
    which have no stiffness. On three such scenes (`test_tied_to_rigid.py`) multigrid ended without
    a certificate after 8 and 948 operator applications, and with one after 718; Total FETI takes 22
    to 42.
    """
    tied, rubbing = problem.shared.tied, problem.shared.friction.rows
    nodes = np.concatenate(problem.comm.allgather(tied.nodes[tied.on_rigid]))
    return problem.comm.allreduce(int(np.isin(rubbing.nodes, nodes).any())) > 0


def _solve(
    task: Task[DecomposedProblem],
    guess: Guess | None,
    restart: Restart | None,
    factors: FactorOptions | None,
) -> Solution:
    """Run `solve_by_multigrid` without handling of errors."""
    place = task.problem.place or SharedPlace()
    backend = Multigrid(task.problem, factors, place)
    before = Counts() if restart is None else restart.counts
    problem = task.problem
    sums = [np.abs(f).sum(axis=0) for f in problem.forces]
    loads = problem.comm.allreduce(problem.bodies.sum_members(sums))
    test = CertificateTest(
        task.rule,
        partial(_certified, backend, task.rule),
        partial(_required_reduction, backend, task.rule, loads),
    )
    method = task.active_set_method(backend, test, saved_by(Saver(task.checkpoint, before)))
    options = MultigridSetOptions().of(method.options, backend, task.rule.tolerance)
    method = replace(method, options=options, law=method.law.locking())
    frictionless = not problem.friction.acts
    peeling = backend.matrices.peeling(backend.factors.slow_seconds) if frictionless else None
    statuses = None
    if restart is not None:
        active = problem.inequality & (restart.multiplier > 0.5)
    elif guess is not None:
        active = problem.inequality & (guess.multiplier > 0.0)
        if guess.displacements is not None:
            backend.begin_at(backend.system.from_subdomains(guess.displacements))
    else:
        first = backend.first_set()
        backend.begin_at(first.u)
        active = backend.closed_in(first)
        statuses = _statuses_of(backend, method.law, first, active)
    near = restart.x if restart is not None else guess.multiplier if guess is not None else None
    jumps = None if guess is None else guess.jumps
    start = Start(active, None if frictionless else near, statuses=statuses, jumps=jumps)
    outcome = solve_with_retries(method, start)
    if outcome.reason is None and peeling is not None:
        place.leave(peeling)  # also for other loads
        backend = Multigrid(problem, factors, place)
        method = replace(method.after(outcome), backend=backend).with_options(may_peel=True)
        outcome = solve_with_retries(method, Start(backend.estimated_contact()))
    if outcome.reason is Reason.ROUND_OFF:  # of displacements from which the sets began
        backend.forget()
        active, last = problem.inequality & outcome.following.active, outcome
        start = Start(active, statuses=outcome.following)
        outcome = solve_with_retries(method.after(last), start)
        if outcome.reason is not Reason.ACCEPTED:
            outcome = replace(last, counts=outcome.counts)
    if outcome.reason is None:
        follows = problem.comm.allreduce(int((problem.friction.coefficients > 0.0).any()))
        made = CoupledLagrangian if follows else AugmentedLagrangian
        lagrangian = made(backend, method.after(outcome))
        outcome = lagrangian.solve(backend.first_set().u)
    return _answer(test, outcome, before)


def _statuses_of(
    backend: Multigrid, law: ContactLaw, first: FirstSet, active: Mask
) -> Statuses | None:
    """Statuses with the friction and the slips of the first set; None if there is none.

    Parameters
    ----------
    active : (dual,)
        Its contact rows.
    """
    if first.multiplier is None or not backend.problem.friction.acts:
        return None
    system = backend.system
    jumps = system.on_all_rows(multiply(system.C, first.u) - system.c)
    return law.initial(active, system.on_all_rows(first.multiplier), ahead=True, jumps=jumps)


def _answer(
    test: CertificateTest[PrimalState], outcome: Outcome[PrimalState], before: Counts
) -> Solution:
    """The certified answer of the loop, or its best one.

    Raises
    ------
    ArithmeticError
        The loop found no answer.
    """
    answer, reason = test.answer, outcome.reason
    if reason is not Reason.ACCEPTED:
        if outcome.state is None:
            raise ArithmeticError("the active sets of the undecomposed problem hold no body")
        answer = test.certified(outcome.state)
        reason = reason or Reason.UNSETTLED
    assert answer is not None
    assert reason is not None
    return replace(answer, counts=before + outcome.counts, reason=reason, method=METHOD)


def _certified(backend: Multigrid, rule: StoppingRule, state: PrimalState) -> Solution:
    """The answer of a state with its certificate (collective)."""
    problem = backend.problem
    pressing = np.where(problem.inequality, np.maximum(state.multiplier, 0.0), state.multiplier)
    u, multiplier = recover(backend.system, state.u, pressing)
    answer = certified(problem, multiplier, u, rule.tolerance, state.errors)
    return without_rounded_forces(problem, rule, rule.judge(answer), state.errors)


def _required_reduction(
    backend: Multigrid, rule: StoppingRule, loads: Array, state: PrimalState
) -> float:
    """Factor by which the numbers of a state have to fall before it is certified (collective).

    Parameters
    ----------
    loads : (bodies,)
        Sum of the magnitudes of all loads on each body, for those that heat alone loads.
    """
    problem = backend.problem
    forces = state.multiplier * problem.spread
    pressed, pulled = problem.comm.allreduce(np.array([
        problem.bodies.sum_rows(part, problem.inequality)
        for part in (np.abs(forces), np.maximum(-forces, 0.0))
    ]))  # fmt: skip
    load = np.maximum(problem.mechanical_loads, pressed)
    size = float(load.max()) or float(loads.max()) or 1.0
    worst = max(problem.largest_distance(state), state.imbalance / size)
    if rule.may_end_early:  # the answer has no tensile forces, and its gap takes it for balanced
        worst = max(worst, float(np.divide(pulled, load, out=pulled, where=load > 0.0).max()))
    left = friction_residual(problem, state.multiplier, state.jumps, state.lengths)
    worst = max(worst, left / SURE)
    required = rule.required_reduction(worst, state.strained, lambda: 0.5 * state.error_square)
    relative = state.error_square / state.strained if state.strained > 0.0 else 0.0
    return max(required, float(np.sqrt(relative / rule.tolerance)))
