"""The largest stress and contact pressure over all load cases, and the case of each value.

``envelope.xdmf`` has four fields: `largest_von_mises` and `von_mises_case` in cells,
`largest_contact_pressure` and `contact_pressure_case` at nodes. Cases are numbered in the order of
the scene file, from 1; a node that no case presses has pressure and case 0.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.model.model import Model
from contact_app.results.fields import CellFields, NodeFields
from contact_app.results.output import write_grid
from contact_app.results.result_size import file_names
from meshes.arrays import Array, Ints

ROUNDED = 1e-9
"""Distance of equal nodes in two decompositions over the largest coordinate: rounding errors."""


class _Largest:
    """Largest of non-negative values, entry by entry, and the number of its case, from 1."""

    def __init__(self, count: int) -> None:
        self.values, self.cases = np.zeros(count), np.zeros(count)
        self.peaks: dict[int, float] = {}

    def add(self, number: int, values: Array | None, peak: float) -> None:
        """Add a case: its values where the entries are the same, and the largest of all ranks."""
        self.peaks[number] = peak
        if values is not None:
            more = values > self.values
            self.values[more], self.cases[more] = values[more], number


class Envelope:
    """The envelope of load cases; local parts.

    Parameters
    ----------
    model, nodes, cells
        Model, nodes and cells of the first case.
    """

    def __init__(self, model: Model, nodes: NodeFields, cells: CellFields) -> None:
        self._model, self._nodes, self._cells = model, nodes, cells
        self._stress = _Largest(len(cells.von_mises))
        self._pressure = _Largest(len(nodes.contact_pressure))

    def add(self, number: int, model: Model, nodes: NodeFields, cells: CellFields) -> bool:
        """Add a case; return False if a rank has other nodes or cells in it (collective).

        The fields then lack the case; its largest values count.
        """
        comm, stress = model.comm, cells.von_mises
        peaks = [float(values.max(initial=0.0)) for values in (stress, nodes.contact_pressure)]
        alike = model.partition is self._model.partition
        if not alike:
            places = self._places(nodes, cells)
            alike, stress = places is not None, stress if places is None else stress[places]
        alike = all(comm.allgather(alike))
        for largest, values, peak in (
            (self._stress, stress, peaks[0]),
            (self._pressure, nodes.contact_pressure, peaks[1]),
        ):
            largest.add(number, values if alike else None, comm.allreduce(peak, op=MPI.MAX))
        return alike

    def _places(self, nodes: NodeFields, cells: CellFields) -> Ints | None:
        """Places of the first case's cells among those of another decomposition of the mesh.

        None where this rank has other nodes or cells.
        """
        points, others = self._nodes.points, nodes.points
        size = ROUNDED * np.abs(points).max(initial=0.0)
        if points.shape != others.shape or np.abs(points - others).max(initial=0.0) > size:
            return None
        (first, order), (other, place) = (_sorted_cells(c.cells) for c in (self._cells, cells))
        if not np.array_equal(first, other):
            return None
        places = np.empty(len(order), np.int64)
        places[order] = place
        return places

    def peaks(self, names: list[str]) -> dict[str, Any]:
        """The largest values of all cases, and the names of their cases."""
        peaks = {}
        for key, largest in (("von_mises", self._stress), ("contact_pressure", self._pressure)):
            number = max(largest.peaks, key=largest.peaks.__getitem__)
            value = largest.peaks[number]
            peaks[key] = {"value": value, "case": names[number - 1] if value > 0.0 else None}
        return peaks

    def write(self, directory: Path) -> list[Path]:
        """Write ``envelope.xdmf``, ``envelope.vtu`` or both; return the paths (collective)."""
        files = [directory / name for name in file_names(self._model.scene.output, "envelope")]
        at_nodes = {
            "largest_contact_pressure": self._pressure.values,
            "contact_pressure_case": self._pressure.cases,
        }
        in_cells = {"largest_von_mises": self._stress.values, "von_mises_case": self._stress.cases}
        if files:
            write_grid(self._model, self._nodes, files, lambda image: at_nodes, in_cells)
        return files


def _sorted_cells(cells: Sequence[Ints]) -> tuple[Ints, Ints]:
    """The nodes of cells in ascending order, cell by cell in lexical order, and their places."""
    width = max((part.shape[1] for part in cells), default=1)
    rows = np.full((sum(map(len, cells)), width), -1, np.int64)
    start = 0
    for part in cells:
        rows[start : start + len(part), : part.shape[1]] = np.sort(part, axis=1)
        start += len(part)
    order = np.lexsort(rows.T)
    return rows[order], order
