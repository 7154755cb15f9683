"""Load cases: comparison with single runs, shared data, files of a run, refused scenes."""

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from mpi4py import MPI

import contact_app
from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.results.envelope import Envelope
from contact_app.run.case_models import CaseModels, outlines_of_cases
from contact_app.run.cases import solved_cases
from contact_app.run.run import run
from contact_app.run.solve import solve_scene
from tests import scenes
from tests.scenes import Config
from tests.scenes_on_ranks import one_and_two

SQUARE = "quadrilateral"


def named(made: Config, names: dict[int, str], cases: Config) -> Config:
    """A scene whose conditions of some numbers have names, with load cases."""
    made = copy.deepcopy(made)
    for number, name in names.items():
        made["conditions"][number]["name"] = name
    return {**made, "cases": cases}


def single(made: Config, case: str) -> Config:
    """One case as a scene of its own, whose conditions are multiplied by hand."""
    made = copy.deepcopy(made)
    factors = made.pop("cases")[case]
    for condition in made["conditions"]:
        name = condition.pop("name", None)
        factor = 1.0 if name is None else factors.get(name, 0.0)
        for key in ("displacement", "traction", "force", "total_force"):
            if key in condition:
                values = condition[key]
                condition[key] = [None if v is None else factor * v for v in values]
        for key in ("pressure", "total_moment"):
            if key in condition:
                condition[key] *= factor
        if "temperature" in condition:
            condition["temperature"] = f"{factor} * ({condition['temperature']})"
    return made


def all_cases(made: Config, subdomains: Any = None) -> dict[str, Any]:
    """The solved cases of a scene by name."""
    scene = scenes.build(made, subdomains)
    found = solved_cases(scene, MPI.COMM_WORLD, lambda name: None)
    return {solved.model.scene.case: solved for solved in found}


def same_alone(solved: Any, made: Config, name: str, subdomains: Any = None) -> Any:
    """The scene with the loads of a case alone, which has the same answer."""
    alone = solve_scene(scenes.build(single(made, name), subdomains))
    energy, known = (s.summary["solution"]["energy"] for s in (solved, alone))
    assert energy == pytest.approx(known, rel=1e-8), name
    u, expected = (s.nodes.displacement for s in (solved, alone))
    np.testing.assert_allclose(u, expected, atol=1e-6 * np.abs(expected).max())
    return alone


def slot(n: int = 6) -> Config:
    """A column between two walls that leans on the one or the other, on a foundation that moves."""
    made = scenes.config(
        SQUARE,
        [scenes.block(SQUARE, n)],
        [
            {"on": "block.y-", "displacement": [0.02, -0.01]},
            {"on": "block.y+", "traction": [20.0, 0.0]},
            {"in": "block", "force": [0.0, -30.0]},
        ],
        [
            {"on": "block.x+", "obstacle": scenes.plane(SQUARE, (1.01, 0, 0), (-1, 0, 0))},
            {"on": "block.x-", "obstacle": scenes.plane(SQUARE, (-0.01, 0, 0), (1, 0, 0))},
        ],
    )
    right, left, moved = {"push": 1}, {"push": -2}, {"push": -1, "settle": 0.25}
    cases = {"right": right, "left": left, "moved": moved, "more": {"push": 1.5}}
    return named(made, {0: "settle", 1: "push"}, cases)


def two_blocks(n: int = 4) -> Config:
    """A block on another, pressed, pushed sideways against stops, or lifted off by its stop."""
    made = scenes.config(
        SQUARE,
        [
            scenes.block(SQUARE, n, "lower", (0, 0, 0), (1, 0, 1)),
            scenes.block(SQUARE, n + 1, "upper", (0.1, 0, 1), (0.9, 0, 2)),
        ],
        [
            scenes.clamp(SQUARE, "lower.y-"),
            {"on": "upper.y+", "displacement": [0.01, None]},
            {"on": "upper.y+", "pressure": 20.0},
            {"on": "upper.x-", "total_force": [5.0, -10.0], "total_moment": 2.0},
        ],
        [{"on": "lower.y+", "against": "upper.y-"}],
    )
    cases = {
        "press": {"press": 1},
        "shove": {"press": 2, "shove": 1},
        "slid": {"press": 1, "slide": 1},
    }
    return named(made, {1: "slide", 2: "press", 3: "shove"}, cases)


