"""The lower half of a body that is its own mirror image about a plane across an axis.

A box is its own image where it has an even number of cells across the plane: the half is a box
again. Triangles and tetrahedra, whose diagonals no mirror keeps, are laid out in the half and
mirrored with it; the whole is then another division of the same box, as good as the one that
repeats a diagonal.

A mesh from a file is its own image where the reflection takes its nodes onto nodes, its cells onto
cells of the same material, and cuts none of them. The half keeps the file's cells on the lower side
as they are, so that it and its image are the file's mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from meshes.box import SIDES, BoxShape, lattice_places
from meshes.unstructured import CellMesh, Topology, row_places

SAME = 1e-9
"""Distance over the size of a mesh below which an image is at the place of a node."""

Bools = NDArray[np.bool_]


class AsymmetryError(ValueError):
    """A mesh is not its own image; the text says why, to be read after the body's name."""


@dataclass(frozen=True, eq=False)
class HalfSurface:
    """The surface of a half but for its cut, beside its image.

    Attributes
    ----------
    points, images : (nodes, 3)
        Nodes of the half, and where the whole has their images.
    on_plane : (nodes,)
        Which of them are their own image.
    facets : (facets, nodes a facet)
        Vertices first.
    sides
        By the name of a part of the surface: which facets are on it, and whose images are.
    """

    points: NDArray[np.float64]
    images: NDArray[np.float64]
    on_plane: Bools
    facets: NDArray[np.int64]
    sides: Mapping[str, tuple[Bools, Bools]]


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
    ends = np.array([box.degree * n for n in cells])
    strides = np.cumprod([1, *(ends[:-1] + 1)], dtype=np.int64)
    faces, of_side = [], []
    for number, (_, across, end) in enumerate(SIDES[: 2 * box.dimension]):
        if (across, end) == (axis, 1):
            continue
        bricks = lattice_places([1 if a == across else n for a, n in enumerate(cells)])
        bricks[:, across] += end * (cells[across] - 1)
        place = box.degree * bricks[:, None, None] + _brick_sides(box.cell, box.degree)[number]
        faces.append((place @ strides).reshape(-1, place.shape[2]))
        of_side.append(np.full(len(faces[-1]), number))
    used, facets = np.unique(np.concatenate(faces), return_inverse=True)
    place = used[:, None] // strides % (ends + 1)
    image = place.copy()
    image[:, axis] = 2 * ends[axis] - place[:, axis]
    side_of, shape = np.concatenate(of_side), (-1, faces[0].shape[1])
    sides = {}
    for number, (name, across, _) in enumerate(SIDES[: 2 * box.dimension]):
        own = side_of == number  # none on the upper side of the axis, whose images are the lower's
        sides[name] = (own, side_of == (number ^ 1 if across == axis else number))
    points, images = np.zeros((len(used), 3)), np.zeros((len(used), 3))
    for at, lattice in ((points, place), (images, image)):
        at[:, : box.dimension] = np.array(box.lower) + lattice * (box.spacing / box.degree)
    on_plane = place[:, axis] == ends[axis]
    return HalfSurface(points, images, on_plane, facets.reshape(shape), sides)


@cache
def _brick_sides(cell: str, degree: int) -> list[NDArray[np.int64]]:
    """Places on the lattice of the nodes of the facets on each side of a box of one brick."""
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    brick = BoxShape((0.0,) * d, (1.0,) * d, (1,) * d, cell, degree)
    mesh, place = brick.cell_mesh(), lattice_places([degree + 1] * d)
    return [place[mesh.topology.facets[mesh.sides[name]]] for name, _, _ in SIDES[: 2 * d]]


