"""Load histories: comparison with theory and single runs, files of a run, refused scenes."""

import csv
import json
import logging
import re
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import contact_app
from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.machine.exits import Exit
from contact_app.run import solve
from contact_app.run.answer import StepAnswers
from contact_app.run.cases import solved_cases
from contact_app.run.other_increments import change_to
from contact_app.run.run import run
from contact_app.run.solve import solve_scene
from contact_app.run.step_equilibrium import leaving_in_step
from solver.contact.solution import Solution
from solver.tfeti.dual import DualProblem
from tests import scenes
from tests.scenes import Config
from tests.scenes_on_ranks import one_and_two
from tests.stability.increments import changes

SQUARE = "quadrilateral"
MU = 0.25


def block(steps: list[Config], n: int = 8, mu: float = MU) -> Config:
    """A block on a rough floor whose top is pressed down and moved aside, as the steps say."""
    press = {"name": "press", "on": "block.y+", "displacement": [None, -0.01]}
    push = {"name": "push", "on": "block.y+", "displacement": [0.01, None]}
    floor = {"on": "block.y-", "obstacle": scenes.plane(SQUARE, (0, 0, 0), (0, 0, 1))}
    made = scenes.config(
        SQUARE,
        [scenes.block(SQUARE, n, upper=(2, 1, 1))],
        [press, push],
        [{**floor, "friction": {"coulomb": mu}}],
    )
    made["output"] = {"probes": {"corner": [2, 1]}}
    return {**made, "steps": steps}


PRESS_AND_PUSH: list[Config] = [{"press": 1}, {"push": 1, "increments": 3}, {"push": -1}]


def solved(made: Config) -> StepAnswers:
    found = contact_app.solve(made)
    assert isinstance(found, StepAnswers)
    return found


@pytest.fixture(scope="module")
def history() -> StepAnswers:
    return solved(block(PRESS_AND_PUSH))


def rod(steps: list[Config], cells: int = 50) -> Config:
    """A thin rod on a floor with a slip limit, pulled at its end."""
    return {
        "dimension": "plane_stress",
        "bodies": [scenes.box("rod", [100, 0.5], [cells, 1], poisson=0.0)],
        "conditions": [
            {"name": "pull", "on": "rod.x+", "traction": [20, 0]},
            {"on": "rod.y+", "displacement": [None, 0]},
        ],
        "contacts": [
            {
                "on": "rod.y-",
                "obstacle": {"plane": {"point": [0, 0], "normal": [0, 1]}},
                "friction": {"tresca": 0.2},
            }
        ],
        "output": {"probes": {"end": [100, 0.25]}},
        "steps": steps,
    }


def test_friction_obeys_the_slip_of_each_increment(history: StepAnswers) -> None:
    """Recomputed at the nodes of the floor: |t| ≤ μ p, and at the limit against what slipped."""
    assert history.converged
    at, slipped = history.last.points[:, 1] == 0.0, 0
    before = np.zeros(history.last.displacement.shape)
    for answer in history.increments:
        slip = (answer.displacement - before)[at, 0]
        force = answer.solved.nodes.friction_traction[at, 0]
        limit = MU * answer.contact_pressure[at]
        least = 1e-6 * np.abs(answer.displacement).max()
        top = limit.max()
        assert (np.abs(force) <= limit + 1e-5 * top).all()
        slides = np.abs(slip) > least
        np.testing.assert_allclose(force[slides], -np.sign(slip[slides]) * limit[slides],
                                   atol=1e-5 * top)  # fmt: skip
        np.testing.assert_allclose(answer.solved.nodes.slip[at, 0], slip, atol=least)
        slipped += int(slides.sum())
        before = answer.displacement
    assert slipped > 10


def test_the_order_of_loads_matters(history: StepAnswers) -> None:
    """Pressed and pushed at once the block ends elsewhere."""
    at_once = block([])
    del at_once["steps"]
    at_once["conditions"][1]["displacement"] = [-0.01, None]
    once = contact_app.solve(at_once).summary["solution"]["dissipated_work"]
    other = history.summary["solution"]["dissipated_work"]
    assert other > 1.5 * once > 0.0


