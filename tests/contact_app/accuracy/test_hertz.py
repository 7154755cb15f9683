"""Hertz's contact by force, curvatures of the gap, and its observed size."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import contact_app
from contact_app.accuracy.hertz import peak_of
from tests import scenes

MODULUS, FORCE, RADIUS = 1000.0, 2.0, 3.0
HALF = (0.75 * FORCE * RADIUS / MODULUS) ** (1.0 / 3.0)


@pytest.mark.parametrize("slope", [0.5 / RADIUS, 1e-17])
def test_a_curvature_that_is_a_rounding_error_gives_no_peak(slope: float) -> None:
    """An edge on a plane: its contact would be infinitely wide."""
    found = peak_of(FORCE, MODULUS, np.full(2, slope), np.full(2, HALF / np.sqrt(5.0)), 0.02)
    if slope < 1e-9:
        assert found is None
    else:
        assert found == pytest.approx(1.5 * FORCE / (np.pi * HALF**2), rel=1e-5)


@pytest.mark.parametrize("size", [0.4, 2.5])
def test_a_contact_of_other_size_gives_no_peak(size: float) -> None:
    lengths = np.full(2, size * HALF / np.sqrt(5.0))
    assert peak_of(FORCE, MODULUS, np.full(2, 0.5 / RADIUS), lengths, 0.02) is None


def test_a_line_on_a_line_gives_no_peak() -> None:
    """The edge of a block: one row of nodes of some length."""
    assert peak_of(FORCE, MODULUS, np.array([-1e-17, 1e-17]), np.array([0.0, 0.3]), 0.17) is None


@pytest.mark.parametrize("force", [1e-165, 1e-300])
def test_forces_whose_squares_are_zero_have_no_peak(force: float) -> None:
    """Python would report a division of zero by zero."""
    block = {**scenes.box("block", [1.0, 1.0], [10, 5], [-1.0, 0.0]), "hold": ["x", "rz"]}
    push = {"on": "block.y-", "traction": [0, force]}
    circle = {"sphere": {"center": [0, 6.0], "radius": 5.0}}
    contact = {"on": "block.y+", "obstacle": circle}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        contact_app.solve(scenes.config("quadrilateral", [block], [push], [contact]))
