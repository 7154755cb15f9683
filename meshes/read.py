"""Reading of mesh files by meshio: cells of one type with named groups.

Names come from Gmsh's physical groups (formats 2.2 and 4.1), from the sets of other formats
(Abaqus, MED, …), or, where groups have numbers only, the numbers as text. Groups of cells of
the body's dimension are parts of its volume, groups one dimension lower parts of its surface;
sets of nodes stand for the facets they enclose.

Cells with nodes on their edges keep them, in VTK's order.
"""

import contextlib
import io
import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from meshes.arrays import Array, Ints
from meshes.unstructured import FACETS, MeshError
from meshes.vtu_arrays import read_vtu


@dataclass(frozen=True)
class CellKind:
    """A cell type: its name here, its number of corners and meshio's names by order."""

    name: str
    dimension: int
    corners: int
    first: str
    second: tuple[str, ...]


KINDS = (
    CellKind("triangle", 2, 3, "triangle", ("triangle6",)),
    CellKind("quadrilateral", 2, 4, "quad", ("quad8", "quad9")),
    CellKind("tetrahedron", 3, 4, "tetra", ("tetra10",)),
    CellKind("hexahedron", 3, 8, "hexahedron", ("hexahedron20", "hexahedron27")),
)
FACET_CORNERS = {
    "line": 2, "line3": 2, "triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4,
}  # fmt: skip
"""Corners of the cells that can be facets."""

NUMBERED = ("gmsh:physical", "medit:ref", "nastran:ref", "CellEntityIds", "cell_tags")
"""Names of meshio's cell data that hold the numbers of groups."""

LARGEST_COORDINATE = 1e50
"""Largest magnitude of a coordinate, as of numbers in a scene: products of lengths stay finite."""

NASTRAN = (".bdf", ".fem", ".nas")
"""Endings of Nastran's bulk data."""

PLANE_ELEMENT = re.compile(r"^(\*ELEMENT\b.*\bTYPE *= *)CP[SE]([3468])[HIMR]*\b", re.I | re.M)
"""A line of Abaqus that begins elements of plane stress or strain, and how many nodes they have."""

PLANE_NAMES = {"3": "CPS3", "4": "CPS4", "6": "CPE6", "8": "S8R"}
"""A name by the number of nodes that meshio knows."""


@dataclass(frozen=True, eq=False)
class FileContent:
    """Cells of one type and the groups of a file, before any check or repair."""

    kind: CellKind
    points: Array  # (nodes, 3)
    cells: Ints  # (cells, corners)
    """In VTK order; nodes may be unused."""
    cell_groups: dict[str, Ints]
    """Ascending rows of `cells` by name."""
    facet_groups: dict[str, Ints]
    """Corner nodes of facets by name, (facets, corners)."""
    point_groups: dict[str, Ints]
    """Nodes by name."""
    nodes: tuple[Ints, ...]
    """All nodes of the cells as the file has them, block by block in the order of `cells`: blocks
    of cells of second order have more than the corners."""
    notes: tuple[str, ...]
    """Notes on data that were left out, one sentence each."""

    @property
    def second_order(self) -> bool:
        """Whether cells have nodes besides their corners."""
        return any(block.shape[1] > self.kind.corners for block in self.nodes)

    @cached_property
    def distinct(self) -> tuple[Ints, Ints, int]:
        """`distinct_cells`, once for all bodies of the file."""
        return distinct_cells(self.cells)


def distinct_cells(cells: Ints) -> tuple[Ints, Ints, int]:
    """Cells without repetitions, the row of each given cell, the number of repetitions."""
    if _all_differ(cells):
        return cells, np.arange(len(cells)), 0
    ordered = np.sort(cells, axis=1)
    order = np.lexsort(ordered.T[::-1])
    new = np.ones(len(cells), bool)
    new[1:] = (ordered[order][1:] != ordered[order][:-1]).any(axis=1)
    leader = np.empty(len(cells), np.int64)
    leader[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]  # lexsort is stable
    distinct = np.unique(leader)
    return cells[distinct], np.searchsorted(distinct, leader), len(cells) - len(distinct)


def _all_differ(cells: Ints) -> bool:
    """Whether all cells differ in their nodes; may be False for some that do.

    Cells with the same nodes have the same sum of random numbers of the nodes.
    """
    count = int(cells.max(initial=0)) + 1
    drawn = np.random.default_rng(0).integers(0, 2**63, count, np.uint64)
    sums = np.sort(drawn[cells].sum(axis=1))
    return not bool((sums[1:] == sums[:-1]).any())


class MixedCellsError(MeshError):
    """A file has cells of several types, or of a type that is not usable."""


