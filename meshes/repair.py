"""Repair and check of the content of a mesh file.

Repaired and reported: nodes without cells are dropped, nodes at one place become one, cells with
negative volume are reordered, repeated cells count once. Refused: cells without volume or folded
into themselves, cells that overlap, hanging nodes on a neighbour's edge or face, and a body of
several pieces without common facets.

For displacements of degree 2, nodes on the edges of second-order cells make the edges curved. For
degree 1 they are left out, which is reported. Cells folded by their curved edges are refused.

`meshes.orientation` tests whether cells overlap their neighbours, and `meshes.overlap` whether a
body overlaps itself elsewhere.
"""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from meshes.arrays import Array, Ints, Mask, distinct_numbers, in_order
from meshes.cell_shape import at_vertices, corner_jacobians, edge_lengths, folded_inside, warped
from meshes.connected import connected
from meshes.hanging import refuse_hanging
from meshes.inner_surface import sides_of_facets
from meshes.merged_nodes import nodes_of
from meshes.orientation import refuse_crowded, refuse_same_side
from meshes.overlap import refuse_overlaps
from meshes.quadratic import (
    CORNERS_ONLY,
    STRAIGHT,
    VERTICES,
    bulges,
    middles_of,
    node_vertices,
    reordering,
    with_middles,
)
from meshes.read import FileContent, MixedCellsError, distinct_cells, read_file
from meshes.unstructured import CellMesh, MeshError, Topology, first_of, row_places

FLAT = 1e-9
"""Extent along z over the size of the body below which a mesh lies in a plane."""

EMPTY = 1e-12
"""Volume over the cube (area over the square) of the longest edge that counts as zero."""

LONGEST_CELL = 1e4
"""Largest admissible ratio of the longest to the shortest edge of a cell, as for boxes."""

SHORTEST_EDGE = 1e-15
"""Smallest admissible length of an edge, as for boxes."""

APART = 1e-6
"""Largest distance, over the size of cells, of the nodes of two cells on a common edge or face."""


REVERSED = {
    "triangle": (0, 2, 1),
    "quadrilateral": (0, 3, 2, 1),
    "tetrahedron": (0, 2, 1, 3),
    "hexahedron": (4, 5, 6, 7, 0, 1, 2, 3),
}
"""Order of the vertices of a cell that changes the sign of its volume."""


@dataclass(frozen=True)
class Placement:
    """Placement of a mesh file in the scene: scaled, then rotated, then moved."""

    scale: float = 1.0
    """Factor on the coordinates."""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    angle: float = 0.0
    """Axis of the rotation, and the angle in degrees."""
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Displacement in the unit of length of the scene."""

    def __call__(self, points: Array) -> Array:
        """Move points (n, 3); Rodrigues' formula."""
        placed = self.scale * points
        if self.angle:
            k = np.array(self.axis) / np.linalg.norm(self.axis)
            radians = np.deg2rad(self.angle)
            placed = (
                np.cos(radians) * placed
                + np.sin(radians) * np.cross(k, placed)
                + (1.0 - np.cos(radians)) * (placed @ k)[:, None] * k
            )
        return placed + np.array(self.translation)


def _content(
    path: Path, dimension: int, groups: tuple[str, ...], read: Callable[[Path, int], FileContent]
) -> FileContent:
    """The content of a file; that of some groups alone if its cells are of several types."""
    try:
        return read(path, dimension)
    except MixedCellsError:
        if not groups:
            raise
        return read_file(path, dimension, groups)


