"""Rigid motions of bodies that only the facets of their meshes resist.

A ball between races may rotate: round surfaces slide along themselves. The facets of a mesh resist
slightly, so the rotation of the ball depends on the mesh only. The motion is the combination of the
loose motions of a group (`solver.contact.equilibrium.loose_motions`) that is nearest to the
displacement in the mean square (`solver.problem.free_motions`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from contact_app.model.equilibrium import directions_in_words, motion_size, upward
from contact_app.model.model import Model
from meshes.arrays import Array
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem

LARGE = 0.5
"""Shares of the largest displacement: there is a warning if the motion alone is larger, and the
displacement without it smaller."""

SMALL = 0.05
"""Components of a motion below this share of the largest are left out of its description."""


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """The slide of one body."""

    body: int
    along: str
    """The motion in words."""
    names: tuple[int, ...]
    """Numbers of the rigid motions whose `hold` stops it."""
    largest: float
    without: float
    """Largest displacement of the body, and without the motion."""

    def record(self, name: str) -> dict[str, Any]:
        """The record in `summary.json`."""
        return {
            "body": name, "along": self.along, "max_displacement": self.largest,
            "without_it": self.without,
        }  # fmt: skip

    def sentence(self, name: str, remedy: str) -> str:
        """The warning on the body of a name."""
        return (
            f"{name} slides by {self.largest:.3g} along {self.along}, which its contacts "
            "hardly resist: only the flat facets of round surfaces determine how far it slides. "
            f"Without this motion its largest displacement is {self.without:.3g}; {remedy}"
        )


def free_motions(model: Model, solution: Solution) -> list[FreeMotion]:
    """Motions that make up most of the displacement of their body (collective)."""
    motions = sliding_bodies(model.problem, solution, partial(motion_size, model.scene.bodies))
    return [slide for slide in motions if slide.body < len(model.scene.bodies)]


def sliding_bodies(
    problem: DualProblem, solution: Solution, size_of: Callable[[int, Array], float]
) -> list[FreeMotion]:
    """Motions that make up most of the displacement of their body, rigid or not (collective).

    Parameters
    ----------
    size_of
        Largest displacement of a body, by its number, in a rigid motion (motions,).
    """
    free, measures, motions = problem.free_motions, solution.measures, []
    for b, motion in enumerate(free.of(solution.displacements) if free is not None else []):
        largest, without = float(measures.displacements[b]), float(measures.deformations[b])
        moved = size_of(b, motion)
        if moved > LARGE * largest and without < LARGE * largest:
            share = np.abs(motion) > SMALL * np.abs(motion).max()
            along = directions_in_words(upward(np.where(share, motion, 0.0)[:, None]))
            names = _stopping(motion, problem.dimension)
            motions.append(FreeMotion(b, along, names, largest, without))
    return motions


def _stopping(motion: Array, dimension: int) -> tuple[int, ...]:
    """Numbers of the rigid motions that have to be held to stop a motion, and no others.

    A rotation about another point than the centre of the body moves the centre, too. Without the
    rotation the centre stays, so that only the part of the translation along the axis counts. To
    hold more would take away load from the contacts.
    """
    along, turn = motion[:dimension].copy(), motion[dimension:]
    large = SMALL * np.abs(motion).max()
    turns = np.abs(turn) > large
    if turns.any():
        axis = turn / np.linalg.norm(turn)
        along = (along @ axis) * axis if dimension == 3 else np.zeros(dimension)
    return tuple(np.flatnonzero(np.concatenate([np.abs(along) > large, turns])).tolist())
