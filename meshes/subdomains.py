"""The parts of a decomposition: references, subdomains and the partition that holds them.

Many subdomains of a scene are translates of one another. A `Reference` is the mesh of such a
congruence class, stored once; a `Subdomain` is a translated copy of it with the numbers its nodes
have in the undecomposed mesh. No mesh of a whole body is needed to describe a regular split.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from meshes import dolfinx_compat
from meshes.arrays import Array, Ints
from meshes.quadratic import VERTICES, node_vertices

VTK_ORDER = {
    "interval": (0, 1),
    "triangle": (0, 1, 2),
    "quadrilateral": (0, 1, 3, 2),
    "tetrahedron": (0, 1, 2, 3),
    "hexahedron": (0, 1, 3, 2, 4, 5, 7, 6),
}
"""Vertices of dolfinx's tensor-product cells in the order VTK and XDMF use."""

PLACE_STEPS = 20
"""Largest number of Newton steps; cells with straight edges take one, or a few if not parallel."""

PLACED = 1e-12
"""Length of a Newton step, in cells, at which the method ends."""


@cache
def vtk_order(cell: str, degree: int) -> tuple[int, ...]:
    """Nodes of dolfinx's Lagrange cells in the order VTK and XDMF use."""
    if degree == 1:
        return VTK_ORDER[cell]
    nodes, vertices, _ = dolfinx_compat.lagrange_nodes(cell, degree)
    corners = vertices[list(VTK_ORDER[cell])]
    middles = np.array([corners[list(on)].mean(axis=0) for on in node_vertices(cell)])
    away = np.linalg.norm(middles[:, None] - nodes[None], axis=2)
    return tuple(int(i) for i in away.argmin(axis=1))


def vtk_shapes(cell: str, degree: int, points: Array) -> tuple[Array, Array]:
    """Shape functions (points, nodes), derivatives (points, dimension, nodes), in VTK order."""
    order = list(vtk_order(cell, degree))
    values, slopes = dolfinx_compat.lagrange_shapes(cell, degree, points)
    return values[:, order], slopes[..., order]


def vtk_places(cell: str, degree: int, nodes: Array, points: Array) -> Array:
    """Coordinates of points in the reference cell, (points, dimension), by Newton's method.

    In simplices and parallelograms of degree 1 its first step is exact, and is taken from the first
    vertex.

    Parameters
    ----------
    nodes : (points, nodes, dimension)
        Nodes of the cell of each point, in VTK order.
    points : (points, dimension)
    """
    dimension = points.shape[1]
    simplex = cell in ("interval", "triangle", "tetrahedron")
    if degree == 1 and (simplex or (cell == "quadrilateral" and _parallelograms(nodes))):
        ends = nodes[:, 1:] if simplex else nodes[:, [1, 3]]
        edges, away = ends - nodes[:, :1], points - nodes[:, 0]
        if dimension == 2:  # Cramer's rule: LAPACK's calls take ten times as long
            (a, b), (c, d), (x, y) = edges[:, 0].T, edges[:, 1].T, away.T
            return np.stack([x * d - y * c, a * y - b * x], axis=1) / (a * d - b * c)[:, None]
        return np.asarray(np.linalg.solve(np.swapaxes(edges, 1, 2), away[..., None])[..., 0])
    places = np.full(points.shape, 1.0 / (dimension + 1) if simplex else 0.5)
    for _ in range(PLACE_STEPS):
        values, slopes = vtk_shapes(cell, degree, places)
        away = points - np.einsum("nk,nki->ni", values, nodes)
        jacobian = np.einsum("nrk,nki->nri", slopes, nodes)
        step = np.linalg.solve(np.swapaxes(jacobian, 1, 2), away[..., None])[..., 0]
        places = places + step
        if np.abs(step).max(initial=0.0) < PLACED:
            break
    return places


