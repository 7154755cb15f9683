"""The numbers of the certificate are right: they are recomputed from the answer by other means.

The displacement at the undecomposed nodes gives the penetration, the balance of forces and the
distance to the exact answer, which the duality gap must bound.
"""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from solver.contact.certificate import Certificate
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


@cache
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

    The bound holds for the admissible displacement. The written one may have jumps and penetrate,
    which changes its strain energy by a similar amount: a factor of four covers both.
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


@pytest.mark.parametrize("name", ["wall", "sliding", "no_contacts"])
def test_a_solve_cut_short_does_not_pass(name: str) -> None:
    solution = certified(name, 1e-9, max_iterations=3)
    summary = solution.summary
    assert not summary["solver"]["converged"]
    assert not summary["certificate"]["passed"]
    assert summary["solver"]["reason"]
    assert max(abs(summary["certificate"][number]) for number in NUMBERS) > 1e-9


def test_a_stiff_body_on_a_soft_one_is_certified_to_round_off() -> None:
    """The body moves by 1e6 times its own strain, so that its forces are the last digits of large
    numbers."""
    soft = scenes.block("quadrilateral", 2, name="soft", young=1.0)
    stiff = scenes.block("quadrilateral", 3, name="stiff", lower=(0, 0, 1), upper=(1, 1, 2),
                         young=1e6, poisson=0.499)  # fmt: skip
    conditions = [
        scenes.clamp("quadrilateral", "soft.y-"),
        {"on": "stiff.x-", "displacement": [0.0, None]},
        {"on": "stiff.y+", "pressure": 1e-3},
    ]
    pair = [{"on": "stiff.y-", "against": "soft.y+"}]
    made = scenes.config("quadrilateral", [soft, stiff], conditions, pair)
    certificate = solve(made, 1, tolerance=1e-9).summary["certificate"]
    assert 1e-9 < certificate["equilibrium"] < certificate["round_off"] < 1e-5
    assert certificate["passed"]
    assert any("forces balance only to" in w for w in certificate["warnings"])


def test_round_off_excuses_no_more_than_it_leaves() -> None:
    found = Certificate(0.0, 0.0, 0.0, 0.0, equilibrium=1e-5, duality_gap=0.0, passed=False)
    assert found.judged(1e-4).passed
    assert not found.judged(1e-6).passed
    assert not replace(found, round_off=1.0).judged(1e-6).passed
    assert not replace(found, equilibrium=1e-7, round_off=1e-8).judged(1e-8).passed
    assert replace(found, equilibrium=1e-7, round_off=2e-7).judged(1e-8).passed


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


def judged(solution: Any, multiplier: np.ndarray, displacements: list[np.ndarray]) -> dict:
    """The certificate of a modified answer."""
    from solver.problem.certify import certify

    return certify(solution.model.problem, multiplier, displacements, 1e-9)[0].as_dict()


def test_detects_a_body_moved_into_the_wall() -> None:
    """Moving everything by t: penetration t, held rows off by t, work Σλ·t in complementarity."""
    solution = certified("wall", 1e-10)
    u = [v.copy() for v in solution.solution.displacements]
    largest = solution.summary["solution"]["max_displacement"]
    t = 1e-3 * largest
    for block in u:
        block[0::3] += t
    seen = judged(solution, solution.solution.multiplier, u)
    assert not seen["passed"]
    assert seen["max_penetration"] == pytest.approx(1e-3, rel=0.02)
    assert seen["max_gluing_jump"] == pytest.approx(1e-3, rel=0.02)
    assert seen["equilibrium"] < 1e-9, "a rigid motion needs no force"
    # Rows that touch now penetrate by t: Σ λ t over load times displacement; the load is the
    # largest of the sums of magnitudes, here at least that of the traction.
    force = abs(solution.summary["solution"]["contact_force"][0])
    assert 0.1 * force * 1e-3 / 50 < seen["complementarity"] <= 1.05 * force * 1e-3 / 50


