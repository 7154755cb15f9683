"""One interface to dolfinx 0.5 (Debian 12) and 0.9 (Debian 13), which differ.

The rest of the project calls these functions and does not depend on the release.
"""

import os
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import basix
import dolfinx
import dolfinx.jit
import numpy as np
import ufl
from dolfinx import fem, geometry
from mpi4py import MPI
from numpy.typing import NDArray

from meshes.arrays import Array, Ints

_MODERN = hasattr(fem, "functionspace")

_compiled: dict[Hashable, Any] = {}


@contextmanager
def _remembering() -> Iterator[None]:
    """Context manager in which dolfinx finds compiled code in memory.

    Otherwise dolfinx looks it up on disk for every mesh, which takes milliseconds per subdomain.
    """
    look_up = dolfinx.jit.ffcx_jit

    def remember(comm: MPI.Intracomm, source: Any, *args: Any, **options: Any) -> Any:
        if comm.size > 1:  # the lookup is collective
            return look_up(comm, source, *args, **options)
        signature = source.signature() if isinstance(source, ufl.Form) else repr(source)
        key = signature, repr((args, sorted(options.items())))
        if key not in _compiled:
            _compiled[key] = look_up(comm, source, *args, **options)
        return _compiled[key]

    dolfinx.jit.ffcx_jit = remember
    try:
        yield
    finally:
        dolfinx.jit.ffcx_jit = look_up


def vector_space(mesh: Any, degree: int, components: int) -> Any:
    """Continuous Lagrange space with `components` values per node."""
    with _remembering():
        if _MODERN:
            return fem.functionspace(mesh, ("Lagrange", degree, (components,)))
        return fem.VectorFunctionSpace(mesh, ("Lagrange", degree), dim=components)


def scalar_space(mesh: Any, degree: int) -> Any:
    """Continuous Lagrange space with one value per node."""
    with _remembering():
        return (fem.functionspace if _MODERN else fem.FunctionSpace)(mesh, ("Lagrange", degree))


def cellwise_scalars(mesh: Any) -> Any:
    """Piecewise constant space with one value per cell."""
    with _remembering():
        return (fem.functionspace if _MODERN else fem.FunctionSpace)(mesh, ("DG", 0))


def cellwise_vectors(mesh: Any, components: int) -> Any:
    """Space with `components` values per cell."""
    with _remembering():
        if _MODERN:
            return fem.functionspace(mesh, ("DG", 0, (components,)))
        return fem.VectorFunctionSpace(mesh, ("DG", 0), dim=components)


def coordinate_element(cell: str, dimension: int, degree: int = 1) -> Any:
    """Coordinate element of a degree, as `create_mesh` expects it."""
    if _MODERN:
        import basix.ufl

        element = basix.ufl.element("Lagrange", cell, degree, shape=(dimension,))
        return ufl.Mesh(element)
    return ufl.Mesh(ufl.VectorElement("Lagrange", cell, degree, dim=dimension))


def create_mesh(
    cells: Ints, points: Array, cell: str, degree: int = 1, comm: MPI.Intracomm = MPI.COMM_SELF
) -> Any:
    """Mesh of given cells (nodes in dolfinx's order), on this process alone unless `comm` has more.

    Cells of degree 2 have the nodes of Lagrange cells of that degree and edges as curved as these.
    With several ranks each gives some of the cells and points; points are numbered over all ranks.
    """
    domain = coordinate_element(cell, points.shape[1], degree)
    if _MODERN:
        return dolfinx.mesh.create_mesh(comm, cells, points, domain)
    # given an array it would fail first, and format the array into a message that is not shown
    listing = dolfinx.cpp.graph.AdjacencyList_int64(cells)
    alone = {"partitioner": _stay} if comm.size == 1 else {}
    return dolfinx.mesh.create_mesh(comm, listing, points, domain, **alone)


