"""Files that appear whole or not at all, and a directory that is cleared of older results."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from contact_app.errors import CouldNotRunError
from contact_app.machine import disk
from contact_app.machine.atomic_file import atomic, part_of
from contact_app.results.xdmf import XDMFWriter, grid_bytes
from contact_app.run.result_directory import RESULTS, clear, remove_parts
from tests.ranks import ROOT


def test_a_file_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    with atomic(path) as part:
        part.write_text("first")
        assert not path.exists()
    assert path.read_text() == "first"
    with pytest.raises(KeyboardInterrupt), atomic(path) as part:
        part.write_text("half of the sec")
        raise KeyboardInterrupt
    assert path.read_text() == "first"
    assert list(tmp_path.iterdir()) == [path]


def test_only_own_files_are_removed(tmp_path: Path) -> None:
    checkpoint = ("checkpoint.json", "checkpoint-3.vectors")
    parts = [part_of(tmp_path / name).name for name in RESULTS]
    for name in (*RESULTS, *parts, *checkpoint, "notes.txt", "my.part", "summary.json.bak"):
        (tmp_path / name).write_text("")
    (tmp_path / "older").mkdir()
    clear(tmp_path, resume=True)
    mine = {"notes.txt", "my.part", "summary.json.bak", "older"}
    assert {p.name for p in tmp_path.iterdir()} == {*mine, *checkpoint, "history.csv"}
    clear(tmp_path, resume=False)
    assert {p.name for p in tmp_path.iterdir()} == mine
    (tmp_path / "history.csv").write_text("of a run without a checkpoint")
    clear(tmp_path, resume=True)
    assert {p.name for p in tmp_path.iterdir()} == mine


def test_a_directory_is_made(tmp_path: Path) -> None:
    clear(tmp_path / "a" / "b", resume=False)
    remove_parts(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()


def test_missing_room_is_reported_before_the_first_file(tmp_path: Path) -> None:
    disk.refuse_without_room(tmp_path, "solution.h5", 1000)
    with pytest.raises(CouldNotRunError, match=r"solution\.h5 needs 1e\+03 TB, .* are free"):
        disk.refuse_without_room(tmp_path, "solution.h5", 10**15)


@pytest.mark.parametrize("unsupported", [False, True])
def test_a_reservation_is_an_error_where_there_is_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unsupported: bool
) -> None:
    if unsupported:

        def refuse(*_: int) -> None:
            raise OSError(disk.UNSUPPORTED[0], "not here")

        monkeypatch.setattr(os, "posix_fallocate", refuse)
    with (tmp_path / "file").open("wb") as file:
        disk.reserve(file.fileno(), 5000)
        with pytest.raises(CouldNotRunError, match="the disk is full"):
            disk.reserve_for(tmp_path / "file", file.fileno(), 10**15)


LIMITED = """
import os, resource, sys
from pathlib import Path
import numpy as np
from contact_app.errors import CouldNotRunError
from contact_app.results.xdmf import XDMFWriter
def write(path, limit):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        fields = {f"field {number}": 3 for number in range(3)}
        with XDMFWriter(path, [("triangle", 800)], 900, fields, {}) as file:
            file.points(0, np.random.rand(900, 3))
            file.cells(0, np.zeros((800, 3), int))
            for name in fields:
                file.point_data(name, 0, np.random.rand(900, 3))
    except CouldNotRunError as error:
        return 4 if "solution.h5 needs" in str(error) else 1
    return 0
for limit in map(int, sys.argv[2:]):
    child = os.fork()
    if child == 0:
        os._exit(write(Path(sys.argv[1]) / str(limit) / "solution.xdmf", limit))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_hdf5_is_never_without_room(tmp_path: Path) -> None:
    """Whatever limit the file meets, it ends with a message, or whole: HDF5 would crash."""
    limits = [str(n) for n in (0, 1_000, 40_000, 66_000, 90_000, 120_000, 150_000, 170_000)]
    for limit in limits:
        (tmp_path / limit).mkdir()
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path), *limits],
        capture_output=True, text=True, cwd=ROOT, timeout=60,
    )  # fmt: skip
    codes = [int(word) for word in done.stdout.split()]
    assert set(codes) == {0, 4}, done.stderr
    for limit, code in zip(limits, codes, strict=True):
        names = sorted(file.name for file in (tmp_path / limit).iterdir())
        assert names == ([] if code else ["solution.h5", "solution.xdmf"])
    assert codes[0] == 4
    assert codes[-1] == 0


def test_the_size_of_a_grid_is_known_beforehand(tmp_path: Path) -> None:
    n, m = 3000, 2000
    runs, path = [("quadrilateral", m)], tmp_path / "solution.xdmf"
    with XDMFWriter(path, runs, n, {"u": 3}, {"s": 9}) as file:
        file.points(0, np.zeros((n, 3)))
        file.cells(0, np.zeros((m, 4), int))
        file.point_data("u", 0, np.zeros((n, 3)))
        file.cell_data("s", 0, np.zeros((m, 6)))
    size = (tmp_path / "solution.h5").stat().st_size
    expected = grid_bytes(n, m, 4, at_nodes=3, at_cells=9)
    assert size <= expected <= size + 80_000
