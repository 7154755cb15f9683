"""Mesh files for the tests: blocks of distorted cells with named groups, written by meshio.

Nodes are numbered in a random order and moved at random inside the block (so facets of hexahedra
inside are not plane); triangles and tetrahedra come from cutting the distorted cells. The left
half (x < ½) is the group ``soft``, the right half ``hard``; each face is a group by the name a box
would give it, with ``bottom`` the lowest one.
"""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from meshes import BoxShape
from meshes.quadratic import node_vertices, reordering
from meshes.repair import REVERSED

MESHIO = {
    "triangle": "triangle",
    "quadrilateral": "quad",
    "tetrahedron": "tetra",
    "hexahedron": "hexahedron",
}
FACET = {
    "triangle": "line",
    "quadrilateral": "line",
    "tetrahedron": "triangle",
    "hexahedron": "quad",
}
FACETS = {
    "triangle": [(0, 1), (1, 2), (2, 0)],
    "quadrilateral": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tetrahedron": [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)],
    "hexahedron": [
        (0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
    ],
}  # fmt: skip
# a hexahedron along its diagonal 0-6: six tetrahedra that fit their neighbours'
TETRAHEDRA = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]


def dimension(cell: str) -> int:
    return 2 if cell in ("triangle", "quadrilateral") else 3


def block(cell: str, n: int, distort: float = 0.2, seed: int = 1) -> meshio.Mesh:
    """The unit block of about n cells along each axis, an even number."""
    random = np.random.default_rng(seed)
    d = dimension(cell)
    axes = np.meshgrid(*[np.arange(n + 1)] * d, indexing="ij")
    lattice = np.stack([a.ravel() for a in axes], axis=1)
    points = lattice / n
    inside = ((lattice > 0) & (lattice < n)).all(axis=1) & (lattice[:, 0] * 2 != n)
    points[inside] += distort / n * random.uniform(-1, 1, (inside.sum(), d))
    order = random.permutation(len(points))
    number = np.empty((n + 1,) * d, int)
    number.ravel()[order] = np.arange(len(points))
    points = points[order]

    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    if d == 3:
        corners = [(*c, z) for z in (0, 1) for c in corners]
    first = np.array(list(itertools.product(range(n), repeat=d)))
    cells = np.stack([number[tuple((first + c).T)] for c in np.array(corners)], axis=1)
    if cell == "triangle":
        cells = cells[:, [(0, 1, 2), (0, 2, 3)]].reshape(-1, 3)
    if cell == "tetrahedron":
        cells = cells[:, TETRAHEDRA].reshape(-1, 4)
    cells = cells[random.permutation(len(cells))]
    if d == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return named(cell, points, cells)


def named(cell: str, points: np.ndarray, cells: np.ndarray) -> meshio.Mesh:
    """A mesh whose halves and faces of the unit block have names."""
    d = dimension(cell)
    facets = cells[:, FACETS[cell]].reshape(-1, len(FACETS[cell][0]))
    field_data = {"soft": [1, d], "hard": [2, d]}
    parts, numbers = [], []
    for k, (axis, side) in enumerate(itertools.product(range(d), (0, 1)), start=11):
        on = facets[(np.abs(points[facets][..., axis] - side) < 1e-12).all(axis=1)]
        parts.append(on)
        numbers.append(np.full(len(on), k))
        field_data["xyz"[axis] + "-+"[side]] = [k, d - 1]
    soft = points[cells][..., 0].mean(axis=1) < 0.5
    return meshio.Mesh(
        points,
        [(MESHIO[cell], cells), (FACET[cell], np.concatenate(parts))],
        cell_data={"gmsh:physical": [np.where(soft, 1, 2), np.concatenate(numbers)],
                   "gmsh:geometrical": [np.where(soft, 1, 2), np.concatenate(numbers)]},
        field_data={name: np.array(v) for name, v in field_data.items()},
    )  # fmt: skip