def lifted(n: int = 3) -> Config:
    """A cube whose foot is moved towards a ball: one held body, whose unknowns are eliminated."""
    made = scenes.sphere("hexahedron", n)
    return named(
        made, {0: "lift"}, {"half": {"lift": 0.5}, "full": {"lift": 1}, "over": {"lift": 1.5}}
    )


def floating(n: int = 3) -> Config:
    """A free cube in a corner."""
    made = scenes.floating_in_corner("hexahedron", n)
    return named(made, {0: "top", 1: "side"}, {"one": {"top": 1, "side": 1}, "two": {"side": 3}})


def slope(n: int = 6) -> Config:
    """Nodes on an oblique plane, one component of which a condition moves: it changes the gap."""
    made = scenes.moved_rollers_on_a_slope(SQUARE, n)
    return named(made, {0: "move"}, {"rest": {}, "moved": {"move": 1}, "back": {"move": -1}})


def heated(n: int = 6) -> Config:
    """A block between a floor and a ceiling that heat presses against them."""
    made = scenes.rollers_and_floor(SQUARE, n)
    made["bodies"][0]["material"]["expansion"] = 1e-3
    made["conditions"].append({"in": "block", "temperature": "10 + 5 * x"})
    obstacle = scenes.plane(SQUARE, (0, 0, 1), (0, 0, -1))
    made["contacts"].append({"on": "block.y+", "obstacle": obstacle})
    return named(
        made, {1: "press", 3: "heat"}, {"cold": {"press": 1}, "hot": {"press": 1, "heat": 3}}
    )


@pytest.mark.parametrize(
    ("made", "subdomains"),
    [
        (heated(), 4),
        (slot(), 4),
        (slot(), 1),
        (two_blocks(), 5),
        (lifted(), None),
        (floating(), 8),
        (slope(), 4),
    ],
    ids=["heated", "slot", "slot-whole", "two-blocks", "lifted", "floating", "slope"],
)
def test_each_case_is_the_scene_with_its_loads(made: Config, subdomains: Any) -> None:
    cases = all_cases(made, subdomains)
    assert list(cases) == list(made["cases"])
    for name, solved in cases.items():
        assert solved.solution.converged
        alone = same_alone(solved, made, name, subdomains)
        for key in ("force", "moment"):
            for record in ("contacts", "reactions"):
                own, other = (
                    np.array([entry[key] for entry in s.summary[record]]) for s in (solved, alone)
                )
                np.testing.assert_allclose(own, other, atol=1e-5, err_msg=f"{name} {record} {key}")
        assert solved.accuracy.discretisation == pytest.approx(
            alone.accuracy.discretisation, rel=1e-4
        )


def test_cases_share_factors_and_rows() -> None:
    cases = list(all_cases(slot(), 4).values())
    first = cases[0].model
    for solved in cases[1:]:
        assert solved.model.problem.classes is first.problem.classes
        assert solved.model.problem.B is first.problem.B
        assert solved.model.problem.F is first.problem.F
        assert solved.model.partition is first.partition
    assert [solved.solution.warm for solved in cases] == [False, False, True, True]


@pytest.mark.parametrize("made", [slot(), two_blocks(), lifted()], ids=["slot", "two", "lifted"])
def test_cases_by_multigrid_share_its_matrices(made: Config) -> None:
    made = {**made, "solver": {**made.get("solver", {}), "method": "primal"}}
    matrices = []
    for solved in solved_cases(scenes.build(made), MPI.COMM_WORLD, lambda name: None):
        assert solved.solution.method == "primal"
        place = solved.model.problem.place
        assert place is not None
        matrices.append(place.take())
        place.leave(matrices[-1])
        same_alone(solved, made, solved.model.scene.case)
    assert all(shared.system.K is matrices[0].system.K for shared in matrices)


@pytest.mark.ratchet
def test_a_multiple_of_a_case_begins_with_its_answer() -> None:
    made = scenes.wall("hexahedron", 6)
    made = named(made, {1: "press"}, {"one": {"press": 1}, "two": {"press": 2}})
    one, two = all_cases(made, 8).values()
    assert two.solution.counts.hessian <= 3 < one.solution.counts.hessian
    assert two.summary["solution"]["energy"] == pytest.approx(
        4.0 * one.summary["solution"]["energy"], rel=1e-9
    )


def far_wall() -> Config:
    """A wall that only the second case reaches."""
    made = scenes.wall(SQUARE, 6)
    made["contacts"][0]["obstacle"] = scenes.plane(SQUARE, (1.05, 0, 0), (-1, 0, 0))
    made["conditions"][1]["traction"] = [0.5, 0.0]
    return named(made, {1: "push"}, {"weak": {"push": 1}, "strong": {"push": 80}})


