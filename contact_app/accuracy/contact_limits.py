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
from contact_app.model.facets import moments, shapes_at_points
from contact_app.model.model import Model, boundary_nodes, facets_of, surface_facets
from contact_app.results.fields import NodeFields
from solver.contact.solution import Solution

ENTERED = 1e-2
"""Depth of nodes beside a contact boundary in an obstacle, over the largest displacement, from
which they are told of."""

BETWEEN = 0.1
"""Depth of a round obstacle between nodes, over the largest displacement, from which on it is told.
Under Hertz's ball on facets of size h it is h²/(8a²) of the approach, a the radius of contact."""

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


def entered_between(model: Model, solution: Solution, number: int) -> float:
    """How deep a round obstacle enters its contact boundary between nodes, where none was before.

    Contact is watched at nodes. An obstacle whose contact is narrower than a facet slips through
    between them, and no node tells. In units of length (collective).
    """
    scene, comm, d = model.scene, model.comm, model.scene.dimension
    contact, depth = scene.contacts[number], 0.0
    if contact.obstacle.curvature_radius is None:
        return depth
    chosen = facets_of(scene, model.partition, contact.body, contact.boundary)
    for s, rows, (cls, column) in zip(model.partition.subdomains, chosen, model.place, strict=True):
        if len(rows) == 0:
            continue
        facets = s.reference.facets[rows]
        u = solution.displacements[cls][:, column].reshape(-1, d)
        shapes = shapes_at_points(d, facets.shape[1])
        points, moved = (
            np.einsum("qk,fki->fqi", shapes, values[facets]).reshape(-1, values.shape[1])
            for values in (s.points(), u)
        )
        try:
            gap, normal = contact.obstacle.gap_and_normal(points)
        except ConfigurationError:  # a point in the middle of a round obstacle has no normal
            continue
        left = gap + np.einsum("ij,ij->i", normal[:, :d], moved)
        depth = max(depth, float(-left[gap >= 0.0].min(initial=0.0)))
    return float(comm.allreduce(depth, op=MPI.MAX))


def slipped_through(model: Model, solution: Solution) -> list[str]:
    """Sentences on contacts whose obstacle passes between the nodes (collective)."""
    scene, said = model.scene, []
    for number, contact in enumerate(scene.contacts):
        depth = entered_between(model, solution, number)
        moved = float(solution.measures.displacements[contact.body])
        if depth > BETWEEN * moved:
            said.append(
                f"{contact.source}: between the nodes of {scene.bodies[contact.body].name} the "
                f"obstacle enters by up to {depth:.2g}, {100.0 * depth / moved:.2g} % of the "
                "largest displacement: contact is narrower than a facet; use smaller cells there"
            )
    return said


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
