"""The table of what `auto` takes, and the trial parts that it is measured on."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.studies import method_choice
from contact_app.studies.processes import RunError

SCRIPT = Path(__file__).parents[3] / "meshes" / "samples" / "make_trials.py"


@pytest.fixture(scope="module")
def trials() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_trials", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_trials"] = module
    spec.loader.exec_module(module)
    return module


def test_a_row_compares_auto_with_the_better_method() -> None:
    seconds = {"auto": 2.6, "primal": 4.0, "active-set": 2.0}

    def run(_path: Path, method: str, _degree: int, _limit: float) -> method_choice.Row:
        return {"cpu": seconds[method], "iterations": 1200, "converged": True,
                "unknowns": 3000, "used": "primal"}  # fmt: skip

    found = method_choice.row(Path("plate.yaml"), 2, 60.0, run)
    assert found == (
        "| plate | 2 | 3,000 | primal | 2.60 (1,200) | 4.00 (1,200) | 2.00 (1,200) | 1.30 |"
    )


def test_a_method_without_a_certified_answer_is_no_better_one() -> None:
    def run(_path: Path, method: str, _degree: int, _limit: float) -> method_choice.Row:
        if method == "active-set":
            raise RunError("not done after 60 s")
        return {"cpu": 1.0 if method == "primal" else 3.0, "iterations": 5,
                "converged": method == "auto", "unknowns": 30, "used": "smalbe"}  # fmt: skip

    found = method_choice.row(Path("plate.yaml"), 1, 60.0, run)
    assert found.endswith("| 1.00 (5, not certified) | not done after 60 s |  |")


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2])
def test_trial_parts_are_scenes(trials: ModuleType, tmp_path: Path, degree: int) -> None:
    """Coarse ones: every boundary has facets, and every tetrahedron a volume."""
    for name in trials.TRIALS:
        path = trials.write(name, 1.8, tmp_path)
        scene = build_scene(load(path, [f"bodies.0.degree={degree}"]))
        assert not scene.bodies[0].mesh.congruent
        assert len(scene.contacts) == len(trials.TRIALS[name](1.8).contacts)


def test_a_trial_part_is_solved_to_a_certificate_with_some_of_its_nodes_open(
    trials: ModuleType, tmp_path: Path
) -> None:
    scene = build_scene(load(trials.write("eye_on_pin", 2.5, tmp_path)))
    found = solve_scene(scene).summary
    assert found["certificate"]["passed"]
    nodes = found["contacts"][0]["nodes"]
    assert nodes["open"] > 0
    assert nodes["slip"] > 0
