"""Results as one VTU file, which VTK's own readers, ParaView, pyvista and meshio open.

Each array stands in base64 behind its length, uncompressed. All lengths are known beforehand, so
that each array has its place in the file and is written slab by slab, from its beginning to its
end: no process holds all of it. Room is taken from the file system at once, and the file appears
under its own name when it is complete.

Format: VTK's XML format, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

import sys
from base64 import b64encode
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_app.machine.atomic_file import atomic
from contact_app.machine.disk import reserve_for
from contact_app.results.xdmf import CELL_TYPES, as_components, three_columns

VTK = {
    "triangle": 5, "quadrilateral": 9, "tetrahedron": 10, "hexahedron": 12,
    "triangle6": 22, "quadrilateral9": 28, "tetrahedron10": 24, "hexahedron27": 29,
}  # fmt: skip
"""VTK's numbers of the `CELL_TYPES`."""

AT_ONCE = 1_000_000
"""Cells whose offsets and types are written at once."""


def vtu_bytes(nodes: int, cells: int, vertices: int, at_nodes: int, at_cells: int) -> int:
    """Size of a file, about, in base64: four bytes for three. Parameters as of `grid_bytes`."""
    numbers = nodes * 8 * (3 + at_nodes) + cells * (8 * at_cells + 4 * vertices + 9)
    return 4096 + numbers * 4 // 3


class _Array:
    """An array of a file: its XML element, its place, and what of it awaits encoding."""

    def __init__(self, name: str, rows: int, components: int, number: type) -> None:
        self.number: np.dtype[Any] = np.dtype(number)
        size = rows * components * self.number.itemsize
        several = f'NumberOfComponents="{components}" ' if components > 1 else ""
        kind = {"f": "Float", "i": "Int", "u": "UInt"}[self.number.kind]
        self.tag = (
            f'<DataArray type="{kind}{8 * self.number.itemsize}" Name={quoteattr(name)} '
            f'{several}format="binary">'
        )
        self.name, self.rows, self.place = name, 0, 0
        self.characters = (8 + size + 2) // 3 * 4
        self.waiting = np.uint64(size).tobytes()


class VTUWriter:
    """One unstructured grid with fields on points and cells, written in slabs.

    Used as a context manager; leaving it by an exception leaves no new file behind. Its methods are
    those of `xdmf.XDMFWriter`; the slabs of each array come in their order.

    Parameters
    ----------
    path
        ``….vtu``.
    runs
        Type (a name in `CELL_TYPES`) and number of the cells of each run of consecutive ones.
    n_nodes
        Points of the whole grid.
    point_fields, cell_fields
        Components of each field: 1, 3 or 9.

    Raises
    ------
    CouldNotRunError
        There is no room on the disk, when the context is entered.
    """

    def __init__(
        self,
        path: Path | str,
        runs: Sequence[tuple[str, int]],
        n_nodes: int,
        point_fields: Mapping[str, int],
        cell_fields: Mapping[str, int],
    ) -> None:
        self.path, self._runs = Path(path), runs
        self._counts = n_nodes, sum(count for _, count in runs)
        corners = sum(CELL_TYPES[name].vertices * count for name, count in runs)
        wide = np.int32 if n_nodes < 2**31 else np.int64
        self._points = _Array("Points", n_nodes, 3, np.float64)
        self._cells = _Array("connectivity", corners, 1, wide)
        self._offsets = _Array("offsets", self._counts[1], 1, np.int64)
        self._types = _Array("types", self._counts[1], 1, np.uint8)
        self._at_nodes, self._at_cells = (
            {name: _Array(name, rows, k, np.float64) for name, k in fields.items()}
            for rows, fields in zip(self._counts, (point_fields, cell_fields), strict=True)
        )

    def __enter__(self) -> "VTUWriter":
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            self._file = stack.enter_context(stack.enter_context(atomic(self.path)).open("wb"))
            self._begin()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if kind is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            for array in self._arrays:
                self._file.seek(array.place)
                self._file.write(b64encode(array.waiting))

    def points(self, start: int, values: ArrayLike) -> None:
        """Write the coordinates (k, 2 or 3) of nodes `start` to `start` + k."""
        self._write(self._points, start, three_columns(np.asarray(values, dtype=np.float64)))

    def cells(self, start: int, values: ArrayLike) -> None:
        """Write the node numbers (k, vertices) of cells `start` to `start` + k, in VTK's order."""
        self._write(self._cells, start, np.asarray(values))

    def point_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values at nodes `start` to `start` + k, as XDMFWriter takes them."""
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._write(self._at_nodes[name], start, array)

    def cell_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values in cells `start` to `start` + k."""
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._write(self._at_cells[name], start, array)

    @property
    def _arrays(self) -> list[_Array]:
        mesh = [self._points, self._cells, self._offsets, self._types]
        return [*mesh, *self._at_nodes.values(), *self._at_cells.values()]

    def _begin(self) -> None:
        """Take room for the file, write its text about the arrays, and the types of its cells."""
        place, texts = 0, []
        for part in self._layout():
            if isinstance(part, _Array):
                part.place, place = place, place + part.characters
            else:
                texts.append((place, part.encode()))
                place += len(texts[-1][1])
        reserve_for(self.path, self._file.fileno(), place)
        for at, text in texts:
            self._file.seek(at)
            self._file.write(text)
        first = corner = 0
        for name, count in self._runs:
            vertices = CELL_TYPES[name].vertices
            for begin in range(0, count, AT_ONCE):
                part_of_run = np.arange(begin, min(begin + AT_ONCE, count))
                self._write(self._offsets, first + begin, corner + (part_of_run + 1) * vertices)
                self._write(self._types, first + begin, np.full(len(part_of_run), VTK[name]))
            first, corner = first + count, corner + count * vertices

    def _layout(self) -> list[str | _Array]:
        """The parts of the file in their order: text, and arrays."""
        groups = {
            "Points": [self._points],
            "Cells": [self._cells, self._offsets, self._types],
            "PointData": self._at_nodes.values(),
            "CellData": self._at_cells.values(),
        }
        nodes, cells = self._counts
        parts: list[str | _Array] = [
            '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" '
            f'byte_order="{sys.byteorder.capitalize()}Endian" header_type="UInt64">\n'
            f'<UnstructuredGrid><Piece NumberOfPoints="{nodes}" NumberOfCells="{cells}">\n'
        ]
        for group, arrays in groups.items():
            parts.append(f"<{group}>\n")
            for array in arrays:
                parts += [array.tag, array, "</DataArray>\n"]
            parts.append(f"</{group}>\n")
        return [*parts, "</Piece></UnstructuredGrid></VTKFile>\n"]

    def _write(self, array: _Array, start: int, values: NDArray[Any]) -> None:
        """Write the next rows of an array, as many bytes as make whole groups of base64."""
        if len(values) and start != array.rows:
            raise ValueError(f"{array.name}: row {array.rows} comes next, not {start}")
        array.rows += len(values)
        ready = array.waiting + np.ascontiguousarray(values, array.number).tobytes()
        whole = len(ready) // 3 * 3
        self._file.seek(array.place)
        array.place += self._file.write(b64encode(memoryview(ready)[:whole]))
        array.waiting = ready[whole:]