def mirrored(cell: str, n: int, axes: str) -> meshio.Mesh:
    """The unit block of n cells along each axis, divided as a box of half of them and its images.

    Nodes and cells are in a random order.
    """
    d = dimension(cell)
    cut = [axis for axis in range(d) if "xyz"[axis] in axes]
    upper = tuple(0.5 if axis in cut else 1.0 for axis in range(d))
    counts = tuple(n // 2 if axis in cut else n for axis in range(d))
    half = BoxShape((0.0,) * d, upper, counts, cell).cell_mesh()
    points = np.pad(half.points, ((0, 0), (0, 3 - d)))
    mesh = meshio.Mesh(points, [(MESHIO[cell], half.cells)])
    for axis in cut:
        mesh = with_image(mesh, axis, 0.5)
    random = np.random.default_rng(3)
    order = random.permutation(len(mesh.points))
    cells = np.argsort(order)[random.permutation(mesh.cells[0].data)]
    return named(cell, mesh.points[order], cells)


def with_image(mesh: meshio.Mesh, axis: int, at: float) -> meshio.Mesh:
    """A mesh and its mirror image about a plane across an axis; nodes on the plane are one."""
    beside = np.abs(mesh.points[:, axis] - at) > 1e-9
    image = np.arange(len(mesh.points))
    image[beside] = len(mesh.points) + np.arange(beside.sum())
    points = mesh.points[beside]
    points[:, axis] = 2.0 * at - points[:, axis]
    blocks = []
    for block in mesh.cells:
        cells = image[block.data]
        known = [c for c, names in SECOND.items() if block.type in (MESHIO[c], *names)]
        if known and block.dim == max(b.dim for b in mesh.cells):
            cells = cells[:, reordering(known[0], REVERSED[known[0]])[: cells.shape[1]]]
        blocks.append((block.type, np.concatenate([block.data, cells])))
    return meshio.Mesh(
        np.concatenate([mesh.points, points]),
        blocks,
        cell_data={k: [np.tile(v, 2) for v in values] for k, values in mesh.cell_data.items()},
        field_data=mesh.field_data,
    )


SECOND = {
    "triangle": ("triangle6",),
    "quadrilateral": ("quad8", "quad9"),
    "tetrahedron": ("tetra10",),
    "hexahedron": ("hexahedron20", "hexahedron27"),
}
"""meshio's names of the cells of second order."""


def ring(
    inner: float, outer: float, high: float = 1.0, angle: float = 0.5 * np.pi
) -> Callable[[np.ndarray], np.ndarray]:
    """Function that bends the unit block (n, 3) into a sector of a ring about the z axis."""

    def bent(x: np.ndarray) -> np.ndarray:
        radius, turn = inner + (outer - inner) * x[:, 0], angle * x[:, 1]
        return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), high * x[:, 2]])

    return bent


bend = ring(1.0, 2.0, angle=0.25 * np.pi)


def second_order(
    mesh: meshio.Mesh, cell: str, name: str, shape: Callable[[np.ndarray], np.ndarray]
) -> meshio.Mesh:
    """A block with nodes amid edges (faces, cells), all nodes moved by `shape`; groups stay.

    Facets stay of first order: their corners name them.
    """
    cells = mesh.cells[0].data
    places, columns = [mesh.points], [cells]
    count = len(mesh.points)
    for on in node_vertices(cell)[cells.shape[1] :]:
        if len(columns) + cells.shape[1] > int("".join(filter(str.isdigit, name))):
            break
        places.append(mesh.points[cells[:, list(on)]].mean(axis=1))
        columns.append(count + np.arange(len(cells))[:, None])
        count += len(cells)
    return meshio.Mesh(
        shape(np.concatenate(places)),
        [(name, np.concatenate(columns, axis=1)), *((b.type, b.data) for b in mesh.cells[1:])],
        cell_data=mesh.cell_data,
        field_data=mesh.field_data,
    )


def on_circle(mesh: meshio.Mesh, centre: tuple[float, float], radius: float) -> meshio.Mesh:
    """A plane mesh of first order with nodes amid edges, those of edges of a circle on it."""
    cell = next(c for c, name in MESHIO.items() if name == mesh.cells[-1].type)
    order = [len(mesh.cells) - 1, *range(len(mesh.cells) - 1)]
    blocks = [mesh.cells[i] for i in order]
    data = {key: [values[i] for i in order] for key, values in mesh.cell_data.items()}
    first = meshio.Mesh(mesh.points, blocks, cell_data=data, field_data=mesh.field_data)
    made = second_order(first, cell, SECOND[cell][-1], np.array)
    away = made.points[:, :2] - centre
    cells = made.cells[0].data
    corners = np.hypot(*away[cells[:, : len(FACETS[cell])]].T).T
    on = np.abs(corners - radius) < 1e-6 * radius
    for k, (a, b) in enumerate(FACETS[cell]):
        moved = cells[on[:, a] & on[:, b], len(FACETS[cell]) + k]
        scale = radius / np.hypot(*away[moved].T)
        made.points[moved, :2] = centre + away[moved] * scale[:, None]
    return made