def _parallelograms(nodes: Array) -> bool:
    """Whether the opposite sides of all quadrilaterals (n, 4, d) are equal."""
    skew = nodes[:, 0] - nodes[:, 1] + nodes[:, 2] - nodes[:, 3]
    size = np.abs(nodes[:, 2] - nodes[:, 0]).max(axis=1, initial=0.0)
    return bool((np.abs(skew).max(axis=1, initial=0.0) <= PLACED * size).all())


@dataclass(frozen=True, eq=False)
class Reference:
    """Mesh of one congruence class of subdomains, on one process."""

    mesh: Any
    """The dolfinx mesh; its geometry nodes come first among the nodes. If edges are curved, its
    geometry is of second order and has all nodes of degree 2."""
    cell: str
    """Name of the cell, e.g. ``hexahedron``."""
    degree: int
    """Degree of the displacement, 1 or 2, which decides the nodes."""
    points: Array  # (nodes, 3)
    """Coordinates."""
    cells: NDArray[np.int32]  # (cells, nodes per cell)
    """Nodes of each cell in VTK order, vertices first."""
    facets: NDArray[np.int32]  # (facets, nodes per facet)
    """Nodes of the facets on the surface of the subdomain, in dolfinx's order, vertices first."""
    facet_entities: NDArray[np.int32]  # (facets,)
    """The same facets as entities of `mesh`."""
    tags: NDArray[np.int32]  # (cells,)
    """Number of each cell's material among those of the body, in the order of `cells`."""

    @property
    def curved(self) -> bool:
        """Whether cells have curved edges."""
        return dolfinx_compat.cell_nodes(self.mesh).shape[1] > VERTICES[self.cell]

    @property
    def vertex_weights(self) -> sparse.csr_matrix | None:
        """For degree 2, the shape functions of degree 1 of all vertices at all nodes.

        None for degree 1.
        """
        if self.degree == 1:
            return None
        amid, count = node_vertices(self.cell), len(self.points)
        cell, place = np.empty((2, count), np.int64)
        for i in range(len(amid)):
            cell[self.cells[:, i]], place[self.cells[:, i]] = np.arange(len(self.cells)), i
        rows, columns, values = [], [], []
        for i, on in enumerate(amid):
            nodes = np.flatnonzero(place == i)
            rows.append(np.repeat(nodes, len(on)))
            columns.append(self.cells[cell[nodes]][:, list(on)].ravel())
            values.append(np.full(len(rows[-1]), 1.0 / len(on)))
        entries = np.concatenate(rows), np.concatenate(columns)
        return sparse.csr_matrix((np.concatenate(values), entries), shape=(count, count))

    @cached_property
    def facet_cells(self) -> NDArray[np.int32]:
        """Cell of each facet, (facets,)."""
        return _sides_of_facets(self.mesh, self.facet_entities)[0]

    @cached_property
    def middles_behind(self) -> Array:
        """Middle of the cell behind each facet, (facets, 3)."""
        corners = dolfinx_compat.cell_nodes(self.mesh)[self.facet_cells]
        return np.asarray(self.points[corners].mean(axis=1))

    @classmethod
    def of(
        cls, mesh: Any, cell: str, degree: int = 1, tags: NDArray[np.int32] | None = None
    ) -> "Reference":
        """Describe a dolfinx mesh on one process.

        Parameters
        ----------
        degree
            Degree of the displacement.
        tags
            Numbers of the materials of the cells given to `create_mesh`, in their order; all 0
            unless given.
        """
        dimension = mesh.topology.dim
        mesh.topology.create_connectivity(dimension - 1, dimension)
        entities = np.asarray(dmesh.exterior_facet_indices(mesh.topology), dtype=np.int32)
        points, nodes = _nodes(mesh, cell, degree)
        closures = dolfinx_compat.lagrange_nodes(cell, degree)[2]
        owner, local = _sides_of_facets(mesh, entities)
        materials = np.zeros(len(nodes), np.int32) if tags is None else tags
        return cls(
            mesh=mesh,
            cell=cell,
            degree=degree,
            points=points,
            cells=nodes[:, list(vtk_order(cell, degree))],
            facets=nodes[owner[:, None], closures[local]],
            facet_entities=entities,
            tags=materials if tags is None else materials[dolfinx_compat.original_cells(mesh)],
        )


