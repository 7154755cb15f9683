"""The guaranteed bound: never below the error, near it, exact where the mesh is, or refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.guarantee import box_surface
from contact_app.accuracy.guarantee import guarantee as module
from contact_app.accuracy.guarantee.guarantee import Guarantee, guarantee, with_guarantee
from contact_app.errors import ConfigurationError
from contact_app.model.outline import partition_scene
from contact_app.model.symmetry import halved
from contact_app.results.report import at_most
from contact_app.run.solve import solve_scene
from tests import scenes
from tests.comparison import solve
from tests.contact_app.model.test_two_bodies import stack
from tests.contact_app.test_cli import contact_app
from tests.scenes_on_ranks import summary_of

CELLS = scenes.CELLS_3D + scenes.CELLS_2D


def bounded(made: scenes.Config, subdomains: Any = None, **options: Any) -> tuple[Any, Guarantee]:
    solved = solve(made, subdomains, **options)
    return solved, guarantee(solved.model, solved.solution)


def energy(solved: Any) -> float:
    return float(solved.summary["solution"]["energy"])


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("parts", [1, 2])
def test_zero_where_the_mesh_is_exact(cell: str, parts: int) -> None:
    """The contact patch: a constant stress, with rollers, a loaded and a touching side."""
    made = scenes.column(cell, 3, scenes.on_top(cell, 0, 0, -30.0))
    _, found = bounded(made, [parts] * scenes.dimension(cell), tolerance=1e-13)
    assert found.bound is not None
    assert found.bound < 1e-7  # rounding of a closed gap, of second order in the error


def test_zero_where_the_mesh_is_exact_in_shear() -> None:
    """u = (γ y, 0): shear tractions that meet at the edges and agree there."""
    made = scenes.config(
        "quadrilateral",
        [scenes.block("quadrilateral", 3)],
        [
            {"on": "block.y-", "displacement": [0, 0]},
            {"on": "block.y+", "traction": [7, 0]},
            {"on": "block.x+", "traction": [0, 7]},
            {"on": "block.x-", "traction": [0, -7]},
        ],
        [],
    )
    _, found = bounded(made, tolerance=1e-13)
    assert found.bound is not None
    assert found.bound < 1e-7  # rounding of a closed gap, of second order in the error


@pytest.mark.parametrize("cell", CELLS)
def test_own_weight_against_the_exact_solution(cell: str) -> None:
    """‖u - u_h‖² = 2 (J(u_h) - J(u)) with J(u) = -w²/(6 M): above it, below twice, of order 1."""
    weight, bounds = 20.0, []
    exact = -(weight**2) / (6 * scenes.confined_modulus(1000.0, 0.3))
    for n in (2, 4, 8):
        solved, found = bounded(scenes.column(cell, n, scenes.weight(cell, 0, 0, -weight)))
        assert found.bound is not None
        error = (2 * (energy(solved) - exact) / found.norm**2) ** 0.5
        assert 1.0 <= found.bound / error < 2.0
        bounds.append(found.bound)
    assert np.log2(bounds[-2] / bounds[-1]) == pytest.approx(1.0, abs=0.1)


def test_a_slender_beam_that_comes_to_lie_on_the_floor() -> None:
    """The pressed facets are found anew: those that û touches would be in tension."""
    body = scenes.block("quadrilateral", 6, upper=(100.0, 1.0, 1.0))
    body["mesh"]["box"]["cells"] = [300, 6]
    made = scenes.config(
        "quadrilateral",
        [body],
        [scenes.clamp("quadrilateral", "block.x-"), {"on": "block.y+", "traction": [0, -1e-5]}],
        [{"on": "block.y-", "obstacle": scenes.plane("quadrilateral", (0, 0, -1e-3), (0, 0, 1))}],
    )
    solved, found = bounded(made)
    assert found.bound is not None
    assert solved.summary["solution"]["contact_force"][1] > 1e-4
    assert solved.accuracy.discretisation < found.bound < 2.0 * solved.accuracy.discretisation


def random_scene(seed: int, cells: int) -> scenes.Config:
    """A box of random sides, material, loads, held at one face, with obstacles at two others."""
    random = np.random.default_rng(seed)
    cell = [*scenes.CELLS_2D, *scenes.CELLS_3D][seed % 4]
    d = scenes.dimension(cell)
    sides = random.uniform(0.5, 2.0, d)
    counts = [int(k) * cells for k in random.integers(2, 4, d)]
    poisson = float(random.uniform(-0.3, 0.48))
    body = scenes.box("block", [float(v) for v in sides], counts, cell=cell, poisson=poisson)
    faces = [f"{'xyz'[k]}{end}" for k in range(d) for end in "-+"]
    held, pushed, *others = [str(f) for f in random.permutation(faces)]
    held_at = [float(v) for v in random.uniform(-0.02, 0.02, d)]
    for face in others[:2]:
        held_at["xyz".index(face[0])] = 0.0  # an obstacle beside it has room
    conditions: list[dict[str, Any]] = [
        {"on": f"block.{held}", "displacement": held_at},
        {"on": f"block.{pushed}", "pressure": float(random.uniform(-30.0, 60.0))},
        {"in": "block", "force": [float(v) for v in random.uniform(-40.0, 40.0, d)]},
        {"on": f"block.{others[0]}", "pressure": float(random.uniform(-30.0, 30.0))},
    ]
    contacts = []
    for face in others[:2]:
        axis, sign = "xyz".index(face[0]), 1.0 if face[1] == "+" else -1.0
        gap = float(random.uniform(0.0, 0.02))
        point, normal = [0.0] * d, [0.0] * d
        point[axis] = (float(sides[axis]) if sign > 0 else 0.0) + sign * gap
        normal[axis] = -sign
        contacts.append(
            {"on": f"block.{face}", "obstacle": {"plane": {"point": point, "normal": normal}}}
        )
    made = scenes.config(cell, [body], conditions, contacts)
    if d == 2 and seed % 3 == 0:
        made["dimension"] = "plane_stress"
    return made


@pytest.mark.parametrize(
    "seed", [*range(8), *(pytest.param(n, marks=pytest.mark.slow) for n in range(8, 100))]
)
def test_never_below_the_error(seed: int) -> None:
    """J(u_h) - J(u) is bounded from below by a mesh that contains this one; also for partial
    answers."""
    fine = solve(random_scene(seed, 4 if seed % 4 < 2 else 3))
    for tolerance in (1e-9, 3e-2):
        solved, found = bounded(random_scene(seed, 1), tolerance=tolerance)
        assert found.bound is not None, found.missing
        error = 2.0 * (energy(solved) - energy(fine)) / found.norm**2
        assert error > 0.0
        assert found.bound**2 >= error
        assert found.bound**2 < 6.0 * error


def test_the_same_however_it_is_cut(tmp_path: Path) -> None:
    """Subdomains, ranks, and half the body where the scene mirrors."""
    made = scenes.wall("hexahedron", 4)
    one, *others = [bounded(made, parts)[1].bound for parts in (1, [2, 2, 2], 5)]
    made |= {"certificate": {"guaranteed": True}, "decomposition": {"subdomains": [2, 2, 1]}}
    others.append(summary_of(made, tmp_path, 2)["accuracy"]["guaranteed"])
    assert others == pytest.approx([one] * 3, rel=1e-6)
    half = halved(scenes.build(made)).scene
    assert len(half.mirrors) == 1
    solved = solve_scene(half)
    assert guarantee(solved.model, solved.solution).bound == pytest.approx(one, rel=0.01)


def test_zero_where_nothing_is_strained() -> None:
    """A body that is only moved has no strain energy to which an error could be relative."""
    made = scenes.wall("quadrilateral", 3)
    made["conditions"] = [{"on": "block.y-", "displacement": [-0.5, 0.25]}]
    assert bounded(made)[1].bound == 0.0


@pytest.mark.parametrize(
    ("parts", "expected"), [(1, "crosses an obstacle by"), ([2, 2], "jumps by")]
)
def test_inadmissible_data_are_refused(
    parts: Any, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An answer moved towards the wall: held nodes are rows of B where it is cut."""
    solved = solve(scenes.wall("quadrilateral", 8), parts)
    moved = [u + 0.01 for u in solved.solution.displacements]
    monkeypatch.setattr(
        module, "nearest_admissible", lambda problem, *_: problem.on_interface(moved)
    )
    found = guarantee(solved.model, solved.solution)
    assert found.bound is None
    assert expected in found.missing


