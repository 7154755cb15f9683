"""Tagged facets of a mesh as facets of the parts, with nodes in dolfinx's order."""

from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np
from numpy.typing import NDArray

from contact_app.forms.parts import Parts
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from meshes.contact_surface import Surface
from meshes.quadratic import FACETS


@dataclass(frozen=True, eq=False)
class Facets:
    """Facets of this rank on the surface of the bodies."""

    copies: Ints  # (facets, nodes per facet)
    """Copies of the nodes, vertices first."""
    numbers: Ints  # (facets, nodes per facet)
    """Nodes, as all ranks number them."""
    points: Array  # (facets, nodes per facet, 3)
    inside: Array  # (facets, 3)
    """Middle of the cell behind each facet."""

    def vertices(self, dimension: int) -> Ints:
        """Copies of the vertices, (facets, vertices)."""
        return self.copies[:, : FACETS[dimension, self.copies.shape[1]].vertices]

    def chosen(self, mask: Mask) -> "Facets":
        """Some of them."""
        return Facets(self.copies[mask], self.numbers[mask], self.points[mask], self.inside[mask])


def surface_facets(parts: Parts, tags: Any, values: tuple[int, ...]) -> Facets:
    """The facets with one of some values that lie on the surface (collective)."""
    return exterior_facets(parts, dolfinx_compat.tagged(tags)[np.isin(tags.values, values)])


def exterior_facets(parts: Parts, among: NDArray[np.int32] | None = None) -> Facets:
    """The facets of the surface, or those of some facets that lie on it (collective)."""
    mesh = parts.space.mesh
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)
    entities = np.asarray(dolfinx.mesh.exterior_facet_indices(mesh.topology))
    if among is not None:
        entities = np.intersect1d(among, entities)
    links, offsets = dolfinx_compat.adjacency(mesh.topology.connectivity(d - 1, d))
    cell = links[offsets[entities]]
    local = cell < len(parts.of_cell)
    entities, cell = entities[local], cell[local]
    facets, starts = dolfinx_compat.adjacency(mesh.topology.connectivity(d, d - 1))
    of_cell = facets[starts[cell][:, None] + np.arange(starts[1] if len(starts) > 1 else 0)]
    place = (of_cell == entities[:, None]).argmax(axis=1)
    closures = dolfinx_compat.lagrange_nodes(
        mesh.topology.cell_name(), dolfinx_compat.lagrange_degree(parts.space) or 1
    )[2]
    copies = np.take_along_axis(parts.cells[cell], closures[place].astype(np.int64), axis=1)
    corners = mesh.geometry.x[dolfinx_compat.cell_nodes(mesh)[cell]]
    return Facets(copies, parts.numbers[copies], parts.points[copies], corners.mean(axis=1))


def gathered_surface(parts: Parts, facets: Facets) -> Surface:
    """The facets of all ranks, oriented (collective)."""
    local = (facets.numbers, facets.points, facets.inside)
    nodes, points, inside = (
        np.concatenate(of_ranks) for of_ranks in zip(*parts.comm.allgather(local), strict=True)
    )
    return Surface.of(parts.dimension, nodes, points, inside)
