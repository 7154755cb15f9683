"""Load histories on meshes that are refined to an accuracy."""

import json
import logging
from pathlib import Path

import pytest

from contact_app.errors import ConfigurationError
from contact_app.machine.exits import Exit
from contact_app.run.run import run
from tests import scenes
from tests.contact_app.run.test_steps import PRESS_AND_PUSH, Interrupts, block, rod, solved, times
from tests.scenes_on_ranks import one_and_two

RELEASED: list[scenes.Config] = [{"pull": 1}, {"pull": 0, "increments": 2}]


def coarse(**changes: object) -> scenes.Config:
    """The block, pressed and pushed to and fro, on a few cells."""
    made = {**block(PRESS_AND_PUSH, 4), "accuracy": 0.08}
    return {**made, **changes}


def test_a_rod_is_refined_until_its_last_increment_is_accurate() -> None:
    """The end of a rod that was pulled and released stays at a half of its displacement.

    All increments are solved on each mesh, and the energy of a history changes by the first order
    in the errors that it inherits, so that squares of errors would never agree with it.
    """
    found = solved({**rod(RELEASED, 5), "accuracy": 0.02})
    assert found.converged
    moved = [record["probes"]["end"]["displacement"][0] for record in found.summary["steps"]]
    assert moved == pytest.approx([0.5, 0.4375, 0.25], rel=2e-3)
    accuracy, levels = found.summary["accuracy"], found.summary["levels"]
    assert accuracy["met"]
    assert accuracy["total"] < 0.02 < levels[0]["total"]
    assert found.summary["steps"][-1]["accuracy"]["total"] == accuracy["total"]
    work = [r["solver"]["hessian_multiplications"] for r in found.summary["steps"]]
    assert sum(work) == levels[-1]["hessian_multiplications"]
    assert len(found.last.points) * 2 == levels[-1]["dofs"] > levels[0]["dofs"]


def test_a_warning_counts_less_accurate_increments_before_the_last() -> None:
    found = solved(coarse(steps=[{"press": 1}, {"push": 1}, {"push": 0}]))
    errors = [record["accuracy"]["total"] for record in found.summary["steps"]]
    above = sum(error > 0.08 for error in errors[:-1])
    assert errors[-1] < 0.08
    text = f"the accuracy 0.08 is that of the last increment: {above} of the others"
    assert above
    assert any(text in warning for warning in found.summary["certificate"]["warnings"])


def test_files_are_those_of_the_last_mesh(tmp_path: Path) -> None:
    scene = scenes.build(coarse())
    assert run(scene, tmp_path) == Exit.CERTIFIED
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert len(summary["levels"]) > 1
    assert [r["time"] for r in summary["steps"]] == pytest.approx(times(tmp_path))
    assert len((tmp_path / "increments.csv").read_text().splitlines()) == 1 + len(summary["steps"])
    assert summary["mesh"]["dofs"] == summary["levels"][-1]["dofs"]
    assert not list(tmp_path.glob("checkpoint*"))
    with pytest.raises(ConfigurationError, match="a run to an accuracy leaves no checkpoint"):
        run(scene, tmp_path, resume=True)


class InterruptsLevel(Interrupts):
    """Sends the signal in the middle of the second level."""

    def __init__(self) -> None:
        super().__init__("level 1: ")

    def emit(self, record: logging.LogRecord) -> None:
        if self.text == "level 1: " and record.getMessage().startswith(self.text):
            self.text = "step 3 of 3"
            return
        super().emit(record)


@pytest.mark.parametrize("handler", [Interrupts("level 1: "), InterruptsLevel()])
def test_an_interrupted_run_writes_the_last_finished_level(
    handler: Interrupts, tmp_path: Path
) -> None:
    with handler:
        assert run(scenes.build(coarse(accuracy=0.01)), tmp_path) == Exit.NOT_CERTIFIED
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["steps"][-1]["time"] == 3.0 == times(tmp_path)[-1]
    assert summary["mesh"]["dofs"] == summary["levels"][0]["dofs"]
    assert not summary["accuracy"]["met"]
    assert any("the run was interrupted" in text for text in summary["certificate"]["warnings"])


@pytest.mark.mpi
def test_two_ranks_refine_as_one(tmp_path: Path) -> None:
    one, two = one_and_two(coarse(), tmp_path)
    assert [level["dofs"] for level in two["levels"]] == [level["dofs"] for level in one["levels"]]
    assert two["accuracy"]["total"] == pytest.approx(one["accuracy"]["total"], rel=1e-3)
