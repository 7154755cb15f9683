"""The reference solver against brute force, and what it refuses.

Everything the application is compared with must itself be right, so these tests know nothing of
the application's solver. The application is held against exact answers in
`tests/contact_app/model/test_exact.py`, and against the reference in many tests.
"""

import itertools

import numpy as np
import pytest
import scipy.sparse as sp

from tests import reference, scenes


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
