"""The rates of Signorini's problem, as the study measures them."""

from __future__ import annotations

import numpy as np
import pytest

from contact_app.studies.contact_rates import errors, rate


@pytest.mark.parametrize(
    "cell", [pytest.param("quadrilateral", marks=pytest.mark.slow), "triangle"]
)
def test_the_rates_of_signorini(cell: str) -> None:
    """Energy norm, the edge of contact amid a boundary: O(h) and for degree 2 O(h^1.5)."""
    cells = (8, 16, 32)
    found = errors(cell, depths=(0.02, 0.03, 0.05, 0.08), cells=cells, fine=96)
    assert rate(found[1], cells) == pytest.approx(0.95, abs=0.1)
    assert rate(found[2], cells) == pytest.approx(1.5, abs=0.2)
    assert found[2][-1] < 0.012


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "order"), [("hexahedron", 1.5), ("tetrahedron", 1.3)])
def test_the_rates_of_signorini_in_space(cell: str, order: float) -> None:
    """The same in 3D: nodal rows on hexahedra, means about vertices on tetrahedra."""
    cells = (3, 6, 12)
    found = errors(cell, (2,), depths=(0.05, 0.08), cells=cells, fine=24)[2]
    assert rate(found, cells) == pytest.approx(order, abs=0.25)
    assert np.log2(found[1] / found[2]) > 1.3
