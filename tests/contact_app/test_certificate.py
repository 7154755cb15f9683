"""The certificate tells the truth: its numbers are recomputed from the answer by other means.

What can be recomputed from outside is the displacement at the undecomposed nodes: penetration,
the balance of forces and the distance to the exact answer, which the duality gap must bound.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from tests import scenes
from tests.comparison import in_order_of, reference_of, solve

NUMBERS = (
    "max_penetration",
    "max_gluing_jump",
    "min_multiplier",
    "complementarity",
    "equilibrium",
    "duality_gap",
)
NAMES = ["wall", "tilted_plane", "hollow_sphere", "floating_in_corner", "two_planes", "pushed"]
CELL, SPLIT = "hexahedron", [2, 2, 2]


def certified(name: str, tolerance: float, **options: Any) -> Any:
    return solve(scenes.ALL[name](CELL, 4), SPLIT, tolerance=tolerance, **options)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-9])
@pytest.mark.parametrize("name", NAMES)
def test_every_number_is_below_the_tolerance_when_it_passes(name: str, tolerance: float) -> None:
    certificate = certified(name, tolerance).summary["certificate"]
    assert certificate["passed"]
    for number in NUMBERS:
        assert math.isfinite(certificate[number])
        assert abs(certificate[number]) <= max(tolerance, 1e-9 if number == "equilibrium" else 0)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-9])
@pytest.mark.parametrize("name", NAMES)
def test_duality_gap_bounds_the_error(name: str, tolerance: float) -> None:
    """½‖u - u*‖²_K and |J - J*| against the exact answer of the undecomposed problem.

    The bound holds for the repaired displacement. The one that is written may have jumps and
    penetrate, which moves its strain energy by a like amount: a factor of four covers both.
    """
    known = reference_of(name, CELL, 4)
    solution = certified(name, tolerance)
    gap = solution.summary["certificate"]["duality_gap"]
    energy = solution.summary["solution"]["energy"]
    bound = gap * abs(energy)
    round_off = 1e-13 * abs(known.u.ravel() @ known.system.load) + 1e-13 * abs(energy)
    assert gap >= 0
    assert energy - known.energy <= bound + round_off
    assert energy - known.energy >= -round_off, "an admissible displacement has more energy"
    error = 0.5 * known.energy_error(in_order_of(known, solution))
    assert error <= 4 * bound + round_off


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-9])
@pytest.mark.parametrize("name", NAMES)
def test_penetration_is_that_of_the_displacement(name: str, tolerance: float) -> None:
    """At a node where subdomains meet, copies differ by no more than the jump."""
    known = reference_of(name, CELL, 4)
    solution = certified(name, tolerance)
    u = in_order_of(known, solution)
    largest = np.linalg.norm(u, axis=1).max()
    penetration = np.max(known.system.contact @ u.ravel() - known.system.gap, initial=0) / largest
    certificate = solution.summary["certificate"]
    slack = certificate["max_gluing_jump"] * 3 + 1e-14
    assert penetration <= certificate["max_penetration"] + slack
    assert certificate["max_penetration"] <= max(penetration, 0) + slack


@pytest.mark.parametrize("name", ["wall", "two_planes", "floating_in_corner"])
def test_forces_balance(name: str) -> None:
    """K u - f vanishes at nodes that are neither held nor touching, and only pushes elsewhere."""
    known = reference_of(name, CELL, 4)
    system = known.system
    u = in_order_of(known, certified(name, 1e-9)).ravel()
    excess = system.stiffness @ u - system.load
    touching = np.zeros(system.load.size, bool)
    touching[system.contact[known.multiplier > 0].indices] = True
    alone = ~system.held & ~touching
    load = np.abs(system.load).sum()
    assert np.abs(excess[alone]).max() < 1e-7 * load
    rows = system.contact[known.multiplier > 0][:, ~system.held].toarray()
    multiplier, *_ = np.linalg.lstsq(rows.T, -excess[~system.held], rcond=None)
    assert multiplier.min() > -1e-7 * load


def test_numbers_shrink_with_the_tolerance() -> None:
    loose = certified("two_planes", 1e-2).summary["certificate"]
    tight = certified("two_planes", 1e-10).summary["certificate"]
    worst = [max(abs(c[number]) for number in NUMBERS) for c in (loose, tight)]
    assert worst[0] > 1e-7, "a loose tolerance must show"
    assert worst[1] < 1e-9 < worst[0]


@pytest.mark.parametrize("name", ["wall", "sliding", "no_contacts"])
def test_a_solve_cut_short_does_not_pass(name: str) -> None:
    solution = certified(name, 1e-9, max_iterations=3)
    summary = solution.summary
    assert not summary["solver"]["converged"]
    assert not summary["certificate"]["passed"]
    assert summary["solver"]["reason"]
    assert max(abs(summary["certificate"][number]) for number in NUMBERS) > 1e-9


def test_large_displacements_are_warned_of() -> None:
    made = scenes.wall(CELL, 2)
    made["conditions"][1]["traction"] = [0, 0, -2000]
    certificate = solve(made, SPLIT).summary["certificate"]
    assert any("strain" in w or "rotation" in w for w in certificate["warnings"]), certificate
    small = solve(scenes.scaled(scenes.wall(CELL, 2), 1e-4), SPLIT).summary["certificate"]
    assert not any("strain" in w or "rotation" in w for w in small["warnings"])


def test_sliding_along_a_curved_obstacle_is_warned_of() -> None:
    """A ball of radius 1 and a block that slides past it by half its radius."""
    made = scenes.sphere(CELL, 2)
    made["conditions"][0]["displacement"] = [0.5, 0.0, 0.04]
    certificate = solve(made, SPLIT).summary["certificate"]
    assert any("curved" in w or "slid" in w for w in certificate["warnings"]), certificate


def test_nearly_incompressible_is_warned_of() -> None:
    """Degree 1 locks as ν → 0.5."""
    made = scenes.wall(CELL, 2)
    made["bodies"][0]["material"]["poisson"] = 0.499
    certificate = solve(made, SPLIT).summary["certificate"]
    assert any("lock" in w or "incompressible" in w for w in certificate["warnings"]), certificate