def load_mesh(
    path: Path,
    dimension: int,
    placement: Placement | None = None,
    groups: Iterable[str] = (),
    degree: int = 1,
    read: Callable[[Path, int], FileContent] = read_file,
    comm: MPI.Intracomm | None = None,
) -> CellMesh:
    """Read a mesh file, repair and check it.

    Parameters
    ----------
    dimension
        2 or 3: cells of this dimension make the body.
    placement
        Scaling, rotation and translation of the file.
    groups
        Cell groups that make the body; all cells unless given.
    degree
        Degree of the displacement; 2 keeps the nodes on the edges of second-order cells.
    read
        Reads the file; a function that remembers serves bodies of one file.
    comm
        Ranks that all load this mesh and share its checks; None for one alone.

    Raises
    ------
    MeshError
        The message says what is wrong and how to correct it.
    """
    groups, comm = tuple(groups), comm or MPI.COMM_SELF
    content = _content(path, dimension, groups, read)
    notes, cell = list(content.notes), content.kind.name
    distinct, row, _ = content.distinct  # Gmsh 2.2 repeats a cell for each of its groups
    members = {name: np.unique(row[rows]) for name, rows in content.cell_groups.items()}
    chosen = _chosen(members, groups) if groups else np.arange(len(distinct))
    cells = distinct[chosen]
    points = content.points
    if dimension == 2:
        points = _in_the_plane(points, cells, notes)
    points = (placement or Placement())(points)[:, :dimension]
    middles = _middles(content, points, degree, notes)
    number = np.unique(row, return_index=True)[1][chosen]  # number of each cell in the file, from 0
    idle_is_usual = bool(groups) or content.second_order
    masks = {} if groups else {name: np.isin(chosen, rows) for name, rows in members.items()}
    points, rename = nodes_of(points, cells, cell, notes, idle_is_usual, masks)
    cells, rows, doubled = distinct_cells(rename[cells])
    number = number[np.unique(rows, return_index=True)[1]]
    doubled += 0 if content.cell_groups else len(content.cells) - len(distinct)
    if doubled:
        notes.append(f"{doubled} cells are given twice: counted once")
    turned = _turn(points, cells, cell, number)
    if turned.any():
        notes.append(f"{int(turned.sum())} cells were inside out (negative volume): turned")
    topology = Topology.of(cells, cell)
    refuse_crowded(cells, cell, topology, number)
    refuse_same_side(points, cells, cell, topology, number, turned)
    if middles is not None:
        middles = _curved(points, cells, _turned(middles[number], turned, cell), cell, number)
    pieces = _pieces(cells, topology)
    # overlapping pieces are bodies of their own and have hanging nodes: they are refused as pieces
    facets = topology.facets
    if pieces.max() == 0:
        facets = facets[refuse_overlaps(points, cells, cell, topology, middles, number, comm)]
    refuse_hanging(points, facets, comm)
    _refuse_pieces(points, cells, pieces, content.cell_groups, groups)
    place = np.full(len(distinct), -1, np.int64)
    place[chosen] = rows
    of_groups = {name: np.unique(place[rows][place[rows] >= 0]) for name, rows in members.items()}
    sides, inner = _sides(content, rename, cells, topology, notes)
    return CellMesh(
        cell=cell, points=points, cells=cells, topology=topology, sides=sides, groups=of_groups,
        tags=np.zeros(len(cells), np.int32), name=path.name, notes=tuple(notes), middles=middles,
        inner=inner,
    )  # fmt: skip


def _turned(middles: Array, turned: Mask, cell: str) -> Array:
    """The further nodes of cells (changed in place), in the order of cells that were reversed."""
    order, v = reordering(cell, REVERSED[cell]), VERTICES[cell]
    middles[turned] = middles[turned][:, order[v:] - v]
    return middles


def _middles(content: FileContent, points: Array, degree: int, notes: list[str]) -> Array | None:
    """Coordinates of the further nodes of all cells, (cells, further nodes, dimension)."""
    if not content.second_order:
        return None
    if degree == 1:
        notes.append(CORNERS_ONLY)
        return None
    cell = content.kind.name
    full = len(node_vertices(cell))
    lacking = sum(len(b) for b in content.nodes if content.kind.corners < b.shape[1] < full)
    if lacking:
        notes.append(
            f"{lacking} cells have no nodes on their faces or in their middle (serendipity): "
            "added where their own shape functions put them"
        )
    return np.concatenate([middles_of(points[block], cell) for block in content.nodes])


def _curved(points: Array, cells: Ints, middles: Array, cell: str, number: Ints) -> Array | None:
    """The checked coordinates of further nodes, or None if all edges are straight."""
    v = VERTICES[cell]
    bulge = bulges(points[cells], middles, cell)
    if bulge.max() <= STRAIGHT:
        return None
    places, nodes = with_middles(points, cells, cell)
    places[nodes[:, v:]] = middles
    away = np.linalg.norm(places[nodes[:, v:]] - middles, axis=2).max(axis=1)
    differs = away > APART * np.ptp(points[cells], axis=1).max(axis=1)
    if differs.any():
        fault = f"{cell}s that have nodes amid an edge or face elsewhere than their neighbours"
        raise MeshError(first_of(points, cells, differs, fault, number))
    folded = np.zeros(len(cells), bool)
    rows = np.flatnonzero(bulge > STRAIGHT)
    folded[rows] = folded_inside(places, nodes[rows], cell, 2)
    if folded.any():
        fault = f"{cell}s folded by their curved edges (their Jacobian is not positive everywhere)"
        raise MeshError(
            first_of(points, cells, folded, fault, number)
            + "; use smaller cells or straight edges "
            "there (in Gmsh: Mesh.HighOrderOptimize = 2, or Mesh.SecondOrderLinear = 1)"
        )
    return middles


def _chosen(members: dict[str, Ints], groups: tuple[str, ...]) -> Ints:
    """Rows of the cells in any of the groups."""
    for name in groups:
        if name not in members:
            names = ", ".join(members) or "none"
            raise MeshError(f"has no group of cells named {name!r} (known: {names})")
    return np.unique(np.concatenate([members[name] for name in groups]))


def _in_the_plane(points: Array, cells: Ints, notes: list[str]) -> Array:
    """The points with z set to 0, if they all have the same z."""
    used = points[np.unique(cells)]
    size = np.ptp(used, axis=0).max()
    if np.ptp(used[:, 2]) > FLAT * size:
        raise MeshError(
            f"reaches from z = {used[:, 2].min():g} to {used[:, 2].max():g}; a scene of "
            "dimension 2 takes a mesh in a plane of constant z"
        )
    if abs(used[0, 2]) > FLAT * size:
        notes.append(f"the mesh lies at z = {used[0, 2]:g}: taken to lie at z = 0")
    flat = points.copy()
    flat[:, 2] = 0.0
    return flat


