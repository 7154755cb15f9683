"""Placement of rigid bodies by the displacements of an answer.

Contact rows with a moving rigid body are linearised about its placement. If its displacement is
large compared with the radius of curvature of its shapes, the linearised gaps differ from those of
the shapes. The body is then moved by its displacement and the scene is solved again, until both
agree: the answer is that of obstacles that are fixed there.

Free rotations are small, as rotations of elastic bodies: normals do not rotate with them, and a
plate that tilts slightly on frictionless supports does not slide off. Prescribed rotations are
exact: the placement contains them from the start.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import NoEquilibriumError
from contact_app.model.equilibrium import directions_in_words
from contact_app.model.model import Model
from contact_app.run.summary import warned
from contact_app.scene.conditions import Contact
from contact_app.scene.rigid import Placement, RigidBody
from meshes.arrays import Array
from solver.contact.solution import Guess, Solution

PLACINGS, JUDGED = 40, 8
"""Most placements of a body, and placements from which on a body that moves on and on leaves.

Each multiplies the error by the ratio of contact pressure to stiffness of the bodies, or squares
it. At the largest force that friction at a circle holds this ratio is nearly one.
"""

MISPLACED = 0.1
"""Admissible error of gaps over the largest displacement, in units of the solver's tolerance."""

SMALL_ROTATION = 0.1
"""Free rotation in radians above which a warning follows: the rotation is not small."""

STRAIGHT = 0.9
"""Distance over the length of the way, and over the distance before, from which on a body keeps its
direction and moves on. The distances of circles that are pushed beyond the largest force that holds
them grow by 0.92 and more, those of others shrink to a tenth. With a constant ratio of placements
this is a ratio of 0.97, and forty placements would not suffice."""

LEAST, MOST = 0.3, 3.0
"""Least and largest factor on the displacement of a new placement."""


@dataclass(frozen=True, eq=False)
class SameRows:
    """An answer with the same rows, such as to other placements, as initial guess."""

    answer: Solution

    def on(self, model: Model) -> Guess | None:
        """The answer and its slips if rows and subdomains are the same, else None (collective)."""
        same = model.problem.size == len(self.answer.multiplier)
        shapes = [u.shape for u in self.answer.displacements]
        same &= shapes == [forces.shape for forces in model.problem.forces]
        if not model.comm.allreduce(int(same), op=MPI.MIN):
            return None
        jumps = model.problem.jumps(self.answer.displacements)
        return replace(self.answer.guess, jumps=jumps)


class Relaxation:
    """Relaxation of the placements of rigid bodies: Aitken's Δ² for vectors.

    New placements are a fixed-point iteration. If contact forces turn with the body, the error
    decreases by the same factor each time, and the factor of the last step gives the relaxation (U.
    Küttler, W. A. Wall, *Fixed-point fluid-structure interaction solvers with dynamic relaxation*,
    Comput. Mech. 43 (2008), section 3.2).
    """

    def __init__(self) -> None:
        self._share, self._before = 1.0, np.zeros(0)
        self._steps: list[Array] = []

    def towards(self, now: Sequence[Placement], computed: Sequence[Placement]) -> list[Placement]:
        """The next placement of bodies, from their present placement and that of the answer."""
        places, targets = (np.array([p.displacement for p in some]) for some in (now, computed))
        step = targets - places
        if len(self._before):
            change = step - self._before
            square = float((change**2).sum())
            if square > 0.0:
                self._share *= -float((self._before * change).sum()) / square
                self._share = float(np.clip(self._share, LEAST, MOST))
        self._before = step
        self._steps.append(step)
        return [
            replace(place, displacement=(float(x), float(y), float(z)))
            for place, (x, y, z) in zip(computed, places + self._share * step, strict=True)
        ]

    @property
    def moves_on(self) -> bool:
        """Whether the answers' later steps are about as long as the earlier ones, the same way."""
        middle = len(self._steps) // 2
        earlier, later = (sum(some) for some in (self._steps[:middle], self._steps[middle:]))
        way = sum(float(np.linalg.norm(step)) for step in self._steps[middle:])
        distance = float(np.linalg.norm(later))
        far = distance > STRAIGHT * max(way, float(np.linalg.norm(earlier)))
        return far and len(self._steps) >= JUDGED


def placed_anew(solved: SolvedScene) -> list[Placement] | None:
    """The next placements of the rigid bodies.

    None if the present ones are accurate (collective).
    """
    scene = solved.model.scene
    if not scene.moving or not solved.solution.converged:
        return None
    places = [
        replace(place, rotation=before.rotation)
        for place, before in zip(solved.placements, scene.rigid.placements, strict=True)
    ]
    allowed = MISPLACED * solved.solution.tolerance
    return places if _misplaced(solved, places) > allowed else None


