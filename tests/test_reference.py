"""The reference solver against exact answers and brute force.

Everything the application is compared with must itself be right, so these tests know nothing of
the application's solver.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy.sparse as sp

from tests import extended, reference, scenes


def at(solution: reference.Reference, *point: float) -> np.ndarray:
    """Displacement at the node nearest to a point."""
    distance = np.linalg.norm(solution.points[:, : len(point)] - np.array(point), axis=1)
    return solution.u[np.argmin(distance)]


@pytest.mark.parametrize("cell", scenes.CELLS_3D + scenes.CELLS_2D)
def test_bar_against_a_wall(cell: str) -> None:
    solution = reference.solve(scenes.build(scenes.bar(cell, 3)))
    assert at(solution, 1, 0)[0] == pytest.approx(0.4, rel=1e-12)
    assert solution.contact_force[0] == pytest.approx(-0.6, rel=1e-12)
    assert solution.energy == pytest.approx(-0.32, rel=1e-12)


@pytest.mark.parametrize("cell", scenes.CELLS_3D)
def test_patch_in_space(cell: str) -> None:
    solution = reference.solve(scenes.build(scenes.patch(cell, 3)))
    np.testing.assert_allclose(at(solution, 1, 1, 1), [1 / 36, 1 / 36, -1 / 9], rtol=1e-12)
    assert solution.contact_force[2] == pytest.approx(100, rel=1e-12)


@pytest.mark.parametrize("cell", scenes.CELLS_2D)
@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_patch_in_the_plane(cell: str, plane: str) -> None:
    E, nu, q = 2.1e5, 0.3, 100.0
    solution = reference.solve(scenes.build(scenes.patch(cell, 4, assumption=plane)))
    down, side = (-(1 - nu**2), nu * (1 + nu)) if plane == "strain" else (-1.0, nu)
    np.testing.assert_allclose(at(solution, 1, 1), [side * q / E, down * q / E], rtol=1e-12)
    if plane == "strain":
        assert at(solution, 1, 1)[1] == pytest.approx(-4.3333e-4, rel=1e-5)


def test_every_scene_is_a_contact_problem() -> None:
    """Scenes whose contact never or always closes everywhere would test too little."""
    for name in ("wall", "tilted_plane", "sphere", "hollow_sphere", "floating_in_corner"):
        solution = reference.solve(scenes.build(scenes.ALL[name]("hexahedron", 4)))
        assert 0 < solution.active < solution.multiplier.size, name
        assert solution.residual < 1e-11, name


@pytest.mark.parametrize("seed", range(12))
def test_quadratic_programme_by_brute_force(seed: int) -> None:
    """The energy is the least of all active sets' feasible minimisers; rows may be dependent."""
    rng = np.random.default_rng(seed)
    n, m = 5, 6
    half = rng.standard_normal((n, n))
    K, f = half @ half.T + 0.1 * np.eye(n), rng.standard_normal(n)
    B, g = rng.standard_normal((m, n)), rng.uniform(0.0, 0.3, m)
    B[5], g[5] = B[0], g[0]
    u, multiplier, residual, _ = reference.minimise(
        sp.csr_matrix(K), f, sp.csr_matrix(B), g, extent=1.0
    )
    best = np.inf
    for size in range(m):
        for rows in map(list, itertools.combinations(range(5), size)):
            zero = np.zeros((size, size))
            system = np.block([[K, B[rows].T], [B[rows], zero]])
            try:
                candidate = np.linalg.solve(system, np.concatenate([f, g[rows]]))[:n]
            except np.linalg.LinAlgError:
                continue
            if np.all(B @ candidate <= g + 1e-12):
                best = min(best, 0.5 * candidate @ K @ candidate - f @ candidate)
    assert residual < 1e-11
    assert 0.5 * u @ K @ u - f @ u == pytest.approx(best, rel=1e-10, abs=1e-12)
    assert multiplier.min() >= 0


@pytest.mark.parametrize("traction", [(0, 0, 100), (5, 0, -100)])
def test_refuses_a_scene_without_equilibrium(traction: tuple[float, ...]) -> None:
    made = scenes.sliding("hexahedron", 2)
    made["conditions"] = [{"on": "block.z+", "traction": list(traction)}]
    with pytest.raises(reference.ReferenceError, match="equilibrium"):
        reference.solve(scenes.build(made))


def test_refuses_a_held_node_inside_an_obstacle() -> None:
    made = scenes.wall("hexahedron", 2)
    made["contacts"][0]["obstacle"] = scenes.plane("hexahedron", (0.9, 0, 0), (-1, 0, 0))
    with pytest.raises(reference.ReferenceError, match="penetrates"):
        reference.solve(scenes.build(made))


def test_gaps_of_the_obstacles() -> None:
    """Signed distances worked out by hand, so that a wrong obstacle fools nobody."""
    cell = "hexahedron"
    made = scenes.wall(cell, 1)
    made["contacts"] = [
        {"on": "block.x+", "obstacle": obstacle}
        for obstacle in (
            scenes.plane(cell, (1.5, 0, 0), (-2, 0, 0)),
            {"sphere": {"center": [4, 0, 0], "radius": 1}},
            {"sphere": {"center": [0, 0, 0], "radius": 2, "hollow": True}},
            {"cylinder": {"point": [4, 9, 0], "axis": [0, -3, 0], "radius": 1}},
            {"cylinder": {"point": [0, 5, 0], "axis": [0, 1, 0], "radius": 2, "hollow": True}},
        )
    ]
    system = reference.assemble(scenes.build(made))
    x, y, z = system.points[system.contact_node].T
    expected = np.concatenate(
        [
            0.5 + 0 * x[:4],
            np.sqrt((4 - x) ** 2 + y**2 + z**2)[4:8] - 1,
            2 - np.sqrt(x**2 + y**2 + z**2)[8:12],
            np.sqrt((4 - x) ** 2 + z**2)[12:16] - 1,
            2 - np.sqrt(x**2 + z**2)[16:],
        ]
    )
    np.testing.assert_allclose(system.gap, expected, rtol=1e-13)
    normal = -system.contact.toarray()[
        np.arange(20)[:, None], 3 * system.contact_node[:, None] + np.arange(3)
    ]
    away = np.column_stack([x - 4, 0 * y, z])[12:16]
    np.testing.assert_allclose(
        normal[12:16], away / np.linalg.norm(away, axis=1)[:, None], atol=1e-14
    )
    inward = -np.column_stack([x, y, z])[8:12]
    np.testing.assert_allclose(
        normal[8:12], inward / np.linalg.norm(inward, axis=1)[:, None], atol=1e-14
    )


def test_extended_precision_agrees_with_the_reference() -> None:
    """A well-conditioned programme: the same minimiser by both, from any start."""
    rng = np.random.default_rng(5)
    n, rows = 30, 12
    root = rng.standard_normal((n, n))
    K, B = sp.csr_matrix(root @ root.T + n * np.eye(n)), sp.csr_matrix(rng.random((rows, n)))
    load, gap = 50.0 * rng.random(n), rng.random(rows)
    known = reference.minimise(K, load, B, gap, 1.0)[0]
    assert ((B @ known - gap) > -1e-9).sum() >= 1
    for near in (np.zeros(n), known):
        found = extended.minimise(K, load, B, gap, near)
        assert found is not None
        np.testing.assert_allclose(found.astype(float), known, atol=1e-8 * np.abs(known).max())
    floating = sp.csr_matrix(np.array([[1.0, -1.0], [-1.0, 1.0]]))
    assert extended.minimise(floating, load[:2], B[:, :2], gap, np.zeros(2)) is None