def _turn(points: Array, cells: Ints, cell: str, number: Ints) -> Mask:
    """Reorder cells with negative volume (in place), return their mask.

    Refuse empty and folded cells.
    """
    vertices = at_vertices(points, cells)
    lengths = edge_lengths(vertices, cell)
    longest, shortest = lengths.max(axis=0), lengths.min(axis=0)
    jacobian = corner_jacobians(vertices, cell)
    empty = (np.abs(jacobian) <= EMPTY * longest ** points.shape[1]).any(axis=0)
    _refuse(points, cells, empty, f"{cell}s without volume, or with a flat corner", number)
    if shortest.min() < SHORTEST_EDGE:
        raise MeshError(
            f"has edges of {shortest.min():.3g}; at least {SHORTEST_EDGE:g} is allowed: choose a "
            "smaller unit of length (`scale`)"
        )
    slender = longest > LONGEST_CELL * shortest
    fault = f"{cell}s more than {LONGEST_CELL:g} times as long as wide, which is not allowed"
    _refuse(points, cells, slender, fault, number)
    inside_out = (jacobian < 0.0).all(axis=0)
    folded = (jacobian < 0.0).any(axis=0) & ~inside_out
    fault = (
        f"{cell}s folded into themselves, or with their nodes in another order than the format's"
    )
    _refuse(points, cells, folded, fault, number)
    cells[inside_out] = cells[inside_out][:, np.array(REVERSED[cell])]
    if cell == "hexahedron":
        rows = np.flatnonzero(warped(points, cells))
        folded[rows] = folded_inside(points, cells[rows], cell, 1)
        fault = f"{cell}s folded inside: their Jacobian is positive at their corners only"
        _refuse(points, cells, folded, fault, number)
    return inside_out


def _refuse(points: Array, cells: Ints, bad: Mask, fault: str, number: Ints) -> None:
    """Refuse a mesh of which some cells are `bad` (cells,)."""
    if bad.any():
        raise MeshError(first_of(points, cells, bad, fault, number))


def _pieces(cells: Ints, topology: Topology) -> Ints:
    """Number of the piece of each cell, (cells,); pieces are connected through facets."""
    return connected(topology.pairs.T, len(cells))


def _refuse_pieces(
    points: Array, cells: Ints, label: Ints, groups: Collection[str], chosen: Collection[str]
) -> None:
    """Refuse a body of more than one piece; `label` (cells,) numbers them.

    Parameters
    ----------
    groups
        Names of groups of cells in the file.
    chosen
        Groups of the body; none if it has all cells.
    """
    number = int(label.max()) + 1
    if number == 1:
        return
    sizes = np.bincount(label)
    smallest = int(np.argmin(sizes))
    centre = points[cells[label == smallest]].reshape(-1, points.shape[1]).mean(axis=0)
    at = ", ".join(f"{v:g}" for v in centre)
    names = f" ({', '.join(sorted(groups)[:9])})" if groups else (
        ", which the file lacks: give each piece a physical group in the mesher, or a file"
    )  # fmt: skip
    if len(chosen) == 1:
        names = f", but {min(chosen)} holds them all: give each a physical group in the mesher"
    raise MeshError(
        f"falls into {number} pieces that share no facet, the smallest of {sizes[smallest]} cells "
        f"about ({at}); each piece is a body of its own: choose its cells by `group`{names}"
    )


def _sides(
    content: FileContent, rename: Ints, cells: Ints, topology: Topology, notes: list[str]
) -> tuple[dict[str, NDArray[np.int32]], dict[str, Ints]]:
    """Rows of the surface facets in each group, and cells on one side of each inner surface.

    Groups without facets are left out.
    """
    surface = in_order(topology.facets)
    sides, inner = {}, {}
    for name, facets in content.facet_groups.items():
        nodes = in_order(rename[facets])
        nodes = nodes[nodes[:, 0] >= 0]
        rows = row_places(surface, nodes)
        inside, on_surface = np.unique(nodes[rows < 0], axis=0), distinct_numbers(rows[rows >= 0])
        total = len(inside) + len(on_surface)
        side = sides_of_facets(inside, cells, content.kind.name, topology)
        if side is not None:
            inner[name] = np.flatnonzero(side)
        elif len(inside):
            notes.append(
                f"{len(inside)} of {total} facets of the group {name!r} are not "
                "on the surface of the body: left out"
            )
        if len(on_surface):
            sides[name] = on_surface.astype(np.int32)
    for name, nodes in content.point_groups.items():
        if name in sides or name in inner:
            continue
        within = np.zeros(rename.max() + 1, bool)
        within[rename[nodes][rename[nodes] >= 0]] = True
        rows = np.flatnonzero(within[topology.facets].all(axis=1))
        if len(rows):
            sides[name] = rows.astype(np.int32)
        else:
            notes.append(f"the nodes of {name!r} enclose no facet of the surface: left out")
    return sides, inner
