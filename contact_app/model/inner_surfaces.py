"""Inner surfaces of a body at which section forces are computed: their two sides, area, centroid.

The surface consists of facets between cells: those that the mesh file names, or all whose nodes
satisfy the expression of a boundary. It divides the cells of the body into two sides
(`meshes.inner_surface`). The side with a point that the scene names is behind the surface.
"""

from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from mpi4py import MPI

from contact_app.errors import ConfigurationError
from contact_app.model.facets import moments
from contact_app.model.geometry import Geometry
from contact_app.model.probes import OUTSIDE, in_cell
from contact_app.scene.scene import InnerSection
from meshes import CellMesh, Partition, dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from meshes.inner_surface import sides_where
from meshes.quadratic import VERTICES
from meshes.subdomains import vtk_order
from meshes.unstructured import FACETS, row_places


@dataclass(frozen=True, eq=False)
class InnerSurface:
    """An inner surface."""

    behind: tuple[Mask | None, ...]
    """For each subdomain of this rank, mask (cells,) of the cells behind the surface; None for
    other bodies."""
    area: float
    """Area; in 2D length."""
    centre: Array  # (3,)


def locate_inner_surface(geometry: Geometry, section: InnerSection) -> InnerSurface:
    """The inner surface of a section (collective).

    Raises
    ------
    ConfigurationError
        There is no such surface, it does not divide the body, or the point is on none of its sides.
    """
    body = geometry.bodies[section.body]
    shape = body.mesh.shape(body.degree)  # as it is cut into subdomains, node by node
    mesh: CellMesh = shape if isinstance(shape, CellMesh) else shape.cell_mesh()
    if section.boundary in mesh.inner:
        side = np.zeros(mesh.total_cells, bool)
        side[mesh.inner[section.boundary]] = True
    else:
        points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.dimension)))
        sides = sides_where(mesh, body.boundaries[section.boundary](points))
        if sides is None:
            _refuse(
                geometry.at("output"), section, "on",
                f"the facets between cells on {body.name}.{section.boundary} do not divide "
                f"{body.name} into two sides; all nodes of a facet have to satisfy `where`",
            )  # fmt: skip
        side = sides
    local = _of_subdomains(geometry.partition, section.body, mesh, side)
    if not _is_behind(geometry, section, local):
        side = ~side
        local = tuple(None if mask is None else ~mask for mask in local)
    return InnerSurface(local, *_area_and_centre(mesh, side))


def _refuse(place: str, section: InnerSection, key: str, why: str) -> NoReturn:
    raise ConfigurationError(f"{place}.sections.{section.name}.{key}: {why}")


def _of_subdomains(
    partition: Partition, body: int, mesh: CellMesh, side: Mask
) -> tuple[Mask | None, ...]:
    """The mask of the cells of a body for those of each subdomain of this rank."""
    corners = VERTICES[mesh.cell]
    cells_of_body = np.sort(partition.first_node[body] + mesh.cells[:, :corners], axis=1)
    masks: list[Mask | None] = []
    for s in partition.subdomains:
        if s.body == body:
            cells = np.sort(s.nodes[s.reference.cells[:, :corners]], axis=1)
            masks.append(side[row_places(cells_of_body, cells)])
        else:
            masks.append(None)
    return tuple(masks)


def _is_behind(geometry: Geometry, section: InnerSection, masks: tuple[Mask | None, ...]) -> bool:
    """Whether the point of a section lies on the side of the masks (collective)."""
    point, comm, d = np.array(section.behind), geometry.comm, geometry.dimension
    best: tuple[float, bool] = np.inf, False
    for s, mask in zip(geometry.partition.subdomains, masks, strict=True):
        if mask is None:
            continue
        outside, nodes, shares = in_cell(s, point, d)
        if outside < best[0]:
            cells = s.reference.cells
            at = int(np.argmax((cells == nodes).all(axis=1)))
            best = outside, bool(mask[at])
    least, rank = comm.allreduce((best[0], comm.rank), op=MPI.MIN)
    if least > OUTSIDE:
        place = ", ".join(f"{v:g}" for v in section.behind[:d])
        name = geometry.bodies[section.body].name
        _refuse(
            geometry.at("output"), section, "behind", f"the point ({place}) does not lie in {name}"
        )
    return bool(comm.bcast(best[1], root=rank))


def _area_and_centre(mesh: CellMesh, side: Mask) -> tuple[float, Array]:
    """Area and centroid of the facets between the two sides of a mesh."""
    topology = mesh.topology
    across = side[topology.pairs[:, 0]] != side[topology.pairs[:, 1]]
    table = _facet_nodes(mesh.cell, mesh.degree)[topology.pair_facets[across, 0]]
    nodes = np.take_along_axis(mesh.cells[topology.pairs[across, 0]], table, axis=1)
    x = np.pad(mesh.points[nodes], ((0, 0), (0, 0), (0, 3 - mesh.dimension)))
    weights = moments(x, mesh.dimension).sum(axis=1)
    area = float(weights.sum())
    return area, np.einsum("fk,fki->i", weights, x) / area


def _facet_nodes(cell: str, degree: int) -> Ints:
    """Nodes of each facet of a cell in VTK order, in dolfinx's order of the facet."""
    closures = dolfinx_compat.lagrange_nodes(cell, degree)[2]
    table = np.argsort(vtk_order(cell, degree))[closures]
    corners = [set(row) & set(range(VERTICES[cell])) for row in table.tolist()]
    return table[[corners.index(set(facet)) for facet in FACETS[cell]]]
