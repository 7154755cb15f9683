"""Every scene on which methods fail: this application holds, or refuses with a reason."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from contact_app.run.solve import solve_scene
from contact_app.studies import failing_scenes
from contact_app.studies.failing_friction import FRICTION_CASES, solve_rough, two_floors
from contact_app.studies.failing_qps import QP_CASES, QPCase
from contact_app.studies.failing_scenes import CASES, HOLDS, REFUSED, Case
from contact_app.studies.outcomes import Outcome
from contact_app.studies.stability import (
    APPLICATION,
    QP_METHODS,
    STRATEGIES,
    WHOLE,
    run_case,
    run_qp_case,
    solve_by,
)
from tests import friction_reference, reference, scenes
from tests.stability import groups

SLOW = ("slender body 1:100", "load at the edge of the support")


def case_named(beginning: str) -> Case:
    return next(case for case in CASES if case.name.startswith(beginning))


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=pytest.mark.slow if c.name in SLOW else (), id=c.name) for c in CASES],
)
def test_this_application_certifies_or_refuses(case: Case) -> None:
    found = run_case(case, (APPLICATION, WHOLE))
    for method, outcome in found.items():
        allowed = {case.expected}
        if case.expected == HOLDS:
            allowed.add("degrades")
        assert outcome.verdict in allowed, f"{method}: {outcome}"
    if case.expected == REFUSED:
        return
    far = case.name.startswith("a million")  # the reference knows gaps to 1e-12 of the body
    made = case.mild() if far and case.mild else case.make()
    # a slender body's K leaves its optimality conditions eight digits
    known = reference.solve(scenes.build(made, 1), tolerance=1e-7).energy
    for method, outcome in found.items():
        assert math.isclose(outcome.energy, known, rel_tol=1e-6, abs_tol=1e-6 * case.scale), method


@pytest.mark.parametrize(
    "case",
    [c for c in CASES if c.expected == HOLDS and len(c.make()["bodies"]) > 1],
    ids=lambda case: case.name,
)
def test_each_of_several_bodies_is_right(case: Case) -> None:
    """A weak body's stresses are nothing in the energy of all."""
    scene = scenes.build(case.make(), 1)
    known = groups.solve(reference.assemble(scene), groups.groups_of(scene))
    for method, outcome in run_case(case, (APPLICATION, WHOLE)).items():
        for strain, body in zip(outcome.strains, known.bodies, strict=True):
            assert math.isclose(strain, body.strain, rel_tol=1e-3), method


@pytest.mark.parametrize("case", FRICTION_CASES, ids=lambda case: case.name)
def test_this_application_certifies_or_refuses_with_friction(case: Case) -> None:
    """And where the body is held, with the energy of sweeps over contact points."""
    for method, outcome in run_case(case, (APPLICATION, "multigrid"), solve_rough).items():
        allowed = {HOLDS, "degrades"} if case.expected == HOLDS else {REFUSED}
        assert outcome.verdict in allowed, f"{method}: {outcome}"
    made = case.make()
    held = any("displacement" in condition for condition in made["conditions"])
    if held and "steps" not in made:
        energy = solve_rough(APPLICATION, made, list(case.subdomains)).energy
        known = friction_reference.solve(scenes.build(made, 1)).energy
        assert math.isclose(energy, known, rel_tol=1e-6)


@pytest.mark.ratchet
def test_an_edge_in_two_frictional_planes_takes_few_applications() -> None:
    """Directions of slip that lagged behind its state took 10,125, by SMALBE-M in the end."""
    found = solve_rough(APPLICATION, two_floors(3), [2, 2, 2])
    assert not found.verdict
    assert found.applications <= 100


@pytest.mark.parametrize("case", QP_CASES, ids=lambda case: case.name)
def test_the_default_strategy_holds_or_refuses(case: QPCase) -> None:
    outcome = run_qp_case(case, ["projcg-safe"])["projcg-safe"]
    assert outcome.verdict == (REFUSED if case.refused else HOLDS), outcome


@pytest.mark.parametrize("case", [c for c in QP_CASES if c.refused], ids=lambda case: case.name)
def test_refusals_name_a_component_or_a_direction(case: QPCase) -> None:
    for outcome in run_qp_case(case, list(STRATEGIES)).values():
        assert outcome.verdict == REFUSED
        assert "component" in outcome.detail or "direction" in outcome.detail, outcome


def test_units_take_the_same_counts() -> None:
    assert run_case(case_named("micrometres"), [APPLICATION])[APPLICATION].growth == 1.0


@pytest.mark.parametrize("subdomains", [1, 4])
def test_a_node_may_fit_exactly_between_two_obstacles(subdomains: int) -> None:
    """No room is enough, as long as the obstacles do not overlap."""
    made = failing_scenes.squeezed()
    for contact in made["contacts"]:
        contact["obstacle"]["plane"]["point"][0] = 0.5
    solved = solve_scene(scenes.build(made, subdomains)).summary
    assert solved["certificate"]["passed"]
    known = reference.solve(scenes.build(made)).energy
    assert math.isclose(solved["solution"]["energy"], known, rel_tol=1e-6)


@pytest.mark.parametrize(("cells", "parts"), [([600, 4], 1), ([60, 40], 24)])
@pytest.mark.ratchet
def test_rods_stay_whole_and_end(cells: list[int], parts: int) -> None:
    """A chain of subdomains took 11611 products where the whole rod takes some hundreds."""
    ratio = 100.0 if parts == 1 else 1.5
    solved = solve_scene(scenes.build(failing_scenes.slender(ratio, cells))).summary
    assert solved["certificate"]["passed"]
    assert (solved["decomposition"]["subdomains"] == 1) == (parts == 1)
    assert solved["solver"]["hessian_multiplications"] < 1500


def too_large(outcome: Outcome, _: int) -> Outcome:
    return replace(outcome, energy=1.00001 * outcome.energy)


def weak_body_off(outcome: Outcome, subdomains: int) -> Outcome:
    strong, weak = outcome.strains
    return replace(outcome, strains=(strong, weak if subdomains == 1 else 1.01 * weak))


@pytest.mark.parametrize(
    ("case", "change", "named"),
    [(CASES[1], too_large, ""), (case_named("weak body"), weak_body_off, "body")],
)
def test_a_wrong_answer_is_detected(
    case: Case, change: Callable[[Outcome, int], Outcome], named: str
) -> None:
    """The judge itself, for an answer that is wrong in all or in one body."""

    def wrong(method: str, made: scenes.Config, subdomains: int) -> Outcome:
        return change(solve_by(method, made, subdomains), subdomains)

    outcome = run_case(case, [APPLICATION], wrong)[APPLICATION]
    assert outcome.verdict == "WRONG"
    assert named in outcome.detail


def test_an_invented_equilibrium_is_detected() -> None:
    from contact_app.studies import stability

    case = next(c for c in CASES if c.expected == REFUSED)
    answer = stability.Outcome("", "", 3, -1.0, 0.0)
    assert run_case(case, [APPLICATION], lambda *_: answer)[APPLICATION].verdict == "WRONG"


def test_the_document_has_every_case_and_method() -> None:
    """A row of verdicts, and one of what goes wrong and what guards."""
    from pathlib import Path

    page = Path(__file__).parents[3] / "docs" / "benchmarks" / "stability.md"
    text = page.read_text(encoding="utf-8")
    for case in (*CASES, *FRICTION_CASES, *QP_CASES):
        assert text.count(f"\n| {case.name} |") == 2, case.name
    for method in QP_METHODS:
        assert f"| {method} " in text
