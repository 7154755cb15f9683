"""Scenes under several settings side by side."""

import pytest

from contact_app.run.answer import CaseAnswers, solve
from contact_app.studies.settings import HEADING, rows
from tests.scenes import CONFIGS

COLUMNS = [cell.strip() for cell in HEADING.splitlines()[0].strip("|").split("|")]


def table(scene: str, *settings: str, keys: tuple[str, ...] = ()) -> list[dict[str, str]]:
    """The rows of one solve each, by the names of columns."""
    lines = rows(CONFIGS / f"{scene}.yaml", keys, settings, rounds=0)
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(COLUMNS, row, strict=False)) for row in cells]


@pytest.mark.ratchet
def test_each_setting_has_a_row() -> None:
    """The tables of the guide: half a scene, and no more accuracy than the mesh has."""
    keys = ("bodies.0.mesh.box.cells=[8,8,4]",)
    whole, part, auto = table("sphere", "symmetry=allow", "solver.tolerance=auto", keys=keys)
    assert whole["scene"] == f"sphere {keys[0]}"
    assert 2 * int(part["unknowns"]) < int(whole["unknowns"].replace(",", ""))
    assert float(part["energy"]) < 1e-6
    assert float(auto["tolerance"]) > 10.0 * float(whole["tolerance"])
    assert int(auto["applications"]) <= int(whole["applications"])
    assert auto["error of the mesh"] == whole["error of the mesh"]
    assert min(float(row["over the least"]) for row in (whole, part, auto)) == 1.0


def test_a_setting_that_a_scene_refuses_is_reported() -> None:
    good, bad = table("block_2d", "solver.tolerance=2")
    assert good["method"]
    assert "solver.tolerance" in bad["unknowns"]


def test_the_last_load_case_is_reported() -> None:
    (row,) = table("load_cases")
    answers = solve(CONFIGS / "load_cases.yaml")
    assert isinstance(answers, CaseAnswers)
    last = [*answers.cases.values()][-1].summary
    assert int(row["applications"]) == last["solver"]["hessian_multiplications"]
