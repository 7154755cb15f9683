"""A stopped run goes on from the step that it had reached and ends with the same answer."""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from contact_app.run.progress import together
from solver import Counts, Reason, Step
from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.checkpoint import Attention, Checkpoint, CheckpointError, Saver
from solver.driver import Solution, solve
from solver.qp.outer_state import Restart
from solver.tfeti.dual import DualProblem
from tests import scenes

CUBE = Path(__file__).parents[3] / "configs" / "cube.yaml"


@pytest.fixture(scope="module")
def scene() -> Any:
    overrides = ["bodies.0.mesh.box.cells=[9,9,9]", "decomposition.subdomains=[3,3,3]"]
    return scenes.read(CUBE, overrides)


@pytest.fixture(scope="module")
def problem(scene: Any) -> DualProblem:
    return build_model(scene, MPI.COMM_SELF).problem


def stopped_after(outer: int) -> Any:
    return lambda event: isinstance(event, Step) and event.outer > outer


def stopped_after_steps(steps: int) -> Any:
    taken = itertools.count(1)
    return lambda event: next(taken) > steps


SMALBE_ALONE = ActiveSetOptions(most_sets=0)


def go(
    problem: DualProblem,
    scene: Any,
    directory: Path,
    stop: Any,
    resume: bool,
    every: float = 1e9,
    **how: Any,
) -> Solution:
    """Solve; as in a run, a step at which it is stopped is saved, and steps `every` seconds."""
    checkpoint = Checkpoint(directory, MPI.COMM_SELF, resume, every)
    asked = [False]

    def ask(event: Step) -> None:
        asked[0] = stop is not None and stop(event)

    monitor = together(ask, Attention(MPI.COMM_SELF, lambda: asked[0], checkpoint))
    solution = solve(problem, scene.solver, monitor, checkpoint, **how)
    assert (solution.reason is Reason.STOPPED) == (stop is not None)
    return solution


