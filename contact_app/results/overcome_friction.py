"""Answers without a certificate in which friction does not hold the loads."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from contact_app.model.equilibrium import leaving
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem
from solver.tfeti.friction_share import overcome

HOLDS = 0.995
"""Share of the loads below which friction is said not to hold them. Contact forces without a
certificate are not accurate, but a history comes near the limit before a body leaves: forces of a
block between walls that cool down hold 0.9 of its loads where it falls."""


def overcome_friction(
    problem: DualProblem, solution: Solution, name_of: Callable[[int], str]
) -> Iterator[str]:
    """One sentence for each group of bodies that friction does not hold (collective).

    None for an answer with a certificate.

    Parameters
    ----------
    name_of
        Name of a body, by its number.
    """
    if solution.certificate.passed:
        return
    for group in overcome(problem, solution):
        if group.share < HOLDS:
            yield (
                f"friction at the contact forces of this answer holds {group.share:.3g} of the "
                f"loads and does not stop {leaving(name_of, group.bodies, group.motion)}. More "
                "friction, smaller loads or an `interference` that presses opposite contacts "
                "against each other may hold the bodies: the test of equilibrium before the solve "
                "admits any forces between opposite contacts, also those that no load causes"
            )
