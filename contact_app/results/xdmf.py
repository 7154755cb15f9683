"""Results as XDMF and HDF5 that open as one grid in ParaView and pyvista.

dolfinx's own writer makes one grid for every function, so that displacement and stress land in
different blocks of ParaView. Here one temporal collection holds one unstructured grid that carries
every attribute: ``solution.xdmf``, the text that names them, and ``solution.h5`` beside it, the
numbers. The array of a field is written slab by slab, so that no process needs to hold all of it.

Both files are written under temporary names and renamed at the end, the ``.xdmf`` last: a file
under its own name is complete. Room for the numbers is taken from the file system before HDF5
writes them, since HDF5 crashes when it closes a file for which the disk had no room.

Format: the XDMF model and format, version 3 (www.xdmf.org).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from contact_app.errors import ContactError
from contact_app.machine.atomic_file import atomic, part_of
from contact_app.machine.disk import reserve_for
from contact_app.results.series import Series, xdmf_text
from meshes.arrays import Array
from meshes.quadratic import node_vertices

DIRECTORY_BYTES = 1 << 16
"""Room for what HDF5 writes beside the numbers: names and shapes of a dozen arrays take 10 kB."""


class XDMFError(ContactError):
    """The data do not form a valid XDMF file."""


@dataclass(frozen=True)
class CellType:
    """A cell type of XDMF: name of its topology, number in mixed grids, number of nodes."""

    topology: str
    number: int
    vertices: int


#: Names as dolfinx and the configuration use them, and of cells of second order with the number of
#: their nodes; nodes in VTK's order.
CELL_TYPES = {
    "triangle": CellType("Triangle", 4, 3),
    "quadrilateral": CellType("Quadrilateral", 5, 4),
    "tetrahedron": CellType("Tetrahedron", 6, 4),
    "hexahedron": CellType("Hexahedron", 9, 8),
    "triangle6": CellType("Triangle_6", 36, 6),
    "quadrilateral9": CellType("Quadrilateral_9", 35, 9),
    "tetrahedron10": CellType("Tetrahedron_10", 38, 10),
    "hexahedron27": CellType("Hexahedron_27", 50, 27),
}

#: XDMF's word for a value of so many components.
_ATTRIBUTES = {1: "Scalar", 3: "Vector", 9: "Tensor"}

#: Where xx, yy, zz, xy, yz, xz stand in the 9 components of a tensor. XDMF's own Tensor6 has
#: another order than VTK's symmetric tensors, and readers disagree on it; all agree on Tensor.
_FULL = [0, 3, 5, 3, 1, 4, 5, 4, 2]


def cell_type_name(cell: str, degree: int) -> str:
    """Name in `CELL_TYPES` of a cell with the nodes of a degree."""
    return cell if degree == 1 else f"{cell}{len(node_vertices(cell))}"


class XDMFWriter:
    """One unstructured grid with fields on points and cells, written in slabs.

    Used as a context manager; leaving it by an exception leaves no new file behind.

    Parameters
    ----------
    path
        ``….xdmf``; the numbers go to ``….h5`` beside it.
    cell_type
        A name in `CELL_TYPES`; or, for a grid of several types, ``[(name, number of cells), …]``,
        one pair for each run of consecutive cells of one type.
    n_nodes, n_cells
        Size of the whole grid. Points and cells must be complete in the end; a point or cell
        that a field is never written for reads as NaN.
    expected
        Size of the file (`grid_bytes`), where it is known beforehand: as much room is made at once.
    series
        The frames before this one, which joins them: the mesh is that of the first, and points and
        cells of later ones are not written.

    Raises
    ------
    CouldNotRunError
        There is no room on the disk; also when a field is first written.
    """

    def __init__(
        self,
        path: Path | str,
        cell_type: str | Sequence[tuple[str, int]],
        n_nodes: int,
        n_cells: int,
        expected: int = 0,
        series: Series | None = None,
    ) -> None:
        self.path, self._series = Path(path), series
        runs = [(cell_type, n_cells)] if isinstance(cell_type, str) else list(cell_type)
        self.n_nodes, self.n_cells = n_nodes, n_cells
        self._runs = _Runs([(CELL_TYPES[name], count) for name, count in runs])
        self._attributes: dict[tuple[str, str], int] = {}  # (centre, name) -> components
        self._missing = {"points": n_nodes, "cells": n_cells}
        self._mesh = self._data = self.path.with_suffix(".h5")
        if series is not None:
            self._data = series.numbers_of(self.path)
        self._part = part_of(self._data)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._needed, self._expected = DIRECTORY_BYTES, expected
        self._file: h5py.File | None = None
        self._begin()
        if self._later:
            self._missing.clear()
            return
        self._make("points", (n_nodes, 3), "f8")
        self._make("cells", self._runs.shape, "i4" if n_nodes < 2**31 else "i8")

    @property
    def _later(self) -> bool:
        """Whether the mesh is that of an earlier frame."""
        return self._data != self._mesh

    def _begin(self) -> None:
        """Make the file, with room for what is expected."""
        self._room = self._part.open("wb", buffering=0)
        try:
            self._reserve(0)
            self._room.write(_empty_file())
            self._file = h5py.File(self._part, "r+")
        except BaseException:
            self.discard()
            raise

    def _make(self, key: str, shape: tuple[int, ...], number: str, fill: Any = None) -> None:
        """Make an array, with room for it."""
        try:
            self._reserve(math.prod(shape) * int(number[1:]))
            self._arrays.create_dataset(key, shape, number, fillvalue=fill)
        except BaseException:
            self.discard()
            raise

    def _reserve(self, count: int) -> None:
        """Take room for so many bytes more, and for all that are expected."""
        self._needed += count
        reserve_for(self._data, self._room.fileno(), max(self._needed, self._expected))

    def __enter__(self) -> "XDMFWriter":
        return self

    def __exit__(self, kind: object, *ended: object) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def points(self, start: int, values: ArrayLike) -> None:
        """Write the coordinates (k, 2 or 3) of nodes `start` to `start` + k."""
        array = three_columns(np.asarray(values, dtype=np.float64))
        if self._later:
            return
        self._write("points", start, array, self.n_nodes)
        self._missing["points"] -= len(array)

    def cells(self, start: int, values: ArrayLike) -> None:
        """Write the node numbers (k, vertices) of cells `start` to `start` + k, in VTK's order.

        In a grid of several types the cells of one call are of one run.
        """
        array = np.asarray(values)
        kind, row = self._runs.find(start, len(array))
        if self._later:
            return
        self._missing["cells"] -= len(array)
        if self._runs.mixed:
            array = np.insert(array, 0, kind.number, axis=1).ravel()
        self._arrays["cells"][row : row + len(array)] = array

    def point_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values at nodes `start` to `start` + k.

        Parameters
        ----------
        values : (k,), (k, 2 or 3), (k, 6), (k, 9) or (k, 3, 3)
            Scalars; vectors, whose third component is 0 where not given; symmetric tensors as
            xx, yy, zz, xy, yz, xz; tensors.
        """
        self._field("Node", name, start, values, self.n_nodes)

    def cell_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values in cells `start` to `start` + k; shapes as in `point_data`."""
        self._field("Cell", name, start, values, self.n_cells)

    def close(self) -> None:
        """Finish both files and give them their names."""
        for what, count in self._missing.items():
            if count:
                self.discard()
                raise XDMFError(
                    f"{self.path.name}: {abs(count)} {what} were "
                    f"{'never written' if count > 0 else 'written twice'}"
                )
        try:
            self._arrays.close()
            self._room.close()
            grids = [*(self._series.grids if self._series else []), self._grid()]
            with atomic(self.path) as text:
                text.write_text(xdmf_text(grids), encoding="utf-8")
                if not self._later:
                    # An older text must not stand beside newer numbers, even for a moment.
                    self.path.unlink(missing_ok=True)
                self._part.replace(self._data)
            if self._series is not None:
                self._series.grids.append(grids[-1])
        except BaseException:
            self.discard()
            raise

    def discard(self) -> None:
        """Remove the incomplete files."""
        if self._file is not None:
            self._file.close()
        self._room.close()
        self._part.unlink(missing_ok=True)

    @property
    def _arrays(self) -> h5py.File:
        assert self._file is not None
        return self._file

    def _field(self, centre: str, name: str, start: int, values: ArrayLike, size: int) -> None:
        array = as_components(name, np.asarray(values, dtype=np.float64))
        components = 1 if array.ndim == 1 else array.shape[1]
        key = f"{centre.lower()}/{name}"
        self._attributes[centre, name] = components
        if key not in self._arrays:
            self._make(key, (size,) if components == 1 else (size, components), "f8", np.nan)
        self._write(key, start, array, size)

    def _write(self, key: str, start: int, array: NDArray[Any], size: int) -> None:
        if not 0 <= start <= start + len(array) <= size:
            raise XDMFError(f"rows {start} to {start + len(array)} of {key} are outside 0 … {size}")
        self._arrays[key][start : start + len(array)] = array

    def _item(self, key: str, shape: tuple[int, ...], number: str, size: int) -> str:
        file = self._mesh if key in ("points", "cells") else self._data
        return (
            f'<DataItem Dimensions="{" ".join(map(str, shape))}" NumberType="{number}" '
            f'Precision="{size}" Format="HDF">{_escape(file.name)}:/{_escape(key)}</DataItem>'
        )

    def _grid(self) -> str:
        """The XML text of the last time: mesh and fields, with their places in the HDF5 file."""
        wide = 4 if self.n_nodes < 2**31 else 8
        time = self._series.times[-1] if self._series else 0
        lines = [
            '<Grid Name="solution" GridType="Uniform">',
            f'<Time Value="{time:.12g}"/>',
            f'<Topology {self._runs.attributes} NumberOfElements="{self.n_cells}">',
            self._item("cells", self._runs.shape, "Int", wide),
            "</Topology>",
            '<Geometry GeometryType="XYZ">',
            self._item("points", (self.n_nodes, 3), "Float", 8),
            "</Geometry>",
        ]
        for (centre, name), components in self._attributes.items():
            size = self.n_nodes if centre == "Node" else self.n_cells
            lines += [
                f"<Attribute Name={quoteattr(name)} "
                f'AttributeType="{_ATTRIBUTES[components]}" Center="{centre}">',
                self._item(f"{centre.lower()}/{name}", (size, components), "Float", 8),
                "</Attribute>",
            ]
        lines.append("</Grid>")
        return "\n".join(lines)


def _empty_file() -> bytes:
    """An HDF5 file without anything in it, made in memory."""
    with h5py.File("nowhere", "w", driver="core", backing_store=False) as file:
        file.flush()
        return bytes(file.id.get_file_image())


class _Runs:
    """Positions of the cells of each run in the topology's array."""

    def __init__(self, runs: list[tuple[CellType, int]]) -> None:
        self.runs = runs
        self.mixed = len({kind for kind, _ in runs}) > 1

    @property
    def shape(self) -> tuple[int, ...]:
        """One row per cell; mixed, each cell's number and vertices one after another."""
        if self.mixed:
            return (sum((1 + kind.vertices) * count for kind, count in self.runs),)
        return (sum(count for _, count in self.runs), self.runs[0][0].vertices)

    @property
    def attributes(self) -> str:
        """Attributes of the Topology element."""
        kind = "Mixed" if self.mixed else self.runs[0][0].topology
        return f'TopologyType="{kind}"'

    def find(self, start: int, count: int) -> tuple[CellType, int]:
        """Type of the cells `start` to `start` + count, and the row that the first begins at."""
        cell = row = 0
        for kind, size in self.runs:
            width = 1 + kind.vertices if self.mixed else 1
            if cell <= start and start + count <= cell + size:
                return kind, row + (start - cell) * width
            cell, row = cell + size, row + size * width
        raise XDMFError(f"cells {start} to {start + count} are not within one run of the grid")