@pytest.mark.parametrize("increments", [None, 1, 2, 5])
def test_friction_dissipates_the_work_of_proportional_loads_beyond_the_strain_energy(
    increments: int | None,
) -> None:
    """The top is moved by forces that grow with it: their work is half the product.

    Friction dissipates what is not strain energy, in any number of increments.
    """
    made = block([{"press": 1, "push": 1, "increments": increments or 1}])
    if increments is None:
        del made["steps"]
    summary = contact_app.solve(made).summary
    forces = [reaction["force"] for reaction in summary["reactions"]]
    work = 0.5 * (forces[0][1] * -0.01 + forces[1][0] * 0.01)
    solution = summary["solution"]
    assert solution["dissipated_work"] > 0.02 * solution["energy"]
    assert solution["dissipated_work"] == pytest.approx(work - solution["energy"], rel=1e-4)


def test_one_increment_is_the_scene_without_steps() -> None:
    made = block([{"press": 1, "push": 1}])
    found = solved(made).summary
    alone = solve_scene(scenes.build({k: v for k, v in made.items() if k != "steps"})).summary
    assert found["solution"]["energy"] == pytest.approx(alone["solution"]["energy"], rel=1e-10)
    assert found["contacts"][0]["nodes"] == alone["contacts"][0]["nodes"]


def test_without_friction_increments_are_cases() -> None:
    made = block([{"press": 1}, {"push": 1, "increments": 2}])
    del made["contacts"][0]["friction"]
    energies = [r["solution"]["energy"] for r in solved(made).summary["steps"]]
    made["cases"] = {
        "a": {"press": 1},
        "b": {"press": 1, "push": 0.5},
        "c": {"press": 1, "push": 1},
    }
    del made["steps"]
    cases = solved_cases(scenes.build(made), MPI.COMM_WORLD, lambda name: None)
    known = [case.summary["solution"]["energy"] for case in cases]
    np.testing.assert_allclose(energies, known, rtol=1e-8)


def test_records_of_increments(history: StepAnswers) -> None:
    records = history.summary["steps"]
    assert [r["step"] for r in records] == [1, 2, 2, 2, 3]
    assert [r["factor"] for r in records] == pytest.approx([1, 1 / 3, 2 / 3, 1, 1])
    assert [r["time"] for r in records] == pytest.approx([1, 4 / 3, 5 / 3, 2, 3])
    assert [r["factors"]["push"] for r in records[1:]] == pytest.approx([1 / 3, 2 / 3, 1, -1])
    assert history.summary["solution"] == records[-1]["solution"]
    assert history.summary["probes"] == records[-1]["probes"]
    work = [r["solution"]["dissipated_work_of_increment"] for r in records]
    lost = [r["solution"]["dissipated_work"] for r in records]
    np.testing.assert_allclose(np.cumsum(work), lost, rtol=1e-12)


def test_increments_share_factors(history: StepAnswers) -> None:
    first, *others = (answer.solved.model.problem for answer in history.increments)
    for problem in others:
        assert problem.F is first.F


@pytest.mark.ratchet
def test_a_block_that_slides_to_and_fro_is_cheap() -> None:
    """With the search directions of all increments conjugate gradients diverged: no answer."""
    made = block(
        [
            {"press": 1},
            {"push": 1, "increments": 3},
            {"push": -1, "increments": 4},
            {"push": 0, "increments": 2},
        ],
        mu=0.3,
    )
    del made["output"]
    (body,), (_, push) = made["bodies"], made["conditions"]
    body["mesh"]["box"]["upper"], body["degree"], push["displacement"] = [1, 1], 2, [0.03, None]
    found = solved(made)
    assert found.converged
    counts = [r["solver"]["hessian_multiplications"] for r in found.summary["steps"]]
    assert max(counts) <= 30, counts