def read_file(path: Path, dimension: int, only: Collection[str] = ()) -> FileContent:
    """Read the cells of a dimension and the groups from a mesh file.

    Parameters
    ----------
    only
        Names of groups of cells; cells of other groups may be of other types and are left out.

    Raises
    ------
    MeshError
        There is no such file, it cannot be read, or it holds no cells of one usable type.
    """
    mesh = _meshio(path)
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or len(points) == 0:
        raise MeshError("holds no points")
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    if not np.isfinite(points).all():
        raise MeshError("has a node whose coordinates are not finite numbers")
    if np.abs(points).max() > LARGEST_COORDINATE:
        raise MeshError(f"has a node with a coordinate above {LARGEST_COORDINATE:g}")
    for block in mesh.cells:
        used = np.asarray(block.data)
        if used.size and not (0 <= used.min() and used.max() < len(points)):
            raise MeshError(f"has a {block.type} that names a node the file does not define")
    groups = _groups(mesh, _gmsh_names(path))
    chosen = {block for name, block, _ in groups if name in only} or set(range(len(mesh.cells)))
    kind = _kind(mesh, dimension, chosen)
    names = (kind.first, *kind.second)
    own_blocks = [i for i in sorted(chosen) if mesh.cells[i].type in names]
    cells = np.concatenate([_corners(mesh.cells[i], kind.corners) for i in own_blocks])
    notes = []
    facet_types = {n for n, c in FACET_CORNERS.items() if c == len(FACETS[kind.name][0])}
    facets = [i for i, block in enumerate(mesh.cells) if block.type in facet_types]
    starts = dict(
        zip(own_blocks, np.cumsum([0, *(len(mesh.cells[i]) for i in own_blocks)]), strict=False)
    )

    cell_groups: dict[str, list[Ints]] = {}
    facet_groups: dict[str, list[Ints]] = {}
    lower = set()
    for name, block, rows in groups:
        if block in starts:
            cell_groups.setdefault(name, []).append(starts[block] + rows)
        elif block in facets:
            corners = FACET_CORNERS[mesh.cells[block].type]
            facet_groups.setdefault(name, []).append(_corners(mesh.cells[block], corners)[rows])
        else:
            lower.add(name)
    for name in sorted(lower - set(cell_groups) - set(facet_groups)):
        notes.append(f"the group {name!r} holds neither cells nor facets of them: left out")
    return FileContent(
        kind=kind,
        points=points,
        cells=cells,
        cell_groups={name: np.unique(np.concatenate(r)) for name, r in cell_groups.items()},
        facet_groups={name: np.concatenate(r) for name, r in facet_groups.items()},
        point_groups=_point_groups(mesh),
        nodes=tuple(np.asarray(mesh.cells[i].data, dtype=np.int64) for i in own_blocks),
        notes=tuple(notes),
    )


def _meshio(path: Path) -> Any:
    """Read a file by meshio; meshio's messages, and its calls of `sys.exit`, become errors."""
    try:
        if not path.is_file():
            raise MeshError("is not a file" if path.exists() else "does not exist")
    except OSError as error:
        raise MeshError(f"cannot be read: {error.strerror}") from None
    if path.stat().st_size == 0:
        raise MeshError("is empty")
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            if path.suffix == ".vtu":
                return read_vtu(path)
            return meshio.read(*_as_meshio_reads(path))
    except SystemExit:
        reason = output.getvalue()
    except MemoryError:
        raise
    except Exception as error:  # a reader may fail in any way on a file that is not what it seems
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    reason = re.sub(r"\x1b\[[0-9;]*m", "", reason)
    if "Incompatible cell data 'gmsh:physical'" in reason:
        raise MeshError(
            "has some cells in physical groups and some in none, which cannot be read in this "
            "format; let Gmsh save grouped elements only (Mesh.SaveAll = 0) or write version 2.2"
        )
    reason = " ".join(reason.replace(str(path), path.name).split())
    if "Could not deduce file format" in reason:
        endings = ".msh, .vtu, .vtk, .xdmf, .med, .inp, .bdf, .mesh"
        raise MeshError(f"has an ending no mesh format is known by; {endings} and others are")
    raise MeshError(f"cannot be read as a mesh ({reason[:200]})")


def _as_meshio_reads(path: Path) -> tuple[Any, ...]:
    """Input of meshio for a file: its path, or its text in a dialect that meshio reads.

    Gmsh writes Nastran's bulk data without a line ``BEGIN BULK``. Of Abaqus' plane elements meshio
    knows some names only; which one it is, plane stress or strain, is said by the scene.
    """
    ending = path.suffix.lower()
    if ending in NASTRAN:
        text = path.read_text(encoding="utf-8", errors="replace")
        if "BEGIN BULK" not in text.upper() and text.strip():
            return io.StringIO(f"BEGIN BULK\n{text}"), "nastran"
    if ending == ".inp":
        text = path.read_text(encoding="utf-8", errors="replace")
        renamed = PLANE_ELEMENT.sub(lambda match: match[1] + PLANE_NAMES[match[2]], text)
        if renamed != text:
            return io.StringIO(renamed), "abaqus"
    return (path,)