def test_detects_a_wrong_prescribed_displacement_without_rows() -> None:
    """One subdomain eliminates what conditions hold; moved with all the rest, no force is wrong."""
    solution = solve(scenes.ALL["no_contacts"](CELL, 4), 1, tolerance=1e-10)
    answer = solution.solution
    assert not len(answer.multiplier), "held unknowns are eliminated"
    t = 1e-3 * solution.summary["solution"]["max_displacement"]
    seen = judged(solution, answer.multiplier, [u + t for u in answer.displacements])
    assert not seen["passed"]
    assert seen["max_gluing_jump"] == pytest.approx(1e-3, rel=0.02)


def test_detects_a_torn_node() -> None:
    """One unknown of one subdomain off by t: at most t in jumps, and forces out of balance."""
    solution = certified("wall", 1e-10)
    u = [v.copy() for v in solution.solution.displacements]
    t = 1e-3 * solution.summary["solution"]["max_displacement"]
    u[0][:, 0] += t * (np.abs(u[0][:, 0]) == np.abs(u[0][:, 0]).max())
    seen = judged(solution, solution.solution.multiplier, u)
    assert not seen["passed"]
    assert seen["equilibrium"] > 1e-5
    assert seen["duality_gap"] > 0


def test_jump_is_the_difference_of_copies() -> None:
    """The copies of a node, brought together by their coordinates, differ by what is claimed."""
    solution = certified("wall", 1e-3)
    copies: dict[tuple[float, ...], list[np.ndarray]] = {}
    model = solution.model
    for subdomain, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        u = solution.solution.displacements[cls][:, column].reshape(-1, 3)
        for point, value in zip(subdomain.points(), u, strict=True):
            copies.setdefault(tuple(np.round(point, 9) + 0.0), []).append(value)
    assert max(len(values) for values in copies.values()) == 8
    jump = max(np.abs(np.ptp(values, axis=0)).max() for values in copies.values())
    held = max(np.abs(values).max() for point, values in copies.items() if point[2] == 0.0)
    largest = solution.summary["solution"]["max_displacement"]
    claimed = solution.summary["certificate"]["max_gluing_jump"] * largest
    assert claimed > 0
    # Orthonormal rows combine copies: a row is at most √2 and at least 1/8 of a difference.
    worst = max(jump, held)
    assert worst / 8 <= claimed <= 2 * worst


@pytest.mark.parametrize("change", ["pull", "push", "scale"])
def test_detects_wrong_contact_forces(change: str) -> None:
    solution = certified("wall", 1e-10)
    problem = solution.model.problem
    multiplier = solution.solution.multiplier.copy()
    contact = np.flatnonzero(problem.inequality)
    largest = np.argmax(multiplier[contact])
    if change == "pull":
        multiplier[contact[np.argmin(multiplier[contact])]] = -0.1 * multiplier[contact[largest]]
    elif change == "push":
        multiplier[contact[np.argmin(multiplier[contact])]] = 0.1 * multiplier[contact[largest]]
    else:
        multiplier[contact] *= 1.1
    seen = judged(solution, multiplier, solution.solution.displacements)
    assert not seen["passed"]
    assert seen["equilibrium"] > 1e-5
    if change == "pull":
        assert seen["min_multiplier"] < -1e-5
    if change == "push":
        assert seen["complementarity"] > 1e-6, "a force across an open gap"


def test_rows_that_press_and_stand_open_cost_the_second_order() -> None:
    """A body moved off its wall by t: λ t would be of first order in t, the closed gap is of order
    t²."""
    from solver.problem.certify import certify

    solution = certified("wall", 1e-12)
    problem, answer = solution.model.problem, solution.solution
    gaps = []
    for t in (1e-3, 5e-4):
        moved = [u.copy() for u in answer.displacements]
        for u in moved:
            u[0::3] -= t * answer.measures.displacement
        measures = certify(problem, answer.multiplier, moved, 1e-9)[1]
        gaps.append(measures.gap)
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.05)