@pytest.mark.ratchet
@pytest.mark.parametrize("method", ["auto", "primal"])
def test_an_increment_without_a_change_of_loads_costs_next_to_nothing(method: str) -> None:
    """Its forces are those before, although the slips that it is measured from are others."""
    steps = [{"press": 1}, {"push": 1, "increments": 2}, {"push": 1, "increments": 2}, {"press": 1}]
    made = {**block(steps), "solver": {"method": method, "tolerance": 1e-8}}
    records = solved(made).summary["steps"]
    assert records[2]["contacts"][0]["nodes"]["slip"] > 0
    assert all(r["solver"]["hessian_multiplications"] <= 4 for r in records[3:])
    for record in records[3:]:
        for key in ("energy", "dissipated_work", "max_displacement"):
            before = records[2]["solution"][key]
            assert record["solution"][key] == pytest.approx(before, rel=1e-6)


@pytest.mark.ratchet
def test_a_cycle_ends_as_it_began_in_few_operator_applications() -> None:
    """The last step begins with the answer to its loads, and not with that of the step before."""
    made = contact_app.solve(Path(__file__).parents[3] / "configs" / "rod_cycle.yaml")
    counts = [r["solver"]["hessian_multiplications"] for r in made.summary["steps"]]
    assert counts[-1] <= 6, counts  # 58 from the answer of the step before


# --- runs --------------------------------------------------------------------------------------


def times(directory: Path) -> list[float]:
    """Times of the frames of ``solution.xdmf``, whose files all exist."""
    text = (directory / "solution.xdmf").read_text()
    for name in set(re.findall(r">([^<>]*\.h5):/", text)):
        assert (directory / name).is_file(), name
    return [float(t) for t in re.findall(r'<Time Value="([^"]*)"/>', text)]


class Interrupts(logging.Handler):
    """Sends a signal, Ctrl-C by default, once a message is logged."""

    def __init__(self, text: str, number: int = signal.SIGINT) -> None:
        super().__init__()
        self.text, self.number = text, number

    def emit(self, record: logging.LogRecord) -> None:
        if record.getMessage().startswith(self.text):
            signal.raise_signal(self.number)

    def __enter__(self) -> None:
        logging.getLogger("contact_app").addHandler(self)

    def __exit__(self, *_: object) -> None:
        logging.getLogger("contact_app").removeHandler(self)


def interrupted(directory: Path, changes: Config | None = None) -> Config:
    """A run that is interrupted after its third increment; its scene."""
    made = block(PRESS_AND_PUSH) | (changes or {})
    made["output"]["vtu"] = True
    with Interrupts("step 2, factor 0.666667:"):
        assert run(scenes.build(made), directory) == Exit.NOT_CERTIFIED
    return made


def test_a_history_of_direct_solves_is_interrupted(tmp_path: Path) -> None:
    """A solve without iterations does not ask whether to stop."""
    made = scenes.wall("quadrilateral", 3)
    del made["contacts"]
    made["conditions"][1]["name"] = "press"
    made["steps"] = [{"press": 1, "increments": 5}]
    with Interrupts("step 1, factor 0.4:"):
        assert run(scenes.build(made), tmp_path) == Exit.NOT_CERTIFIED
    assert len(json.loads((tmp_path / "summary.json").read_text())["steps"]) == 2


def test_increments_without_an_answer_are_halved() -> None:
    made = block(PRESS_AND_PUSH, mu=0.4)
    made["solver"]["max_iterations"] = 8
    found = solved(made)
    assert found.converged
    halved = [record["halved"] for record in found.summary["steps"]]
    assert halved[0] == 0 < max(halved)
    assert found.summary["steps"][-1]["time"] == 3.0
    made["solver"]["max_iterations"] = 1
    assert not solved(made).converged