def _stay(comm: MPI.Intracomm, parts: int, dimension: int, cells: Any, *ghosts: Any) -> Any:
    """Partitioner that gives all cells to the single process.

    Dolfinx's own would build a graph first.
    """
    return dolfinx.cpp.graph.AdjacencyList_int32(np.zeros((cells.num_nodes, 1), np.int32))


def cell_nodes(mesh: Any) -> NDArray[np.int32]:
    """Geometry nodes of each cell, (cells, nodes per cell), in dolfinx's order, vertices first."""
    dofmap = mesh.geometry.dofmap
    if _MODERN:
        return np.asarray(dofmap)
    return dofmap.array.reshape(dofmap.num_nodes, -1)


def original_cells(mesh: Any) -> NDArray[np.int32]:
    """Number of each cell of a mesh in the array given to `create_mesh`."""
    return np.asarray(mesh.topology.original_cell_index)


def dof_nodes(space: Any) -> NDArray[np.int32]:
    """Dof blocks of each cell, (cells, blocks per cell)."""
    dofs = space.dofmap.list
    if _MODERN:
        return np.asarray(dofs)
    return dofs.array.reshape(dofs.num_nodes, -1)


def lagrange_nodes(cell: str, degree: int) -> tuple[NDArray, NDArray, NDArray]:
    """Nodes of a Lagrange cell in dolfinx's order.

    Returns reference coordinates of its nodes (nodes, dimension) and of its vertices (vertices,
    dimension), and the nodes of each facet (facets, nodes per facet), vertices first.
    """
    element = _lagrange(cell, degree)
    closures = np.array(element.entity_closure_dofs[-2])
    return np.asarray(element.points), np.asarray(basix.geometry(element.cell_type)), closures


def quadrature(cell: str, degree: int) -> tuple[NDArray, NDArray]:
    """Points (q, dimension) and weights (q,) of a quadrature rule that is exact for a degree."""
    points, weights = basix.make_quadrature(getattr(basix.CellType, cell), degree)
    return np.asarray(points), np.asarray(weights)


def lagrange_values(cell: str, degree: int, points: Array) -> NDArray:
    """Shape functions of a Lagrange cell at reference points, (points, nodes)."""
    return _lagrange(cell, degree).tabulate(0, points)[0, ..., 0]


def lagrange_slopes(cell: str, degree: int, points: Array) -> NDArray:
    """Derivatives of the shape functions at reference points, (points, dimension, nodes)."""
    return lagrange_shapes(cell, degree, points)[1]


def lagrange_shapes(cell: str, degree: int, points: Array) -> tuple[NDArray, NDArray]:
    """Values (points, nodes) and derivatives (points, dimension, nodes) of the shape functions."""
    some = points if len(points) else np.zeros((1, points.shape[1]))  # basix aborts without points
    table = _lagrange(cell, degree).tabulate(1, some)[:, : len(points), :, 0]
    return table[0], np.moveaxis(table[1:], 0, 1)


@cache
def _lagrange(cell: str, degree: int) -> Any:
    kind = getattr(basix.CellType, cell)
    return basix.create_element(
        basix.ElementFamily.P, kind, degree, basix.LagrangeVariant.gll_warped
    )


def lagrange_degree(space: Any) -> int | None:
    """Degree of a continuous Lagrange space with any number of components.

    None for other spaces.
    """
    element = space.ufl_element()
    if _MODERN:
        family = getattr(element, "family_name", "")
        continuous = family == "P" and not getattr(element.basix_element, "discontinuous", True)
        return int(element.degree) if continuous else None
    if element.family() not in ("Lagrange", "P", "CG", "Q"):
        return None
    return int(element.degree())


