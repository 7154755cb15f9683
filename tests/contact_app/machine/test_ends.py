"""How a run ends: its exit code, its message, and what stands in the directory."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests import scenes
from tests.contact_app.test_cli import contact_app
from tests.ranks import ENVIRONMENT, ROOT

FINAL = {"solution.xdmf", "solution.h5", "summary.json"}
LOGS = {"history.csv", "run.log"}

FAULT = """
import os, sys
where, rank, kind, *sys.argv[1:] = sys.argv[1:]
import contact_app.run.files, contact_app.run.run, contact_app.run.solve
def fail(*_, **__):
    raise {"disk": OSError(28, "No space left on device"), "memory": MemoryError(),
           "bug": TypeError("a mistake")}[kind]
if int(os.environ.get("OMPI_COMM_WORLD_RANK", 0)) == int(rank):
    for module in (contact_app.run.files, contact_app.run.run, contact_app.run.solve):
        if hasattr(module, where):
            setattr(module, where, fail)
from contact_app.cli import main
main()
"""
"""``contact-app`` with a function of a run that fails on one rank."""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    made = scenes.wall("quadrilateral", 4)
    made["decomposition"] = {"subdomains": [2, 2]}
    return scenes.write(made, tmp_path / "scene.yaml")


def start(
    *words: str | Path, ranks: int = 1, shell: str = "", python: str = "", **environment: str
) -> subprocess.CompletedProcess[str]:
    """`contact-app` in a process of its own.

    Parameters
    ----------
    shell
        What stands behind the command: redirections.
    python
        A program in place of ``-m contact_app``.
    """
    program = ["-c", python] if python else ["-m", "contact_app"]
    command = [sys.executable, *program, *map(str, words)]
    if ranks > 1:
        command = ["mpirun", "--oversubscribe", "-n", str(ranks), *command]
    if shell:
        command = ["bash", "-c", f'"$@" {shell}', "-", *command]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=120, cwd=ROOT,
        env={**os.environ, **ENVIRONMENT, **environment},
    )  # fmt: skip


def left(directory: Path) -> set[str]:
    return {file.name for file in directory.iterdir()}


def test_an_older_result_does_not_outlive_a_run_without_one(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    leaves = "conditions.1={on: block.y+, traction: [0, 5]}"
    nothing_held = ["--set", leaves, "--set", "conditions.0={on: block.y+, pressure: -1}"]
    cases: list[tuple[list[str], int, set[str]]] = [
        ([], 0, FINAL | LOGS),
        (nothing_held, 3, LOGS),
        ([], 0, FINAL | LOGS),
        (["--set", "bodis=1"], 2, FINAL | LOGS | {"mine.txt", "bodies.png"}),  # no run began
        (["--set", "solver.max_iterations=2", "--set", "output.xdmf=false"], 1,
         LOGS | {"summary.json"}),
    ]  # fmt: skip
    for words, code, files in cases:
        assert contact_app("run", scene, "-o", out, *words) == code
        assert left(out) - {"mine.txt"} == files - {"mine.txt"}
        (out / "mine.txt").write_text("not the program's")
        if FINAL <= left(out):
            (out / "bodies.png").write_text("of the older result")
            (out / ".solution.h5.part").write_text("of a run that was killed")
            if code == 0:
                (out / ".solution.h5.part").unlink()
    assert (out / "mine.txt").exists()


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("where", "rank", "kind", "expected"),
    [
        ("cell_fields", 1, "disk", "rank 1: the run ended: No space left on device; make room"),
        pytest.param("cell_fields", 0, "memory", "not enough memory", marks=pytest.mark.slow),
        ("build_model", 1, "bug", "rank 1: the run ended by an internal error of the program"),
        ("write_fields", 0, "disk", "No space left on device"),
    ],
)
def test_a_fault_on_one_rank_ends_all(
    scene: Path, tmp_path: Path, where: str, rank: int, kind: str, expected: str
) -> None:
    out = tmp_path / "out"
    words = (where, str(rank), kind, "run", scene, "-o", out)
    done = start(*words, ranks=2, python=FAULT)
    assert done.returncode == 4, done.stderr
    assert expected in done.stderr
    assert "Traceback" not in done.stderr
    assert left(out) == LOGS
    in_log = (out / "run.log").read_text()
    assert ("Traceback" in in_log and "TypeError: a mistake" in in_log) is (kind == "bug")
    assert ("(TypeError: a mistake); the traceback is in" in done.stderr) is (kind == "bug")


@pytest.mark.parametrize(
    "shell",
    [
        ">&-",
        "<&- >&- 2>&-",
        "2>/dev/full",
        *(pytest.param(s, marks=pytest.mark.slow) for s in ("2>&-", ">&- 2>&-", ">/dev/full")),
    ],
)
def test_a_closed_or_full_stream_is_no_reason_to_lose_the_result(
    scene: Path, tmp_path: Path, shell: str
) -> None:
    out = tmp_path / "out"
    done = start("run", scene, "-o", out, shell=shell)
    assert done.returncode == 0, done.stderr
    assert left(out) == FINAL | LOGS
    assert "Traceback" not in done.stderr
    assert "iteration" not in (out / "run.log").read_text().split("INFO", 1)[0]


def test_a_closed_pipe_does_not_change_the_exit_code(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = start("run", scene, "-o", out, shell="| head -1; exit ${PIPESTATUS[0]}")
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert "rror" not in done.stderr
    assert done.stdout.count("\n") == 1


def test_output_lost_on_standard_output_is_an_error() -> None:
    done = start("schema", shell=">/dev/full")
    assert done.returncode == 4
    assert done.stderr.startswith("the run ended: standard output: No space left on device")


def test_a_terminal_of_ascii_gets_ascii_characters(scene: Path, tmp_path: Path) -> None:
    ascii_only = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "TERM": "dumb"}
    said = []
    for words in (["run", scene, "-o", tmp_path / "out"], ["check", scene], ["run", "--help"]):
        done = start(*words, **ascii_only)
        assert done.returncode == 0, done.stderr
        assert (done.stdout + done.stderr).isascii()
        said.append(done.stdout)
    assert "complementarity / (load ? displacement)" in said[0]


@pytest.mark.parametrize(
    "environment",
    [
        pytest.param({"HOME": "/dev/null", "XDG_CACHE_HOME": ""}, marks=pytest.mark.slow),
        pytest.param({"XDG_CACHE_HOME": "/proc/nope"}, marks=pytest.mark.slow),
        {"XDG_CONFIG_HOME": "/dev/null"},
    ],
    ids=lambda e: " ".join(e),
)
def test_without_a_home_it_runs_and_names_the_directory_of_forms(
    scene: Path, tmp_path: Path, environment: dict[str, str]
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    out = tmp_path / "out"
    done = start("run", scene, "-o", out, TMPDIR=str(temporary), **environment)
    assert done.returncode == 0, done.stderr
    (own,) = temporary.glob("contact-app-*")
    assert own.stat().st_mode & 0o777 == 0o700
    assert str(own) in (out / "run.log").read_text() or "options" in (out / "run.log").read_text()
    if "CONFIG" not in "".join(environment):
        assert list((own / "fenics").glob("*.so"))
    plotted = start("plot", out, TMPDIR=str(temporary), **environment)
    assert plotted.returncode == 0, plotted.stderr
    assert "Matplotlib" not in plotted.stderr


@pytest.mark.parametrize("directory", ["/proc/nope", "/dev/null/nope"])
def test_a_directory_that_cannot_be_made_ends_with_4(
    scene: Path, directory: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert contact_app("run", scene, "-o", directory) == 4
    expected = capsys.readouterr().err
    assert f"--output {directory}: results cannot be written there" in expected


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 256 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(place)]
    if os.geteuid() or not shutil.which("mount") or subprocess.run(command, check=False).returncode:
        pytest.skip("no file system can be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("words", [[], ["--set", "output.xdmf=false"]], ids=["xdmf", "json"])
def test_a_full_disk_ends_with_4_and_reports_the_needed_room(
    scene: Path, small_disk: Path, words: list[str]
) -> None:
    free = 60 if not words else 4
    (small_disk / "fill").write_bytes(bytes((256 - free) * 1024))
    done = start("run", scene, "-o", small_disk / "out", *words)
    said = done.stderr.splitlines()
    assert done.returncode == 4, done.stderr
    assert "Traceback" not in done.stderr
    assert any("No space left" in line or "the disk is full" in line for line in said)
    if not words:
        assert "solution.h5 needs" in done.stderr
        assert "are free" in done.stderr
    assert left(small_disk / "out") <= LOGS


def test_a_disk_that_fills_up_in_a_load_history_leaves_a_checkpoint(
    tmp_path: Path, small_disk: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Another program takes the room after two of four increments."""
    made = scenes.wall("quadrilateral", 2)
    made["conditions"][1]["name"] = "load"
    made["steps"] = [{"load": 1, "increments": 4}]
    made["output"] = {"xdmf": False}
    scene, out, fill = scenes.write(made, tmp_path / "s.yaml"), small_disk / "out", small_disk / "f"
    program = (
        "from contact_app.run.steps import _Files\n"
        "add = _Files.add\n"
        "def fill(self, increment):\n"
        "    if len(self.records) == 2:\n"
        f"        with open({str(fill)!r}, 'wb', 0) as file:\n"
        "            while file.write(bytes(4096)) == 4096: pass\n"
        "    add(self, increment)\n"
        "_Files.add = fill\n"
        "from contact_app.cli import main\n"
        "main()\n"
    )
    done = start("run", scene, "-o", out, python=program)
    assert done.returncode == 4, done.stderr
    assert "No space left" in done.stderr
    assert "--resume goes on from the checkpoint" in done.stderr
    fill.unlink()
    assert contact_app("run", scene, "-o", out, "--resume") == 0
    assert "going on after step 1, factor 0.5" in capfd.readouterr().err