def test_rows_left_out_join_where_a_case_crosses_them() -> None:
    """The answer of a model without contact rows requests the rows that it violates."""
    made = far_wall()
    scene = scenes.build(made, 4)
    outlines = outlines_of_cases(scene, MPI.COMM_WORLD)
    none = {
        name: known and replace(known, needed=np.zeros_like(known.needed))
        for name, known in outlines.items()
    }
    models = CaseModels(scene, MPI.COMM_WORLD, none)
    cases = {case.name: solve_scene(scene.under(case), cases=models) for case in scene.cases}
    for name, solved in cases.items():
        same_alone(solved, made, name, 4)
    assert cases["strong"].summary["solution"]["active_contacts"] > 0


def test_a_case_in_which_another_row_is_the_tighter_is_right() -> None:
    """Two slopes whose order at a held node depends on where the displacement takes it."""
    made = scenes.config(
        SQUARE,
        [scenes.block(SQUARE, 4)],
        [
            {"on": "block.x-", "displacement": [0.1, None]},
            {"on": "block.x+", "displacement": [0.1, None]},
            {"in": "block", "force": [0.0, -50.0]},
        ],
        [
            {"on": "block.y-", "obstacle": scenes.plane(SQUARE, (0, 0, 0), (0.2, 0, 1))},
            {"on": "block.y-", "obstacle": scenes.plane(SQUARE, (0, 0, -0.01), (-0.2, 0, 1))},
        ],
    )
    made = named(made, {0: "left", 1: "right"}, {"rest": {}, "moved": {"left": 1, "right": 1}})
    scene = scenes.build(made, 4)
    assert outlines_of_cases(scene, MPI.COMM_WORLD)["moved"] is None
    for name, solved in all_cases(made, 4).items():
        same_alone(solved, made, name, 4)


def test_a_case_without_equilibrium_is_named() -> None:
    made = floating(2)
    made["cases"] = {"sits": {"top": 1}, "flies": {"top": -20}}
    with pytest.raises(NoEquilibriumError, match=r"case flies: .*nothing stops block from leaving"):
        all_cases(made)


def test_displacements_that_exclude_each_other_in_one_case_are_refused() -> None:
    made = slot()
    made["cases"] = {"rest": {"push": 1}, "inside": {"settle": 5}}
    with pytest.raises(NoEquilibriumError, match=r"case inside: .*push held nodes into the obst"):
        all_cases(made)


# --- symmetry ----------------------------------------------------------------------------------


def squeezed(cases: Config) -> Config:
    """A block between walls, pressed on top and on both sides."""
    made = scenes.config(
        SQUARE,
        [scenes.block(SQUARE, 6)],
        [
            scenes.clamp(SQUARE, "block.y-"),
            {"on": "block.y+", "traction": [0, -40]},
            {"on": "block.x-", "traction": [3, 0]},
            {"on": "block.x+", "traction": [-3, 0]},
        ],
        [
            {"on": "block.x+", "obstacle": scenes.plane(SQUARE, (1, 0, 0), (-1, 0, 0))},
            {"on": "block.x-", "obstacle": scenes.plane(SQUARE, (0, 0, 0), (1, 0, 0))},
        ],
    )
    return {**named(made, {1: "top", 2: "left", 3: "right"}, cases), "symmetry": "allow"}


@pytest.mark.parametrize(
    ("second", "mirrors"),
    [({"top": 1, "left": 2, "right": 2}, True), ({"top": 1, "left": 1, "right": 2}, False)],
    ids=["symmetric", "one-is-not"],
)
def test_a_scene_is_halved_where_all_its_cases_mirror(second: Config, mirrors: bool) -> None:
    made = squeezed({"one": {"top": 1}, "two": second})
    answers = contact_app.solve(made)
    assert bool(answers.cases["one"].solved.model.scene.mirrors) == mirrors
    for name in made["cases"]:
        alone = contact_app.solve({**single(made, name), "symmetry": "none"})
        assert answers.cases[name].summary["solution"]["energy"] == pytest.approx(
            alone.summary["solution"]["energy"], rel=1e-8
        )


# --- what a run leaves -------------------------------------------------------------------------


def fields(path: Path) -> tuple[Config, Config]:
    """Fields at points and in cells."""
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        reader.read_points_cells()
        _, points, cells = reader.read_data(0)
    return points, {name: np.concatenate(values) for name, values in cells.items()}


