"""Errors of stress and displacement of Lamé's ring, curved and straight."""

from pathlib import Path

import numpy as np
import pytest

from contact_app.studies.exact_fields import lame_ring, relative_errors
from tests import meshfiles
from tests.contact_app.model.test_curved import NAMES, ring


def ring_errors(cell: str, name: str | None, n: int, directory: Path) -> tuple[float, ...]:
    """Errors of displacement, stress and largest pressure."""
    solved, d = ring(cell, name, n, directory), meshfiles.dimension(cell)
    u, sigma, outside = lame_ring(2.1e5, 0.3, (10.0, 20.0), 100.0, 0.01)

    def displacement(x: np.ndarray) -> np.ndarray:
        return np.pad(u(x[:, :2]), ((0, 0), (0, d - 2)))

    errors = relative_errors(solved, displacement, lambda x: sigma(x[:, :2]))
    pressure = solved.summary["solution"]["max_contact_pressure"]
    return (*errors, abs(pressure / outside - 1.0))


@pytest.mark.parametrize(("cell", "name"), NAMES)
def test_curved_edges_reach_the_rate_of_degree_2(cell: str, name: str, tmp_path: Path) -> None:
    """Against Lamé: third order in displacement, second in stress; straight edges are far off."""
    meshes = (2, 4) if meshfiles.dimension(cell) == 3 else (4, 8)
    coarse, fine = (ring_errors(cell, name, n, tmp_path) for n in meshes)
    straight = ring_errors(cell, None, meshes[1], tmp_path)
    assert np.log2(coarse[0] / fine[0]) > 2.5
    assert np.log2(coarse[1] / fine[1]) > 1.6
    assert fine[0] < 2e-3
    assert fine[1] < 3e-2
    assert fine[2] < 2e-2
    assert straight[0] > 20 * fine[0]
    assert straight[1] > 5 * fine[1]
