"""The study of the cost of ties compares the same cantilever, tied and as one body."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from contact_app.studies.tie_cost import ROWS, cantilever, solved, written


def extent(mesh: dict[str, Any]) -> tuple[list[float], list[float], int]:
    """Lower and upper corner, and bricks, of a box or of the mesh of a file."""
    if "box" in mesh:
        box = mesh["box"]
        return box["lower"], box["upper"], int(np.prod(box["cells"]))
    read = meshio.read(mesh["file"])
    low, high = (read.points.min(axis=0), read.points.max(axis=0))
    return low.tolist(), high.tolist(), len(read.cells_dict["tetra"]) // 6


@pytest.mark.parametrize("row", ROWS)
def test_the_tied_cantilever_is_as_large_as_the_conforming_one(row: str, tmp_path: Path) -> None:
    tied = [extent(b["mesh"]) for b in cantilever(row, tmp_path, 3, 5)["bodies"]]
    (whole,) = [extent(b["mesh"]) for b in cantilever(row, tmp_path, 4)["bodies"]]
    assert (tied[0][0], tied[1][1]) == whole[:2] == ([0, 0, 0], [2, 1, 1])
    assert (tied[0][2], tied[1][2], whole[2]) == (27, 125, 128)
    *_, a, b, even = ROWS[row]
    cells = 0.5 * (a**3 + b**3)
    assert np.cbrt(cells) == pytest.approx(even, rel=0.03)


@pytest.mark.parametrize("row", ["box", "file"])
def test_a_solve_is_certified(row: str, tmp_path: Path) -> None:
    summary, seconds = solved(written(row, [2, 3], tmp_path / "scene"))
    assert summary["certificate"]["passed"]
    assert summary["mesh"]["dofs"] == 3 * (3**3 + 4**3)
    assert seconds > 0.0