def test_a_file_system_that_cannot_be_written_ends_with_4(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "readonly"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(place)]
    if os.geteuid() or not shutil.which("mount") or subprocess.run(command, check=False).returncode:
        pytest.skip("no file system can be mounted here")
    try:
        assert contact_app("run", scene, "-o", place / "out") == 4
        assert "Read-only file system" in capsys.readouterr().err
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_leaves_results_and_a_checkpoint_to_resume(
    scene: Path, tmp_path: Path, number: int, capfd: pytest.CaptureFixture[str]
) -> None:
    """The signal comes at the fourth step, on the first active set."""
    out = tmp_path / "out"
    program = (
        "import os, itertools\n"
        "from solver.contact.checkpoint import Attention\n"
        "steps, before = itertools.count(1), Attention.__call__\n"
        "def call(self, event):\n"
        f"    if next(steps) == 4: os.kill(os.getpid(), {int(number)})\n"
        "    return before(self, event)\n"
        "Attention.__call__ = call\n"
        "from contact_app.cli import main\n"
        "main()\n"
    )
    done = start("run", scene, "-o", out, python=program)
    assert done.returncode == 1, done.stderr
    assert left(out) == FINAL | LOGS | {"checkpoint.json", "checkpoint-1.vectors"}
    assert "--resume goes on from here" in (out / "run.log").read_text()
    assert contact_app("run", scene, "-o", out, "--resume") == 0
    assert "going on from" in capfd.readouterr().err
    assert left(out) == FINAL | LOGS