def test_each_case_has_a_directory_and_the_run_an_overview_and_an_envelope(tmp_path: Path) -> None:
    made = slot()
    assert run(scenes.build(made, 4), tmp_path) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert list(summary["cases"]) == list(made["cases"])
    stress, pressure = [], []
    for name, case in summary["cases"].items():
        own = json.loads((tmp_path / name / "summary.json").read_text())
        assert own["certificate"] == case["certificate"]
        assert own["certificate"]["passed"]
        assert case["solution"].items() >= own["solution"].items()
        assert case["contacts"] == own["contacts"]
        assert len((tmp_path / name / "history.csv").read_text().splitlines()) > 1
        at_points, in_cells = fields(tmp_path / name / "solution.xdmf")
        stress.append(in_cells["von_mises"].ravel())
        pressure.append(at_points["contact_pressure"].ravel())
        assert case["solution"]["max_von_mises"] == pytest.approx(stress[-1].max())
    at_points, in_cells = fields(tmp_path / "envelope.xdmf")
    for values, key, found in (
        (np.array(stress), "von_mises", in_cells),
        (np.array(pressure), "contact_pressure", at_points),
    ):
        largest = found[f"largest_{key}"].ravel()
        case = found[f"{key}_case"].ravel()
        np.testing.assert_allclose(largest, values.max(axis=0), rtol=1e-12)
        np.testing.assert_array_equal(case, np.where(largest > 0.0, values.argmax(axis=0) + 1, 0))
        peak = summary["envelope"][key]
        assert peak["value"] == pytest.approx(largest.max())
        assert peak["case"] == list(made["cases"])[int(case[largest.argmax()]) - 1]


def test_the_envelope_has_cases_in_other_subdomains(tmp_path: Path) -> None:
    """A case that a second method solved in other subdomains has its cells in another order."""
    made = slot()
    first, other = (solve_scene(scenes.build(single(made, "right"), n)) for n in (4, 1))
    whole, less = other.cells.von_mises, 0.5 * first.cells.von_mises
    envelope = Envelope(first.model, first.nodes, first.cells)
    assert envelope.add(1, first.model, first.nodes, replace(first.cells, von_mises=less))
    assert envelope.add(2, other.model, other.nodes, other.cells)
    found = envelope.peaks(["small", "large"])["von_mises"]
    assert found == {"value": pytest.approx(whole.max()), "case": "large"}
    envelope.write(tmp_path)
    largest = fields(tmp_path / "envelope.xdmf")[1]["largest_von_mises"].ravel()
    np.testing.assert_allclose(largest, first.cells.von_mises, rtol=1e-5)


def test_the_largest_values_of_a_case_with_another_mesh_count() -> None:
    one, other = (solve_scene(scenes.build(single(slot(n), "right"))) for n in (4, 6))
    envelope = Envelope(one.model, one.nodes, one.cells)
    assert envelope.add(1, one.model, one.nodes, one.cells)
    assert not envelope.add(2, other.model, other.nodes, other.cells)
    largest = float(other.cells.von_mises.max())
    assert envelope.peaks(["a", "b"])["von_mises"] == {"value": largest, "case": "b"}


def test_the_next_run_removes_the_cases_of_the_last(tmp_path: Path) -> None:
    made = slot(3)
    made["output"] = {"xdmf": False}
    assert run(scenes.build(made), tmp_path) == 0
    (tmp_path / "left" / "mine.txt").write_text("kept")
    del made["cases"]["left"], made["cases"]["right"]
    assert run(scenes.build(made), tmp_path) == 0
    found = sorted(path.name for path in tmp_path.iterdir())
    assert found == ["left", "more", "moved", "run.log", "summary.json"]
    assert [path.name for path in (tmp_path / "left").iterdir()] == ["mine.txt"]


def test_the_worst_case_decides_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = slot(3)
    made["solver"]["max_iterations"] = 1
    made["cases"] = {"nothing": {"push": 1e-12}, "right": {"push": 1}}
    made["conditions"][2]["force"] = [0.0, -1e-12]
    assert run(scenes.build(made, 4), tmp_path) == 1
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert not summary["cases"]["right"]["certificate"]["passed"]
    assert "case right: " in capsys.readouterr().out