def _misplaced(solved: SolvedScene, places: list[Placement]) -> float:
    """Largest error of a gap over the displacement of its body, where contact is near (collective).

    An error of the normal counts by its effect on the displacement along it, and rounding errors of
    the gap do not count.
    """
    model, moved = solved.model, solved.solution.measures.deformations
    scene, contact = model.scene, model.problem.contact
    after, worst = scene.placed(places), 0.0
    pressed = solved.solution.multiplier[model.problem.inequality] > 0.0
    for number, item in enumerate(scene.contacts):
        if item.rigid is None or item.rigid not in scene.moving:
            continue
        of_contact = contact.sources == number
        points, size = contact.points[of_contact], float(moved[item.body])
        if not len(points) or size == 0.0:
            continue
        before_after = scene.rigid.placements[item.rigid], places[item.rigid]
        distance, normal = _distance_and_normal(before_after, item, points)
        gap, turned = after.contacts[number].gap_and_normal(points)
        near = pressed[of_contact] | (gap <= size)
        rounded = 4.0 * float(np.finfo(np.float64).eps) * float(np.abs(points).max())
        off = np.maximum(np.abs(gap - distance) - rounded, 0.0)
        error = off / size + np.linalg.norm(turned - normal, axis=1)
        worst = max(worst, float(error[near].max(initial=0.0)))
    return float(model.comm.allreduce(worst, op=MPI.MAX))


def _distance_and_normal(
    moved: tuple[Placement, Placement], item: Contact, points: Array
) -> tuple[Array, Array]:
    """Linearised gap of points to a rigid body after its displacement, and the rows' normal."""
    before, after = moved
    gap, normal = item.gap_and_normal(points)
    return gap - normal @ np.subtract(after.displacement, before.displacement), normal


def rotation_warnings(
    placements: Sequence[Placement], rigid_bodies: Sequence[RigidBody], places: list[Placement]
) -> list[str]:
    """Warnings on rigid bodies whose free rotation is not small."""
    angles = [
        float(np.linalg.norm(np.subtract(place.rotation, before.rotation)))
        for place, before in zip(places, placements, strict=True)
    ]
    return [
        f"{body.name} turns by {angle:.2g} radians besides its prescribed rotation; the model "
        f"assumes small rotations of rigid bodies (below {SMALL_ROTATION:g})"
        for body, angle in zip(rigid_bodies, angles, strict=True)
        if angle > SMALL_ROTATION
    ]


def leaves_where_placed(error: NoEquilibriumError) -> NoEquilibriumError:
    """The error, with a note that an earlier answer has moved the rigid bodies."""
    return NoEquilibriumError(
        f"{error}\n  In the positions of the scene file the rigid bodies are in equilibrium, but "
        "not in those to which earlier solves have moved them. Add displacement conditions along "
        "the surfaces on which they slide"
    )


def moves_away(solved: SolvedScene, solves: int) -> NoEquilibriumError:
    """The error for rigid bodies that each of some solves moves further."""
    return NoEquilibriumError(
        f"{solved.model.scene.source}: the scene has no equilibrium: nothing stops "
        f"{_last_moves(solved, ' from leaving')} under its loads: each of {solves} solves, "
        "begun from the positions of the last answer, moved the bodies further. Add displacement "
        "conditions along the surfaces on which the bodies slide or roll"
    )


def never_placed(solved: SolvedScene) -> SolvedScene:
    """The last answer of rigid bodies whose positions still change; it is not certified."""
    certificate = replace(solved.solution.certificate, passed=False)
    solution = replace(solved.solution, certificate=certificate)
    solved = replace(solved, solution=solution, summary={})  # of the changed verdict
    text = (
        f"the positions of the rigid bodies still change after {PLACINGS} solves, each from "
        f"the positions of the last answer; the last one moves {_last_moves(solved)}: the bodies "
        "may slide off the surfaces that they touch or roll on; add displacement conditions along "
        "these surfaces"
    )
    return warned(solved, [text])


def _last_moves(solved: SolvedScene, verb: str = "") -> str:
    """Phrase with the rigid bodies that an answer moves, and their directions (collective)."""
    scene, d = solved.model.scene, solved.model.scene.dimension
    after, before = solved.placements, scene.rigid.placements
    moved = np.array([after[k].components(d) - before[k].components(d) for k in scene.moving])
    largest = np.abs(moved).max()
    return " and ".join(
        f"{scene.rigid.bodies[k].name}{verb} along {directions_in_words(motion[:, None])}"
        for k, motion in zip(scene.moving, moved, strict=True)
        if np.abs(motion).max() > 1e-3 * largest
    )