def write(
    mesh: meshio.Mesh, path: Path, file_format: str | None = "gmsh22", **options: object
) -> Path:
    """Write a mesh; Gmsh 2.2 unless told otherwise (None: by the ending)."""
    if file_format == "gmsh":
        mesh = by_entities(mesh)
    meshio.write(path, mesh, file_format=file_format, **options)
    return path


def by_entities(mesh: meshio.Mesh) -> meshio.Mesh:
    """The mesh as Gmsh 4.1 has it: each group the cells of one entity, each node on an entity."""
    blocks, tags = [], []
    for block, numbers in zip(mesh.cells, mesh.cell_data["gmsh:physical"], strict=True):
        for number in np.unique(numbers):
            blocks.append((block.type, block.data[numbers == number]))
            tags.append(np.full(len(blocks[-1][1]), number))
    entities = [[meshio.CellBlock(t, c).dim, n[0]] for (t, c), n in zip(blocks, tags, strict=True)]
    return meshio.Mesh(
        mesh.points,
        blocks,
        point_data={"gmsh:dim_tags": np.resize(entities, (len(mesh.points), 2))},
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data=mesh.field_data,
    )


def lattice(cell: str, counts: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points (nodes, 3) and cells of the unit block of so many cells along each axis."""
    d = dimension(cell)
    made = BoxShape((0.0,) * d, (1.0,) * d, counts[:d], cell).cell_mesh()
    return np.pad(made.points, ((0, 0), (0, 3 - d))), made.cells


def of_cells(cell: str, points: np.ndarray, cells: np.ndarray) -> meshio.Mesh:
    """A mesh without groups; plane ones at z = 0."""
    if dimension(cell) == 2:
        points = points * [1.0, 1.0, 0.0]
    return meshio.Mesh(points, [(MESHIO[cell], cells)])


def part(
    path: Path,
    cell: str,
    counts: tuple[int, ...],
    shape: Callable[[np.ndarray], np.ndarray],
    sides: dict[str, str],
    **keys: Any,
) -> dict[str, Any]:
    """A body of a scene with the name of its mesh file, which is written: a block that is shaped.

    Parameters
    ----------
    counts
        Cells along each axis of the unit block.
    shape
        Places of points (n, 3) of the block, (n, 2 or 3).
    sides
        Expressions of boundaries, by name.
    keys
        Further keys of the body; steel unless another material is named.
    """
    points, cells = lattice(cell, counts)
    places = shape(points)
    places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
    write(of_cells(cell, places, cells), path, None)
    return {
        "name": path.stem,
        "mesh": {"file": str(path)},
        "material": {"young": 2.1e5, "poisson": 0.3},
        "boundaries": {name: {"where": where} for name, where in sides.items()},
        **keys,
    }


def spiral(
    cell: str, turns: float, width: float, pitch: float, rise: float = 0.0, counts: int = 24
) -> meshio.Mesh:
    """A band of a width wound about the z axis, of inner radius 1 at its start.

    A turn moves it outward by `pitch` and up by `rise`; in 3D its height is `width`, too. It
    overlaps itself where it is wound by more than a turn and wider than pitch and rise.
    """
    around = max(3, round(counts * turns))
    points, cells = lattice(cell, (around, 2, 2))
    s, t, u = points.T
    angle, radius = 2.0 * np.pi * turns * s, 1.0 + turns * pitch * s + width * t
    height = turns * rise * s + width * u
    wound = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return of_cells(cell, wound, cells)


def loop(cell: str, far: bool) -> meshio.Mesh:
    """A strip along a path that crosses itself (an alpha); in 3D it passes above where `far`."""
    points, cells = lattice(cell, (40, 2, 2))
    s = 2.0 * points[:, 0] - 1.0
    path = np.column_stack([3.0 * s**2, 4.0 * (s**3 - 0.6 * s), s if far else 0.05 * s])
    slope = np.column_stack([6.0 * s, 4.0 * (3.0 * s**2 - 0.6), 0.0 * s])
    side = np.column_stack([-slope[:, 1], slope[:, 0]]) / np.hypot(*slope[:, :2].T)[:, None]
    path[:, :2] += 0.2 * (points[:, 1, None] - 0.5) * side
    path[:, 2] += 0.2 * points[:, 2]
    return of_cells(cell, path, cells)


def tangled(cell: str, seed: int) -> meshio.Mesh:
    """The unit block with one node inside pulled through the surface of the cells it belongs to."""
    random = np.random.default_rng(seed)
    n, d = 4, dimension(cell)
    points, cells = lattice(cell, (n,) * d)
    inside = ((points[:, :d] > 0.3) & (points[:, :d] < 0.7)).all(axis=1)
    node = random.choice(np.flatnonzero(inside))
    away = random.normal(size=d)
    points[node, :d] += (random.uniform(2.1, 4.0) / n) * away / np.abs(away).max()
    return of_cells(cell, points, cells)


def pitchfork(cell: str, gap: float, prongs: int = 2, high: int = 3) -> meshio.Mesh:
    """Prongs of width 1 on a foot, `gap` apart; of cells of about 1."""
    columns = 2 * prongs - 1
    points, cells = lattice(cell, (columns, high, 2))
    index = np.rint(points * [columns, high, 2]).astype(int)
    middle = points[cells].mean(axis=1) * [columns, high, 2]
    kept = (middle[:, 0].astype(int) % 2 == 0) | (middle[:, 1] < 1.0)
    x = (index[:, 0] + 1) // 2 + gap * (index[:, 0] // 2)
    return of_cells(cell, np.column_stack([x, index[:, 1], 0.5 * index[:, 2]]), cells[kept])


def two_sheets() -> meshio.Mesh:
    """A square above a larger one, joined crosswise along a slit: no facets on the surface cross.

    Each side of the slit in one square goes on in the other one, so that the mesh winds twice
    about the two ends of the slit (the surface of √(z² - ¼)); all cells have positive area.
    """
    points: list[tuple[float, float]] = []
    number: dict[tuple[int, int, int], int] = {}
    cells = []
    for sheet, half in ((0, 4), (1, 8)):
        for i, j in itertools.product(range(-half, half), repeat=2):
            corners = []
            for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                key = (sheet, a, b)
                x, y = 0.25 * a + 0.03 * sheet * (b != 0), 0.25 * b + 0.02 * sheet
                if b == 0 and abs(a) <= 2:  # on the slit: the side is of sheet `link`
                    link = sheet if j >= 0 else 1 - sheet
                    key = (2 + link if abs(a) < 2 else 4, a, 0)
                    x, y = 0.25 * a, (0.03 - 0.06 * link) * (abs(a) < 2)
                if key not in number:
                    number[key] = len(points)
                    points.append((x, y))
                corners.append(number[key])
            cells.append(corners)
    return of_cells("quadrilateral", np.pad(np.array(points), ((0, 0), (0, 1))), np.array(cells))


def overlapping(cell: str, seed: int) -> meshio.Mesh:
    """A random mesh whose cells overlap: refused, whatever is done with it."""
    random = np.random.default_rng(seed)
    wide = random.uniform(0.15, 0.4)
    kinds = {
        "tangled": lambda: tangled(cell, seed),
        "loop": lambda: loop(cell, far=False),
        "spiral": lambda: spiral(
            cell, random.uniform(1.1, 2.5), wide, wide * random.uniform(0.3, 0.9)
        ),
        "helix": lambda: spiral(
            cell, random.uniform(1.1, 2.5), wide, 0.0, wide * random.uniform(0.3, 0.9)
        ),
    }
    mesh = kinds[list(kinds)[int(random.integers(4))]]()
    mesh.points[:, : dimension(cell)] *= 10.0 ** random.uniform(-3.0, 3.0)
    return mesh