def _kind(mesh: Any, dimension: int, chosen: Collection[int]) -> CellKind:
    """The one type of cell of a dimension in some blocks of a file."""
    count: dict[str, int] = {}
    for block in (mesh.cells[i] for i in sorted(chosen)):
        count[block.type] = count.get(block.type, 0) + len(block.data)
    possible = [k for k in KINDS if k.dimension == dimension]
    present = {t: n for t, n in count.items() if n and _dimension(mesh, t) == dimension}
    kinds = [k for k in possible if any(t in present for t in (k.first, *k.second))]
    allowed = " or ".join(f"{k.first} ({', '.join(k.second)})" for k in possible)
    listing = ", ".join(f"{n} {t}" for t, n in count.items() if n) or "no cells"
    higher = {t for t, n in count.items() if n and _dimension(mesh, t) > dimension}
    if higher:
        raise MeshError(
            f"holds {listing}: {', '.join(sorted(higher))} have no place in a scene of dimension "
            f"{dimension}; set dimension: 3 or mesh the plane alone"
        )
    if not present:
        hint = "; in Gmsh mesh in 3D and put the volumes into a physical group" * (dimension == 3)
        raise MeshError(
            f"holds {listing}, and none of dimension {dimension}; allowed: {allowed}{hint}"
        )
    if len(kinds) != 1 or any(t not in (kinds[0].first, *kinds[0].second) for t in present):
        mixed = ", ".join(f"{n} {t}" for t, n in present.items())
        raise MixedCellsError(
            f"holds {mixed}; the cells of a body are of one type: {allowed}; choose those of a "
            "body by `group`"
        )
    return kinds[0]


def _dimension(mesh: Any, name: str) -> int:
    return next(int(block.dim) for block in mesh.cells if block.type == name)


def _corners(block: Any, corners: int) -> Ints:
    return np.asarray(block.data, dtype=np.int64)[:, :corners]


def _groups(mesh: Any, names: dict[tuple[int, int], str]) -> list[tuple[str, int, Ints]]:
    """Name, block and rows of every group of cells; a group may occur more than once."""
    groups = []
    for name, blocks in (mesh.cell_sets or {}).items():
        if name.startswith("gmsh:"):
            continue
        for i, rows in enumerate(blocks):
            if rows is not None and len(rows):
                groups.append((str(name), i, np.asarray(rows, dtype=np.int64)))
    for name, value in (mesh.field_data or {}).items():
        if np.size(value) == 2:
            names.setdefault((int(value[0]), int(value[1])), str(name))
    families = getattr(mesh, "cell_tags", {})  # of MED: the groups of cells with this number
    from_sets = {(name, i): rows for name, i, rows in groups}  # meshio gives Gmsh's groups twice
    for key in NUMBERED:
        for i, tags in enumerate((mesh.cell_data or {}).get(key, [])):
            numbers = np.abs(np.asarray(tags).ravel())  # below zero: reversed orientation, in Gmsh
            for number in np.unique(numbers[numbers != 0]):
                name = names.get((int(number), int(mesh.cells[i].dim)), str(number))
                rows = np.flatnonzero(numbers == number)
                for each in families.get(-int(number), [name]):
                    if not np.array_equal(from_sets.get((each, i), ()), rows):
                        groups.append((each, i, rows))
    return groups


def _point_groups(mesh: Any) -> dict[str, Ints]:
    """Nodes of each set of nodes; MED has them as families, each in several groups."""
    groups = {str(name): [nodes] for name, nodes in (mesh.point_sets or {}).items()}
    numbers = np.ravel((mesh.point_data or {}).get("point_tags", ()))
    for number, names in getattr(mesh, "point_tags", {}).items():
        for name in names:
            groups.setdefault(str(name), []).append(np.flatnonzero(numbers == number))
    return {name: np.unique(np.concatenate(each).astype(np.int64)) for name, each in groups.items()}


def _gmsh_names(path: Path) -> dict[tuple[int, int], str]:
    """Names of Gmsh's physical groups by number and dimension.

    meshio keeps one group for each name, but Gmsh allows a surface and a volume of one name.
    """
    names: dict[tuple[int, int], str] = {}
    if path.suffix != ".msh":
        return names
    with path.open("rb") as file:
        for line in file:
            if line.strip() == b"$PhysicalNames":
                break
            if line.strip() in (b"$Nodes", b"$Entities"):
                return names
        for line in file:
            match = re.match(r'\s*(\d+)\s+(\d+)\s+"(.*)"\s*$', line.decode(errors="replace"))
            if match:
                names[int(match[2]), int(match[1])] = match[3]
            elif line.startswith(b"$"):
                break
    return names