def half_mesh(
    mesh: CellMesh, degree: int, kinds: NDArray[np.int64], axis: int, at: float, cut: str
) -> tuple[CellMesh, HalfSurface]:
    """The lower half of a mesh from a file, and its surface.

    Parameters
    ----------
    degree
        Of the displacement, whose nodes are held against their images.
    kinds : (tags,)
        A number for each of the body's materials, equal for equal ones.
    at
        Where the plane is.
    cut
        The name its cut gets among the parts of the half's surface.

    Raises
    ------
    AsymmetryError
        It is not its own image.
    """
    whole = mesh.shape(degree)
    x, tolerance = whole.points, SAME * float(np.ptp(whole.points, axis=0).max())
    place = _images(x, axis, at, tolerance)
    above = x[:, axis] - at
    lower = (above[whole.cells] <= tolerance).all(axis=1)
    across = ~lower & ~(above[whole.cells] >= -tolerance).all(axis=1)
    if across.any():
        raise AsymmetryError(f"has a {mesh.cell} at {_middle(whole, across)} that the plane cuts")
    image = row_places(np.sort(whole.cells, axis=1), np.sort(place[whole.cells], axis=1))
    if (image < 0).any():
        where = _middle(whole, image < 0)
        raise AsymmetryError(f"has a {mesh.cell} at {where} whose mirror image is none")
    kind = kinds[mesh.tags]
    if (kind != kind[image]).any():
        where = _middle(whole, kind != kind[image])
        raise AsymmetryError(f"has a {mesh.cell} at {where} whose image is of another material")
    half = _lower(mesh, lower, axis, at, tolerance, cut)
    return half, _surface(whole, mesh.sides, lower, place, np.abs(above) <= tolerance)


def _images(x: NDArray[np.float64], axis: int, at: float, tolerance: float) -> NDArray[np.int64]:
    """The node at the image of each node (n,)."""
    image = x.copy()
    image[:, axis] = 2.0 * at - image[:, axis]
    distance, place = cKDTree(x).query(image)
    worst = int(np.argmax(distance))
    if distance[worst] > tolerance:
        raise AsymmetryError(
            f"has no node at the image of that at {_point(x[worst])}: the nearest is "
            f"{distance[worst]:.3g} away ({tolerance:.1g} is allowed)"
        )
    return np.asarray(place, np.int64)


def _lower(
    mesh: CellMesh, kept: Bools, axis: int, at: float, tolerance: float, cut: str
) -> CellMesh:
    """The cells on the lower side; nodes on the plane exactly so."""
    used, cells = np.unique(mesh.cells[kept], return_inverse=True)
    cells = cells.reshape(-1, mesh.cells.shape[1])
    points = mesh.points[used]
    points[np.abs(points[:, axis] - at) <= tolerance, axis] = at
    middles = mesh.middles
    if middles is not None:
        middles = middles[kept]
        middles[np.abs(middles[..., axis] - at) <= tolerance, axis] = at
    topology = Topology.of(cells, mesh.cell)
    before = row_places(
        np.sort(mesh.topology.facets, axis=1), np.sort(used[topology.facets], axis=1)
    )
    sides = {name: np.flatnonzero(np.isin(before, rows)) for name, rows in mesh.sides.items()}
    sides[cut] = np.flatnonzero(before < 0)
    number = np.cumsum(kept) - 1
    return replace(
        mesh,
        points=points,
        cells=cells,
        topology=topology,
        sides={name: rows.astype(np.int32) for name, rows in sides.items() if len(rows)},
        groups={name: number[rows[kept[rows]]] for name, rows in mesh.groups.items()},
        tags=mesh.tags[kept],
        name=f"{mesh.name} below {'xyz'[axis]} = {at:g}",
        middles=middles,
    )


def _surface(
    whole: CellMesh,
    sides: Mapping[str, NDArray[np.int32]],
    lower: Bools,
    place: NDArray[np.int64],
    on_plane: Bools,
) -> HalfSurface:
    """The surface of the cells on the lower side, and its images."""
    facets, own = whole.topology.facets, lower[whole.topology.facet_cells]
    image = row_places(np.sort(facets, axis=1), np.sort(place[facets[own]], axis=1))
    used, local = np.unique(facets[own], return_inverse=True)
    padding = ((0, 0), (0, 3 - whole.dimension))
    found = {}
    for name, rows in sides.items():
        member = np.zeros(len(facets), bool)
        member[rows] = True
        found[name] = (member[own], member[image])
    return HalfSurface(
        points=np.pad(whole.points[used], padding),
        images=np.pad(whole.points[place[used]], padding),
        on_plane=on_plane[used],
        facets=local.reshape(-1, facets.shape[1]),
        sides=found,
    )


def _middle(mesh: CellMesh, of: Bools) -> str:
    """The middle of the first of some cells."""
    return _point(mesh.points[mesh.cells[np.argmax(of)]].mean(axis=0))


def _point(x: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in x) + ")"