@pytest.mark.mpi
def test_two_ranks_halve_increments_by_multigrid_as_one(tmp_path: Path) -> None:
    """The halves measure their slip from the same increments."""
    made = block(PRESS_AND_PUSH, mu=0.4)
    made["solver"] = {"method": "primal", "max_iterations": 3, "tolerance": 1e-8}
    one, two = one_and_two(made, tmp_path, 2)
    assert [r["halved"] for r in one["steps"]] == [0, 0, 0, 0, 1, 2, 2]
    for own, other in zip(one["steps"], two["steps"], strict=True):
        assert (own["time"], own["halved"]) == (other["time"], other["halved"])
        for key in ("energy", "dissipated_work"):
            assert own["solution"][key] == pytest.approx(other["solution"][key], rel=1e-6)
    assert "Hessian multiplications: halved" in (tmp_path / "out2" / "run.log").read_text()


@pytest.mark.parametrize("method", ["active-set", "primal", "smalbe"])
def test_a_block_that_comes_back_to_its_unloaded_state_is_certified(method: str) -> None:
    """Its displacements are then rounding errors of those from which slip is measured."""
    made = block([{"press": 1, "push": 1}, {"press": 0, "push": 0}])
    made["contacts"][0]["obstacle"] = scenes.plane(SQUARE, (0, 0, -0.001), (0, 0, 1))
    made["solver"] = {"method": method}
    found = solved(made)
    assert found.converged
    assert [record["halved"] for record in found.summary["steps"]] == [0, 0]
    loaded, unloaded = (np.linalg.norm(a.summary["contacts"][0]["force"]) for a in found.increments)
    assert unloaded <= 1e-6 * loaded
    last = found.last.solved  # other rounding errors by halving are no reason for a warning
    rounded = [u + 1e-15 for u in last.solution.displacements]
    change = change_to(last.model.problem, last.solution, last.solution.multiplier, rounded)
    assert change.displacements == 0.0


def first_solve_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first solve ends without an answer, and the scene is solved in fewer subdomains."""
    solves = chain([None], repeat(solve.solve))

    def solved_or_not(*arguments: Any) -> Solution:
        one = next(solves)
        if one is None:
            raise ArithmeticError("no digit is right")
        return one(*arguments)

    monkeypatch.setattr(solve, "solve", solved_or_not)


def test_increments_follow_a_first_one_in_other_subdomains(
    history: StepAnswers, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Their slip is measured from its displacements, also in a run that goes on."""
    first_solve_fails(monkeypatch)
    made = {**block(PRESS_AND_PUSH), "decomposition": {"subdomains": 6}}
    found = solved(made)
    assert found.summary["solver"]["method"] == "primal"
    energies = [[r["solution"]["energy"] for r in h.summary["steps"]] for h in (history, found)]
    np.testing.assert_allclose(energies[1], energies[0], rtol=1e-5)

    first_solve_fails(monkeypatch)
    made = interrupted(tmp_path, {"decomposition": {"subdomains": 6}})
    assert run(scenes.build(made), tmp_path, resume=True) == Exit.CERTIFIED
    summary = json.loads((tmp_path / "summary.json").read_text())
    energies = [[r["solution"]["energy"] for r in s["steps"]] for s in (history.summary, summary)]
    np.testing.assert_allclose(energies[1], energies[0], rtol=1e-5)


@pytest.mark.parametrize(
    ("method", "subdomains", "other", "slow"),
    [("primal", 1, "active-set", False), ("auto", 4, "primal", False), ("auto", 4, "primal", True)],
)
def test_the_other_method_follows_where_one_fails_in_a_later_increment(
    monkeypatch: pytest.MonkeyPatch, method: str, subdomains: int, other: str, slow: bool
) -> None:
    """It goes on from the displacements of the first one, and solves the rest of the history.

    Total FETI solves halves only, multigrid all increments, also one that takes too long."""
    made = {**block(PRESS_AND_PUSH), "solver": {"method": method, "tolerance": 1e-8}}
    made["decomposition"] = {"subdomains": subdomains}
    before, by = solved(made), solve.solve

    def fails_when_pushed_farther(problem: DualProblem, *rest: Any) -> Solution:
        slips = np.abs(problem.c[problem.tangential]).max(initial=0.0)
        if problem.factored != (method == "auto") or slips <= 2e-3:
            return by(problem, *rest)
        if not slow:
            raise ArithmeticError("no digit is right")
        return by(problem, replace(rest[0], max_iterations=5), *rest[1:])

    monkeypatch.setattr(solve, "solve", fails_when_pushed_farther)
    records = solved(made).summary["steps"]
    methods = [record["solver"]["method"] for record in records]
    halved = [0, 0, 0, *([0] if method == "auto" else [1, 1]), 0]
    assert methods == [before.summary["solver"]["method"]] * 3 + [other] * (len(halved) - 3)
    assert [record["halved"] for record in records] == halved
    ends = [r["solution"] for r in records if r["factor"] == 1]
    for key in ("energy", "dissipated_work", "max_displacement"):
        values = [r["solution"][key] for r in before.summary["steps"] if r["factor"] == 1]
        assert [end[key] for end in ends] == pytest.approx(values, rel=1e-3)