def test_two_bodies_are_bounded_together() -> None:
    """A second body whose mesh is exact adds to the norm alone."""
    made = scenes.wall("quadrilateral", 4)
    _, alone = bounded(made)
    far = scenes.block("quadrilateral", 2, name="far", lower=(5, 0, 0), upper=(6, 0, 1))
    made["bodies"].append(far)
    made["conditions"] += [
        {"on": "far.y-", "displacement": [None, 0]},
        {"on": "far.x-", "displacement": [0, None]},
        {"on": "far.y+", "pressure": 0.01},
    ]
    _, both = bounded(made)
    assert alone.bound is not None
    assert both.bound == pytest.approx(alone.bound, rel=1e-4)


def test_graded_meshes_of_a_run_to_an_accuracy(tmp_path: Path) -> None:
    """They keep degree 1, and the bound is held against the target."""
    made = scenes.wall("quadrilateral", 8)
    made |= {"accuracy": 0.05, "certificate": {"guaranteed": True}, "solver": {}}
    summary = summary_of(made, tmp_path, 1)
    assert len(summary["levels"]) > 2
    assert summary["accuracy"]["total"] < summary["accuracy"]["guaranteed"] < 0.05
    assert all(level["guaranteed"] > 0.05 for level in summary["levels"][:-1])
    assert summary["levels"][-1]["guaranteed"] == summary["accuracy"]["guaranteed"]


