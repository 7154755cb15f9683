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
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
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
    """A cell type: its topology and number in mixed grids of XDMF, VTK's number, and its nodes."""

    topology: str
    number: int
    vtk: int
    vertices: int


#: Names as dolfinx and the configuration use them, and of cells of second order with the number of
#: their nodes; nodes in VTK's order.
CELL_TYPES = {
    "triangle": CellType("Triangle", 4, 5, 3),
    "quadrilateral": CellType("Quadrilateral", 5, 9, 4),
    "tetrahedron": CellType("Tetrahedron", 6, 10, 4),
    "hexahedron": CellType("Hexahedron", 9, 12, 8),
    "triangle6": CellType("Triangle_6", 36, 22, 6),
    "quadrilateral9": CellType("Quadrilateral_9", 35, 28, 9),
    "tetrahedron10": CellType("Tetrahedron_10", 38, 24, 10),
    "hexahedron27": CellType("Hexahedron_27", 50, 29, 27),
}

#: XDMF's word for a value of so many components.
_ATTRIBUTES = {1: "Scalar", 3: "Vector", 9: "Tensor"}

#: Where xx, yy, zz, xy, yz, xz stand in the 9 components of a tensor. XDMF's own Tensor6 has
#: another order than VTK's symmetric tensors, and readers disagree on it; all agree on Tensor.
_FULL = [0, 3, 5, 3, 1, 4, 5, 4, 2]


def cell_type_name(cell: str, degree: int) -> str:
    """Name in `CELL_TYPES` of a cell with the nodes of a degree."""
    return cell if degree == 1 else f"{cell}{len(node_vertices(cell))}"


class GridWriter(ABC):
    """One unstructured grid with fields on points and cells, written in slabs.

    Used as a context manager; leaving it by an exception leaves no new file behind.

    Parameters
    ----------
    path
        File of the grid.
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
        self.path = Path(path)
        self._runs = [(CELL_TYPES[name], count) for name, count in runs]
        self._counts = n_nodes, sum(count for _, count in runs)
        self._fields = {f"node/{name}": k for name, k in point_fields.items()}
        self._fields |= {f"cell/{name}": k for name, k in cell_fields.items()}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            self._begin(stack)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if kind is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            self._finish()

    def points(self, start: int, values: ArrayLike) -> None:
        """Write the coordinates (k, 2 or 3) of nodes `start` to `start` + k."""
        self._write("points", start, three_columns(np.asarray(values, dtype=np.float64)))

    def cells(self, start: int, values: ArrayLike) -> None:
        """Write the node numbers (k, vertices) of cells `start` to `start` + k, in VTK's order.

        The cells of one call are of one run.
        """
        self._write("cells", start, np.asarray(values))

    def point_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values at nodes `start` to `start` + k.

        Parameters
        ----------
        values : (k,), (k, 2 or 3), (k, 6), (k, 9) or (k, 3, 3)
            Scalars; vectors, whose third component is 0 where not given; symmetric tensors as
            xx, yy, zz, xy, yz, xz; tensors.
        """
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._write(f"node/{name}", start, array)

    def cell_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Write a field's values in cells `start` to `start` + k; shapes as in `point_data`."""
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._write(f"cell/{name}", start, array)

    def _size(self, key: str) -> int:
        """Rows of a field."""
        return self._counts[0 if key.startswith("node/") else 1]

    @abstractmethod
    def _begin(self, stack: ExitStack) -> None:
        """Make the file, with room for all of it; it is closed with the stack."""

    @abstractmethod
    def _write(self, key: str, start: int, array: NDArray[Any]) -> None:
        """Write rows of an array: ``points``, ``cells``, or a field at nodes or in cells."""

    @abstractmethod
    def _finish(self) -> None:
        """Complete the file and give it its name."""


