"""Pressures without the effect of facets, and contact of round bodies with straight edges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError
from contact_app.model.symmetry import halved
from contact_app.results.smoothed_pressure import smoothed_on
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from meshes.contact_surface import Surface
from tests import scenes
from tests.contact_app.model.test_symmetry import pressed

CONFIG = Path(__file__).parents[3] / "configs" / "round_facets.yaml"
LAME = 78.75


def fit(*changes: str) -> SolvedScene:
    return solve_scene(build_scene(load(CONFIG, changes)))


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


def test_a_pressure_that_rises_towards_an_end_stays() -> None:
    """A linear pressure is met by the linear fit, also where nodes lie on one side alone."""
    points = np.array([[0.1 * i, 0.0, 0.0] for i in range(11)])
    nodes = np.array([[i, i + 1] for i in range(10)])
    side = Surface.of(2, nodes, points[nodes], np.tile([0.5, -1.0, 0.0], (10, 1)))
    pressure, shares = 1.0 + points[:, 0], np.full(11, 0.1)
    shares[[0, -1]] = 0.05
    known = np.arange(11), pressure, shares, np.ones(11)
    np.testing.assert_allclose(smoothed_on(MPI.COMM_SELF, [side], known, 11), pressure, rtol=1e-9)


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
    """Means reach across the plane of symmetry."""
    whole = scenes.build(pressed("quadrilateral", 4), 1)
    found = halved(whole).scene
    assert found.mirrors
    one, other = (solve_scene(scene).summary["contacts"] for scene in (whole, found))
    for first, second in zip(one, other, strict=True):
        assert second["max_smoothed_pressure"] == pytest.approx(
            first["max_smoothed_pressure"], rel=1e-5
        )
    assert one[0]["max_smoothed_pressure"] != pytest.approx(one[0]["max_pressure"], rel=1e-2)


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
