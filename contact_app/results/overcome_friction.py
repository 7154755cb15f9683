"""Answers without a certificate in which friction does not hold the loads."""

from collections.abc import Callable, Iterator

from contact_app.model.equilibrium import leaving
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem
from solver.tfeti.friction_share import HOLDS, overcome


def overcome_friction(
    problem: DualProblem, solution: Solution, name_of: Callable[[int], str], holds: float = HOLDS
) -> Iterator[str]:
    """One sentence for each group of bodies that friction does not hold (collective).

    None for an answer with a certificate.

    Parameters
    ----------
    name_of
        Name of a body, by its number.
    holds
        Share of the loads below which friction does not hold them.
    """
    if solution.certificate.passed:
        return
    for group in overcome(problem, solution):
        if group.share < holds:
            yield (
                f"friction at the contact forces of this answer holds {group.share:.6g} of the "
                f"loads and does not stop {leaving(name_of, group.bodies, group.motion)}. More "
                "friction, smaller loads or an `interference` that presses opposite contacts "
                "against each other may hold the bodies: the test of equilibrium before the solve "
                "admits any contact forces, also those that no load causes"
            )