class XDMFWriter(GridWriter):
    """A grid as ``….xdmf``; the numbers go to ``….h5`` beside it.

    Points and cells must be complete in the end; a point or cell that a field is never written for
    reads as NaN. Parameters as of `GridWriter`.

    Parameters
    ----------
    series
        The frames before this one, which joins them: the mesh is that of the first, and points and
        cells of later ones are not written.
    """

    def __init__(
        self,
        path: Path | str,
        runs: Sequence[tuple[str, int]],
        n_nodes: int,
        point_fields: Mapping[str, int],
        cell_fields: Mapping[str, int],
        series: Series | None = None,
    ) -> None:
        super().__init__(path, runs, n_nodes, point_fields, cell_fields)
        self._series, self._places = series, _Runs(self._runs)
        self._mesh = self._data = self.path.with_suffix(".h5")
        if series is not None:
            self._data = series.numbers_of(self.path)
        self._part = part_of(self._data)
        self._later = self._data != self._mesh  # the mesh is that of an earlier frame
        self._missing = dict.fromkeys(("points", "cells"), 0)
        if not self._later:
            self._missing = dict(zip(("points", "cells"), self._counts, strict=True))

    def cells(self, start: int, values: ArrayLike) -> None:
        """Write cells; in a grid of several types each begins with the number of its type."""
        array = np.asarray(values)
        kind, row = self._places.find(start, len(array))
        if not self._later:
            self._missing["cells"] -= len(array)
        if self._places.mixed:
            array = np.insert(array, 0, kind.number, axis=1).ravel()
        self._write("cells", row, array)

    def _begin(self, stack: ExitStack) -> None:
        """Make the HDF5 file under a temporary name, with all its arrays."""
        n = self._counts[0]
        arrays: dict[str, tuple[tuple[int, ...], str]] = {}
        if not self._later:
            arrays["points"] = (n, 3), "f8"
            arrays["cells"] = self._places.shape, "i4" if n < 2**31 else "i8"
        for key, k in self._fields.items():
            arrays[key] = (self._size(key), k)[: 1 + (k > 1)], "f8"
        sizes = (math.prod(shape) * int(number[1:]) for shape, number in arrays.values())
        stack.callback(self._part.unlink, missing_ok=True)
        room = stack.enter_context(self._part.open("wb", buffering=0))
        reserve_for(self._data, room.fileno(), DIRECTORY_BYTES + sum(sizes))
        room.write(_empty_file())
        self._file = stack.enter_context(h5py.File(self._part, "r+"))
        for key, (shape, number) in arrays.items():
            self._file.create_dataset(
                key, shape, number, fillvalue=np.nan if key in self._fields else None
            )

    def _write(self, key: str, start: int, array: NDArray[Any]) -> None:
        if self._later and key in self._missing:
            return
        size = len(self._file[key])
        if not 0 <= start <= start + len(array) <= size:
            raise XDMFError(f"rows {start} to {start + len(array)} of {key} are outside 0 … {size}")
        self._file[key][start : start + len(array)] = array
        if key == "points":
            self._missing[key] -= len(array)

    def _finish(self) -> None:
        """Give both files their names, unless points or cells are missing."""
        for what, count in self._missing.items():
            if count:
                raise XDMFError(
                    f"{self.path.name}: {abs(count)} {what} were "
                    f"{'never written' if count > 0 else 'written twice'}"
                )
        self._file.close()
        grids = [*(self._series.grids if self._series else []), self._grid()]
        with atomic(self.path) as text:
            text.write_text(xdmf_text(grids), encoding="utf-8")
            if not self._later:
                # An older text must not stand beside newer numbers, even for a moment.
                self.path.unlink(missing_ok=True)
            self._part.replace(self._data)
        if self._series is not None:
            self._series.grids.append(grids[-1])

    def _item(self, key: str, shape: tuple[int, ...], number: str, size: int) -> str:
        file = self._mesh if key in self._missing else self._data
        return (
            f'<DataItem Dimensions="{" ".join(map(str, shape))}" NumberType="{number}" '
            f'Precision="{size}" Format="HDF">{_escape(file.name)}:/{_escape(key)}</DataItem>'
        )

    def _grid(self) -> str:
        """The XML text of the last time: mesh and fields, with their places in the HDF5 file."""
        n_nodes, n_cells = self._counts
        time = self._series.times[-1] if self._series else 0
        lines = [
            '<Grid Name="solution" GridType="Uniform">',
            f'<Time Value="{time:.12g}"/>',
            f'<Topology {self._places.attributes} NumberOfElements="{n_cells}">',
            self._item("cells", self._places.shape, "Int", 4 if n_nodes < 2**31 else 8),
            "</Topology>",
            '<Geometry GeometryType="XYZ">',
            self._item("points", (n_nodes, 3), "Float", 8),
            "</Geometry>",
        ]
        for key, components in self._fields.items():
            centre, name = key.split("/", 1)
            lines += [
                f"<Attribute Name={quoteattr(name)} "
                f'AttributeType="{_ATTRIBUTES[components]}" Center="{centre.title()}">',
                self._item(key, (self._size(key), components), "Float", 8),
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
