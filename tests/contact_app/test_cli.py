"""The command line: exit codes, messages, and what a run leaves."""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from contact_app.cli import main
from tests import scenes

ROOT = Path(__file__).parents[2]
FILES = {"solution.xdmf", "solution.h5", "summary.json", "history.csv", "run.log"}


def contact_app(*arguments: str | Path) -> int:
    """Exit code of `contact-app`, run in this process."""
    before = sys.argv
    sys.argv = ["contact-app", *map(str, arguments)]
    try:
        main()
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = before
    return 0


@pytest.fixture
def cube(tmp_path: Path) -> Path:
    return scenes.write(scenes.wall("hexahedron", 3), tmp_path / "cube.yaml")


def test_a_run_leaves_its_files_and_exits_with_0(cube: Path, tmp_path: Path) -> None:
    assert contact_app("run", cube, "-o", tmp_path / "out") == 0
    assert {p.name for p in (tmp_path / "out").iterdir()} == FILES
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["certificate"]["passed"]
    assert summary["mesh"]["nodes"] == 64


def test_set_changes_the_scene(cube: Path, tmp_path: Path) -> None:
    changes = ["--set", "bodies.0.mesh.box.cells=[2,2,2]", "--set", "output.xdmf=false"]
    assert contact_app("run", cube, "-o", tmp_path / "out", *changes) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["mesh"]["cells"] == 8
    assert not (tmp_path / "out" / "solution.xdmf").exists()


