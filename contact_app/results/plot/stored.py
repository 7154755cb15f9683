"""Reader of ``solution.xdmf``: mesh, fields, and the sides of its cells.

Reads the files that `contact_app.results.xdmf` writes, with h5py.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from contact_app.errors import ContactError
from contact_app.results.xdmf import CELL_TYPES
from meshes.arrays import Array, Ints, Mask
from meshes.quadratic import EDGES, facet_table

SIDES: dict[str, tuple[tuple[int, ...], ...]] = {
    "triangle": EDGES["triangle"],
    "quadrilateral": EDGES["quadrilateral"],
    "tetrahedron": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "hexahedron": (
        (0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7),
    ),
}  # fmt: skip
"""Vertices of the sides of a cell; in space anticlockwise seen from outside."""


STRESSES = ("von_mises", "stress", "nodal_von_mises", "nodal_stress")
"""Fields that are stresses, whose extremes may be those of a singularity."""


SMOOTHED = "smoothed_contact_pressure"
LABELS = {
    "displacement": "displacement, magnitude",
    "von_mises": "von Mises stress",
    "stress": "stress, Frobenius norm",
    "nodal_von_mises": "von Mises stress",
    "nodal_stress": "stress, Frobenius norm",
    "contact_pressure": "contact pressure",
    SMOOTHED: "smoothed contact pressure",
    "gap": "gap to the obstacle",
    "friction_traction": "friction traction, magnitude",
    "slip": "slip, magnitude",
    "contact_status": "0 open, 1 stick, 2 slip",
}
"""Label of each field below its colour scale."""


SAME_TIME = 1e-4
"""Relative difference of times up to which they are those of one increment."""


class StoredError(ContactError):
    """There is no result, or it is not one of this application."""


@dataclass(frozen=True, eq=False)
class Stored:
    """The grid of a result."""

    points: Array  # (nodes, 3)
    cells: dict[str, Ints]  # {name: (cells, nodes of a cell)}
    """By the names of `contact_app.results.xdmf.CELL_TYPES`; numbers in VTK's order."""
    numbers: dict[str, Ints]  # {name: (cells,)}
    """Rows of the cells in `cell_data`."""
    point_data: dict[str, Array]
    cell_data: dict[str, Array]
    """By name, (n,), (n, 3) or (n, 9)."""

    @property
    def plane(self) -> bool:
        """Whether the result is two-dimensional."""
        return all(_base(name) in ("triangle", "quadrilateral") for name in self.cells)

    def field(self, name: str) -> Array:
        """The values of a scalar, the magnitudes of vectors and tensors, (n,)."""
        values = self.point_data[name] if name in self.point_data else self.cell_data[name]
        return values if values.ndim == 1 else np.asarray(np.linalg.norm(values, axis=1))

    @property
    def vertices(self) -> Mask:
        """Mask (nodes,) of the vertices of cells."""
        result = np.zeros(len(self.points), bool)
        for name, cells in self.cells.items():
            result[cells[:, : _CORNERS[_base(name)]]] = True
        return result

    def boundary(self) -> list[Ints]:
        """Sides that only one cell has, one array for each number of nodes, cut at middle nodes.

        Returns
        -------
        list of (sides, 2) in the plane, of (sides, 3) or (sides, 4) in space
        """
        return [sides for sides, _ in self.skin()]

    def skin(self) -> list[tuple[Ints, Ints]]:
        """The boundary sides, and the row in `cell_data` of the cell of each side (sides,)."""
        return [single(sides, rows) for sides, rows in self._sides() if len(sides)]

    def triangles(self) -> tuple[Ints, Ints]:
        """Cells of the plane as triangles (n, 3), and the row in `cell_data` of each (n,)."""
        corners, rows = [], []
        for name, cells in self.cells.items():
            for pick in _TRIANGLES[name]:
                corners.append(cells[:, pick])
                rows.append(self.numbers[name])
        return np.concatenate(corners), np.concatenate(rows)

    def _sides(self) -> Iterator[tuple[Ints, Ints]]:
        sides: dict[int, list[Ints]] = {}
        rows: dict[int, list[Ints]] = {}
        for name, cells in self.cells.items():
            base = _base(name)
            for pieces in _pieces(base, quadratic=name != base):
                sides.setdefault(len(pieces), []).append(cells[:, list(pieces)])
                rows.setdefault(len(pieces), []).append(self.numbers[name])
        for corners, parts in sides.items():
            yield np.concatenate(parts), np.concatenate(rows[corners])