def torn_space(space: Any, blocks: NDArray[np.int32], count: int) -> Any:
    """A space with the element of a given space, and separate nodes in each part of the mesh.

    Forms are integrated as over the given space. A matrix has no entries between parts, and none
    between ranks. Collective.

    Parameters
    ----------
    blocks : (cells of this rank including ghosts, nodes per cell)
        Number of each node of a cell among the nodes of this rank.
    count
        Number of nodes of this rank.
    """
    original, comm, size = space._cpp_object, space.mesh.comm, space.dofmap.index_map_bs
    links = dolfinx.cpp.graph.AdjacencyList_int32(np.ascontiguousarray(blocks, np.int32))
    numbers = dolfinx.cpp.common.IndexMap(comm, count)
    dofmap = dolfinx.cpp.fem.DofMap(original.dofmap.dof_layout, numbers, size, links, size)
    if _MODERN:
        make, shape = dolfinx.cpp.fem.FunctionSpace_float64, [list(original.value_shape)]
    else:
        make, shape = dolfinx.cpp.fem.FunctionSpace, []
    torn = make(original.mesh, original.element, dofmap, *shape)
    return fem.FunctionSpace(space.mesh, space.ufl_element(), torn)


def set_values(conditions: Sequence[Any], values: Array) -> None:
    """Write the values of Dirichlet conditions into an array of all unknowns, (unknowns,)."""
    if _MODERN:
        for condition in conditions:
            condition.set(values)
    else:
        fem.set_bc(values, list(conditions))


def compile_form(form: Any) -> Any:
    """Compile a UFL form."""
    with _remembering():
        return fem.form(form)


def meshtags(mesh: Any, dimension: int, entities: NDArray[np.int32], value: int) -> Any:
    """Mesh tags with one value on sorted entities."""
    values = np.full(len(entities), value, dtype=np.int32)
    return dolfinx.mesh.meshtags(mesh, dimension, np.sort(entities).astype(np.int32), values)


def tagged(tags: Any) -> NDArray[np.int32]:
    """Entities of mesh tags, sorted."""
    return np.asarray(tags.indices)


def is_tagged(mesh: Any, tags: Any) -> bool:
    """Whether mesh tags belong to this mesh."""
    if _MODERN:
        return tags.topology is mesh.topology._cpp_object
    return tags.mesh.topology is mesh.topology


def adjacency(links: Any) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Arrays (links, offsets) of an adjacency list or connectivity."""
    return np.asarray(links.array), np.asarray(links.offsets)


def scotch_parts(graph: tuple[NDArray, NDArray], parts: int) -> NDArray[np.int32]:
    """Part of each vertex of a graph (links, offsets) held by this process alone."""
    links, offsets = graph
    os.environ.setdefault("SCOTCH_DETERMINISTIC", "1")
    os.environ.setdefault("SCOTCH_PTHREAD_NUMBER", "1")
    partition = dolfinx.graph.partitioner_scotch()
    make = dolfinx.graph.adjacencylist if _MODERN else dolfinx.graph.create_adjacencylist
    listing = make(links.astype(np.int64), offsets.astype(np.int32))
    destinations = partition(MPI.COMM_SELF, parts, listing, False)
    return np.asarray(destinations.array, dtype=np.int32)


def cells_at(mesh: Any, points: Array) -> NDArray[np.int32]:
    """Cell of a mesh on this process that contains each point (n, 3), or the nearest cell, (n,)."""
    d = mesh.topology.dim
    points = np.ascontiguousarray(points, dtype=np.float64)
    if _MODERN:
        tree = geometry.bb_tree(mesh, d)
        boxes = geometry.compute_collisions_points(tree, points)
    else:
        tree = geometry.BoundingBoxTree(mesh, d)
        boxes = geometry.compute_collisions(tree, points)
    cells, offsets = adjacency(geometry.compute_colliding_cells(mesh, boxes, points))
    result = np.full(len(points), -1, np.int32)
    some = np.diff(offsets) > 0
    result[some] = cells[offsets[:-1][some]]
    if not some.all():
        every = np.arange(mesh.topology.index_map(d).size_local, dtype=np.int32)
        middles = geometry.create_midpoint_tree(mesh, d, every)
        result[~some] = geometry.compute_closest_entity(tree, middles, mesh, points[~some])
    return result