def test_an_interrupted_run_goes_on(history: StepAnswers, tmp_path: Path) -> None:
    """Finished increments stay, and the rest is solved as in an uninterrupted run."""
    made = interrupted(tmp_path)
    saved = json.loads((tmp_path / "summary.json").read_text())["steps"]
    assert [r["time"] for r in saved] == pytest.approx([1, 4 / 3, 5 / 3]) == times(tmp_path)

    assert run(scenes.build(made), tmp_path, resume=True) == Exit.CERTIFIED
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [r["time"] for r in summary["steps"]] == pytest.approx(times(tmp_path))
    assert summary["steps"][-1]["time"] == 3.0
    assert not list(tmp_path.glob("checkpoint*"))
    for key in ("energy", "dissipated_work", "max_displacement"):
        assert summary["solution"][key] == pytest.approx(history.summary["solution"][key], rel=1e-5)
    with (tmp_path / "increments.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(summary["steps"])
    assert float(rows[-1]["corner_x"]) == summary["probes"]["corner"]["displacement"][0]
    assert (tmp_path / "solution.pvd").read_text().count("<DataSet") == len(rows)

    assert run(scenes.build({**made, "steps": [{"press": 1}]}), tmp_path) == Exit.CERTIFIED
    assert not list(tmp_path.glob("solution-2.*"))


@pytest.mark.slow
def test_a_killed_run_goes_on(history: StepAnswers, tmp_path: Path) -> None:
    """Its process ends within the fourth increment, without time to write anything."""
    child = (
        "import json, signal, sys; from pathlib import Path; from tests.contact_app.run import "
        "test_steps as t; t.logging.getLogger('contact_app').addHandler(t.Interrupts('step 2 of "
        "3, factor 1', signal.SIGKILL)); t.run(t.scenes.build(t.block(t.PRESS_AND_PUSH)), "
        "Path(sys.argv[1]))"
    )
    assert subprocess.run([sys.executable, "-c", child, tmp_path]).returncode == -signal.SIGKILL
    assert run(scenes.build(block(PRESS_AND_PUSH)), tmp_path, resume=True) == Exit.CERTIFIED
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert len(summary["steps"]) == len(history.summary["steps"])
    for key in ("energy", "dissipated_work", "max_displacement"):
        assert summary["solution"][key] == pytest.approx(history.summary["solution"][key], rel=1e-5)
    assert "going on after step 2, factor 0.666667" in (tmp_path / "run.log").read_text()
    run(scenes.build(block(PRESS_AND_PUSH)), tmp_path, resume=True)
    assert "no checkpoint in" in (tmp_path / "run.log").read_text()


def test_a_checkpoint_of_another_history_is_refused(tmp_path: Path) -> None:
    made = interrupted(tmp_path)
    made["conditions"][1]["displacement"] = [0.02, None]
    with pytest.raises(ConfigurationError, match="the checkpoint is of another scene"):
        run(scenes.build(made), tmp_path, resume=True)


@pytest.mark.mpi
def test_two_ranks_find_the_same_as_one(tmp_path: Path) -> None:
    one, two = one_and_two(block(PRESS_AND_PUSH), tmp_path, 4)
    for own, other in zip(one["steps"], two["steps"], strict=True):
        assert own["contacts"][0]["nodes"] == other["contacts"][0]["nodes"]
        for key in ("energy", "dissipated_work"):
            assert own["solution"][key] == pytest.approx(other["solution"][key], rel=1e-5)


# --- what is refused ---------------------------------------------------------------------------


def pressed_and_pushed(cell: str, along: float, push: float, press: float = 10.0) -> Config:
    """A block of a floor of 2 is pressed by 2 press, then pushed at an angle by 2 push."""
    aside = push * np.cos(along), push * np.sin(along)
    floor = {
        "on": f"block.{scenes.down(cell)}",
        "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1)),
    }
    top = f"block.{scenes.up(cell)}"
    made = scenes.config(
        cell,
        [scenes.block(cell, 1, upper=(2, 1, 0.2))],
        [
            {"name": "press", "on": top, "traction": scenes.vector(cell, 0.0, 0.0, -press)},
            {"name": "push", "on": top, "traction": scenes.vector(cell, *aside, 0.0)},
        ],
        [{**floor, "friction": {"coulomb": 0.4}}],
    )
    return {**made, "steps": [{"press": 1}, {"push": 1, "increments": 2}]}


@pytest.mark.parametrize(
    ("cell", "along", "push", "leaves"),
    [
        (SQUARE, 0.0, 5.0, "+x"),
        (SQUARE, np.pi, 250.0, "-x"),
        ("hexahedron", np.arctan(0.75), 5.0, "+x and 0.75 +y"),
    ],
)
def test_sliding_away_is_reported_with_step_and_factor(
    cell: str, along: float, push: float, leaves: str
) -> None:
    """The block slides from μ P / Q on, in the direction of the push, also where that is little."""
    with pytest.raises(NoEquilibriumError) as refused:
        contact_app.solve(pressed_and_pushed(cell, along, push))
    said = re.search(
        r"steps\[1\]: step 2, from its factor (\S+) on: .* leaving along (.*) under",
        str(refused.value),
    )
    assert said is not None
    assert "times all loads" not in str(refused.value)  # those before are held
    assert float(said[1]) == pytest.approx(0.4 * 10.0 / push, rel=2e-3)
    assert said[2] == leaves


@pytest.mark.parametrize("degrees", [10.0, 20.0])
def test_a_block_pushed_up_an_incline_slides_at_the_factor_of_statics(degrees: float) -> None:
    """F/G = (tan α + μ)/(1 - μ tan α), F level, axes along the incline; G holds throughout."""
    made = pressed_and_pushed(SQUARE, 0.0, 5.0)
    angle, mu, weight = np.radians(degrees), 0.4, 10.0
    gravity, push = made["conditions"]
    gravity["traction"] = [-weight * np.sin(angle), -weight * np.cos(angle)]
    push["traction"] = [weight * np.cos(angle), -weight * np.sin(angle)]
    with pytest.raises(NoEquilibriumError) as refused:
        contact_app.solve(made)
    said = re.search(r"step 2, from its factor (\S+) on: .* along \+x under", str(refused.value))
    assert said is not None, refused.value
    statics = (np.tan(angle) + mu) / (1.0 - mu * np.tan(angle))
    assert float(said[1]) == pytest.approx(statics, abs=1e-3)


def test_the_factor_is_right_with_rigid_bodies_too() -> None:
    """They have another outline at each factor."""
    made = pressed_and_pushed(SQUARE, 0.0, 5.0)
    plane = {"plane": {"point": [-1, 0], "normal": [1, 0]}}
    made["bodies"].append({"name": "wall", "rigid": plane})
    made["contacts"].append({"on": "block.x-", "against": "wall"})
    del made["conditions"][0]["name"]  # presses throughout
    made["conditions"].append({"in": "wall", "displacement": [0, 0], "rotation": 0})
    scene = scenes.build({**made, "steps": [{"push": 1}]})
    error = leaving_in_step(
        scene, 0, MPI.COMM_WORLD, None, NoEquilibriumError("leaves"), digits=0.1
    )
    said = re.search(r"step 1, from its factor (\S+) on: .* along \+x under", str(error))
    assert said is not None, error
    assert float(said[1]) == pytest.approx(0.8, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"steps": [{"push": 1}, {"pres": 1}]}, r"steps\[1\].pres names no condition; did"),
        ({"steps": [{"push": 1, "increment": 3}]}, r"steps\[0\].increment .* mean increments"),
        ({"steps": [{"push": 1, "increments": 0}]}, r"steps\[0\].increments is 0; it must be at l"),
        ({"steps": [{"push": 1, "increments": 1.5}]}, r"increments is 1.5; a whole number"),
        ({"steps": [{"push": "x"}]}, r"steps\[0\].push is 'x'; a number is allowed"),
        ({"steps": []}, r"steps is \[\]; it must not be empty"),
        ({"steps": [{"increments": 2}]}, r"steps\[0\] names no condition, so that it changes"),
        ({"steps": [{"push": 0}]}, r"steps load nothing"),
        ({"cases": {"a": {"push": 1}}}, r"steps and cases exclude each other"),
        ({"conditions": [{"on": "block.y-", "displacement": [1, 0]}]}, r"no condition has a name"),
    ],
)  # fmt: skip
def test_wrong_steps_are_located(changes: Config, message: str, tmp_path: Path) -> None:
    made: dict[str, Any] = {**block(PRESS_AND_PUSH, 3), **changes}
    with pytest.raises(ConfigurationError, match=rf"scene.yaml:\d+: .*{message}"):
        contact_app.solve(scenes.write(made, tmp_path / "scene.yaml"))


