"""The study of the cost of ties compares the same cantilever, tied and as one body."""

from __future__ import annotations

import numpy as np
import pytest

from contact_app.studies.tie_cost import ROWS, cantilever, solve_once


@pytest.mark.parametrize("row", ROWS)
def test_the_tied_cantilever_is_as_large_as_the_conforming_one(row: str) -> None:
    tied, whole = (cantilever(row, *edges)["bodies"] for edges in ((3, 5), (4,)))
    boxes = [body["mesh"]["box"] for body in tied]
    assert boxes[0]["lower"] == whole[0]["mesh"]["box"]["lower"]
    assert boxes[1]["upper"] == whole[0]["mesh"]["box"]["upper"]
    assert [box["cells"] for box in boxes] == [[3] * 3, [5] * 3]
    assert whole[0]["mesh"]["box"]["cells"] == [8, 4, 4]
    *_, a, b, even = ROWS[row]
    cells = 0.5 * (a**3 + b**3)
    assert np.cbrt(cells) == pytest.approx(even, rel=0.03)


def test_a_solve_is_certified() -> None:
    found = solve_once("box", [2, 3])
    assert found["passed"]
    assert found["dofs"] == 3 * (3**3 + 4**3)
    assert found["seconds"] > 0.0
