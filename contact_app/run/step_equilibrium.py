"""The factor within a load step at which a body leaves.

The loads that contact forces and friction forces within their limits can balance form a convex set:
if it contains the loads at both ends of a step, it contains all loads between. So each step is
tested at its end. If the end has no equilibrium, bisection finds the factor at which the bodies
begin to move.
"""

from mpi4py import MPI

from contact_app.errors import NoEquilibriumError
from contact_app.model.outline import Outline, outline_of_case, outline_of_scene
from contact_app.scene.scene import Scene

DIGITS = 1e-3
"""Relative accuracy of the factor."""

LEAST = 1e-4
"""Factor below which a body counts as leaving from the start of the step on."""


class LeavesInStepError(NoEquilibriumError):
    """A body leaves in a load step; the text names the step and the factor.

    Attributes
    ----------
    share
        Share of the step, in [0, 1], from which on the body leaves.
    """

    def __init__(self, text: str, share: float) -> None:
        super().__init__(text)
        self.share = share


def leaving_in_step(
    scene: Scene,
    step: int,
    comm: MPI.Intracomm,
    outline: Outline | None,
    error: NoEquilibriumError,
    digits: float = DIGITS,
) -> LeavesInStepError:
    """The error for a step at whose end a body leaves (collective).

    Parameters
    ----------
    scene
        The scene with its steps.
    step
        Number of the step, from zero.
    outline
        The outline of another loading, if there is one.
    error
        The error at the end of the step.
    digits
        Relative accuracy of the factor.
    """
    balanced, leaves, share = 0.0, 1.0, 0.0  # test the start of the step first
    while leaves - balanced > digits * leaves and leaves > LEAST:
        loaded = scene.loaded_at(step, share)
        try:
            if outline is None or outline_of_case(outline, loaded) is None:
                outline = outline_of_scene(loaded, comm, needed="distinct")
            balanced = share
        except NoEquilibriumError as earlier:
            leaves, error = share, earlier
        share = 0.5 * (balanced + leaves)
    factor = 0.5 * (balanced + leaves) if balanced else 0.0
    where = f"from its factor {factor:.3g} on" if balanced else "from its start on"
    message = str(error).removeprefix(f"{scene.source}: ")
    text = f"{scene.at(f'steps[{step}]')}: step {step + 1}, {where}: {message}"
    return LeavesInStepError(text, factor)
