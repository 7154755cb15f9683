"""``bench parts``: the command on a small part, its rows, its meshes and what it refuses."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from contact_app.cli import app
from contact_app.studies import parts, parts_meshes
from contact_app.studies.parts_meshes import Meshes
from contact_app.studies.processes import RunError
from contact_app.studies.tables import read

PILLOW_BLOCK = parts.CONFIGS / "pillow_block.yaml"
SAMPLES = parts_meshes.SCRIPT.parent


@pytest.fixture
def one_core() -> Iterator[None]:
    """Runs have one rank."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    yield
    os.sched_setaffinity(0, cores)


@pytest.mark.slow
def test_the_command_measures_a_part_and_writes_table_and_figure(
    one_core: None, tmp_path: Path
) -> None:
    methods = "linear-gamg,primal"
    asked = ["pillow_block", "--meshes", str(SAMPLES), "--methods", methods, "-o", str(tmp_path)]
    done = CliRunner().invoke(app, ["bench", "parts", *asked])
    assert done.exit_code == 0, done.output
    rows = {row["method"]: row for row in read(tmp_path / "parts.csv", parts.TEXTS)}
    assert list(rows) == methods.split(",")
    assert all(row["converged"] and not row["note"] for row in rows.values())
    assert len({row["unknowns"] for row in rows.values()}) == 1
    assert all(row["ranks"] == 1 and row["meshes"] == str(SAMPLES) for row in rows.values())
    assert rows["primal"]["energy"] < rows["linear-gamg"]["energy"]  # glued, it is held more
    assert (tmp_path / "parts.png").stat().st_size > 10_000
    assert done.output.splitlines()[:4] == (tmp_path / "parts.md").read_text().splitlines()


def measured(seconds: float) -> parts.Row:
    """The result of a run."""
    numbers = dict.fromkeys(("read", "assembly", "solve", "cpu", "memory", "energy"), 1.0)
    return {**numbers, "seconds": seconds, "unknowns": 3, "iterations": 1, "ranks": 1,
            "converged": True}  # fmt: skip


def test_a_method_without_an_answer_is_left_out_on_finer_meshes(tmp_path: Path) -> None:
    def run(_path, method, overrides, _settings):
        if method == "tao-bnls" and "middle" in overrides[1]:
            raise RunError("some.module.UnsuitableError: it has 2 bodies")
        converged = method != "snes-vi"
        return {**measured(2.0), "used": method, "converged": converged}

    meshes = [Meshes(name, Path(name)) for name in ("coarse", "middle", "fine")]
    methods = ("linear-gamg", "tao-bnls", "snes-vi")
    list(parts.bench(tmp_path, [PILLOW_BLOCK], meshes, methods, run=run))
    rows = read(tmp_path / "parts.csv", parts.TEXTS)
    notes = {name: [row["note"] for row in rows if row["method"] == name] for name in methods}
    left_out = "left out after a coarser mesh"
    assert notes["linear-gamg"] == ["", "", ""]
    assert notes["tao-bnls"] == ["", "it has 2 bodies", left_out]
    assert notes["snes-vi"] == ["did not converge", left_out, left_out]


def test_rows_of_an_earlier_run_stay_until_they_are_measured_again(tmp_path: Path) -> None:
    shipped = [parts_meshes.SHIPPED]
    for methods, seconds in ((("linear-gamg", "primal"), 2.0), (("primal",), 3.0)):

        def run(_path, method, *_, seconds=seconds):
            return {**measured(seconds), "used": method}

        last = list(parts.bench(tmp_path, [PILLOW_BLOCK], shipped, methods, run=run))[-1]
    rows = {row["method"]: row["seconds"] for row in read(tmp_path / "parts.csv", parts.TEXTS)}
    assert rows == {"linear-gamg": 2.0, "primal": 3.0}
    assert last.split("|")[8].strip() == "1.50"  # beside the linear solve of the first run


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["parts", "pillow_blok"], "'pillow_blok' is no scene file and none of the parts"),
        (["parts", "--methods", "gamg"], "--methods names 'gamg'; known are primal"),
        (["parts", "--meshes", "nowhere"], "--meshes nowhere: there is no such directory"),
        (["parts", "--meshes", ".", "--sizes", "1"], "give one of them"),
        (["parts", str(parts.CONFIGS / "bracket.yaml"), "--sizes", "1"], "need --meshes"),
        (["--limit", "3", "parts"], "--limit stands before `parts`"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(asked: list[str], message: str) -> None:
    done = CliRunner().invoke(app, ["bench", *asked])
    assert done.exit_code == 2
    assert message in done.output


@pytest.mark.skipif(parts_meshes.can_draw(), reason="Gmsh is there")
def test_sizes_need_gmsh() -> None:
    done = CliRunner().invoke(app, ["bench", "parts", "--sizes", "0.5"])
    assert done.exit_code == 2
    assert "install gmsh" in done.output


@pytest.mark.skipif(not parts_meshes.can_draw(), reason="Gmsh draws the meshes")
def test_sizes_draw_meshes(tmp_path: Path) -> None:
    meshes = parts_meshes.drawn(1.5, tmp_path)
    assert meshes.of(PILLOW_BLOCK) == tmp_path / "1.5"
    drawn, shipped = tmp_path / "1.5" / "pillow_block.msh", SAMPLES / "pillow_block.msh"
    assert drawn.stat().st_size < shipped.stat().st_size
