"""Results as one VTU file, which VTK's own readers, ParaView, pyvista and meshio open.

meshio writes it, each array in base64 and uncompressed. The numbers are collected on the rank that
writes; the file appears under its own name when it is complete.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from contact_app.machine.atomic_file import atomic
from contact_app.machine.disk import refuse_without_room
from contact_app.results.xdmf import CELL_TYPES, as_components, three_columns

MESHIO = {
    "quadrilateral": "quad", "quadrilateral9": "quad9",
    "tetrahedron": "tetra", "tetrahedron10": "tetra10",
}  # fmt: skip
"""meshio's names of cells, where it has others than `CELL_TYPES`."""


def vtu_bytes(nodes: int, cells: int, vertices: int, at_nodes: int, at_cells: int) -> int:
    """Size of a file, about, in base64: four bytes for three. Parameters as of `grid_bytes`."""
    numbers = nodes * 8 * (3 + at_nodes) + cells * (8 * at_cells + 4 * vertices + 16)
    return 4096 + numbers * 4 // 3


class VTUWriter:
    """One unstructured grid with fields on points and cells.

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
    """

    def __init__(
        self,
        path: Path | str,
        runs: Sequence[tuple[str, int]],
        n_nodes: int,
        point_fields: Mapping[str, int],
        cell_fields: Mapping[str, int],
    ) -> None:
        self.path, self._names = Path(path), [MESHIO.get(name, name) for name, _ in runs]
        self._starts = np.cumsum([0, *(count for _, count in runs)])
        self._points = np.empty((n_nodes, 3))
        wide = np.int32 if n_nodes < 2**31 else np.int64
        self._cells = [np.empty((k, CELL_TYPES[name].vertices), wide) for name, k in runs]
        self._at_nodes, self._at_cells = (
            {name: np.empty((rows, k) if k > 1 else rows) for name, k in fields.items()}
            for rows, fields in ((n_nodes, point_fields), (self._starts[-1], cell_fields))
        )

    def __enter__(self) -> VTUWriter:
        return self

    def __exit__(self, kind: object, *ended: object) -> None:
        if kind is None:
            self.close()

    def points(self, start: int, values: ArrayLike) -> None:
        """Take the coordinates (k, 2 or 3) of nodes `start` to `start` + k."""
        points = three_columns(np.asarray(values, dtype=np.float64))
        self._points[start : start + len(points)] = points

    def cells(self, start: int, values: ArrayLike) -> None:
        """Take the node numbers (k, vertices) of cells `start` to `start` + k, in VTK's order.

        The cells of one call are of one run.
        """
        cells, run = np.asarray(values), np.searchsorted(self._starts, start, side="right") - 1
        first = start - self._starts[run]
        self._cells[run][first : first + len(cells)] = cells

    def point_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Take a field's values at nodes `start` to `start` + k, as XDMFWriter takes them."""
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._at_nodes[name][start : start + len(array)] = array

    def cell_data(self, name: str, start: int, values: ArrayLike) -> None:
        """Take a field's values in cells `start` to `start` + k."""
        array = as_components(name, np.asarray(values, dtype=np.float64))
        self._at_cells[name][start : start + len(array)] = array

    def close(self) -> None:
        """Write the file.

        Raises
        ------
        CouldNotRunError
            There is no room on the disk.
        """
        import meshio  # other output does without it

        cells = list(zip(self._names, self._cells, strict=True))
        of_runs = {name: np.split(v, self._starts[1:-1]) for name, v in self._at_cells.items()}
        mesh = meshio.Mesh(self._points, cells, self._at_nodes, of_runs)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        arrays = [self._points, *self._cells, *self._at_nodes.values(), *self._at_cells.values()]
        refuse_without_room(
            self.path.parent, self.path.name, sum(array.nbytes for array in arrays) * 4 // 3
        )
        with atomic(self.path) as part:
            meshio.vtu.write(part, mesh, compression=None, header_type="UInt64")
