"""A stopped run goes on from its last outer iteration and ends with the same answer."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.checkpoint import Checkpoint
from contact_app.configuration import load
from contact_app.errors import ConfigurationError
from contact_app.model import build_model
from contact_app.scene import build_scene
from contact_app.solve import Solution, solve
from solver import Reason, Step
from solver.smalbe import Restart
from solver.tfeti.dual import DualProblem

CUBE = Path(__file__).parents[2] / "configs" / "cube.yaml"


@pytest.fixture(scope="module")
def scene() -> Any:
    overrides = ["bodies.0.mesh.box.cells=[9,9,9]", "decomposition.subdomains=[3,3,3]"]
    return build_scene(load(CUBE, overrides))


@pytest.fixture(scope="module")
def problem(scene: Any) -> DualProblem:
    return build_model(scene, MPI.COMM_SELF).problem


def stopped_after(outer: int) -> Any:
    return lambda event: isinstance(event, Step) and event.outer > outer


def stopped_after_steps(steps: int) -> Any:
    taken = itertools.count(1)
    return lambda event: next(taken) > steps


def go(problem: DualProblem, scene: Any, directory: Path, stop: Any, resume: bool) -> Solution:
    checkpoint = Checkpoint(directory, MPI.COMM_SELF, resume, every=0.0)
    solution = solve(problem, scene.solver, stop, checkpoint)
    assert (solution.reason is Reason.STOPPED) == (stop is not None)
    return solution


@pytest.fixture
def smalbe_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No active sets but those of SMALBE."""
    monkeypatch.setattr("contact_app.faces.FACES", 0)


def test_a_solve_stopped_on_a_face_goes_on_from_there(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    straight = solve(problem, scene.solver, None)
    assert straight.counts.outer == 0
    stopped = go(problem, scene, tmp_path, stopped_after_steps(8), resume=False)
    assert not stopped.converged
    gap = stopped.certificate.duality_gap
    assert gap < 0.1  # what it had reached on the face, not where SMALBE handed over
    spent = json.loads((tmp_path / "checkpoint.json").read_text())["state"]["counts"]["hessian"]
    assert 0 < spent <= stopped.counts.hessian
    resumed = go(problem, scene, tmp_path, None, resume=True)
    assert resumed.converged
    assert resumed.counts.hessian <= straight.counts.hessian + 15
    assert resumed.measures.energy == pytest.approx(straight.measures.energy, rel=1e-7)


@pytest.mark.usefixtures("smalbe_alone")
def test_a_resumed_solve_ends_with_the_same_answer(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    straight = solve(problem, scene.solver, None)
    stopped = go(problem, scene, tmp_path, stopped_after(4), resume=False)
    assert not stopped.converged
    assert json.loads((tmp_path / "checkpoint.json").read_text())["state"]["outer"] == 4
    resumed = go(problem, scene, tmp_path, None, resume=True)
    assert resumed.converged
    assert resumed.counts.outer == pytest.approx(straight.counts.outer, abs=2)
    # going on costs the start's product, and the steps of the outer iteration that was cut
    assert resumed.counts.hessian <= straight.counts.hessian + 5
    assert resumed.measures.energy == pytest.approx(straight.measures.energy, rel=1e-7)
    largest = np.abs(straight.displacements[0]).max()
    for a, b in zip(resumed.displacements, straight.displacements, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-5 * largest)


@pytest.mark.usefixtures("smalbe_alone")
def test_one_checkpoint_is_left_and_it_can_be_removed(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    go(problem, scene, tmp_path, stopped_after(5), resume=False)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["checkpoint-5.petsc", "checkpoint.json"]
    Checkpoint(tmp_path, MPI.COMM_SELF, True).remove()
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("smalbe_alone")
def test_a_checkpoint_of_another_problem_is_refused(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    go(problem, scene, tmp_path, stopped_after(3), resume=False)
    other = build_scene(
        load(CUBE, ["bodies.0.mesh.box.cells=[9,9,9]", "decomposition.subdomains=[3,3,3]",
                    "conditions.1.traction=[0,0,-466]"])
    )  # fmt: skip
    with pytest.raises(ConfigurationError, match="another problem"):
        go(build_model(other, MPI.COMM_SELF).problem, scene, tmp_path, None, resume=True)


@pytest.mark.usefixtures("smalbe_alone")
def test_a_damaged_checkpoint_is_refused(problem: DualProblem, scene: Any, tmp_path: Path) -> None:
    go(problem, scene, tmp_path, stopped_after(3), resume=False)
    (tmp_path / "checkpoint-3.petsc").write_bytes(b"")
    with pytest.raises(ConfigurationError, match="no readable checkpoint"):
        go(problem, scene, tmp_path, None, resume=True)


def test_without_a_checkpoint_a_resumed_run_starts_from_the_beginning(
    problem: DualProblem, tmp_path: Path
) -> None:
    assert Checkpoint(tmp_path, MPI.COMM_SELF, True).load(problem) is None


def test_writes_are_rationed(problem: DualProblem, tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path, MPI.COMM_SELF, False, every=1e9)
    checkpoint.load(problem)
    x = np.zeros(problem.size)
    from solver import Counts

    checkpoint(Restart(1, x, x, 1.0, 1.0, 1.0, 0.0, (), Counts()))
    assert not list(tmp_path.iterdir())
    checkpoint.write()
    assert len(list(tmp_path.iterdir())) == 2
