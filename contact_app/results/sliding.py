"""Distances by which bodies slide along obstacles and along each other, where they touch."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from contact_app.model.model import Model
from contact_app.results.fields import NodeFields
from solver.contact.solution import Solution


def largest_sliding(model: Model, solution: Solution, nodes: NodeFields, source: int) -> float:
    """Largest tangential displacement of touching nodes of one contact."""
    contact = model.problem.contact
    touching = (solution.multiplier[model.problem.inequality] > 0.0) & (contact.sources == source)
    u = nodes.displacement[contact.nodes[touching] - nodes.first]
    normal = contact.normals[touching]
    along = u - np.einsum("ij,ij->i", u, normal)[:, None] * normal
    largest = float(np.linalg.norm(along, axis=1).max(initial=0.0))
    return float(model.comm.allreduce(largest, op=MPI.MAX))


def sliding_on_each_other(
    model: Model, solution: Solution, nodes: NodeFields, source: int
) -> tuple[float, float]:
    """Largest tangential motion of a touching row of a pair of bodies, and its facets' size.

    A row weighs nodes by Σ_c value_c n_c, its entries being weights times the mean normal.
    """
    comm, d = model.comm, model.scene.dimension
    contact = model.problem.contact
    pushed = solution.multiplier[model.problem.inequality] > 0.0
    rows = contact.of(pushed & (contact.sources == source))
    entries, normals = rows.entries, rows.normals
    query = model.node_exchange.among(entries.node)
    u = query.from_owners(nodes.displacement[query.nodes - nodes.first])
    weight = entries.value * -normals[entries.row, entries.component]
    motion = np.zeros((len(rows.nodes), d))
    np.add.at(motion, entries.row, weight[:, None] * u)
    motion -= np.einsum("ij,ij->i", motion, normals)[:, None] * normals
    size = np.linalg.norm(motion, axis=1)
    worst = int(np.argmax(size)) if len(size) else -1
    mine = (
        (float(size[worst]), float(rows.areas[worst] ** (1 / (d - 1)))) if len(size) else (0.0, 0.0)
    )
    return max(comm.allgather(mine))