def test_interrupted_before_there_is_a_result_it_is_not_a_1(scene: Path, tmp_path: Path) -> None:
    program = (
        "import contact_app.run.solve\n"
        "def fail(*_, **__): raise KeyboardInterrupt\n"
        "contact_app.run.solve.build_model = fail\n"
        "from contact_app.cli import main\n"
        "main()\n"
    )
    done = start("run", scene, "-o", tmp_path / "out", python=program)
    assert done.returncode == 130
    assert "Traceback" not in done.stderr


def test_a_remark_on_fifty_blocks_is_made_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    n = 50
    blocks: list[dict[str, Any]] = [
        scenes.block("quadrilateral", 1, f"b{i}", (0.0, 0.0, float(i)), (1.0, 1.0, i + 1.0))
        for i in range(n)
    ]
    made = scenes.config(
        "quadrilateral",
        blocks,
        [{"on": "b0.y-", "displacement": [0, 0]}, {"on": f"b{n - 1}.y+", "traction": [0, -1]}],
        [{"on": f"b{i + 1}.y-", "against": f"b{i}.y+"} for i in range(n - 1)],
    )
    out = tmp_path / "out"
    assert contact_app("run", scenes.write(made, tmp_path / "tower.yaml"), "-o", out) == 0
    lines = capsys.readouterr().out.splitlines()
    (expected,) = [line for line in lines if "can move freely" in line]
    assert expected.startswith("warning: b1 can move freely")
    assert "(and 48 more alike: b2, b3, b4, b5, b6, … b49)" in expected
    log = (out / "run.log").read_text()
    assert log.count("WARNING") == sum("warning:" in line for line in lines)
