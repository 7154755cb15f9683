"""Rows that hold rigid motions of a body on request, in the mean over its whole surface.

A motion held on request may have a resistance, and its holding force is then a part of the answer.
With ρ_k the rigid motions about the centre of the body and S its surface,

    M_kl = ∫_S ρ_k · ρ_l ds,   m_k(u) = Σ_l (M⁻¹)_kl ∫_S ρ_l · u ds,

where m(u) are the components of the rigid motion nearest to u in the mean square over S; the held
components are zero. The force of such a row is a traction over the whole surface with the shape of
a rigid motion. It does work on the held motion alone, so it does not change the balance of the
other motions. The condition is independent of the decomposition and, in the limit, of the mesh.
"""

import numpy as np
from mpi4py import MPI

from contact_app.model.assembly import Element
from contact_app.model.boundaries import surface_facets
from contact_app.model.equilibrium import body_frame
from contact_app.model.geometry import Geometry
from meshes.arrays import Array, Ints
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactEntries, ContactRows, HeldRows
from solver.problem.constraints.merge import cut_held
from solver.rigid_motions import MOTIONS, rigid_motions


def mean_motion_rows(
    geometry: Geometry, exchange: NodeExchange, elements: dict[int, Element], held: HeldRows
) -> ContactRows:
    """Rows that this rank owns, without held components (collective)."""
    partition = geometry.partition
    parts = [ContactRows.empty(partition.dimension)]
    for b, body in enumerate(geometry.bodies):
        if body.hold:
            first = int(partition.first_node[b])
            points, weights, nodes = _weights(geometry, elements, b)
            gathered = exchange.among(np.full(len(nodes), first))
            nodes, points, weights = map(gathered.to_owners, (nodes, points, weights))
            if exchange.first <= first < exchange.last:
                centre = body_frame(body)[0]
                parts.append(_rows(b, (first, centre), nodes, points - centre, weights))
    return cut_held(exchange, ContactRows.join(parts), held, geometry.length, sides=0)


def _weights(geometry: Geometry, elements: dict[int, Element], b: int) -> tuple[Array, Array, Ints]:
    """Surface nodes of a body on this rank, their weights in the held m_k, their numbers.

    (k, 3), (k, dimension, held) and (k,); a node occurs once per subdomain (collective).
    """
    d, body = geometry.dimension, geometry.bodies[b]
    square = np.zeros((MOTIONS[d], MOTIONS[d]))
    points, weights = [np.zeros((0, 3))], [np.zeros((0, d, MOTIONS[d]))]
    nodes = [np.zeros(0, np.int64)]
    for s in geometry.partition.subdomains:
        facets = surface_facets(s, body) if s.body == b else np.zeros(0, np.int32)
        if len(facets):
            motions = rigid_motions(s.points(), d, *body_frame(body))
            integrals = elements[id(s.reference)].linear_tractions(facets, motions)
            square += motions.reshape(-1, MOTIONS[d]).T @ integrals
            some = np.unique(s.reference.facets[facets])
            points.append(s.points()[some])
            weights.append(integrals.reshape(-1, d, MOTIONS[d])[some])
            nodes.append(s.nodes[some].astype(np.int64))
    square = geometry.comm.allreduce(square, op=MPI.SUM)
    chosen = np.linalg.inv(square)[:, list(body.hold)]
    return np.concatenate(points), np.concatenate(weights) @ chosen, np.concatenate(nodes)


def _rows(
    source: int, place: tuple[int, Array], nodes: Ints, arms: Array, weights: Array
) -> ContactRows:
    """Orthonormal rows of one body; the weights of a repeated node are summed.

    Parameters
    ----------
    place
        Node to which the rows are assigned, and the centre, to which their moments refer.
    arms : (k, 3)
        From the centre to the nodes.
    """
    node, centre = place
    distinct, first, at = np.unique(nodes, return_index=True, return_inverse=True)
    summed = np.zeros((len(distinct), *weights.shape[1:]))
    np.add.at(summed, at.reshape(-1), weights)
    d, count = weights.shape[1:]
    basis = np.linalg.qr(summed.reshape(-1, count))[0].T.reshape(count, len(distinct), d)
    forces = np.zeros((count, len(distinct), 3))
    forces[..., :d] = -basis
    row, nth, component = np.nonzero(basis)
    return ContactRows(
        nodes=np.full(count, node),
        points=np.tile(centre, (count, 1)),
        sources=np.full(count, source),
        gaps=np.zeros(count),
        normals=forces.sum(axis=1)[:, :d],
        moments=np.cross(arms[first], forces).sum(axis=1),
        areas=np.full(count, np.nan),
        spread=np.ones(count),
        entries=ContactEntries(
            row, distinct[nth], centre + arms[first][nth], component, basis[row, nth, component]
        ),
    )
