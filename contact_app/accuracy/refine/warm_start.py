"""Initial contact forces on the next mesh from the solution on the last one.

Multipliers are forces of constraint rows, which differ between meshes and decompositions, while
pressures do not. A contact row of the next mesh begins with the pressure interpolated between the
nodes of the last mesh, times its area, unless an open node is nearer than one in contact: contact
ends half-way between the last node in contact and the first open one. All other rows begin without
forces; the solver adds those that equilibrium needs. Levels with friction begin anew, which takes
no longer.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.results.pressure import boundary_shares
from contact_app.results.surface_nodes import SurfaceNodes
from meshes.arrays import Array
from solver.contact.solution import Guess
from solver.problem.constraints.conditions import ContactRows

NEARER = 0.96
"""Distance of a row from a node in contact, over that from an open one, up to which it begins
closed: a little less than half-way, where halved edges have new nodes."""

NEIGHBOURS = 6
"""Nodes about a row that determine its pressure."""

SLOPE, ROUNDED = 1e-3, 1e-6
"""Added to the squares of slopes, and to those of distances, both over the farthest neighbour's."""


@dataclass(frozen=True, eq=False)
class LastLevel:
    """The contacts of a solved mesh, on all ranks; construction and calls are collective."""

    contacts: list[tuple[Array, Array]]  # (n, 3) and (n,) each
    """Nodes of each contact with a contact row, in the order of `Scene.touching`, and the pressure
    there: held nodes have no row, and their pressure is not known to be zero."""

    @classmethod
    def of(cls, solved: SolvedScene) -> "LastLevel":
        """The contacts of an answer."""
        nodes, contacts = solved.nodes, []
        for contact in nodes.contacts:
            at = contact.nodes - nodes.first
            with_row = ~np.isnan(nodes.gap[at])
            of_rank = nodes.points[at[with_row]], contact.pressure[with_row]
            parts = zip(*solved.model.comm.allgather(of_rank), strict=True)
            points, pressure = (np.concatenate(part) for part in parts)
            contacts.append((points, pressure))
        return cls(contacts)

    def on(self, model: Model) -> Guess | None:
        """Multipliers on another mesh of the scene, none of them tensile; None with friction."""
        problem, contact = model.problem, model.problem.contact
        if problem.friction.acts:
            return None
        pressures = np.zeros(len(contact.nodes))
        for number, (points, pressure) in enumerate(self.contacts):
            of_contact, pressed = contact.sources == number, pressure > 0.0
            if pressed.any() and of_contact.any():
                x = contact.points[of_contact]
                away = cKDTree(points[pressed]).query(x)[0]
                closed = away <= NEARER * cKDTree(points[~pressed]).query(x)[0]
                pressures[of_contact] = closed * np.maximum(_interpolated(points, pressure, x), 0.0)
        multiplier = np.zeros(problem.size)
        forces = pressures * _areas(model.geometry, contact)
        multiplier[problem.inequality] = forces / contact.spread
        return Guess(multiplier)


def _interpolated(points: Array, values: Array, at: Array) -> Array:
    """Values (n,) at points (n, 3), interpolated at places (m, 3): linear functions of neighbours.

    Each is fitted with weights that fall with the square of the distance (moving least squares); a
    small part of their slopes is added to the squares, since points may lie in a plane.
    """
    away, near = cKDTree(points).query(at, np.arange(1, min(NEIGHBOURS, len(points)) + 1))
    size = np.maximum(away[:, -1:], 1e-300)
    offsets = (points[near] - at[:, None]) / size[:, None]
    terms = np.concatenate([np.ones((*near.shape, 1)), offsets], axis=2)
    weighted = terms / ((away / size) ** 2 + ROUNDED)[..., None]
    squares = np.swapaxes(weighted, 1, 2) @ terms + SLOPE * np.diag([0.0, 1.0, 1.0, 1.0])
    fitted = np.linalg.solve(squares, np.einsum("nki,nk->ni", weighted, values[near])[..., None])
    return np.asarray(fitted[:, 0, 0])


def _areas(geometry: Geometry, contact: ContactRows) -> Array:
    """Area of each contact row on which its pressure acts: its own, or the share of its node."""
    surface = SurfaceNodes.of(geometry.partition)
    at = np.searchsorted(surface.owned, contact.nodes)
    areas = contact.areas.copy()
    for i, touching in enumerate(geometry.touching):
        shares = boundary_shares(geometry, surface, touching)
        unknown = (contact.sources == i) & np.isnan(contact.areas)
        areas[unknown] = shares[at[unknown]]
    return areas
