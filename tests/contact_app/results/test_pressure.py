"""Contact pressures of degree 2: Hertz's profile without alternation, and the right resultant."""

from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.results.alternation import Lines, alternation
from contact_app.run.solve import solve_scene
from tests import meshfiles, scenes

ROOT = Path(__file__).parents[3]


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
    scene = scenes.read("hertz_disc", given)
    solved = solve_scene(scene, MPI.COMM_SELF)
    assert solved.summary["certificate"]["passed"]
    return profile(solved)


@pytest.mark.parametrize("curved", [False, True], ids=["straight", "curved"])
def test_hertz(curved: bool, tmp_path: Path) -> None:
    """Peak and profile; nodal forces over areas would be 2 % off on straight edges."""
    found = hertz(tmp_path, curved)
    assert found.peak < 0.002
    assert found.inner < 0.002
    assert found.rms < 0.004
    assert found.alternation < 0.001


def test_hertz_near_incompressible(tmp_path: Path) -> None:
    """ν = 0.4999: forces of corners and middles differ by their double, the pressure does not."""
    found = hertz(tmp_path, True, "bodies.0.material.poisson=0.4999")
    assert found.peak < 0.01
    assert found.inner < 0.01
    assert found.alternation < 0.01


def line_of_facets(x: np.ndarray) -> tuple[Lines, np.ndarray]:
    """Facets of three nodes between ascending vertices, in an order of their own."""
    middles = 0.5 * (x[1:] + x[:-1])
    points = np.pad(np.concatenate([x, middles])[:, None], ((0, 0), (0, 2)))
    n = np.arange(len(x) - 1)
    return Lines.of([np.stack([n, n + 1, len(x) + n], axis=1)], points), points[:, 0]


@pytest.mark.parametrize("spacing", [np.ones(8), 1.4 ** np.arange(8)])
def test_an_alternation_is_taken_off_a_smooth_pressure(spacing: np.ndarray) -> None:
    lines, x = line_of_facets(np.append(0.0, np.cumsum(spacing)))
    ends = np.arange(len(x)) <= len(spacing)
    smooth = 30.0 + 3.0 * x
    wave = np.where(ends, 2.0, -1.0)
    assert alternation(lines, smooth + wave, lambda v: v) == pytest.approx(wave, abs=1e-12)
    inner = (x > x.max() * 0.02) & (x < x.max() * 0.6) & ends
    curved = smooth + x**2
    assert alternation(lines, curved, lambda v: v)[inner] == pytest.approx(0.0, abs=1e-9)


def test_nodes_that_an_alternation_opens_are_closed() -> None:
    """The mean, two thirds of what middles have, is constant; the contact ends at x = 6."""
    lines, x = line_of_facets(np.arange(9.0))
    ends = np.arange(len(x)) < 9
    q = np.where(ends, 0.0, 2.5)
    q[x > 6.0] = 0.0
    found = q - alternation(lines, q, lambda v: v)
    assert found[(x > 1.1) & (x < 4.9)] == pytest.approx(2.5 * 2.0 / 3.0)
    assert (found[x > 6.0] == 0.0).all()
    q = np.where(ends, 3.0, 0.0)  # as of a polygon in a round hole: corners alone touch
    assert q - alternation(lines, q, lambda v: v) == pytest.approx(1.0)
