"""Where in a load step a body leaves.

The loads that contact forces can carry, pressures with friction within their limits at each point,
are a convex set: if the loads at both ends of a step belong to it, so do those between. So each
step is judged by its end, and where the end has no equilibrium, the factor at which the bodies
begin to move is found by bisection.
"""

from __future__ import annotations

from mpi4py import MPI

from contact_app.errors import NoEquilibriumError
from contact_app.model.outline import Outline, outline, outline_of_case
from contact_app.scene.scene import Scene

DIGITS = 1e-3
"""Relative accuracy of the factor."""

LEAST = 1e-4
"""Factor below which a body leaves from the start of the step on."""


class LeavesInStepError(NoEquilibriumError):
    """A body leaves in a load step; the text names the step and its factor.

    Attributes
    ----------
    share
        Of the step, in [0, 1], from which on the body leaves.
    """

    def __init__(self, text: str, share: float) -> None:
        super().__init__(text)
        self.share = share


def leaving_in_step(
    scene: Scene,
    step: int,
    comm: MPI.Intracomm,
    known: Outline | None,
    error: NoEquilibriumError,
    digits: float = DIGITS,
) -> LeavesInStepError:
    """The message on a step at whose end a body leaves (collective).

    Parameters
    ----------
    scene
        With its steps.
    step
        Number of the step, from zero.
    known
        The outline of another loading, if there is one.
    error
        What is said of the end of the step.
    digits
        Relative accuracy of the factor.
    """
    stands, leaves, share = 0.0, 1.0, 0.0  # first whether it stands at the start of the step
    while leaves - stands > digits * leaves and leaves > LEAST:
        loaded = scene.under(scene.loading_at(step, share))
        try:
            if known is None or outline_of_case(known, loaded) is None:
                known = outline(loaded, comm, needed="estimated")
            stands = share
        except NoEquilibriumError as earlier:
            leaves, error = share, earlier
        share = 0.5 * (stands + leaves)
    said = str(error).removeprefix(f"{scene.source}: ")
    found = 0.5 * (stands + leaves) if stands else 0.0
    where = f"from its factor {found:.3g} on" if stands else "from its start on"
    text = f"{scene.at(f'steps[{step}]')}: step {step + 1}, {where}: {said}"
    return LeavesInStepError(text, found)
