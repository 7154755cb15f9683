"""Contact rows on the faces of second-order tetrahedra: gaps in the mean about each vertex.

On these faces, rows at nodes fail. The shape functions of the vertices of a face have the integral
zero, so the nodal forces of a constant pressure are zero at vertices. The forces of a linear
pressure have either sign, and λ ≥ 0 cannot represent them. Instead the pressure is linear on each
face (on a curved face in the coordinates of its reference), p = Σ p_j ψ_j with ψ_j the linear shape
function of vertex j. The gap averaged with ψ_j must not be negative:

    ∫ ψ_j (g + n·u) ds / W_j ≥ 0,   W_j = ∫ ψ_j ds,

where g + n·u is the quadratic field with the linearised gap of each of the six nodes (n the normal
out of the obstacle at that node). The multiplier of the row is the force p_j W_j; constant and
linear pressures are represented exactly, and p_j ≥ 0 is p ≥ 0 (S. Hüeber, B. I. Wohlmuth, *An
optimal a priori error estimate for nonlinear multibody contact problems*, SINUM 43, 2005, on
multipliers of lower order than the displacement).
"""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from contact_app.model.facets import MIDDLES, moments
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import Contact
from meshes import Partition
from meshes.arrays import Array, Ints
from meshes.facet_overlaps import smallest
from meshes.mortar import POINTED
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactEntries, ContactRows

LEVEL = 0.1
"""Slope over an obstacle from which on an edge rises from it."""

GapAndNormal = Callable[[Array], tuple[Array, Array]]
"""Gap (n,) and normal (n, 3) of an obstacle at points (n, 3)."""


def has_averaged_rows(body: Body) -> bool:
    """Whether contact of a body with obstacles is enforced on averages, not at nodes."""
    return body.degree == 2 and body.mesh.cell == "tetrahedron"


def averaged_rows(
    partition: Partition,
    exchange: NodeExchange,
    chosen: list[NDArray[np.int32]],
    contact: Contact,
    source: int,
) -> ContactRows:
    """Rows of one contact at the vertices this rank owns (collective).

    Parameters
    ----------
    exchange
        Exchange between copies of surface nodes.
    chosen
        For each subdomain of this rank, rows of the reference's facets that may touch.
    source
        Index of the contact.

    Raises
    ------
    ConfigurationError
        The obstacle has no normal at a node.
    """
    parts = []
    for s, rows in zip(partition.subdomains, chosen, strict=True):
        if len(rows):  # facets of another body may have another number of nodes
            facets = s.reference.facets[rows]
            parts.append((s.nodes[facets], s.points()[facets]))
    return rows_about_vertices(exchange, partition.dimension, parts, contact.gap_and_normal, source)


def rows_about_vertices(
    exchange: NodeExchange,
    d: int,
    facets: Iterable[tuple[Ints, Array]],
    gap_and_normal: GapAndNormal,
    source: int,
) -> ContactRows:
    """Rows about the vertices of facets at the vertices this rank owns (collective).

    Parameters
    ----------
    exchange
        Exchange between copies of nodes.
    d
        Dimension.
    facets
        Facets of this rank: global nodes (facets, nodes per facet), vertices first, and coordinates
        (facets, nodes per facet, 3).
    gap_and_normal
        Of the obstacle at points (n, 3): gaps (n,) and unit normals (n, 3) out of it.
    source
        Index of the contact.
    """
    vertices, nodes = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    weights, points, rises = [np.zeros(0)], [np.zeros((0, 3))], [np.zeros((0, 2))]
    for numbers, x in facets:
        integrals = moments(x, d)
        shape = integrals.shape
        rises.append(_rises(integrals, x, gap_and_normal).reshape(-1, 2))
        vertices.append(np.broadcast_to(numbers[:, : shape[1], None], shape).ravel())
        nodes.append(np.broadcast_to(numbers[:, None], shape).ravel())
        weights.append(integrals.ravel())
        points.append(np.broadcast_to(x[:, None], (*shape, 3)).reshape(-1, 3))
    meeting = exchange.among(np.concatenate(vertices))
    pair = np.stack([meeting.nodes, meeting.to_owners(np.concatenate(nodes))], axis=1)
    weight = meeting.to_owners(np.concatenate(weights))
    point = meeting.to_owners(np.concatenate(points))
    rise = meeting.to_owners(np.concatenate(rises))
    pair, first, place = np.unique(pair, axis=0, return_index=True, return_inverse=True)
    point = point[first]
    place = place.reshape(-1)
    weight = np.bincount(place, weight, minlength=len(pair))
    vertex, row = np.unique(pair[:, 0], return_inverse=True)
    row = row.reshape(-1)
    count = len(vertex)
    area = np.bincount(row, weight, minlength=count).astype(np.float64)
    itself = pair[:, 0] == pair[:, 1]
    located = np.empty((count, 3))
    located[row[itself]] = point[itself]
    pointed = smallest(row[place], rise[:, 0], count) > POINTED
    lengths = (rise[first, 1] <= LEVEL) * np.linalg.norm(point - located[row], axis=1)
    along = np.bincount(row, lengths, minlength=count)[row]
    edges = np.divide(lengths, along, out=np.zeros(len(row)), where=along > 0.0)
    edges = np.where(itself & (along == 0.0), 1.0, itself / 3.0 + edges * 2.0 / 3.0)
    mean = np.where(pointed[row], edges, weight / area[row])
    gap, normal = gap_and_normal(point)
    means = [np.bincount(row, mean * part, minlength=count) for part in (gap, *normal.T)]
    entry, component = np.nonzero((np.abs(normal[:, :d]) > 1e-14) & (mean != 0.0)[:, None])
    turns = np.cross(point - located[row], mean[:, None] * normal)
    return ContactRows(
        nodes=vertex,
        points=located,
        sources=np.full(count, source),
        gaps=means[0].astype(np.float64),
        normals=np.stack(means[1 : 1 + d], axis=1),
        moments=np.stack([np.bincount(row, t, minlength=count) for t in turns.T], axis=1),
        areas=area,
        spread=np.ones(count),
        entries=ContactEntries(
            row=row[entry],
            node=pair[entry, 1],
            points=point[entry],
            component=component,
            value=-(mean[:, None] * normal)[entry, component],
        ),
    )


def _rises(integrals: Array, x: Array, gap_and_normal: GapAndNormal) -> Array:
    """How steeply facets, and edges to their middles, rise from their vertices.

    Returns
    -------
    (facets, vertices, nodes, 2)
        Mean gap of the facet beyond that of the vertex, over the facet's size, and the gap of each
        node beyond it, over the distance; infinite for nodes that are not amid edges of the vertex.
    """
    gap = gap_and_normal(x.reshape(-1, 3))[0].reshape(x.shape[:2])
    share = integrals.sum(axis=2)
    at_vertices = gap[:, : share.shape[1]]
    mean = np.einsum("fjk,fk->fj", integrals, gap) / share
    result = np.full((*integrals.shape, 2), np.inf)
    result[..., 0] = ((mean - at_vertices) / np.sqrt(share.sum(axis=1, keepdims=True)))[..., None]
    middles = MIDDLES.get(x.shape[1], ())
    for node, ends in enumerate(middles, x.shape[1] - len(middles)):
        for vertex in ends if len(ends) == 2 else ():
            away = np.linalg.norm(x[:, node] - x[:, vertex], axis=1)
            result[:, vertex, node, 1] = (gap[:, node] - at_vertices[:, vertex]) / away
    return result
