"""Signs that the answer of an increment with friction depends on the path within it.

Slips turn aside from one increment to the next, or points with Coulomb friction close or open: a
point that closes and sticks is held where it was at the start of the increment, not where it
touched.
"""

import math

import numpy as np

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.results.friction import closing_points
from contact_app.run.increment_models import IncrementModels

TURNED = math.pi / 6.0
"""Angle between the lines along which a node slips in two increments, from which on it counts as
turned: the friction force in between is off by up to half of itself. A slip that is reversed does
not count: the node sticks in between, and the load at which that ends is met exactly."""

MANY = 0.1
"""Share of the sliding nodes that may turn unchecked."""

CLOSING = 0.2
"""Share of the points that may close or open unchecked. Of 54 random scenes loaded in one increment
and in twelve, friction forces differ by more than 5 % of their limits in 16 of 28 with more, and in
2 of 26 with fewer, both with given limits. Halving finds 15 of these 18."""


def turning(before: SolvedScene | None, now: SolvedScene) -> str:
    """Phrase with the number of slips that change direction between increments; empty if few do."""
    if before is None or len(before.nodes.slip) != len(now.nodes.slip):
        return ""
    lengths = [np.linalg.norm(solved.nodes.slip, axis=1) for solved in (before, now)]
    moved = max(solved.solution.measures.displacement for solved in (before, now))
    still = now.solution.tolerance * moved
    slides = (lengths[0] > still) & (lengths[1] > still)
    along = np.einsum("ni,ni->n", before.nodes.slip, now.nodes.slip)
    turned = slides & (np.abs(along) < math.cos(TURNED) * lengths[0] * lengths[1])
    of_slides, of_turned = now.model.comm.allreduce(np.array([slides.sum(), turned.sum()]))
    if of_turned <= MANY * of_slides:
        return ""
    return (
        f"at {of_turned:,} of {of_slides:,} sliding nodes the direction of slip turns by more than "
        f"{math.degrees(TURNED):.0f}°"
    )


def closing(models: IncrementModels, now: SolvedScene) -> str:
    """Phrase with the number of points with Coulomb friction that close or open.

    Empty if few do.
    """
    changed, touching = closing_points(
        now.model.problem, now.solution, models.displacements, models.approach(now.model)
    )
    if changed <= CLOSING * touching:
        return ""
    return f"{changed:,} of {touching:,} contact points with friction close or open in it"
