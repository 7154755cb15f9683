"""The lower half of a mirror-symmetric body about a plane normal to an axis, and mirror images.

A box is its own image where it has an even number of cells across the plane: the half is a box
again. The diagonals of triangles and tetrahedra are not mirror-symmetric: the half is meshed and
mirrored. The whole is then another division of the same box, of equal quality.

A mesh from a file is its own image where the reflection takes its nodes onto nodes, its cells onto
cells of the same material, and cuts none of them. The half keeps the file's cells on the lower side
as they are, so that it and its image are the file's mesh.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from meshes.arrays import Array, Ints, Mask
from meshes.box import SIDES, BoxShape, lattice_places
from meshes.unstructured import CellMesh, Topology, row_places

SAME = 1e-9
"""Distance over the size of a mesh below which a mirror image coincides with a node."""


class AsymmetryError(ValueError):
    """A mesh is not mirror-symmetric; the message says why and follows the name of the body."""


@dataclass(frozen=True, eq=False)
class HalfSurface:
    """The surface of a half without its cut, and its mirror image."""

    points: Array
    images: Array
    """Nodes of the half, and the coordinates of their images in the whole. Shape (nodes, 3)."""
    on_plane: Mask  # (nodes,)
    """Mask of the nodes that are their own image."""
    facets: Ints  # (facets, nodes per facet)
    """Vertices first."""
    sides: Mapping[str, tuple[Mask, Mask]]
    """For each named boundary: masks of the facets on it, and of the facets whose images are on
    it."""
    of: tuple[bool, bool] = (True, True)
    """Whether the body has these facets, and whether it has their images. If the image is another
    body, only one of the two is true."""


def half_box(box: BoxShape, axis: int) -> HalfSurface:
    """The surface of the lower half of a box.

    Raises
    ------
    AsymmetryError
        It has an odd number of cells along the axis.
    """
    count = box.cells[axis]
    if count % 2:
        raise AsymmetryError(f"has an odd number of cells, {count}")
    cells = tuple(n // 2 if a == axis else n for a, n in enumerate(box.cells))
    place, facets, side_of = _box_surface(box, cells, 2 * axis + 1)
    image = place.copy()
    image[:, axis] = box.degree * count - place[:, axis]
    sides = {}
    for number, (name, across, _) in enumerate(SIDES[: 2 * box.dimension]):
        lower = side_of == number  # the upper side is the image of the lower side
        sides[name] = (lower, side_of == (number ^ 1 if across == axis else number))
    on_plane = place[:, axis] == box.degree * cells[axis]
    return HalfSurface(_places(box, place), _places(box, image), on_plane, facets, sides)


def box_images(box: BoxShape, other: BoxShape, axis: int) -> tuple[HalfSurface, HalfSurface]:
    """The surface of a box and of its mirror image, another box, from the view of each."""
    place, facets, side_of = _box_surface(box, box.cells)
    image = place.copy()
    image[:, axis] = box.degree * box.cells[axis] - place[:, axis]
    is_beside = np.zeros(len(place), bool)
    none = np.zeros(len(facets), bool)
    points, images = _places(box, place), _places(other, image)
    lower, others = {}, {}
    for number, (name, across, _) in enumerate(SIDES[: 2 * box.dimension]):
        lower[name] = (side_of == number, none)
        others[name] = (none, side_of == (number ^ 1 if across == axis else number))
    return (
        HalfSurface(points, images, is_beside, facets, lower, (True, False)),
        HalfSurface(points, images, is_beside, facets, others, (False, True)),
    )


def _box_surface(
    box: BoxShape, cells: tuple[int, ...], skipped: int = -1
) -> tuple[Ints, Ints, Ints]:
    """Surface of the first cells of a box along each axis, all sides but one.

    Returns
    -------
    Places of its nodes on the lattice (nodes, d), its facets (facets, nodes per facet), and the
    number of the side of each facet.
    """
    ends = np.array([box.degree * n for n in cells])
    strides = np.cumprod([1, *(ends[:-1] + 1)], dtype=np.int64)
    faces, of_side = [], []
    for number, (_, across, end) in enumerate(SIDES[: 2 * box.dimension]):
        if number == skipped:
            continue
        bricks = lattice_places([1 if a == across else n for a, n in enumerate(cells)])
        bricks[:, across] += end * (cells[across] - 1)
        place = box.degree * bricks[:, None, None] + _brick_sides(box.cell, box.degree)[number]
        faces.append((place @ strides).reshape(-1, place.shape[2]))
        of_side.append(np.full(len(faces[-1]), number))
    used, facets = np.unique(np.concatenate(faces), return_inverse=True)
    place = used[:, None] // strides % (ends + 1)
    return place, facets.reshape(-1, faces[0].shape[1]), np.concatenate(of_side)


def _places(box: BoxShape, lattice: Ints) -> Array:
    """Coordinates (n, 3) of places on the lattice of a box."""
    points = np.zeros((len(lattice), 3))
    points[:, : box.dimension] = np.array(box.lower) + lattice * (box.spacing / box.degree)
    return points


@cache
def _brick_sides(cell: str, degree: int) -> list[Ints]:
    """Places on the lattice of the nodes of the facets on each side of a box of one brick."""
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    brick = BoxShape((0.0,) * d, (1.0,) * d, (1,) * d, cell, degree)
    mesh, place = brick.cell_mesh(), lattice_places([degree + 1] * d)
    return [place[mesh.topology.facets[mesh.sides[name]]] for name, _, _ in SIDES[: 2 * d]]


def half_mesh(
    mesh: CellMesh, degree: int, kinds: Ints, axis: int, at: float, cut: str
) -> tuple[CellMesh, HalfSurface]:
    """The lower half of a mesh from a file, and its surface.

    Parameters
    ----------
    degree
        Degree of the displacement; all its nodes are compared with their images.
    kinds : (tags,)
        A number for each material of the body, equal for equal materials.
    at
        Coordinate of the plane.
    cut
        Name of the cut among the boundaries of the half.

    Raises
    ------
    AsymmetryError
        The mesh is not mirror-symmetric.
    """
    shape = mesh.shape(degree)
    tolerance = SAME * float(np.ptp(shape.points, axis=0).max())
    above = shape.points[:, axis] - at
    place = _image_nodes(shape, shape, axis, at, tolerance)
    lower = (above[shape.cells] <= tolerance).all(axis=1)
    across = ~lower & ~(above[shape.cells] >= -tolerance).all(axis=1)
    if across.any():
        raise AsymmetryError(f"has a {mesh.cell} at {_middle(shape, across)} that the plane cuts")
    _refuse_unlike(shape, shape, place, kinds[mesh.tags], kinds[mesh.tags])
    half = _lower(mesh, lower, axis, at, tolerance, cut)
    facets, owner = shape.topology.facets, shape.topology.facet_cells
    points, images, used, local, image = _facet_images(shape, shape, facets[lower[owner]], place)
    sides = {}
    for name, rows in mesh.sides.items():
        member = np.zeros(len(facets), bool)
        member[rows] = True
        sides[name] = (member[lower[owner]], member[image])
    on_plane = np.abs(above[used]) <= tolerance
    return half, HalfSurface(points, images, on_plane, local, sides)


def mesh_images(
    mesh: CellMesh, other: CellMesh, degree: int, kinds: tuple[Ints, Ints], axis: int, at: float
) -> tuple[HalfSurface, HalfSurface]:
    """The surface of a mesh and of its mirror image, another mesh, from the view of each.

    Parameters and errors are those of `half_mesh`.
    """
    shape, image = mesh.shape(degree), other.shape(degree)
    if (mesh.cell, shape.points.shape, shape.cells.shape) != (
        other.cell, image.points.shape, image.cells.shape
    ):  # fmt: skip
        raise AsymmetryError("has another number of nodes or cells than what should be its image")
    tolerance = SAME * float(np.ptp(shape.points, axis=0).max())
    place = _image_nodes(shape, image, axis, at, tolerance)
    _refuse_unlike(shape, image, place, kinds[0][mesh.tags], kinds[1][other.tags])
    facets = shape.topology.facets
    points, images, _, local, rows_there = _facet_images(shape, image, facets, place)
    is_beside, none = np.zeros(len(points), bool), np.zeros(len(facets), bool)

    def members(rows: NDArray[np.int32], other_facets: Ints | slice) -> Mask:
        member = np.zeros(len(facets), bool)
        member[rows] = True
        return np.asarray(member[other_facets])

    lower = {name: (members(rows, slice(None)), none) for name, rows in mesh.sides.items()}
    others = {name: (none, members(rows, rows_there)) for name, rows in other.sides.items()}
    return (
        HalfSurface(points, images, is_beside, local, lower, (True, False)),
        HalfSurface(points, images, is_beside, local, others, (False, True)),
    )


def _image_nodes(mesh: CellMesh, other: CellMesh, axis: int, at: float, tolerance: float) -> Ints:
    """The node of another (or the same) mesh at the image of each node of a mesh, (n,)."""
    x, image = mesh.points, mesh.points.copy()
    image[:, axis] = 2.0 * at - image[:, axis]
    distance, place = cKDTree(other.points).query(image)
    worst = int(np.argmax(distance))
    if distance[worst] > tolerance:
        raise AsymmetryError(
            f"has no node at the image of that at {_point(x[worst])}: the nearest is "
            f"{distance[worst]:.3g} away ({tolerance:.1g} is allowed)"
        )
    if len(np.unique(place)) < len(place):
        raise AsymmetryError(f"has nodes nearer to each other than {tolerance:.1g}")
    return np.asarray(place, np.int64)


def _refuse_unlike(
    mesh: CellMesh, other: CellMesh, place: Ints, kind: Ints, other_kind: Ints
) -> None:
    """Refuse cells whose images are not cells, or are of another material."""
    image = row_places(np.sort(other.cells, axis=1), np.sort(place[mesh.cells], axis=1))
    if (image < 0).any():
        where = _middle(mesh, image < 0)
        raise AsymmetryError(f"has a {mesh.cell} at {where} whose mirror image is none")
    unlike = kind != other_kind[image]
    if unlike.any():
        where = _middle(mesh, unlike)
        raise AsymmetryError(f"has a {mesh.cell} at {where} whose image is of another material")


def _facet_images(
    mesh: CellMesh, other: CellMesh, facets: Ints, place: Ints
) -> tuple[Array, Array, Ints, Ints, Ints]:
    """Nodes of facets and of their images.

    Returns
    -------
    Coordinates of both (nodes, 3), the nodes, the facets by rows of these nodes, and the rows of
    the images among the facets of the other mesh.
    """
    other_facets = np.sort(other.topology.facets, axis=1)
    image = row_places(other_facets, np.sort(place[facets], axis=1))
    used, local = np.unique(facets, return_inverse=True)
    padding = ((0, 0), (0, 3 - mesh.dimension))
    points = np.pad(mesh.points[used], padding)
    images = np.pad(other.points[place[used]], padding)
    return points, images, used, local.reshape(facets.shape), image


def _lower(
    mesh: CellMesh, below: Mask, axis: int, at: float, tolerance: float, cut: str
) -> CellMesh:
    """The cells on the lower side; nodes near the plane are moved exactly onto it."""
    used, cells = np.unique(mesh.cells[below], return_inverse=True)
    cells = cells.reshape(-1, mesh.cells.shape[1])
    points = mesh.points[used]
    points[np.abs(points[:, axis] - at) <= tolerance, axis] = at
    middles = mesh.middles
    if middles is not None:
        middles = middles[below]
        middles[np.abs(middles[..., axis] - at) <= tolerance, axis] = at
    topology = Topology.of(cells, mesh.cell)
    before = row_places(
        np.sort(mesh.topology.facets, axis=1), np.sort(used[topology.facets], axis=1)
    )
    sides = {name: np.flatnonzero(np.isin(before, rows)) for name, rows in mesh.sides.items()}
    sides[cut] = np.flatnonzero(before < 0)
    number = np.cumsum(below) - 1
    return replace(
        mesh,
        points=points,
        cells=cells,
        topology=topology,
        sides={name: rows.astype(np.int32) for name, rows in sides.items() if len(rows)},
        groups={name: number[rows[below[rows]]] for name, rows in mesh.groups.items()},
        inner={},  # the image of an inner surface need not be one: such scenes are not cut
        tags=mesh.tags[below],
        name=f"{mesh.name} below {'xyz'[axis]} = {at:g}",
        middles=middles,
    )


def _middle(mesh: CellMesh, of: Mask) -> str:
    """The middle of the first of some cells."""
    return _point(mesh.points[mesh.cells[np.argmax(of)]].mean(axis=0))


def _point(x: Array) -> str:
    return "(" + ", ".join(f"{v:g}" for v in x) + ")"
