"""Contact forces of one mesh as the start on the next.

What the solver looks for are forces of contact rows; what meshes have in common are pressures.
Those of the last mesh are interpolated between its nearest nodes to the rows of the next and
multiplied by the area that falls to each. Only rows of single nodes of bodies that are solved whole
take them: multipliers of gluing belong to one decomposition.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contact_app.model import Model, facets_of
from solver.tfeti.exchange import NodeExchange

if TYPE_CHECKING:
    from contact_app.run import SolvedScene

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pressures:
    """Contact pressures of a solved mesh, all of them on every rank.

    Attributes
    ----------
    points : list of (n, 3)
        Nodes that may touch, by contact with an obstacle.
    pressures : list of (n,)
    """

    points: list[Array]
    pressures: list[Array]

    @classmethod
    def of(cls, solved: SolvedScene) -> Pressures:
        """Gather them (collective)."""
        model, contact = solved.model, solved.model.problem.contact
        points, pressures = [], []
        for number in range(len(model.scene.contacts)):
            rows = np.flatnonzero(contact.sources == number)
            mine = contact.points[rows], solved.nodes.contact_pressure[
                contact.nodes[rows] - solved.nodes.first
            ]  # fmt: skip
            parts = model.comm.allgather(mine)
            points.append(np.concatenate([p for p, _ in parts]))
            pressures.append(np.concatenate([p for _, p in parts]))
        return cls(points, pressures)

    def on(self, model: Model) -> Array | None:
        """Multipliers on another mesh of the scene, None where there is no use for them."""
        problem, contact = model.problem, model.problem.contact
        if problem.coarse is not None or model.scene.pairs:
            return None
        if model.comm.allreduce(int(problem.wide.sum() + problem.size - len(contact.nodes))):
            return None
        areas = _areas(model)
        result = np.zeros(problem.size)
        for number, (points, pressures) in enumerate(zip(self.points, self.pressures, strict=True)):
            rows = np.flatnonzero(contact.sources == number)
            if len(points) == 0 or len(rows) == 0:
                continue
            nearest = min(len(points), model.scene.dimension)
            distance, at = cKDTree(points).query(contact.points[rows], k=nearest)
            distance, at = distance.reshape(len(rows), -1), at.reshape(len(rows), -1)
            weight = 1.0 / (distance + 1e-6 * distance.max(initial=1e-300))
            pressure = (weight * pressures[at]).sum(axis=1) / weight.sum(axis=1)
            force = pressure * areas[number, contact.nodes[rows] - model.node_exchange.first]
            result[rows] = np.maximum(force, 0.0) / contact.spread[rows]
        return result


def _areas(model: Model) -> Array:
    """Area of each contact boundary that falls to each owned node, (contacts, nodes)."""
    exchange: NodeExchange = model.node_exchange
    subdomains = model.partition.subdomains
    starts = np.cumsum([0, *(len(s.nodes) for s in subdomains)])
    d = model.scene.dimension
    area = np.zeros((len(model.scene.contacts), exchange.last - exchange.first))
    for i, contact in enumerate(model.scene.contacts):
        share = np.zeros(starts[-1])
        chosen = facets_of(model.scene, model.partition, contact.body, contact.boundary)
        for local, rows in enumerate(chosen):
            if len(rows):
                element = model.elements[model.place[local, 0]]
                load = element.traction(rows, np.eye(d)[0])[::d]
                share[starts[local] : starts[local + 1]] = load
        arrived = exchange.to_owners(share)
        area[i] = np.bincount(exchange.nodes - exchange.first, arrived, minlength=area.shape[1])
    return area
