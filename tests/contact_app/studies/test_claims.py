"""The study of claims: random scenes, held against a fine mesh of degree 2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contact_app.scene.material import Material
from contact_app.studies.claims import run_claim, scene_of
from contact_app.studies.claims_reference import fine_solution
from contact_app.studies.claims_scenes import claim_scene
from contact_app.studies.grid_fields import GridField, square_distance


def test_the_distance_of_fields_on_different_grids() -> None:
    """The fields are u = (x², 0) on a coarse grid of degree 2 and its linear interpolant on another
    grid."""
    material = Material(1.0, 0.3)
    coarse, fine = (np.linspace(0.0, 1.0, n) for n in (3, 4))
    nodes = np.stack(np.meshgrid(*2 * [np.linspace(0.0, 1.0, 5)], indexing="ij"), axis=-1)
    square = GridField(2 * (coarse,), 2, False, nodes**2 * [1.0, 0.0])
    assert square_distance(square, square, material, False) == 0.0
    linear = np.stack(np.meshgrid(fine, fine, indexing="ij"), axis=-1) ** 2 * [1.0, 0.0]
    lame = material.poisson / ((1 + material.poisson) * (1 - 2 * material.poisson))
    stiff = material.young * (lame + 1.0 / (1.0 + material.poisson))  # λ + 2μ
    exact = stiff * 3 * (1 / 3) ** 3 / 3  # of (2x - a - b)² over three cells of width 1/3
    for simplices in (False, True):
        other = GridField(2 * (fine,), 1, simplices, linear)
        found = square_distance(square, other, material, False, points=8)
        assert found == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize(
    ("dimension", "seed", "target"),
    [
        pytest.param(2, 70, 0.15, marks=pytest.mark.slow),
        (2, 87, 0.3),
        pytest.param(2, 5087, 0.08, marks=pytest.mark.slow),
    ],
)
def test_a_random_claim_holds(dimension: int, seed: int, target: float, tmp_path: Path) -> None:
    """They were wrong by 1.3 to 3.8 times: discs on few cells, ν = 0.49 in bending."""
    scene = claim_scene(seed, dimension)
    known = fine_solution(scene, scene_of(scene, None), tmp_path)
    claim = run_claim(scene, target, known)
    assert claim.met
    assert claim.ratio <= 1.05


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [2, 3])
def test_random_claims_hold(dimension: int, tmp_path: Path) -> None:
    for seed in range(6):
        scene = claim_scene(seed, dimension)
        known = fine_solution(scene, scene_of(scene, None), tmp_path)
        claim = run_claim(scene, 0.3, known)
        assert not claim.met or claim.ratio <= 1.25
