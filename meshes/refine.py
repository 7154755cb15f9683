"""Uniform refinement of a mesh: every edge is halved.

Triangles and quadrilaterals are divided into four cells, tetrahedra and hexahedra into eight. The
octahedron inside a tetrahedron without its corners is cut along its shortest diagonal, so that
shapes do not degenerate in repeated refinement (S. Zhang, *Successive subdivisions of tetrahedra
and multigrid methods on tetrahedral meshes*, Houston J. Math. 21, 1995). The new nodes are those of
second-order cells: with straight edges a boundary stays the same polygon or polyhedron, and curved
cells are divided into curved cells that fill the same place.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from meshes import dolfinx_compat
from meshes.arrays import Array, Ints
from meshes.quadratic import VERTICES, node_vertices, straight_middles
from meshes.subdomains import vtk_order
from meshes.unstructured import CellMesh, Topology

Rows = list[list[int]]

CORNERS = {
    "quadrilateral": ((0, 0), (1, 0), (1, 1), (0, 1)),
    "hexahedron": (
        (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1),
    ),
}  # fmt: skip

OPPOSITE = (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2)))
"""Edges of a tetrahedron that do not meet: their middles are the diagonals of its octahedron."""


def _middle(cell: str, *vertices: int) -> int:
    """Number of the node in the middle of some vertices of a second-order cell."""
    return [set(on) for on in node_vertices(cell)].index(set(vertices))


def _simplex_parts(cell: str) -> Rows:
    """Parts of a simplex that keep a corner, and the middle of a triangle."""
    vertices = range(VERTICES[cell])
    parts = [[_middle(cell, v, w) for w in vertices] for v in vertices]
    if len(vertices) == 3:
        parts.append([_middle(cell, v, w) for v, w in combinations(vertices, 2)])
        parts[-1][1:] = parts[-1][:0:-1]  # ab, bc, ca: in the cyclic order of the corners
    return parts


def _lattice_parts(cell: str) -> Rows:
    """Parts of a quadrilateral or hexahedron."""
    corners = np.array(CORNERS[cell])
    parts = []
    for first in product((0, 1), repeat=corners.shape[1]):
        places = np.array(first) + corners  # on the lattice of 0, 1 (the middle) and 2
        around = (np.abs(2 * corners - places[:, None]) < 2).all(axis=2)
        parts.append([_middle(cell, *np.flatnonzero(row).tolist()) for row in around])
    return parts


PARTS = {
    "triangle": np.array(_simplex_parts("triangle")),
    "tetrahedron": np.array(_simplex_parts("tetrahedron")),
    "quadrilateral": np.array(_lattice_parts("quadrilateral")),
    "hexahedron": np.array(_lattice_parts("hexahedron")),
}


def refined(mesh: CellMesh) -> CellMesh:
    """A mesh of first order with every edge halved, with the groups and named boundaries."""
    shape = mesh.shape(2)
    points, nodes = shape.points, shape.cells
    local = np.broadcast_to(PARTS[mesh.cell], (len(nodes), *PARTS[mesh.cell].shape))
    if mesh.cell == "tetrahedron":
        local = np.concatenate([local, _octahedra(points, nodes)], axis=1)
    cells = np.take_along_axis(nodes, local.reshape(len(nodes), -1), axis=1).reshape(local.shape)
    middles = None if mesh.middles is None else _inner_middles(points[nodes], local, mesh.cell)
    parts = cells.shape[1]
    cells = cells.reshape(-1, cells.shape[2])
    topology = Topology.of(cells, mesh.cell)
    before = _facets_before(shape.topology, topology, parts)
    return replace(
        mesh,
        points=points,
        cells=cells,
        topology=topology,
        sides={
            name: np.flatnonzero(np.isin(before, rows)).astype(np.int32)
            for name, rows in mesh.sides.items()
        },
        groups=_cell_parts(mesh.groups, parts),
        inner=_cell_parts(mesh.inner, parts),
        tags=np.repeat(mesh.tags, parts),
        middles=middles,
        coarse=mesh.coarse or mesh,
    )


def _cell_parts(groups: Mapping[str, Ints], parts: int) -> dict[str, Ints]:
    """Groups of cells that are divided into so many parts each."""
    return {n: (rows[:, None] * parts + np.arange(parts)).ravel() for n, rows in groups.items()}


def _inner_middles(x: Array, parts: Ints, cell: str) -> Array:
    """Coordinates of the further nodes of the parts of curved cells.

    Parameters
    ----------
    x : (cells, nodes, d)
        All nodes of the cells.
    parts : (cells, parts, vertices)
        Nodes of the cell that are vertices of each part.

    Returns
    -------
    (cells · parts, further nodes, d)
    """
    order = list(vtk_order(cell, 2))
    reference = dolfinx_compat.lagrange_nodes(cell, 2)[0][order]
    middles = np.empty((*parts.shape[:2], x.shape[1] - parts.shape[2], x.shape[2]))
    kinds, kind = np.unique(parts.reshape(-1, parts.shape[2]), axis=0, return_inverse=True)
    kind = kind.reshape(parts.shape[:2])
    for k, vertices in enumerate(kinds):
        at = straight_middles(reference[None, vertices], cell)[0]
        values = dolfinx_compat.lagrange_values(cell, 2, at)[:, order]
        row, part = np.nonzero(kind == k)
        middles[row, part] = np.einsum("qk,cki->cqi", values, x[row])
    return middles.reshape(-1, *middles.shape[2:])


def _facets_before(divided: Topology, parts: Topology, count: int) -> Ints:
    """The facet of a mesh of second order on which each facet of its parts lies, (facets,).

    Each cell has `count` parts.
    """
    owner = parts.facet_cells // count
    begin, end = (np.searchsorted(divided.facet_cells, owner, side) for side in ("left", "right"))
    result = begin.copy()
    for nth in range(1, int((end - begin).max(initial=0))):
        row = np.minimum(begin + nth, end - 1)
        within = (parts.facets[:, :, None] == divided.facets[row][:, None]).any(axis=2).all(axis=1)
        result[within] = row[within]
    return result


def _octahedra(points: Array, nodes: Ints) -> Ints:
    """Nodes of each cell in the four parts about the shortest diagonal, (cells, 4, 4)."""
    ends = np.array([[_middle("tetrahedron", *edge) for edge in pair] for pair in OPPOSITE])
    # the middles around each diagonal, in an order that gives tetrahedra positive volumes
    rings = [(*ends[k - 2], *ends[k - 1]) for k in range(3)]
    rings = [(a, c, b, d) for a, b, c, d in rings]
    x = points[nodes[:, ends]]
    shortest = np.linalg.norm(x[:, :, 0] - x[:, :, 1], axis=2).argmin(axis=1)
    axis, ring = ends[shortest], np.array(rings)[shortest]
    parts = [[*axis.T, ring[:, i], ring[:, (i + 1) % 4]] for i in range(4)]
    return np.array(parts).transpose(2, 0, 1)
