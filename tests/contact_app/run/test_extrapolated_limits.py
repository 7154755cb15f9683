"""A bar that friction presses against a slope: friction raises the forces that cause it."""

import pytest

from contact_app.run.solve import solve_scene
from tests import scenes

MU = 0.8


def bar() -> scenes.Config:
    """A slender bar, pushed along its axis against a slope of 45 degrees, which its tip climbs."""
    body = {
        "name": "bar",
        "mesh": {"box": {"lower": [0, 0], "upper": [10, 1], "cells": [20, 2]}},
        "material": {"young": 2.1e5, "poisson": 0.3},
    }
    slope = {"plane": {"point": [10, 0], "normal": [-1, 1]}}
    return {
        "dimension": "plane_strain",
        "bodies": [body],
        "conditions": [{"on": "bar.x-", "displacement": [0.02, 0]}],
        "contacts": [{"on": "bar.x+", "obstacle": slope, "friction": {"coulomb": MU}}],
    }


@pytest.mark.ratchet
@pytest.mark.parametrize("method", ["active-set", "primal"])
def test_limits_that_creep_towards_the_answer_are_extrapolated(method: str) -> None:
    """The tip moves across the bar, so the plain iteration leaves about μ of the error in each set.

    It takes 25 operator applications by active sets and 22 by multigrid; without extrapolation
    active sets end without a certificate, and multigrid takes 176.
    """
    made = {**bar(), "solver": {"method": method, "tolerance": 1e-10}}
    summary = solve_scene(scenes.build(made)).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["method"] == method
    along, across, _ = summary["contacts"][0]["force"]
    normal, tangential = (across - along) / 2**0.5, (across + along) / 2**0.5
    assert tangential == pytest.approx(-MU * normal, rel=1e-6)
    assert summary["solver"]["hessian_multiplications"] <= 40
