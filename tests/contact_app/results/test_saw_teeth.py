"""A soft strip on saw teeth, which it overlaps: which side `on` should be."""

from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import from_mapping
from tests import meshfiles

OVERLAP = 0.3
"""Overlap of the teeth, which are 0.6 high, and the strip (length)."""


def answer(folder: Path, on: str, times: int) -> Any:
    """Teeth of period 2, with flanks of 20° and 56°, under a strip whose top is held."""

    def toothed(points: np.ndarray) -> np.ndarray:
        x, s = 6.0 * points[:, 0], points[:, 1]
        phase = x % 2.0
        top = 0.6 * np.minimum(phase / 1.6, (2.0 - phase) / 0.4)
        return np.column_stack([x, (2.0 + top) * s - 2.0])

    teeth = meshfiles.part(
        folder / "teeth.vtu", "quadrilateral", (30 * times, 4 * times), toothed,
        {"top": "y > -1e-6", "foot": "y < -2 + 1e-6"}, material={"young": 2e5, "poisson": 0.3},
    )  # fmt: skip
    lower = 0.6 - OVERLAP
    box = {"lower": [0, lower], "upper": [6, lower + 3], "cells": [33 * times, 12 * times]}
    sides = ["strip.y-", "teeth.top"] if on == "strip" else ["teeth.top", "strip.y-"]
    made = {
        "title": "a strip on teeth", "dimension": 2,
        "bodies": [
            teeth,
            {"name": "strip", "mesh": {"box": box}, "material": {"young": 5, "poisson": 0.4}},
        ],
        "conditions": [
            {"on": "teeth.foot", "displacement": [0, 0]},
            {"on": "strip.y+", "displacement": [0, 0]},
            {"on": "strip.x-", "displacement": [0, None]},
            {"on": "strip.x+", "displacement": [0, None]},
        ],
        "contacts": [{"on": sides[0], "against": sides[1]}],
    }  # fmt: skip
    return solve_scene(build_scene(from_mapping(made)), MPI.COMM_SELF)


def test_a_strip_rests_on_the_tips_with_the_smooth_side_as_on_and_hovers_with_the_teeth(
    tmp_path: Path,
) -> None:
    energies = {}
    for on in ("strip", "teeth"):
        found = [answer(tmp_path, on, times) for times in (1, 2)]
        energies[on] = [made.summary["solution"]["energy"] for made in found]
        assert any("tilted" in w for w in found[1].summary["certificate"]["warnings"])
        points, moved = found[1].nodes.points, found[1].nodes.displacement
        bottom = np.flatnonzero(np.isclose(points[:, 1], 0.6 - OVERLAP))
        bottom = bottom[bottom > 61 * 9 - 1]  # behind the nodes of the teeth
        deformed = points[bottom, :2] + moved[bottom]
        deformed = deformed[np.argsort(deformed[:, 0])]
        above = np.interp([1.6, 3.6], *deformed.T) - 0.6
        assert ((above > 0.01) if on == "teeth" else (above < 0.0)).all()
    coarse, fine = energies["strip"]
    assert abs(fine / coarse - 1.0) < 0.03
    assert energies["teeth"][1] > 3.0 * fine