def on_a_part(made: scenes.Config, where: str) -> scenes.Config:
    made["bodies"][0]["boundaries"] = {"part": {"where": where}}
    made["contacts"][0]["on"] = "block.part"
    return made


def refused() -> dict[str, tuple[scenes.Config, str]]:
    """Scenes without a guarantee, and words of the reason."""
    shear = scenes.wall("quadrilateral", 4)
    shear["conditions"][1]["traction"] = [5, -50]
    second, averaged = (scenes.wall("quadrilateral", 4) for _ in range(2))
    second["bodies"][0]["degree"] = 2
    averaged["bodies"][0]["mean_dilatation"] = True
    return {
        "tilted": (scenes.tilted_plane("quadrilateral", 4), "not a plane parallel"),
        "round": (scenes.sphere("quadrilateral", 4), "not a plane parallel"),
        "shear": (shear, "shear tractions that meet at x = 0 and y = 1 contradict"),
        "degree": (second, "block has degree 2"),
        "mean dilatation": (averaged, "block has mean_dilatation"),
        "pair": (stack("quadrilateral", "quadrilateral", (2, 3)), "is a contact between bodies"),
        "node": (
            on_a_part(scenes.wall("quadrilateral", 4), "x > 0.99 and y > 0.4 and y < 0.6"),
            "whole facets",
        ),
        "halves": (
            on_a_part(scenes.wall("tetrahedron", 2), "x > 0.99 and z <= y + 1e-9"),
            "whole facets",
        ),
    }


@pytest.mark.parametrize("case", refused())
@pytest.mark.parametrize("command", ["run", "check"])
def test_refused_with_the_reason(
    case: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything is solved, naming the line."""
    made, reason = refused()[case]
    path = scenes.write(made | {"certificate": {"guaranteed": True}}, tmp_path / "scene.yaml")
    out = ["-o", str(tmp_path / "out")] if command == "run" else []
    assert contact_app(command, path, *out) == 2
    said = capsys.readouterr().err
    assert "certificate.guaranteed: no error can be guaranteed" in " ".join(said.split())
    assert reason in " ".join(said.split())
    line = int(said.split("scene.yaml:")[1].split(":")[0])
    assert "guaranteed" in path.read_text().splitlines()[line - 1]


def test_grids_beyond_the_memory_are_refused() -> None:
    made = scenes.wall("hexahedron", 4) | {"certificate": {"guaranteed": True}}
    scene = scenes.build(made)
    partition = partition_scene(scene, MPI.COMM_WORLD)
    box_surface.refuse_unguaranteed(scene, partition)
    with pytest.raises(ConfigurationError, match=r"about 0\.00064 GB on one rank, and 0\.0005 GB"):
        box_surface.refuse_unguaranteed(scene, partition, memory=5e5)


def test_the_messages_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = scenes.write(scenes.wall("quadrilateral", 8), tmp_path / "scene.yaml")
    arguments = ["run", path, "-o", tmp_path / "out", "--set"]
    assert contact_app(*arguments, "certificate.guaranteed=true") == 0
    accuracy = json.loads((tmp_path / "out" / "summary.json").read_text())["accuracy"]
    assert accuracy["total"] < accuracy["guaranteed"] < 2 * accuracy["total"]
    said = at_most(accuracy["guaranteed"])
    assert f"at most {said} in energy norm" in (tmp_path / "out" / "run.log").read_text()
    assert said in capsys.readouterr().out
    assert contact_app(*arguments, "certificate.guaranteed=false") == 0
    accuracy = json.loads((tmp_path / "out" / "summary.json").read_text())["accuracy"]
    assert "guaranteed" not in accuracy


def test_a_guarantee_that_is_missing_is_a_warning() -> None:
    summary = {"accuracy": {"total": 0.1}, "certificate": {"passed": True, "warnings": ["one"]}}
    expected = with_guarantee(summary, Guarantee(None, "a reason"))
    assert expected["accuracy"] == {"total": 0.1, "guaranteed": None}
    assert expected["certificate"]["warnings"] == ["one", "no error is guaranteed: a reason"]


@pytest.mark.parametrize("value", [0.05, 0.123401, 1.0, 3.3e-9, 0.0999999, 12.34567, 0.0])
def test_bounds_are_rounded_up(value: float) -> None:
    shown = float(at_most(value).split()[0]) / 100
    assert value * (1 - 1e-12) <= shown <= 1.011 * value
