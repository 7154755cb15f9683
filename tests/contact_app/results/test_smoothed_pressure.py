"""Pressures without the effect of facets, and contact of round bodies with straight edges."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError
from contact_app.model.symmetry import halved
from contact_app.results.smoothed_pressure import smoothed_on
from contact_app.run.solve import solve_scene
from meshes.contact_surface import Surface
from tests import scenes
from tests.contact_app.model.test_symmetry import pressed

CONFIG = Path(__file__).parents[3] / "configs" / "round_facets.yaml"
LAME = 78.75


def fit(*changes: str) -> SolvedScene:
    return solve_scene(scenes.read(CONFIG, changes))


@pytest.fixture(scope="module")
def straight() -> SolvedScene:
    return fit("contacts.0.round=false")


@pytest.fixture(scope="module")
def smooth() -> SolvedScene:
    return fit()


def test_polygons_press_as_circles(straight: SolvedScene, smooth: SolvedScene) -> None:
    """Lamé's pressure in the mean to 0.5 %, in the peak to 3 %; of polygons neither is right."""
    (polygon,), (circle,) = straight.summary["contacts"], smooth.summary["contacts"]
    assert circle["force"][0] / 10.0 == pytest.approx(LAME, rel=5e-3)
    assert circle["max_smoothed_pressure"] == pytest.approx(LAME, rel=0.03)
    assert circle["nodes"]["open"] == 0
    assert abs(polygon["force"][0] / 10.0 - LAME) > 0.05 * LAME
    assert polygon["max_pressure"] > 2.5 * LAME
    assert polygon["max_smoothed_pressure"] < 0.75 * polygon["max_pressure"]
    assert smooth.summary["certificate"]["passed"]


def line(places: np.ndarray) -> tuple[Surface, np.ndarray]:
    """Lines between places on the x axis, and the integrals of their shape functions."""
    points = np.stack([places, 0.0 * places, 0.0 * places], axis=1)
    nodes = np.stack([np.arange(len(places) - 1), np.arange(1, len(places))], axis=1)
    inside = points[nodes].mean(axis=1) - [0.0, 1.0, 0.0]
    lengths = np.diff(places)
    shares = 0.5 * (np.append(lengths, 0.0) + np.insert(lengths, 0, 0.0))
    return Surface.of(2, nodes, points[nodes], inside), shares


def smoothed(side: Surface, pressure: np.ndarray, shares: np.ndarray) -> np.ndarray:
    samples = np.arange(len(pressure)), pressure, shares, np.ones(len(pressure))
    return smoothed_on(MPI.COMM_SELF, [side], samples, len(pressure))


def test_a_pressure_that_rises_towards_an_end_stays() -> None:
    """The square of a linear pressure is quadratic, also where nodes lie on one side alone."""
    side, shares = line(0.1 * np.arange(11))
    pressure = 1.0 + side.points[:, 0, 0].max() * np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(smoothed(side, pressure, shares), pressure, rtol=1e-3)


@pytest.mark.parametrize("across", [4, 6, 8])
def test_hertz_pressure_stays(across: int) -> None:
    """An ellipse on facets of random lengths: its peak, and the fall at the edge."""
    random = np.random.default_rng(across)
    side, shares = line(np.cumsum(random.uniform(0.7, 1.3, 40)) - 20.0)
    x = np.append(side.points[:, 0, 0], side.points[:, 1, 0].max())
    x = np.sort(x)
    pressure = np.sqrt(np.maximum(1.0 - (2.0 * x / across) ** 2, 0.0))
    np.testing.assert_allclose(smoothed(side, pressure, shares), pressure, atol=0.02)


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_alternating_pressures_are_averaged(share: float) -> None:
    """Between every other node and the next the pressure varies, or single nodes are open."""
    side, shares = line(np.arange(41.0))
    pressure = 1.0 + share * (-1.0) ** np.arange(41)
    inside = smoothed(side, pressure, shares)[5:-5]
    np.testing.assert_allclose(inside, 1.0, atol=0.35 * share)


@pytest.mark.parametrize("size", [2.0**-700, 2.0**-530, 2.0**300])
def test_pressures_of_all_sizes_are_smoothed_alike(size: float) -> None:
    """Bodies without a load are pressed by rounding errors of gaps, as small as 1e-160."""
    side, shares = line(np.linspace(0.0, 1.0, 21))
    pressure = np.random.default_rng(2).uniform(0.5, 1.5, 21)
    pressure[8:14] *= 1e-90
    expected = smoothed(side, pressure, shares)
    assert expected.max() > 0.5
    np.testing.assert_array_equal(smoothed(side, size * pressure, shares), size * expected)