def grid_bytes(nodes: int, cells: int, vertices: int, at_nodes: int, at_cells: int) -> int:
    """Size of a file with these fields.

    Parameters
    ----------
    vertices
        Of a cell.
    at_nodes, at_cells
        Components of all fields together.
    """
    return DIRECTORY_BYTES + nodes * 8 * (3 + at_nodes) + cells * (8 * at_cells + 4 * vertices + 4)


def three_columns(array: Array) -> Array:
    """Vectors of the plane with a third component 0."""
    if array.ndim == 2 and array.shape[1] == 2:
        return np.pad(array, ((0, 0), (0, 1)))
    return array


def as_components(name: str, array: Array) -> Array:
    """Values as (k,), (k, 3) or (k, 9)."""
    if array.ndim == 3 and array.shape[1:] == (3, 3):
        return array.reshape(len(array), 9)
    if array.ndim == 2:
        array = three_columns(array)
        if array.shape[1] == 1:
            return array[:, 0]
        if array.shape[1] == 6:
            return array[:, _FULL]
    if array.ndim == 1 or (array.ndim == 2 and array.shape[1] in (3, 9)):
        return array
    raise XDMFError(
        f"{name} has shape {array.shape}; (k,), (k, 2), (k, 3), (k, 6), (k, 9) and (k, 3, 3) can "
        "be written"
    )


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")
