"""Results as one VTU file, which VTK's own readers, ParaView, pyvista and meshio open.

The text that names the arrays comes first, the numbers follow it as they are in memory ("appended",
"raw", after an underscore), each array behind its length in bytes. All lengths are known
beforehand, so that an array is written slab by slab at its place and no process holds all of it.
Room is taken from the file system at once; the file appears under its own name when it is complete.

Format: VTK's XML format, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_app.errors import ContactError
from contact_app.machine.atomic_file import part_of
from contact_app.machine.disk import reserve_for
from contact_app.results.xdmf import CELL_TYPES, as_components, in_run, three_columns

LENGTH_BYTES = 8
"""Bytes of the length that precedes each array."""

AT_ONCE = 1_000_000
"""Cells whose offsets and types are written at once."""

_TYPES = {"f8": "Float64", "i4": "Int32", "i8": "Int64", "u1": "UInt8"}


class VTUError(ContactError):
    """Something was handed over that makes no valid file."""


class _Array:
    """An array of the file: its name, its shape, where it begins behind the underscore."""

    def __init__(self, name: str, rows: int, components: int, number: str, offset: int) -> None:
        self.name, self.rows, self.components, self.number = name, rows, components, number
        self.offset, self.missing = offset, rows
        self.row_bytes = components * int(number[1:])
        self.bytes = rows * self.row_bytes

    @property
    def tag(self) -> str:
        """The XML element of the array."""
        several = f'NumberOfComponents="{self.components}" ' if self.components > 1 else ""
        return (
            f'<DataArray type="{_TYPES[self.number]}" Name={quoteattr(self.name)} {several}'
            f'format="appended" offset="{self.offset}"/>'
        )


class VTUWriter:
    """One unstructured grid with fields on points and cells, written in slabs.

    Used as a context manager; leaving it by an exception leaves no new file behind. Its methods are
    those of `xdmf.XDMFWriter`.

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
        There is no room on the disk.
    """

    def __init__(
        self,
        path: Path | str,
        runs: Sequence[tuple[str, int]],
        n_nodes: int,
        point_fields: Mapping[str, int],
        cell_fields: Mapping[str, int],
    ) -> None:
        self.path = Path(path)
        self.n_nodes = n_nodes
        kinds = [(CELL_TYPES[name], count) for name, count in runs]
        self.n_cells = sum(count for _, count in kinds)
        self._kinds, self._size = kinds, 0
        corners = sum(kind.vertices * count for kind, count in kinds)
        wide = "i4" if n_nodes < 2**31 else "i8"
        # the last one named comes first: where texts name them in the order of the numbers, meshio
        # (5.3) takes an array for another once its offset in a copy of its own is that of the other
        self._types = self._array("types", self.n_cells, 1, "u1")
        self._offsets = self._array("offsets", self.n_cells, 1, "i8")
        self._connectivity = self._array("connectivity", corners, 1, wide)
        self._points = self._array("points", n_nodes, 3, "f8")
        of_cells, of_nodes = (
            {name: self._array(name, rows, fields[name], "f8") for name in reversed(fields)}
            for rows, fields in ((self.n_cells, dict(cell_fields)), (n_nodes, dict(point_fields)))
        )
        self._at_cells = dict(reversed(of_cells.items()))
        self._at_nodes = dict(reversed(of_nodes.items()))
        text = self._text().encode()
        self._start = len(text)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._part = part_of(self.path)
        self._file = self._part.open("wb")
        try:
            self._reserve()
            self._file.write(text)
            self._write_types()
        except BaseException:
            self.discard()
            raise

    def __enter__(self) -> VTUWriter:
        return self

    def __exit__(self, kind: object, *ended: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def points(self, start: int, values: ArrayLike) -> None:
        """Write the coordinates (k, 2 or 3) of nodes `start` to `start` + k."""
        self._write(self._points, start, three_columns(np.asarray(values, dtype=np.float64)))

    def cells(self, start: int, values: ArrayLike) -> None:
        """Write the node numbers (k, vertices) of cells `start` to `start` + k, in VTK's order.

        The cells of one call are of one run.
        """
        array = np.asarray(values)
        kind, corner = in_run(self._kinds, start, len(array))
        if array.shape[1:] != (kind.vertices,):
            raise VTUError(f"cells of shape {array.shape} are none of {kind.vertices} nodes")
        self._write(self._connectivity, corner, array.ravel())

    def point_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values at nodes `start` to `start` + k, as XDMFWriter takes them."""
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._write(self._at_nodes[name], start, array)

    def cell_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values in cells `start` to `start` + k."""
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._write(self._at_cells[name], start, array)

    def close(self) -> None:
        """Finish the file and give it its name."""
        try:
            for array in self._arrays:
                if array.missing:
                    raise VTUError(
                        f"{self.path.name}: {abs(array.missing)} rows of {array.name} were "
                        f"{'never written' if array.missing > 0 else 'written twice'}"
                    )
            self._file.seek(self._start + self._size)
            self._file.write(_END)
            self._file.close()
            self._part.replace(self.path)
        except BaseException:
            self.discard()
            raise

    def discard(self) -> None:
        """Remove the incomplete file."""
        try:
            self._file.close()
        finally:
            self._part.unlink(missing_ok=True)

    @property
    def _arrays(self) -> list[_Array]:
        mesh = [self._points, self._connectivity, self._offsets, self._types]
        return [*mesh, *self._at_nodes.values(), *self._at_cells.values()]

    def _array(self, name: str, rows: int, components: int, number: str) -> _Array:
        """The next array of the file."""
        array = _Array(name, rows, components, number, self._size)
        self._size += LENGTH_BYTES + array.bytes
        return array

    def _reserve(self) -> None:
        """Take room for all of the file."""
        reserve_for(self.path, self._file.fileno(), self._start + self._size + len(_END))
        for array in self._arrays:
            self._file.seek(self._start + array.offset)
            self._file.write(np.array(array.bytes, np.uint64).tobytes())
        self._file.seek(0)

    def _write_types(self) -> None:
        """Write the end of each cell's nodes in the list of nodes, and VTK's number of its type."""
        first = corner = 0
        for kind, count in self._kinds:
            for begin in range(0, count, AT_ONCE):
                part = np.arange(begin, min(begin + AT_ONCE, count))
                self._write(self._offsets, first + begin, corner + (part + 1) * kind.vertices)
                self._write(self._types, first + begin, np.full(len(part), kind.vtk))
            first, corner = first + count, corner + count * kind.vertices

    def _write(self, array: _Array, start: int, values: NDArray[Any]) -> None:
        width = 1 if values.ndim == 1 else values.shape[1]
        if width != array.components:
            raise VTUError(f"{array.name} has {width} components here, {array.components} expected")
        if not 0 <= start <= start + len(values) <= array.rows:
            raise VTUError(
                f"rows {start} to {start + len(values)} of {array.name} are outside "
                f"0 … {array.rows}"
            )
        array.missing -= len(values)
        begin = self._start + array.offset + LENGTH_BYTES + start * array.row_bytes
        self._file.seek(begin)
        self._file.write(np.ascontiguousarray(values, array.number).data)

    def _text(self) -> str:
        """All that stands before the numbers."""
        order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
        cells = (self._connectivity, self._offsets, self._types)
        lines = [
            '<?xml version="1.0"?>',
            f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{order}" '
            'header_type="UInt64">',
            "<UnstructuredGrid>",
            f'<Piece NumberOfPoints="{self.n_nodes}" NumberOfCells="{self.n_cells}">',
            "<PointData>", *(array.tag for array in self._at_nodes.values()), "</PointData>",
            "<CellData>", *(array.tag for array in self._at_cells.values()), "</CellData>",
            "<Points>", self._points.tag, "</Points>",
            "<Cells>", *(array.tag for array in cells), "</Cells>",
            "</Piece>",
            "</UnstructuredGrid>",
            '<AppendedData encoding="raw">',
            "_",
        ]  # fmt: skip
        return "\n".join(lines)


_END = b"\n</AppendedData>\n</VTKFile>\n"