@pytest.mark.mpi
def test_two_ranks_report_the_same_as_one(tmp_path: Path) -> None:
    one, two = one_and_two(slot(), tmp_path, 4)
    for name, case in one["cases"].items():
        other = two["cases"][name]["solution"]
        assert case["solution"]["energy"] == pytest.approx(other["energy"], rel=1e-8)
        assert case["solution"]["max_von_mises"] == pytest.approx(other["max_von_mises"], rel=1e-6)
    for key, peak in one["envelope"].items():
        assert peak["case"] == two["envelope"][key]["case"]
        assert peak["value"] == pytest.approx(two["envelope"][key]["value"], rel=1e-6)


def test_python_answers_by_case(tmp_path: Path) -> None:
    answers = contact_app.solve(slot(3))
    assert answers.converged
    assert answers.cases["right"].certificate.passed
    assert answers.summary["cases"]["left"]["solution"]["energy"] == pytest.approx(
        answers.cases["left"].summary["solution"]["energy"]
    )
    answers.write(tmp_path)
    assert (tmp_path / "right" / "solution.xdmf").is_file()
    assert (tmp_path / "envelope.xdmf").is_file()


def test_an_automatic_tolerance_serves_each_case() -> None:
    made = slot()
    made["solver"]["tolerance"] = "auto"
    for solved in all_cases(made, 4).values():
        assert solved.solution.converged
        assert solved.accuracy.algebraic <= 0.11 * solved.accuracy.discretisation


# --- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cases": {"a": {"pus": 1}}}, r"scene.yaml:\d+: cases.a.pus names no condition; did you"),
        ({"cases": {"a/b": {"push": 1}}}, r"scene.yaml:\d+: cases.a/b is no valid name of a case"),
        ({"cases": {"a": {"push": 1}, "A": {"push": 2}}}, r"cases.A and a differ in upper"),
        ({"cases": {}}, r"cases is {}; it must not be empty"),
        ({"cases": {"a": {"push": "x"}}}, r"cases.a.push is 'x'; a number is allowed"),
        ({"steps": [{"push": 1}]}, r"scene.yaml:\d+: steps and cases exclude each other"),
        ({"accuracy": 0.1}, r"scene.yaml:\d+: accuracy is not available with cases"),
    ],
    ids=["unknown", "directory", "capitals", "empty", "number", "steps", "accuracy"],
)  # fmt: skip
def test_wrong_cases_are_located(changes: Config, message: str, tmp_path: Path) -> None:
    path = scenes.write({**slot(3), **changes}, tmp_path / "scene.yaml")
    with pytest.raises(ConfigurationError, match=message):
        contact_app.solve(path)


def test_names_are_given_once_and_some_condition_has_one() -> None:
    made = slot(3)
    made["conditions"][0]["name"] = "push"
    with pytest.raises(ConfigurationError, match=r"conditions\[1\].name is 'push', the name of"):
        contact_app.solve(made)
    made = slot(3)
    for condition in made["conditions"]:
        condition.pop("name", None)
    with pytest.raises(ConfigurationError, match="no condition has a name"):
        contact_app.solve(made)


def test_a_case_that_loads_nothing_is_refused() -> None:
    made = slot(3)
    made["conditions"][2]["name"] = "weight"
    made["cases"] = {"idle": {"push": 0}}
    with pytest.raises(ConfigurationError, match=r"cases.idle loads nothing"):
        contact_app.solve(made)


def test_functions_of_one_load_case_refuse_several(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="load cases are solved by `run`"):
        solve_scene(scenes.build(slot(3)))
    with pytest.raises(ConfigurationError, match="leaves no checkpoint"):
        run(scenes.build(slot(3)), tmp_path, resume=True)


def test_each_case_and_their_envelope_have_pictures(tmp_path: Path) -> None:
    from contact_app.results.plot.picture import plot

    assert run(scenes.build(slot(3)), tmp_path) == 0
    pictures, remarks = plot(tmp_path)
    made = ("bodies.png", "contact_pressure.png")
    of_cases = [tmp_path / case / name for case in slot(3)["cases"] for name in made]
    assert pictures == [*of_cases, tmp_path / "envelope.png"]
    assert all(path.is_file() for path in pictures)
    assert all("without VTK" in remark for remark in remarks)
    pictures, _ = plot(tmp_path, output=tmp_path / "to")
    assert pictures[0] == tmp_path / "to" / next(iter(slot(3)["cases"])) / "bodies.png"
    assert run(scenes.build(slot(3)), tmp_path) == 0
    assert not list(tmp_path.glob("[!t]*/*.png"))
