"""Contact pressures of degree 2: Hertz's profile without alternation, and the right resultant."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from contact_app.configuration import load
from contact_app.facets import moments
from contact_app.model import facets_of
from contact_app.run import SolvedScene, solve_scene
from contact_app.scene import build_scene
from tests import meshfiles, scenes
from tests.comparison import solve

ROOT = Path(__file__).parents[2]


class Profile(NamedTuple):
    """Errors over Hertz's peak: of the peak, of the inner 80 %, of all, and of alternation."""

    peak: float
    inner: float
    rms: float
    alternation: float


def profile(solved: SolvedScene) -> Profile:
    """The pressures of `configs/hertz_disc.yaml` beside p0 √(1 - x²/a²), a from the force."""
    (material,) = solved.model.scene.bodies[0].materials
    modulus = material.young / (1.0 - material.poisson**2)
    force = 2.0 * solved.summary["solution"]["contact_force"][1]
    a = np.sqrt(4.0 * force * 50.0 / (np.pi * modulus))
    p0 = 2.0 * force / (np.pi * a)
    (s,) = solved.model.partition.subdomains
    rim = np.unique(s.reference.facets[s.boundaries["rim"]])
    x, p = s.points()[rim, 0], solved.nodes.contact_pressure[s.nodes[rim]]
    order = np.argsort(x)
    x, p = x[order], p[order]
    near = x < 1.5 * a
    x, p = x[near], p[near]
    exact = p0 * np.sqrt(np.maximum(1.0 - (x / a) ** 2, 0.0))
    inner = x < 0.8 * a
    waves = (p - exact) / p0
    return Profile(
        peak=abs(p.max() / p0 - 1.0),
        inner=np.abs(waves[inner]).max(),
        rms=float(np.sqrt(np.mean(waves**2))),
        alternation=np.abs(np.diff(waves, 2))[inner[1:-1]].max(),
    )


def hertz(directory: Path, curved: bool, *overrides: str) -> Profile:
    file = ROOT / "meshes" / "samples" / "disc_quarter.msh"
    if curved:
        mesh = meshfiles.on_circle(meshio.read(file), (0.0, 50.0), 50.0)
        file = meshfiles.write(mesh, directory / "disc.msh")
    given = (f"bodies.0.mesh.file={file}", "bodies.0.degree=2", "decomposition.subdomains=1",
             *overrides)  # fmt: skip
    scene = build_scene(load(ROOT / "configs" / "hertz_disc.yaml", given))
    solved = solve_scene(scene, MPI.COMM_SELF)
    assert solved.summary["certificate"]["passed"]
    return profile(solved)


@pytest.mark.parametrize("curved", [False, True], ids=["straight", "curved"])
def test_hertz(curved: bool, tmp_path: Path) -> None:
    """Peak and profile; nodal forces over areas would be 2 % off on straight edges."""
    found = hertz(tmp_path, curved)
    assert found.peak < 0.002
    assert found.inner < 0.003
    assert found.rms < 0.015
    assert found.alternation < 0.005


def test_hertz_near_incompressible(tmp_path: Path) -> None:
    """ν = 0.4999: forces of corners and middles differ by their double, the pressure does not."""
    found = hertz(tmp_path, True, "bodies.0.material.poisson=0.4999")
    assert found.peak < 0.01
    assert found.inner < 0.01
    assert found.alternation < 0.01


def test_hertz_converges(tmp_path: Path) -> None:
    """Curved cells halved; parts of straight ones would stay on the polygon."""
    coarse, fine = (hertz(tmp_path, True, f"bodies.0.mesh.refine={n}") for n in (0, 1))
    assert fine.inner < 0.6 * coarse.inner
    assert fine.rms < 0.75 * coarse.rms


@pytest.mark.parametrize("cell", [*scenes.CELLS_2D, *scenes.CELLS_3D])
@pytest.mark.parametrize("subdomains", [1, 5])
def test_the_resultant_is_that_of_the_forces(cell: str, subdomains: int) -> None:
    """∫ p over the contact is the contact force; no pressure where nothing touches."""
    made = scenes.ALL["tilted_plane"](cell, 3)
    made = {**made, "bodies": [{**body, "degree": 2} for body in made["bodies"]]}
    solution = solve(made, subdomains)
    nodes = solution.nodes
    assert nodes.contact_pressure.min() >= 0.0
    total = 0.0
    scene, partition = solution.model.scene, solution.model.partition
    contact = scene.contacts[0]
    chosen = facets_of(scene, partition, contact.body, contact.boundary)
    for s, rows in zip(partition.subdomains, chosen, strict=True):
        if len(rows):
            facets = s.reference.facets[rows]
            shares = moments(s.points()[facets], scene.dimension).sum(axis=1)
            total += float((shares * nodes.contact_pressure[s.nodes[facets]]).sum())
    force = np.linalg.norm(solution.summary["solution"]["contact_force"])
    assert total == pytest.approx(force, rel=1e-8)