def state_of(directory: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((directory / "checkpoint.json").read_text())["state"]
    return found


@pytest.mark.ratchet
def test_a_resumed_solve_ends_with_the_same_answer(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    straight = solve(problem, scene.solver, active_sets=SMALBE_ALONE)
    stopped = go(problem, scene, tmp_path, stopped_after(4), resume=False, active_sets=SMALBE_ALONE)
    assert not stopped.converged
    assert state_of(tmp_path)["outer"] == 4
    resumed = go(problem, scene, tmp_path, None, resume=True, active_sets=SMALBE_ALONE)
    assert resumed.converged
    assert resumed.counts.outer == pytest.approx(straight.counts.outer, abs=2)
    # continuing costs the initial product, and the steps of the interrupted outer iteration
    assert resumed.counts.hessian <= straight.counts.hessian + 5
    assert resumed.measures.energy == pytest.approx(straight.measures.energy, rel=1e-7)
    largest = np.abs(straight.displacements[0]).max()
    for a, b in zip(resumed.displacements, straight.displacements, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-5 * largest)


def test_one_checkpoint_is_left_and_it_can_be_removed(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    go(problem, scene, tmp_path, stopped_after(5), resume=False, active_sets=SMALBE_ALONE)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["checkpoint-1.vectors", "checkpoint.json"]
    go(problem, scene, tmp_path, stopped_after(7), resume=True, active_sets=SMALBE_ALONE)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["checkpoint-2.vectors", "checkpoint.json"]
    Checkpoint(tmp_path, MPI.COMM_SELF, True).remove()
    assert not list(tmp_path.iterdir())


def test_a_checkpoint_of_another_problem_is_refused(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    go(problem, scene, tmp_path, stopped_after(3), resume=False, active_sets=SMALBE_ALONE)
    cut = ["bodies.0.mesh.box.cells=[9,9,9]", "decomposition.subdomains=[3,3,3]"]
    other = scenes.read(CUBE, [*cut, "conditions.1.traction=[0,0,-466]"])
    with pytest.raises(CheckpointError, match="another problem"):
        go(
            build_model(other, MPI.COMM_SELF).problem,
            scene,
            tmp_path,
            None,
            resume=True,
            active_sets=SMALBE_ALONE,
        )


def test_a_damaged_checkpoint_is_refused(problem: DualProblem, scene: Any, tmp_path: Path) -> None:
    go(problem, scene, tmp_path, stopped_after(3), resume=False, active_sets=SMALBE_ALONE)
    (tmp_path / "checkpoint-1.vectors").write_bytes(b"")
    with pytest.raises(CheckpointError, match="no readable checkpoint"):
        go(problem, scene, tmp_path, None, resume=True, active_sets=SMALBE_ALONE)


def test_a_checkpoint_of_another_number_of_ranks_is_refused(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    """Rows have another order there, and the work that was spent would be lost unseen."""
    go(problem, scene, tmp_path, stopped_after_steps(5), resume=False)
    path = tmp_path / "checkpoint.json"
    path.write_text(path.read_text().replace('"ranks": 1', '"ranks": 2'))
    with pytest.raises(CheckpointError, match="written on 2 ranks"):
        go(problem, scene, tmp_path, None, resume=True)


def test_without_a_checkpoint_a_resumed_run_starts_from_the_beginning(
    problem: DualProblem, tmp_path: Path
) -> None:
    assert Checkpoint(tmp_path, MPI.COMM_SELF, True).load(problem.size, problem.description) is None


KINDS = {
    "conjugate gradients on an active set": ({}, 6, True),
    "the first outer iteration of SMALBE": ({}, 3, False),
    "MPRGP on contact rows alone": ({"decomposition.subdomains": 1, "tolerance": 1e-10}, 8, True),
    "conjugate gradients without contact": ({"contacts": [], "tolerance": 1e-10}, 20, True),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("ended", ["stopped", "killed"])
@pytest.mark.ratchet
def test_a_run_continues_from_a_checkpoint_at_any_stage(
    kind: str, ended: str, tmp_path: Path
) -> None:
    """The answer is the same, with far fewer products than from the beginning."""
    changes, steps, on_sets = KINDS[kind]
    # no active sets, and a first outer iteration of more than a few steps
    how = {} if on_sets else {"active_sets": SMALBE_ALONE}
    overrides = ["bodies.0.mesh.box.cells=[9,9,9]", "decomposition.subdomains=[3,3,3]"]
    overrides += [f"{'solver.' * (k == 'tolerance')}{k}={v}" for k, v in changes.items()]
    scene = scenes.read(CUBE, overrides)
    problem = build_model(scene, MPI.COMM_SELF).problem
    straight = solve(problem, scene.solver, **how)
    if ended == "stopped":
        go(problem, scene, tmp_path, stopped_after_steps(steps), resume=False, **how)
    else:  # at a step, without a word; a checkpoint is written at every step

        def kill(event: Step) -> bool:
            if taken(event):
                raise KeyboardInterrupt
            return False

        taken = stopped_after_steps(steps)
        with pytest.raises(KeyboardInterrupt):
            go(problem, scene, tmp_path, kill, resume=False, every=0.0, **how)
    state = state_of(tmp_path)
    assert state["outer"] == 0
    assert (state["rho"] > 0.0) is not on_sets
    spent = state["counts"]["hessian"]
    assert spent >= steps - 2
    resumed = go(problem, scene, tmp_path, None, resume=True, **how)
    assert resumed.converged
    assert resumed.counts.hessian - spent <= straight.counts.hessian - 0.5 * spent
    assert resumed.measures.energy == pytest.approx(straight.measures.energy, rel=1e-7)


def a_state(problem: DualProblem) -> Restart:
    x = np.arange(float(problem.size))
    return Restart(1, x, -x, 1.0, 1.0, 1.0, 0.0, (), Counts())


def test_a_checkpoint_is_due_by_time_and_at_a_stop(problem: DualProblem, tmp_path: Path) -> None:
    event = Step(1, 1, "cg", 1.0, 1.0, 0, 0.0)
    checkpoint = Checkpoint(tmp_path, MPI.COMM_SELF, False, every=1e9)
    checkpoint.load(problem.size, problem.description)
    assert not Attention(MPI.COMM_SELF, lambda: False, checkpoint)(event)
    assert not checkpoint.due
    Saver(checkpoint)(a_state(problem))
    assert not list(tmp_path.iterdir())
    checkpoint.every = 0.0
    assert not Attention(MPI.COMM_SELF, lambda: False, checkpoint)(event)
    assert checkpoint.due
    checkpoint.every, checkpoint.due = 1e9, False
    assert Attention(MPI.COMM_SELF, lambda: True, checkpoint)(event)
    assert checkpoint.due
    Saver(checkpoint, Counts(hessian=3))(a_state(problem))
    assert not checkpoint.due
    assert state_of(tmp_path)["counts"]["hessian"] == 3
    again = Checkpoint(tmp_path, MPI.COMM_SELF, True).load(problem.size, problem.description)
    assert again is not None
    np.testing.assert_array_equal(again.x, np.arange(problem.size))
    np.testing.assert_array_equal(again.multiplier, -np.arange(problem.size))


@pytest.mark.ratchet
def test_the_last_state_of_a_solve_is_held_for_a_later_stop(
    problem: DualProblem, scene: Any, tmp_path: Path
) -> None:
    checkpoint = Checkpoint(tmp_path, MPI.COMM_SELF, False)
    straight = solve(problem, scene.solver, None, checkpoint)
    assert not list(tmp_path.iterdir())
    checkpoint.save_held()
    resumed = go(problem, scene, tmp_path, None, resume=True)
    assert resumed.converged
    assert resumed.counts.hessian <= straight.counts.hessian + 3


def test_a_disk_that_takes_no_checkpoint_does_not_end_the_run(
    problem: DualProblem, scene: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    gone = tmp_path / "gone"  # never made
    assert solve(problem, scene.solver, None).converged
    checkpoint = Checkpoint(gone, MPI.COMM_SELF, False, every=0.0)
    monitor = Attention(MPI.COMM_SELF, lambda: False, checkpoint)
    assert solve(problem, scene.solver, monitor, checkpoint).converged
    assert "no checkpoint could be written" in caplog.text
