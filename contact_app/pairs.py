"""From two boundaries of a scene to contact rows: both surfaces are gathered, rows dealt out.

Every rank gathers the facets of both sides of a contact and computes all of its rows, of which
each keeps those of the nodes it owns: a surface is small beside the bodies, and the answer does
not depend on who holds which part of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contact_app.mortar import MeanGaps, Surface
from meshes import Partition, Reference, versions
from solver.tfeti.constraints import ContactEntries, ContactRows
from solver.tfeti.exchange import NodeExchange


def gather_surface(partition: Partition, chosen: Sequence[NDArray[np.int32]]) -> Surface | None:
    """The facets of a boundary on all ranks (collective); None if there are none.

    Parameters
    ----------
    chosen
        Rows of the reference's facets of each subdomain of this rank.
    """
    parts = []
    for s, rows in zip(partition.subdomains, chosen, strict=True):
        if len(rows):
            facets = s.reference.facets[rows]
            behind = _behind(s.reference, rows) + s.translation
            parts.append((s.nodes[facets], s.points()[facets], behind))
    gathered = [part for rank in partition.comm.allgather(parts) for part in rank]
    if not gathered:
        return None
    nodes, points, inside = (np.concatenate(part) for part in zip(*gathered, strict=True))
    return Surface.of(partition.dimension, nodes, points, inside)


def _behind(reference: Reference, rows: NDArray[np.int32]) -> NDArray[np.float64]:
    """Middle of the cell behind each facet, (rows, 3)."""
    topology = reference.mesh.topology
    links, offsets = versions.adjacency(topology.connectivity(topology.dim - 1, topology.dim))
    cells = links[offsets[reference.facet_entities[rows]]]
    return reference.points[versions.cell_nodes(reference.mesh)[cells]].mean(axis=1)


def owned_rows(exchange: NodeExchange, found: MeanGaps, source: int) -> ContactRows:
    """The mortar rows of the nodes this rank owns."""
    keep = (found.nodes >= exchange.first) & (found.nodes < exchange.last)
    every = ContactEntries(found.row, found.node, found.entry_points, found.component, found.value)
    return ContactRows(
        nodes=found.nodes[keep],
        points=found.points[keep],
        sources=np.full(int(keep.sum()), source),
        gaps=found.gaps[keep],
        normals=found.normals[keep],
        areas=found.areas[keep],
        spread=np.ones(int(keep.sum())),
        entries=every.of_rows(keep),
    )