def test_a_singular_edge_stays_away_from_other_nodes() -> None:
    """A flat punch's pressure is right to 10 %; without the second weights it is off by 14 %."""
    side, shares = line(np.linspace(-1.0, 1.0, 17))
    x = np.linspace(-1.0, 1.0, 17)
    ends = np.array([-1.0, *(0.5 * (x[1:] + x[:-1])), 1.0])
    pressure = np.diff(np.arcsin(ends)) / shares  # means over the lengths about the nodes
    found = smoothed(side, pressure, shares)
    assert found @ shares == pytest.approx(np.pi)
    np.testing.assert_allclose(found, pressure, rtol=0.1)


def test_the_integral_stays(straight: SolvedScene) -> None:
    (contact,) = straight.nodes.contacts
    assert contact.shares @ contact.smoothed == pytest.approx(contact.shares @ contact.pressure)
    assert contact.smoothed.min() >= 0.0
    at = contact.nodes - straight.nodes.first
    field = straight.nodes.smoothed_contact_pressure
    np.testing.assert_array_equal(field[at], contact.smoothed)
    assert field.sum() == pytest.approx(contact.smoothed.sum())


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_a_constant_pressure_stays(cell: str) -> None:
    solved = solve_scene(scenes.build(scenes.patch(cell, 3), 2))
    for contact in solved.nodes.contacts:
        np.testing.assert_allclose(contact.smoothed, contact.pressure, rtol=1e-5)


def test_a_half_has_the_pressure_of_the_whole() -> None:
    """Fits of the field, and of the gap for Hertz's peak, reach across the plane of symmetry."""
    whole = scenes.build(pressed("quadrilateral", 8), 1)
    found = halved(whole).scene
    assert found.mirrors
    solved = [solve_scene(scene) for scene in (whole, found)]
    one, other = (answer.summary["contacts"] for answer in solved)
    fields = [answer.nodes.smoothed_contact_pressure.max() for answer in solved]
    assert fields[1] == pytest.approx(fields[0], rel=1e-5)
    for first, second in zip(one, other, strict=True):
        assert second["max_smoothed_pressure"] == pytest.approx(
            first["max_smoothed_pressure"], rel=1e-5
        )
    assert fields[0] != pytest.approx(one[0]["max_pressure"], rel=1e-2)
    assert fields[0] != pytest.approx(one[0]["max_smoothed_pressure"], rel=1e-2)


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_a_half_that_is_held_has_the_pressure_of_the_whole(cell: str) -> None:
    """A boundary that slides along a plane has mirror images beyond it, one beside it has none."""
    peaks = []
    for left, held in ((0, "x-"), (-1, "y-")):
        made: scenes.Config = {
            "dimension": "plane_strain",
            "bodies": [{
                "name": "block", "material": {"young": 1000.0, "poisson": 0.3},
                "mesh": {"box": {
                    "lower": [left, -1], "upper": [1, 0], "cells": [16 * (1 - left), 16],
                    "cell": cell,
                }},
            }],
            "conditions": [
                {"on": "block.y-", "displacement": [0, 0.01]},
                {"on": f"block.{held}", "displacement": [0, None if left == 0 else 0.01]},
            ],
            "contacts": [{
                "on": "block.y+", "obstacle": {"sphere": {"center": [0, 3], "radius": 3}},
            }],
        }  # fmt: skip
        (contact,) = solve_scene(scenes.build(made)).summary["contacts"]
        peaks.append((contact["max_smoothed_pressure"], contact["max_pressure"]))
    (half, half_nodal), (whole, whole_nodal) = peaks
    if cell == "quadrilateral":
        assert half == pytest.approx(whole, rel=1e-4)
        assert half != pytest.approx(half_nodal, rel=1e-4)
    else:  # the triangle at the plane is stiffer: the largest pressure is less wrong
        assert half / whole - 1.0 < 0.5 * (half_nodal / whole_nodal - 1.0)


def test_play_is_held_against_the_facets(straight: SolvedScene) -> None:
    """A hub moved far as a whole: displacements hide the facets, the overlap shows them."""
    moved = fit(
        "contacts.0.round=false", "conditions.0.displacement=[30, null]",
        "conditions.2.displacement=[30, null]",
    )  # fmt: skip
    told = " ".join(moved.summary["certificate"]["warnings"])
    assert moved.solution.measures.deformations.min() > 29.0
    assert "of the gap or overlap of 0.0" in told
    assert "of the largest displacement" in " ".join(straight.summary["certificate"]["warnings"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tied": True, "round": True}, "contacts[0].round has no meaning in a tied contact"),
        ({"against": None, "obstacle": {"plane": {"point": [0, 0], "normal": [0, 1]}}},
         "contacts[0].round is for two elastic bodies: a round obstacle is round as it is"),
    ],
)  # fmt: skip
def test_wrong_use_is_located(changes: scenes.Config, message: str) -> None:
    made = scenes.two_bodies("quadrilateral", 2)
    made["contacts"] = [{"on": made["contacts"][-1]["on"], "against": "lower.y+", **changes}]
    made["contacts"][0]["round"] = True
    with pytest.raises(ConfigurationError) as caught:
        scenes.build(made)
    assert message in str(caught.value)