def test_slips_that_turn_aside_ask_for_more_increments() -> None:
    made = scenes.config(
        "hexahedron",
        [scenes.block("hexahedron", 2, upper=(1, 1, 0.5))],
        [
            {"on": "block.z+", "displacement": [None, None, -0.01]},
            {"name": "x", "on": "block.z+", "displacement": [0.02, None, None]},
            {"name": "y", "on": "block.z+", "displacement": [None, 0.02, None]},
        ],
        [
            {
                "on": "block.z-",
                "obstacle": scenes.plane("hexahedron", (0, 0, 0), (0, 0, 1)),
                "friction": {"coulomb": 0.1},
            }
        ],
    )
    steps = solved({**made, "steps": [{"x": 1}, {"x": 2}, {"y": 1}]}).summary["steps"]
    warned = [
        any("direction of slip turns" in w for w in s["certificate"]["warnings"]) for s in steps
    ]
    assert warned == [False, False, True]


def on_a_ball(increments: int | None) -> Config:
    """A block pressed down on a ball and aside; without increments, all at once."""
    made = scenes.config(
        SQUARE,
        [scenes.block(SQUARE, 20, upper=(1, 1, 0.5))],
        [{"name": "press", "on": "block.y+", "displacement": [0.02, -0.04]}],
        [
            {
                "on": "block.y-",
                "obstacle": {"sphere": {"center": [0.45, -1], "radius": 1}},
                "friction": {"coulomb": 0.3},
            }
        ],
    )
    return {**made, "steps": [{"press": 1, "increments": increments}]} if increments else made