def test_results_go_to_a_directory_of_the_scene_s_name(
    cube: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert contact_app("run", cube) == 0
    assert (tmp_path / "results" / "cube" / "summary.json").exists()


@pytest.mark.parametrize("subdomains", ["1", "[2, 1, 1]"])
def test_no_convergence_exits_with_1_and_leaves_everything(
    cube: Path, tmp_path: Path, subdomains: str
) -> None:
    changes = ["solver.max_iterations=3", f"decomposition.subdomains={subdomains}"]
    sets = [word for change in changes for word in ("--set", change)]
    assert contact_app("run", cube, "-o", tmp_path / "out", *sets) == 1
    assert {p.name for p in (tmp_path / "out").iterdir()} == FILES
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert not summary["certificate"]["passed"]
    assert not summary["solver"]["converged"]
    assert summary["solver"]["reason"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("bodis=1", "bodis is an unknown key; did you mean bodies?"),
        (
            "contacts.0.obstacle={sphere: {center: [1, 0, 0], radius: 0.1}}",
            "contacts[0].obstacle: a contact node lies on the centre of the sphere",
        ),
        ("bodies.0.boundaries.nose.where=x > 5", None),
        (
            "conditions.1={on: block.nose, pressure: 1}",
            "conditions[1].on: no whole facet of the surface of block lies on nose",
        ),
        (
            "contacts.0.on=block.nose",
            "contacts[0].on: no node of the surface of block lies on nose",
        ),
    ],
)
@pytest.mark.parametrize("command", ["run", "check"])
def test_bad_input_exits_with_2(
    cube: Path, tmp_path: Path, command: str, change: str, message: str | None,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    where = ["-o", str(tmp_path / "out")] if command == "run" else []
    nose = "bodies.0.boundaries.nose.where=x > 5"
    code = contact_app(command, cube, *where, "--set", nose, "--set", change)
    err = capsys.readouterr().err
    if message is None:
        assert code == 0
    else:
        assert code == 2
        assert message in err
        assert "Traceback" not in err


@pytest.mark.parametrize("command", ["run", "check"])
def test_no_equilibrium_exits_with_3(
    cube: Path, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["-o", str(tmp_path / "out")] if command == "run" else []
    only_load = "conditions=[{on: block.z+, traction: [0, 0, 1]}]"
    assert contact_app(command, cube, *where, "--set", only_load) == 3
    err = capsys.readouterr().err
    assert "nothing stops block from leaving along +z" in err
    assert "Traceback" not in err


@pytest.mark.parametrize("command", ["run", "check"])
def test_contradictory_conditions_exit_with_2(
    cube: Path, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["-o", str(tmp_path / "out")] if command == "run" else []
    again = "conditions.2={on: block.z-, displacement: [0.1, null, null]}"
    assert contact_app(command, cube, *where, "--set", again) == 2
    assert "conditions[0] and conditions[2] hold one node of block" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["run"],
        ["walk"],
        ["run", "none.yaml"],
        ["run", "none.yaml", "--nope"],
        ["run", "."],
        ["run", "a.yaml", "b.yaml"],
        ["check"],
        ["check", "none.yaml"],
        ["plot", ".", "--scale", "nan"],
        ["plot", ".", "--camera", "1", "inf", "0"],
    ],
    ids=" ".join,
)
def test_wrong_usage_exits_with_2(
    arguments: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert contact_app(*arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_directory_that_cannot_be_written(cube: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert contact_app("run", cube, "-o", cube) == 2
    assert "results cannot be written there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (OSError(28, "No space left on device"), "No space left on device"),
        (MemoryError(), "not enough memory"),
    ],
)
def test_missing_parts_of_the_machine_are_reported(
    cube: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: BaseException, message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def fail(*_: object, **__: object) -> int:
        raise fault

    monkeypatch.setattr("contact_app.run.run.run", fail)
    assert contact_app("run", cube, "-o", tmp_path / "out") == 4
    err = capsys.readouterr().err
    assert message in err
    assert "Traceback" not in err


def test_common_errors_of_ranks_are_printed_once_and_others_by_each_rank(
    cube: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    waits: list[float] = []
    monkeypatch.setattr("contact_app.machine.exits.time.sleep", waits.append)
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "1")
    assert contact_app("run", cube, "--set", "bodis=1") == 2
    assert capsys.readouterr().err == ""
    assert len(waits) == 1  # rank 0 is given the time to speak

    def fail(*_: object, **__: object) -> int:
        raise MemoryError

    monkeypatch.setattr("contact_app.run.run.run", fail)
    assert contact_app("run", cube, "-o", tmp_path / "out") == 4
    assert capsys.readouterr().err.startswith("rank 1: the run ended: not enough memory")


def test_control_characters_are_not_sent_to_a_terminal(
    cube: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cube.write_text('"\\x1b[31mred": 1\n')
    assert contact_app("run", cube) == 2
    err = capsys.readouterr().err
    assert "\x1b" not in err
    assert "\\x1b[31mred is an unknown key" in err


def test_schema_is_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert contact_app("schema") == 0
    schema = json.loads(capsys.readouterr().out)
    assert "bodies" in schema["required"]
    assert "in" in schema["$defs"]["Condition"]["properties"]


def test_as_a_module_from_outside() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "contact_app", "run", "none.yaml"],
        capture_output=True, text=True, timeout=60, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.strip() == "none.yaml: there is no such file"


def test_a_closed_pipe_causes_no_errors_of_petsc(tmp_path: Path) -> None:
    """`contact-app check scene.yaml | head -1`"""
    path = scenes.write(scenes.wall("quadrilateral", 2), tmp_path / "scene.yaml")
    command = [sys.executable, "-u", "-m", "contact_app", "check", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        said = process.stderr.read().decode()
    assert "PETSC" not in said
    assert "MPI_ABORT" not in said


def test_logs_of_compilers_do_not_reach_the_terminal() -> None:
    program = (
        "import logging, sys\n"
        "from contact_app import cli\n"
        "@cli.app.command()\n"
        "def compiling() -> None:\n"
        "    logging.getLogger().setLevel(logging.INFO)\n"
        "    logging.info('cc -O2'), logging.warning('cc is old')\n"
        "sys.argv = ['contact-app', 'compiling']\n"
        "cli.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout + done.stderr == "cc is old\n"