def _nodes(mesh: Any, cell: str, degree: int) -> tuple[Array, NDArray[np.int32]]:
    """Coordinates of the nodes (geometry nodes first), and the nodes of cells.

    Returns (nodes, 3) and (cells, nodes per cell) in dolfinx's order.
    """
    corners = dolfinx_compat.cell_nodes(mesh)
    points = mesh.geometry.x
    vertices = VERTICES[cell]
    if corners.shape[1] == (vertices if degree == 1 else len(node_vertices(cell))):
        return points.copy(), corners
    space = dolfinx_compat.scalar_space(mesh, degree)
    dofs, at = dolfinx_compat.dof_nodes(space), space.tabulate_dof_coordinates()
    number = np.full(len(at), -1, np.int32)
    number[dofs[:, :vertices]] = corners
    added = number < 0
    number[added] = len(points) + np.arange(int(added.sum()))
    return np.concatenate([points, at[added]]), number[dofs]


def _sides_of_facets(mesh: Any, entities: NDArray[np.int32]) -> tuple[NDArray[np.int32], Ints]:
    """The cell of each facet on the surface, and the local number of the facet in the cell."""
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d, d - 1)
    cells, offsets = dolfinx_compat.adjacency(mesh.topology.connectivity(d - 1, d))
    owner = cells[offsets[entities]]
    facets, starts = dolfinx_compat.adjacency(mesh.topology.connectivity(d, d - 1))
    of_cells = facets.reshape(len(starts) - 1, -1)
    return owner, np.argmax(of_cells[owner] == entities[:, None], axis=1)


@dataclass(frozen=True, eq=False)
class Subdomain:
    """One subdomain: a translated reference with the node numbers of the undecomposed mesh."""

    number: int
    """Number of the subdomain in the whole scene."""
    body: int
    reference: Reference
    translation: Array
    nodes: Ints  # (nodes,)
    """Number of each node in the undecomposed mesh of the scene."""
    exterior: NDArray[np.int32]
    """Rows of ``reference.facets`` that lie on the surface of the body."""
    boundaries: Mapping[str, NDArray[np.int32]]
    """Rows of ``reference.facets`` by the name of a boundary the mesh itself knows."""

    def points(self) -> Array:
        """Coordinates of the nodes, (nodes, 3)."""
        return self.reference.points + self.translation


@dataclass(frozen=True, eq=False)
class Partition:
    """The decomposition of a scene, with the subdomains of this rank."""

    comm: MPI.Intracomm
    dimension: int
    subdomains: tuple[Subdomain, ...]
    """The subdomains of this rank, by number; ranks hold consecutive numbers."""
    count: int
    """Number of subdomains on all ranks."""
    subdomains_of_body: tuple[int, ...]
    """Number of subdomains of each body."""
    first_node: Ints  # (bodies + 1,)
    """Nodes of body b are numbered from ``first_node[b]`` up to ``first_node[b + 1]``."""
    first_cell: Ints  # (bodies + 1,)
    """Cells of body b are numbered from ``first_cell[b]`` up to ``first_cell[b + 1]``."""
    cell_starts: Ints
    """Number of the first cell of each local subdomain, in the order of `subdomains`."""

    @property
    def nodes(self) -> int:
        """Number of nodes of the undecomposed scene."""
        return int(self.first_node[-1])

    @property
    def cells(self) -> int:
        """Number of cells of the undecomposed scene."""
        return int(self.first_cell[-1])


def owned_range(total: int, comm: MPI.Intracomm) -> tuple[int, int]:
    """First and end number of this rank's consecutive share of `total` items."""
    return total * comm.rank // comm.size, total * (comm.rank + 1) // comm.size