def read(directory: Path | str, time: float | None = None, name: str = "solution") -> Stored:
    """Read the result in a directory.

    Parameters
    ----------
    time
        Of an increment of a load history, in completed steps; the last one unless given.
    name
        Of the files, ``solution`` or ``envelope``.

    Raises
    ------
    StoredError
        There is no result, its files are incomplete, or it has no increment at the time.
    """
    source = Path(directory) / f"{name}.xdmf"
    if not source.is_file():
        cases = sorted(Path(directory).glob("*/solution.xdmf"))
        if cases:
            raise StoredError(
                f"{directory} has the results of several runs or load cases: draw one of them, as "
                f"{cases[0].parent}"
            )
        raise StoredError(f"{source} is not there: run the scene first, with output.xdmf: true")
    try:
        grids = ElementTree.parse(source).getroot().findall(".//Grid[@GridType='Uniform']")
        grid = grids[-1] if time is None else _at(grids, time, source)
        topology = grid.find("Topology")
        with h5py.File(source.with_suffix(".h5"), "r") as file:
            points = file["points"][:]
            numbers = file["cells"][:]
        with h5py.File(source.with_name(_last_numbers(grid, source)), "r") as file:
            data = {
                centre: {name: item[:] for name, item in file[centre].items()}
                for centre in ("node", "cell")
                if centre in file
            }
    except (OSError, KeyError, IndexError, ElementTree.ParseError) as error:
        raise StoredError(f"{source} cannot be read: {error}") from error
    if topology is None:
        raise StoredError(f"{source} names no cells: it is not a result of this application")
    cells, rows = _split(topology.get("TopologyType", ""), numbers)
    return Stored(points, cells, rows, data.get("node", {}), data.get("cell", {}))


def _at(grids: list[ElementTree.Element], time: float, source: Path) -> ElementTree.Element:
    """The frame of a time; its times are written with twelve digits."""
    times = [None if (at := grid.find("Time")) is None else at.get("Value") for grid in grids]
    for grid, text in zip(grids, times, strict=True):
        if text is not None and abs(float(text) - time) <= SAME_TIME * max(1.0, abs(time)):
            return grid
    listed = ", ".join(text for text in times if text is not None) or "none: it is no load history"
    raise StoredError(f"{source} has no increment at the time {time:g}; it has {listed}")


def _last_numbers(grid: ElementTree.Element, source: Path) -> str:
    """The file of the fields of a frame; the file of the mesh if the frame has none."""
    item = grid.find("Attribute/DataItem")
    text = "" if item is None else item.text or ""
    return text.partition(":/")[0] or source.with_suffix(".h5").name


def _split(topology: str, numbers: Ints) -> tuple[dict[str, Ints], dict[str, Ints]]:
    """Cells and their rows by type."""
    if topology != "Mixed":
        for name, kind in CELL_TYPES.items():
            if kind.topology == topology:
                return {name: numbers.astype(np.int64)}, {name: np.arange(len(numbers))}
        raise StoredError(f"cells of type {topology!r} are not drawn")
    kinds = {kind.number: (name, kind.vertices) for name, kind in CELL_TYPES.items()}
    parts: dict[str, list[Ints]] = {}
    rows: dict[str, list[Ints]] = {}
    at = row = 0
    while at < len(numbers):  # once per run of cells of one type
        name, vertices = kinds[int(numbers[at])]
        width = vertices + 1
        rest = numbers[at : at + (len(numbers) - at) // width * width].reshape(-1, width)
        other = np.flatnonzero(rest[:, 0] != numbers[at])
        count = int(other[0]) if len(other) else len(rest)
        parts.setdefault(name, []).append(rest[:count, 1:].astype(np.int64))
        rows.setdefault(name, []).append(np.arange(row, row + count))
        at, row = at + count * width, row + count
    return (
        {name: np.concatenate(p) for name, p in parts.items()},
        {name: np.concatenate(r) for name, r in rows.items()},
    )


def _base(name: str) -> str:
    return name.rstrip("0123456789")


def _pieces(cell: str, quadratic: bool) -> Iterator[tuple[int, ...]]:
    """Nodes of the sides of a cell; sides of second order are divided at all their nodes."""
    if not quadratic:
        yield from SIDES[cell]
        return
    for side, nodes in zip(SIDES[cell], facet_table(SIDES[cell], cell), strict=True):
        middles = edge_middles(cell, side)
        if len(side) == 2:
            yield side[0], middles[0]
            yield middles[0], side[1]
        elif len(side) == 3:
            a, b, c = side
            ab, bc, ca = middles
            yield from ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        else:
            a, b, c, d = side
            ab, bc, cd, da = middles
            (centre,) = set(map(int, nodes)) - set(side) - set(middles)
            yield from ((a, ab, centre, da), (ab, b, bc, centre))
            yield from ((centre, bc, c, cd), (da, centre, cd, d))


def edge_middles(cell: str, side: tuple[int, ...]) -> list[int]:
    """Middle nodes of the edges of a side, in the order of its vertices."""
    middles = {frozenset(edge): i for i, edge in enumerate(EDGES[cell], start=_CORNERS[cell])}
    around = zip(side, side[1:] + side[:1], strict=True)
    pairs = [frozenset(pair) for pair in around]
    return [middles[pair] for pair in (pairs[:1] if len(side) == 2 else pairs)]


def single(sides: Ints, rows: Ints) -> tuple[Ints, Ints]:
    """Sides that occur once, in either orientation, and their rows."""
    _, first, count = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
    )
    once = first[count == 1]
    return sides[once], rows[once]


_CORNERS = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}

_TRIANGLES: dict[str, tuple[list[int], ...]] = {
    "triangle": ([0, 1, 2],),
    "quadrilateral": ([0, 1, 2], [0, 2, 3]),
    "triangle6": ([0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]),
    "quadrilateral9": tuple(
        [8, a, b] for a, b in ((0, 4), (4, 1), (1, 5), (5, 2), (2, 6), (6, 3), (3, 7), (7, 0))
    ),
}
