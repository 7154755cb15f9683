"""Results as one VTU file, which VTK's own readers, ParaView, pyvista and meshio open.

Each array stands in base64 behind its length, uncompressed. All lengths are known beforehand, so
that each array has its place in the file and is written slab by slab, from its beginning to its
end: no process holds all of it. Room is taken from the file system at once, and the file appears
under its own name when it is complete.

Format: VTK's XML format, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

import sys
from base64 import b64encode
from contextlib import ExitStack
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from contact_app.machine.atomic_file import atomic
from contact_app.machine.disk import reserve_for
from contact_app.results.xdmf import GridWriter

AT_ONCE = 1_000_000
"""Cells whose offsets and types are written at once."""


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


class VTUWriter(GridWriter):
    """A grid as ``….vtu``; the slabs of each array come in their order."""

    def _begin(self, stack: ExitStack) -> None:
        """Take room for the file, write its text about the arrays, and the types of its cells."""
        self._file = stack.enter_context(stack.enter_context(atomic(self.path)).open("wb"))
        (n, m), wide = self._counts, np.int32 if self._counts[0] < 2**31 else np.int64
        corners = sum(kind.vertices * count for kind, count in self._runs)
        self._arrays = {
            "points": _Array("Points", n, 3, np.float64),
            "cells": _Array("connectivity", corners, 1, wide),
            "offsets": _Array("offsets", m, 1, np.int64),
            "types": _Array("types", m, 1, np.uint8),
        }
        for key, k in self._fields.items():
            self._arrays[key] = _Array(key.split("/", 1)[1], self._size(key), k, np.float64)
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
        for kind, count in self._runs:
            for begin in range(0, count, AT_ONCE):
                some = np.arange(begin, min(begin + AT_ONCE, count))
                self._write("offsets", first + begin, corner + (some + 1) * kind.vertices)
                self._write("types", first + begin, np.full(len(some), kind.vtk))
            first, corner = first + count, corner + count * kind.vertices

    def _finish(self) -> None:
        for array in self._arrays.values():
            self._file.seek(array.place)
            self._file.write(b64encode(array.waiting))

    def _layout(self) -> list[str | _Array]:
        """The parts of the file in their order: text, and arrays."""
        names = {"points": "Points", "node": "PointData", "cell": "CellData"}
        groups: dict[str, list[_Array]] = {}
        for key, array in self._arrays.items():
            groups.setdefault(names.get(key.split("/")[0], "Cells"), []).append(array)
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

    def _write(self, key: str, start: int, values: NDArray[Any]) -> None:
        """Write the next rows of an array, as many bytes as make whole groups of base64."""
        array = self._arrays[key]
        if len(values) and start != array.rows:
            raise ValueError(f"{array.name}: row {array.rows} comes next, not {start}")
        array.rows += len(values)
        ready = array.waiting + np.ascontiguousarray(values, array.number).tobytes()
        whole = len(ready) // 3 * 3
        self._file.seek(array.place)
        array.place += self._file.write(b64encode(memoryview(ready)[:whole]))
        array.waiting = ready[whole:]
