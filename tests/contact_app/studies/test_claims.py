"""The study of claims: random scenes, held against a fine mesh of degree 2."""

import numpy as np
import pytest

from contact_app.studies.claims import run_claim, scene_of
from contact_app.studies.claims_reference import fine_solution, square_distance
from contact_app.studies.claims_scenes import claim_scene
from contact_app.studies.reference import Fields
from meshes import BoxShape


def on_square(cell: str, n: int) -> Fields:
    """The linear interpolant of (x², 0) on n times n cells of the unit square."""
    mesh = BoxShape((0.0, 0.0), (1.0, 1.0), (n, n), cell).cell_mesh()
    x = np.pad(mesh.points[:, :2], ((0, 0), (0, 1)))
    none = np.zeros(len(x))
    return Fields(
        x, x[:, :2] ** 2 * [1.0, 0.0], none, none > 0.0, np.array([0, len(x)]), np.array([1]),
        np.array([cell]), [mesh.cells], [np.zeros(len(mesh.cells), np.int32)],
    )  # fmt: skip


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_the_distance_of_fields_on_different_grids(cell: str) -> None:
    """The slopes are 1/2, 3/2 on two cells and 1/3, 1, 5/3 on three."""
    one, other = on_square("quadrilateral", 2), on_square(cell, 3)
    lam, mu = 3.0, 2.0
    exact = (lam + 2.0 * mu) * (1 / 54 + 1 / 12)
    assert square_distance(one, other, (lam, mu)) == pytest.approx(exact, rel=1e-12)
    assert square_distance(other, other, (lam, mu)) == pytest.approx(0.0, abs=1e-20)


@pytest.mark.parametrize(
    ("dimension", "seed", "target"),
    [
        pytest.param(2, 70, 0.15, marks=pytest.mark.slow),
        (2, 87, 0.3),
        pytest.param(2, 5087, 0.08, marks=pytest.mark.slow),
    ],
)
def test_a_random_claim_holds(dimension: int, seed: int, target: float) -> None:
    """They were wrong by 1.3 to 3.8 times: discs on few cells, ν = 0.49 in bending."""
    scene = claim_scene(seed, dimension)
    known = fine_solution(scene, scene_of(scene, None))
    claim = run_claim(scene, target, known)
    assert claim.met
    assert claim.ratio <= 1.05
