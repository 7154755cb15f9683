"""Results as files, written from arrays."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from contact_app.results.xdmf import XDMFWriter, as_components


def components(fields: Mapping[str, ArrayLike]) -> dict[str, int]:
    """Number of written components of each field."""
    arrays = {name: as_components(name, np.asarray(v, float)) for name, v in fields.items()}
    return {name: int(np.prod(array.shape[1:])) for name, array in arrays.items()}


def write_result(
    directory: Path,
    kind: str,
    points: ArrayLike,
    cells: ArrayLike,
    at_nodes: Mapping[str, ArrayLike],
    in_cells: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Write the ``solution.xdmf`` of cells of one type, with fields at nodes and in cells."""
    runs, path = [(kind, len(np.asarray(cells)))], directory / "solution.xdmf"
    in_cells, count = in_cells or {}, len(np.asarray(points))
    with XDMFWriter(path, runs, count, components(at_nodes), components(in_cells)) as file:
        file.points(0, points)
        file.cells(0, cells)
        for name, values in at_nodes.items():
            file.point_data(name, 0, values)
        for name, values in in_cells.items():
            file.cell_data(name, 0, values)