def test_changes_by_halving_an_increment_cause_a_warning() -> None:
    """The warning has the numbers of a history in twice as many increments.

    For a step of several increments they are half the changes from half as many.
    """
    one, two = (solved(on_a_ball(count)).last for count in (1, 2))
    for answer, other, share, words in (
        (one, two, 1.0, "8 of 9 contact points"),
        (two, one, 0.5, "5 of 6 contact points"),
    ):
        (said,) = [w for w in answer.certificate.warnings if "halving" in w]
        found = re.search(r"forces by ([\d.]+) % .* displacements by ([\d.]+) % ", said)
        assert found is not None
        assert words in said
        expected = 100 * share * np.array(changes(answer.solved, other.solved))
        np.testing.assert_allclose([float(text) for text in found.groups()], expected, rtol=0.05)


def test_small_increments_are_not_warned_of() -> None:
    warnings = solved(on_a_ball(8)).summary["certificate"]["warnings"]
    assert not [w for w in warnings if "halving" in w]


def test_an_increment_that_opens_all_contacts_changes_no_friction() -> None:
    """A hot block between two walls cools: the slip limits left are rounding errors."""
    body = scenes.box("block", [2, 1, 1], [6, 3, 3])
    body["material"]["expansion"] = 1e-4
    walls = [{"on": f"block.{side}", "obstacle": {"plane": {"point": [x, 0, 0], "normal": n}}}
             for side, x, n in (("x-", 0, [1, 0, 0]), ("x+", 2, [-1, 0, 0]))]  # fmt: skip
    walls[0]["friction"] = {"coulomb": 0.2}
    conditions = [{"name": "hot", "in": "block", "temperature": 100},
                  {"on": "block.y-", "displacement": [None, 0, None]},
                  {"on": "block.z-", "displacement": [None, None, 0]},
                  {"name": "push", "on": "block.z+", "traction": [0, 0, -2]}]  # fmt: skip
    made = scenes.config("hexahedron", [body], conditions, walls)
    made["solver"]["tolerance"] = 1e-9
    answer = solved({**made, "steps": [{"hot": 1}, {"push": 1, "increments": 2}, {"hot": -1}]})
    assert answer.last.certificate.passed
    assert not [w for w in answer.last.certificate.warnings if "halving" in w]


