"""The largest stress and contact pressure over all load cases, and the case of each value.

``envelope.xdmf`` has four fields: `largest_von_mises` and `von_mises_case` in cells,
`largest_contact_pressure` and `contact_pressure_case` at nodes. Cases are numbered in the order of
the scene file, from 1; a node that no case presses has pressure and case 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.model.model import Model
from contact_app.results.fields import CellFields, NodeFields
from contact_app.results.output import write_grid
from contact_app.results.result_size import file_names

Array = NDArray[np.float64]


class _Largest:
    """Largest of non-negative values, entry by entry, and the number of its case, from 1."""

    def __init__(self, count: int) -> None:
        self.values, self.cases = np.zeros(count), np.zeros(count)

    def add(self, number: int, values: Array) -> None:
        """Add the values of a case."""
        more = values > self.values
        self.values[more], self.cases[more] = values[more], number

    def peak(self) -> tuple[float, int]:
        """The largest value on this rank, and its case."""
        if not len(self.values):
            return 0.0, 0
        at = int(np.argmax(self.values))
        return float(self.values[at]), int(self.cases[at])


class Envelope:
    """The envelope of load cases; local parts.

    Parameters
    ----------
    model, nodes, cells
        Model, nodes and cells of the first case; other cases must have the same nodes and cells.
    """

    def __init__(self, model: Model, nodes: NodeFields, cells: CellFields) -> None:
        self._model, self._nodes, self._cells = model, nodes, cells
        self._stress = _Largest(len(cells.von_mises))
        self._pressure = _Largest(len(nodes.contact_pressure))

    def add(self, number: int, model: Model, nodes: NodeFields, cells: CellFields) -> bool:
        """Add a case; return False if its nodes or cells differ (collective)."""
        alike = model.partition is self._model.partition or (
            np.array_equal(nodes.points, self._nodes.points)
            and len(cells.cells) == len(self._cells.cells)
            and all(map(np.array_equal, cells.cells, self._cells.cells))
        )
        if not all(model.comm.allgather(alike)):
            return False
        self._stress.add(number, cells.von_mises)
        self._pressure.add(number, nodes.contact_pressure)
        return True

    def peaks(self, names: list[str]) -> dict[str, Any]:
        """The largest values of all, by the names of the cases (collective)."""
        found = {}
        for key, largest in (("von_mises", self._stress), ("contact_pressure", self._pressure)):
            value, number = max(self._model.comm.allgather(largest.peak()))
            found[key] = {"value": value, "case": names[number - 1] if number else None}
        return found

    def write(self, directory: Path) -> list[Path]:
        """Write ``envelope.xdmf``, ``envelope.vtu`` or both; return the paths (collective)."""
        files = [directory / name for name in file_names(self._model.scene, "envelope")]
        at_nodes = {
            "largest_contact_pressure": self._pressure.values,
            "contact_pressure_case": self._pressure.cases,
        }
        in_cells = {
            "largest_von_mises": self._stress.values,
            "von_mises_case": self._stress.cases,
        }
        if files:
            write_grid(self._model, self._nodes, files, lambda image: at_nodes, in_cells)
        return files
