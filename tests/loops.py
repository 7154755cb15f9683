"""The active-set loop alone, on a backend that a test may watch."""

from solver import MPRGP
from solver.contact.active_set import ActiveSetMethod
from solver.contact.retries import solve_with_retries
from solver.contact.solve_on_set import Outcome, StoppingTest
from solver.tfeti.active_set_problem import State
from solver.tfeti.backend import TotalFeti
from solver.tfeti.methods.by_active_sets import initial_active_set


def loop(backend: TotalFeti, violation: float = 1e-8, steps: int = 10_000) -> Outcome[State]:
    """From the first set of a scene on, until no constraint is violated by more (relatively)."""
    problem = backend.problem

    def required(state: State) -> float:
        return problem.largest_distance(state) / violation

    test = StoppingTest(required, lambda state: required(state) <= 1.0)
    method = ActiveSetMethod(backend, test, MPRGP(max_iterations=steps))
    return solve_with_retries(method, initial_active_set(problem, None))
