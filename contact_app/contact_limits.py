"""Where the contacts of a scene are too few or too coarse for the answer.

Contact leaves its boundary where surface nodes beside it enter an obstacle: nothing stops them.
And a pressure that changes by as much as itself within single facets is that of the mesh. Over
facets T of size h, with p at their nodes,

    Σ |T| (max p - min p) / Σ |T| mean p

is about 8/(π n) for Hertz's half ellipse on n lines and 6/n for his ellipsoid on quadrilaterals,
n across the contact.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.facets import moments
from contact_app.fields import NodeFields
from contact_app.model import Model, boundary_nodes, facets_of, surface_facets
from contact_app.solution import Solution

ENTERED = 1e-2
"""Depth of nodes beside a contact boundary in an obstacle, over the largest displacement, from
which they are told of."""

FACETS_ACROSS = {2: 8.0 / np.pi, 3: 6.0}
"""Facets across a contact times the variation of its pressure within them."""

FEWEST_FACETS = 3.0
"""Facets across a contact below which its pressure is that of the mesh."""


def entered_beside(model: Model, solution: Solution, number: int) -> tuple[int, float]:
    """How many surface nodes beside a contact's boundary enter its obstacle, and how deep.

    They were outside before; nodes that subdomains share are counted once for each. A plane on a
    boundary that an expression picks ends with it: a punch (collective).
    """
    scene, comm, d = model.scene, model.comm, model.scene.dimension
    contact = scene.contacts[number]
    body, count, depth = scene.bodies[contact.body], 0, 0.0
    if contact.boundary in body.boundaries and contact.obstacle.curvature_radius is None:
        return count, depth
    least = ENTERED * solution.measures.displacements[contact.body]
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        if s.body != contact.body:
            continue
        surface = np.unique(s.reference.facets[surface_facets(s, body)])
        beside = np.setdiff1d(surface, boundary_nodes(s, body, contact.boundary))
        u = solution.displacements[cls][:, column].reshape(-1, d)[beside]
        try:
            gap, normal = contact.obstacle.gap_and_normal(s.points()[beside])
        except ConfigurationError:  # a node in the middle of a round obstacle has no normal
            continue
        entered = -(gap + np.einsum("ij,ij->i", normal[:, :d], u))
        entered = entered[(gap >= 0.0) & (entered > least)]
        count += len(entered)
        depth = max(depth, float(entered.max(initial=0.0)))
    return int(comm.allreduce(count)), float(comm.allreduce(depth, op=MPI.MAX))


def facets_across(model: Model, nodes: NodeFields) -> list[float]:
    """About how many facets carry each contact, one number a contact; ∞ without a pressure.

    Obstacles first, then pairs (collective).
    """
    scene, exchange = model.scene, model.node_exchange
    subdomains = model.partition.subdomains
    starts = np.cumsum([0, *(len(s.nodes) for s in subdomains)])
    found = []
    for contact, at_nodes in zip(scene.touching, nodes.contacts, strict=True):
        owned = np.zeros(len(nodes.points))
        owned[at_nodes.nodes - nodes.first] = at_nodes.pressure
        pressure = exchange.from_owners(owned[exchange.nodes - exchange.first])
        sums = np.zeros(2)
        chosen = facets_of(scene, model.partition, contact.body, contact.boundary)
        for start, s, rows in zip(starts, subdomains, chosen, strict=False):
            facets = s.reference.facets[rows]
            if len(facets) == 0:
                continue
            p = pressure[start + facets]
            area = moments(s.reference.points[facets], scene.dimension).sum(axis=(1, 2))
            sums += area @ np.stack([np.ptp(p, axis=1), p.mean(axis=1)], axis=1)
        varying, whole = model.comm.allreduce(sums)
        across = FACETS_ACROSS[scene.dimension]
        found.append(across * whole / varying if varying > 0.0 else np.inf)
    return found
