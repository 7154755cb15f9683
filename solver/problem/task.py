"""The arguments of a solve, which the driver passes to its algorithms."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from solver.backend import Backend, S
from solver.contact.active_set import ActiveSetMethod
from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.checkpoint import Checkpoint, Saver, without_outer_iterations
from solver.contact.solve_on_set import SaveState, StoppingTest
from solver.contact.stopping import CertificateTest, StoppingRule
from solver.problem.contact_law import contact_law
from solver.problem.decomposed import DecomposedProblem
from solver.qp.mprgp import MPRGP
from solver.qp.outer_state import Restart
from solver.qp.result import Counts, Monitor

Problem = TypeVar("Problem", bound=DecomposedProblem, covariant=True)


@dataclass(frozen=True, eq=False)
class Task(Generic[Problem]):
    """A problem with the stopping rule, the options and the callbacks of its solve."""

    problem: Problem
    rule: StoppingRule
    """Stopping rule; it may tighten its tolerance during a solve."""
    inner: MPRGP
    """MPRGP with the options of the user; its limit is for the iterations of all algorithms
    together."""
    monitor: Monitor | None = None
    """Called with each step; may stop the solve."""
    checkpoint: Checkpoint | None = None
    """Checkpoint to save the state to, and to resume from."""
    active_sets: ActiveSetOptions = field(default_factory=ActiveSetOptions)
    """Options of the active-set loop."""

    def restart(self) -> Restart | None:
        """The state to go on from; None without a checkpoint to resume (collective)."""
        checkpoint, problem = self.checkpoint, self.problem
        return checkpoint.load(problem.size, problem.description) if checkpoint else None

    def active_set_method(
        self, backend: Backend[S], test: CertificateTest[S], save: SaveState[S]
    ) -> ActiveSetMethod[S]:
        """Active sets on a backend, with the certificate as the test of their answers."""
        stopping = StoppingTest(test.required_reduction, test.accept, self.rule.may_end_early)
        options, law = self.active_sets, contact_law(self.problem)
        if self.problem.friction.acts:
            options = options.with_friction()
        return ActiveSetMethod(backend, stopping, self.inner, self.monitor, save, options, law)


def saved_by(saver: Saver) -> SaveState[S]:
    """Saves the states of active sets with a saver of an algorithm without outer iterations."""

    def save(state: Callable[[], S], work: Counts) -> None:
        if saver.due:
            now = state()
            saver(without_outer_iterations(now.multiplier, now.active, work))

    return save
