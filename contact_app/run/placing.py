"""Rigid bodies where their answer has brought them.

Contact rows with a moving rigid body are linear in its motion about where it is placed. If the
answer moves it far beside the curvature of its shapes, the gaps that the rows tell are not those of
the shapes any more. The body is then placed where its displacement has brought it and the scene is
solved again, until both agree: the answer is that of obstacles that are fixed there.

Free rotations stay linear, as those of elastic bodies are: normals do not turn with them, and a
plate that tilts a little on frictionless supports does not slide off. Rotations that a condition
prescribes are no part of this: the body is placed by them from the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import NoEquilibriumError
from contact_app.model.model import Model
from contact_app.results.rigid import placements_of
from contact_app.scene.conditions import Contact
from contact_app.scene.rigid import Placement
from contact_app.scene.scene import Scene

PLACINGS = 20
"""Times a body is placed anew. Each takes the error down by the ratio of the contact pressure to
the stiffness of the bodies, or squares it."""

MISPLACED = 0.1
"""Error of gaps over the largest displacement, in units of the solver's tolerance, that is left."""

SMALL_ROTATION = 0.1
"""Free rotation in radians above which it is not small: as of cells of elastic bodies."""

LEAST, MOST = 0.3, 3.0
"""Shares of the way to where a body was found that are taken."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SameRows:
    """Multipliers of the same scene with rigid bodies in other places, to begin with."""

    multiplier: Array

    def on(self, model: Model) -> Array | None:
        """The same where there are as many rows (collective)."""
        same = model.problem.size == len(self.multiplier)
        if not model.comm.allreduce(int(same), op=MPI.MIN):
            return None
        return self.multiplier


class Relaxation:
    """How far to go towards where an answer has brought rigid bodies: Aitken's Δ² for vectors.

    Placing them there is a fixed-point iteration. Where contact forces turn with the body it comes
    nearer by the same factor each time, and the factor of the step before tells how much farther
    to go (U. Küttler, W. A. Wall, *Fixed-point fluid-structure interaction solvers with dynamic
    relaxation*, Comput. Mech. 43 (2008), section 3.2).
    """

    def __init__(self) -> None:
        self._share, self._before = 1.0, np.zeros(0)

    def towards(self, now: Sequence[Placement], found: Sequence[Placement]) -> list[Placement]:
        """Where to place bodies that are in one place and were found in another."""
        places, targets = (np.array([p.displacement for p in some]) for some in (now, found))
        step = targets - places
        if len(self._before):
            change = step - self._before
            square = float((change**2).sum())
            if square > 0.0:
                self._share *= -float((self._before * change).sum()) / square
                self._share = float(np.clip(self._share, LEAST, MOST))
        self._before = step
        return [
            replace(place, displacement=(float(x), float(y), float(z)))
            for place, (x, y, z) in zip(found, places + self._share * step, strict=True)
        ]


def placed_anew(solved: SolvedScene) -> list[Placement] | None:
    """Where the rigid bodies are to be placed; None where they are near enough (collective)."""
    scene = solved.model.scene
    if not scene.moving or not solved.solution.converged:
        return None
    places = [
        replace(place, rotation=before.rotation)
        for place, before in zip(
            placements_of(solved.model, solved.solution), scene.placements, strict=True
        )
    ]
    allowed = MISPLACED * solved.solution.tolerance
    return places if _misplaced(solved, places) > allowed else None


def _misplaced(solved: SolvedScene, places: list[Placement]) -> float:
    """Largest error of a gap over the displacement of its body, where contact is near (collective).

    The normal counts by what it makes of the displacement.
    """
    model, moved = solved.model, solved.solution.measures.deformations
    scene, contact = model.scene, model.problem.contact
    after, worst = scene.placed(places), 0.0
    pressed = solved.solution.multiplier[model.problem.inequality] > 0.0
    for number, item in enumerate(scene.contacts):
        if item.rigid not in scene.moving:
            continue
        mine = contact.sources == number
        points, size = contact.points[mine], float(moved[item.body])
        if not len(points) or size == 0.0:
            continue
        told, normal = _told(scene, places, item, points)
        gap, turned = after.contacts[number].gap_and_normal(points)
        near = pressed[mine] | (gap <= size)
        error = np.abs(gap - told) / size + np.linalg.norm(turned - normal, axis=1)
        worst = max(worst, float(error[near].max(initial=0.0)))
    return float(model.comm.allreduce(worst, op=MPI.MAX))


def _told(
    scene: Scene, places: list[Placement], item: Contact, points: Array
) -> tuple[Array, Array]:
    """Gap of points that the rows tell of a rigid body elsewhere, and the normal they take."""
    assert item.rigid is not None
    before, after = scene.placements[item.rigid], places[item.rigid]
    gap, normal = item.gap_and_normal(points)
    return gap - normal @ np.subtract(after.displacement, before.displacement), normal


def rotation_warnings(scene: Scene, places: list[Placement]) -> list[str]:
    """Rigid bodies whose free rotation is not small, a sentence each."""
    angles = [
        float(np.linalg.norm(np.subtract(place.rotation, before.rotation)))
        for place, before in zip(places, scene.placements, strict=True)
    ]
    return [
        f"{body.name} turns by {angle:.2g} radians beside what is prescribed; the model assumes "
        f"small rotations of rigid bodies (below {SMALL_ROTATION:g})"
        for body, angle in zip(scene.rigid_bodies, angles, strict=True)
        if angle > SMALL_ROTATION
    ]


def leaves_where_placed(error: NoEquilibriumError) -> NoEquilibriumError:
    """The same error, of a scene whose rigid bodies an earlier answer has brought elsewhere."""
    return NoEquilibriumError(
        f"{error}\n  That is where earlier solves have brought the rigid bodies; where they are "
        "drawn the loads keep them. Hold them along what they slide on"
    )


def never_placed(solved: SolvedScene) -> SolvedScene:
    """The last answer of bodies that did not come to rest: no certificate passes."""
    certificate = solved.solution.certificate
    text = (
        f"the rigid bodies did not come to rest in {PLACINGS} solves, each about where the last "
        "one brought them: they may slide off what they touch; hold them along it"
    )
    certificate = replace(certificate, passed=False, warnings=(*certificate.warnings, text))
    return replace(solved, solution=replace(solved.solution, certificate=certificate))
