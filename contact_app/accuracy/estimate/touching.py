"""Nodes in contact, and the known friction tractions.

Where a point slides, the traction along the surface has the size of its slip limit and the
direction of the friction force: μ times the pressure, which is a linear condition on the stress, or
a given force per area. At a sticking point friction is an unknown reaction.
"""

from dataclasses import dataclass

import numpy as np

from contact_app.model.geometry import Geometry
from meshes.arrays import Array, Mask
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem


@dataclass(frozen=True, eq=False)
class FrictionAtNodes:
    """Friction of one contact at the nodes of each class, on both sides of a pair."""

    contact: int
    """Number among those of `Scene.touching`."""
    sticks: list[Mask]  # one (nodes, members) array per class
    """Nodes with a point that sticks."""
    forces: list[Array]  # one (nodes, members, dimension) array per class
    """Friction forces of points that slide, on the body of the node."""


@dataclass(frozen=True, eq=False)
class Touching:
    """Contact at the nodes of each class."""

    pushed: list[Mask]  # one (nodes, members) array per class
    """Nodes that an obstacle or another body pushes."""
    friction: tuple[FrictionAtNodes, ...] = ()
    """Friction of each contact that has friction."""


def touching_nodes(geometry: Geometry, problem: DualProblem, solution: Solution) -> Touching:
    """Contact in an answer (collective)."""
    pushing = np.where(problem.inequality, solution.multiplier, 0.0)
    pushed = [(force != 0.0).any(axis=2) for force in _at_nodes(problem, pushing)]
    touching = [
        _friction(problem, solution, number)
        for number, contact in enumerate(geometry.touching)
        if contact.law.acts
    ]
    return Touching(pushed, tuple(touching))


def _friction(problem: DualProblem, solution: Solution, number: int) -> FrictionAtNodes:
    """Friction of one contact (collective)."""
    points, rows = problem.friction, problem.shared.friction
    sliding, held = np.zeros((2, problem.size))
    slides = points.sliding(solution.multiplier)[points.rows[points.first]]
    of_contact = rows.rows.sources[points.first] == number
    at_limit = points.rows[(of_contact & slides)[points.point]]
    sliding[at_limit] = solution.multiplier[at_limit]
    # the normal row marks a point that sticks, also where its friction force is zero
    held[points.normals[points.first[of_contact & ~slides]]] = 1.0
    sticks = [(reach != 0.0).any(axis=2) for reach in _at_nodes(problem, held)]
    return FrictionAtNodes(number, sticks, [-force for force in _at_nodes(problem, sliding)])


def _at_nodes(problem: DualProblem, multiplier: Array) -> list[Array]:
    """Bᵀ λ at the nodes of each class, (nodes, members, dimension)."""
    forces = problem.constraint_forces(multiplier)
    result = []
    for cls, part in zip(problem.classes, problem.slices, strict=True):
        nodal = np.zeros((cls.unknowns, cls.members))
        nodal[cls.interface] = forces[part].reshape(cls.members, -1).T
        result.append(nodal.reshape(-1, problem.dimension, cls.members).swapaxes(1, 2))
    return result
