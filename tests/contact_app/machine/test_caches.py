"""A directory for compiled forms that is this user's alone."""

import os
from pathlib import Path

import pytest
from mpi4py import MPI

from contact_app.machine import caches
from contact_app.run.attended import attended


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        monkeypatch.setenv(name, "set, so that it is set back")
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(caches.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(caches.tempfile, "tempdir", str(tmp_path))
    caches.usable_caches.cache_clear()
    caches.own_directory.cache_clear()
    yield
    caches.usable_caches.cache_clear()
    caches.own_directory.cache_clear()


def test_a_home_that_can_be_written_is_used(tmp_path: Path) -> None:
    assert caches.usable_caches() == ()
    assert "XDG_CACHE_HOME" not in os.environ
    assert not list(tmp_path.glob("contact-app-*"))


def test_without_a_cache_one_of_this_user_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/dev/null")
    (first, second) = caches.usable_caches()
    own = tmp_path / f"contact-app-{os.geteuid()}"
    assert first == f"/dev/null/.cache cannot be written: compiled forms are kept in {own}"
    assert second.startswith("/dev/null/.config cannot be read")
    assert os.environ["XDG_CACHE_HOME"] == str(own)
    assert own.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("how", ["open to others", "a link"])
def test_a_directory_that_someone_else_may_have_filled_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    own = tmp_path / f"contact-app-{os.geteuid()}"
    if how == "a link":
        (tmp_path / "theirs").mkdir(mode=0o700)
        own.symlink_to(tmp_path / "theirs")
    else:
        own.mkdir()
        own.chmod(0o777)
    caches.usable_caches()
    used = Path(os.environ["XDG_CACHE_HOME"])
    assert used != own
    assert used.parent == tmp_path
    assert used.stat().st_mode & 0o777 == 0o700


def test_the_log_of_cases_and_steps_reports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null")
    with attended(tmp_path / "out", MPI.COMM_SELF, False, 30.0):
        pass
    assert "/dev/null cannot be written" in (tmp_path / "out" / "run.log").read_text()