def test_growing_frictional_contact_under_a_load_at_once_causes_a_warning() -> None:
    warnings = contact_app.solve(on_a_ball(None)).summary["certificate"]["warnings"]
    assert [w for w in warnings if "close or open under the load" in w]


@pytest.mark.parametrize(("mu", "warned"), [(0.5, False), (1.0, True)])
def test_large_friction_may_have_several_answers(mu: float, warned: bool) -> None:
    warnings = solved(block([{"press": 1}], 4, mu)).summary["certificate"]["warnings"]
    assert any("need not be unique" in w for w in warnings) == warned


def test_a_history_without_a_first_answer_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = block([{"press": 1}], 4)
    made["solver"] = {"max_iterations": 2}
    assert run(scenes.build(made), tmp_path) == Exit.NOT_CERTIFIED
    log = (tmp_path / "run.log").read_text()
    assert "the increment to factor 0.0625 has no certified answer, though it was halved 4" in log
    screen = capsys.readouterr().err
    assert "step 1 of 1, factor 0.0625, halved (increment 1 of 1)" in screen
    for text in (log, screen):
        assert "ends in its first increment: there is no checkpoint to resume from" in text


@pytest.mark.parametrize("friction", [{}, {"friction": {"coulomb": 0.3}}])
def test_unloaded_bodies_that_touch_nothing_are_at_rest_at_once(friction: Config) -> None:
    """Slips count while friction may hold them: with friction from the second such step on."""
    wall = {"on": "block.x+", "obstacle": scenes.plane(SQUARE, (1.001, 0, 0), (-1, 0, 0))}
    conditions = [
        {"on": "block.y-", "displacement": [0, 0]},
        {"name": "press", "on": "block.y+", "traction": [0, -20]},
    ]
    made = scenes.config(SQUARE, [scenes.block(SQUARE, 6)], conditions, [{**wall, **friction}])
    found = solved({**made, "steps": [{"press": factor} for factor in (1, 0, 0)]}).summary
    pressed, *unloaded = found["steps"]
    assert pressed["contacts"][0]["force"][0] < -0.1
    methods = [record["solver"]["method"] for record in unloaded]
    assert methods[bool(friction) :] == ["direct"] * (2 - bool(friction))
    assert all(record["solution"]["max_displacement"] < 1e-12 for record in unloaded)
    assert not [w for w in found["certificate"]["warnings"] if "certified" in w]
