"""Rigid bodies in ``summary.json``: displacement, rotation and reactions.

A rigid body is in equilibrium: in held components the reaction balances contact forces and loads.
Moments are about its displaced reference point. The contact forces are those of the contacts with
it, on the bodies of `on`, with the other sign.
"""

from typing import Any

import numpy as np

from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.model.rigid import RigidUnknowns
from contact_app.results.fields import NodeFields
from contact_app.scene.rigid import Placement, RigidBodies, RigidMotion
from meshes.arrays import Array
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem


def placements_of(geometry: Geometry, problem: DualProblem, solution: Solution) -> list[Placement]:
    """Placement of each rigid body after its displacement by an answer (collective)."""
    comm, rigid, unknowns = geometry.comm, geometry.rigid, RigidUnknowns.of(geometry)
    on_rank = [
        u[: len(unknowns.units), 0] / unknowns.units
        for cls, u in zip(problem.classes, solution.displacements, strict=True)
        if cls.rigid
    ]
    moved: list[Array] = comm.bcast(on_rank, root=comm.size - 1)
    motions = dict(zip(rigid.moving, moved, strict=True))
    held = [rigid.held(k)[1] for k in range(len(rigid.bodies))]
    d = geometry.dimension
    return [Placement.of(motions.get(k, values), d) for k, values in enumerate(held)]


def rigid_records(
    model: Model,
    solution: Solution,
    nodes: NodeFields,
    reactions: list[dict[str, Any]],
    ties: list[dict[str, Any]],
) -> dict[str, Any]:
    """`rigid_bodies` of ``summary.json``, and `reactions` with those of rigid bodies (collective).

    Parameters
    ----------
    reactions
        Reactions of elastic bodies, in the order of the file.
    ties
        Records of the tied boundaries, as `tie_records` makes them.
    """
    scene, d = model.scene, model.scene.dimension
    places = placements_of(model.geometry, model.problem, solution)
    records = {}
    for body, place in zip(scene.rigid.bodies, places, strict=True):
        records[body.name] = {
            "displacement": [float(v) for v in place.displacement[:d]],
            "rotation": _turn([float(v) for v in place.rotation], d),
        }
    points = [
        np.array(body.center) + np.array(place.displacement)
        for body, place in zip(scene.rigid.bodies, places, strict=True)
    ]
    forces = [_on_rigid(model.geometry, nodes, k, point) for k, point in enumerate(points)]
    for tie, record in zip(scene.rigid_ties, ties[len(scene.ties) :], strict=True):
        forces[tie.rigid] -= _about(record, points[tie.rigid])
    moved = {
        motion.source: _reaction(scene.rigid, motion, forces[motion.body], points[motion.body])
        for motion in scene.rigid.motions
    }
    every = (
        dict(zip((source for source, _ in scene.condition_names), reactions, strict=True)) | moved
    )
    order = sorted(every, key=lambda source: (len(source), source))
    return {"rigid_bodies": records, "reactions": [every[source] for source in order]}


def _turn(vector: list[float], d: int) -> list[float] | float:
    """A rotation or moment; in the plane its one component."""
    return vector[2] if d == 2 else vector


def _about(record: dict[str, Any], point: Array) -> Array:
    """Force of a record of `contacts`, and its moment about a point, (6,)."""
    force, moment = np.array(record["force"]), np.array(record["moment"])
    moment = moment if moment.ndim else np.array([0.0, 0.0, moment])
    return np.concatenate([force, moment + np.cross(np.array(record["point"]) - point, force)])


def _on_rigid(geometry: Geometry, nodes: NodeFields, number: int, point: Array) -> Array:
    """Force, and moment about a point, of all contacts on a rigid body, (6,) (collective)."""
    total = np.zeros(6)
    for touching, contact in zip(geometry.touching, nodes.contacts, strict=True):
        if getattr(touching, "rigid", None) == number:
            arm = nodes.points[contact.nodes - nodes.first] - point
            turned = np.cross(arm, contact.forces) + contact.moments
            total -= np.concatenate([contact.forces.sum(axis=0), turned.sum(axis=0)])
    return np.asarray(geometry.comm.allreduce(total))


def _reaction(
    bodies: RigidBodies, motion: RigidMotion, pressed: Array, point: Array
) -> dict[str, Any]:
    """The force and moment by which a condition holds its body."""
    d, needed = bodies.dimension, -pressed
    for load in bodies.loads:
        if load.body == motion.body:
            needed -= np.array([*load.force, *load.moment])
    held = np.array([value is not None for value in motion.values])
    holds = np.zeros(6, bool)
    holds[:d], holds[3 if d == 3 else 5 :] = held[:d], held[d:]
    needed = np.where(holds, needed, 0.0)
    return {
        "on": bodies.bodies[motion.body].name,
        "force": [float(v) + 0.0 for v in needed[:3]],
        "moment": _turn([float(v) + 0.0 for v in needed[3:]], d),
        "point": [float(v) for v in point],
    }
