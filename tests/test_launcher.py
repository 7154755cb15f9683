"""The launcher, on copies whose system and environment are pretended: nothing gets installed."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
ECHO = '#!/bin/sh\nfor word; do echo "<$word>"; done\n'
DEBIAN = Path("/etc/os-release").is_file() and "ID=debian" in Path("/etc/os-release").read_text()


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with the launcher and an environment that is said to be complete."""
    home = tmp_path / "a folder"
    home.mkdir()
    for name in ("contact", "pyproject.toml"):
        shutil.copy(REPOSITORY / name, home)
    program(home / ".venv/bin/contact-app", ECHO)
    program(home / ".venv/bin/python", ECHO)
    key = subprocess.run(
        ["cksum", home / "pyproject.toml", home / "contact"], capture_output=True, check=True
    ).stdout
    for stamp in ("ready", "ready-test"):
        (home / ".venv" / stamp).write_bytes(key)
    return home


def start(place: Path, *words: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [place / "contact", *words],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        cwd=place.parent,
        timeout=60,
        check=False,
    )


def pretend(place: Path, **programs: str) -> str:
    """PATH on which some programs are others: the value to give it."""
    for name, text in programs.items():
        program(place / "bin" / name, f"#!/bin/sh\n{text}\n")
    return f"{place / 'bin'}:{os.environ['PATH']}"


def test_when_nothing_is_missing_it_hands_over_without_output(place: Path) -> None:
    done = start(place, "run", "two words.yaml", "--set", "title=a 'b' $c *")
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout.splitlines() == [
        "<run>",
        "<two words.yaml>",
        "<--set>",
        "<title=a 'b' $c *>",
    ]


def test_it_hands_over_the_exit_code(place: Path) -> None:
    program(place / ".venv/bin/contact-app", "#!/bin/sh\nexit 3\n")
    assert start(place, "run").returncode == 3


def test_it_works_through_a_link_from_elsewhere(place: Path) -> None:
    link = place.parent / "link"
    link.symlink_to(place / "contact")
    done = subprocess.run([link, "schema"], capture_output=True, text=True, check=True)
    assert done.stdout == "<schema>\n"


def test_tests_are_handed_to_pytest(place: Path) -> None:
    done = start(place, "test", "--slow", "-k", "a or b")
    words = ["-m", "pytest", "-n", "auto", "--dist", "loadfile", "--slow", "-k", "a or b"]
    assert done.stdout.splitlines() == [f"<{word}>" for word in words]


def test_ranks_and_threads_fill_the_cores_and_no_more(place: Path) -> None:
    path = pretend(place, mpirun=f"echo threads $OPENBLAS_NUM_THREADS; {ECHO}", nproc="echo 8")
    done = start(place, "mpirun", "-n", "3", "run", "cube.yaml", PATH=path, OPENBLAS_NUM_THREADS="")
    lines = done.stdout.splitlines()
    assert lines[0] == "threads 2"
    assert lines[-4:] == ["<3>", f"<{place}/.venv/bin/contact-app>", "<run>", "<cube.yaml>"]


@pytest.mark.parametrize("words", [["run", "x"], ["-n"], ["-n", "0", "run"], ["-n", "2x", "run"]])
def test_ranks_must_be_a_number(place: Path, words: list[str]) -> None:
    done = start(place, "mpirun", *words)
    assert done.returncode == 1
    assert "usage: ./contact mpirun -n RANKS" in done.stderr


def test_modules_of_another_python_are_ignored(place: Path) -> None:
    program(place / ".venv/bin/contact-app", '#!/bin/sh\necho "${PYTHONPATH-none}"\n')
    assert start(place, PYTHONPATH="/elsewhere").stdout == "none\n"


@pytest.mark.skipif(not DEBIAN, reason="the launcher installs on Debian only")
@pytest.mark.parametrize("change", ["pyproject.toml", "stamp", "packages"])
def test_changed_data_are_read_again(place: Path, change: str) -> None:
    """Packages are missing, the user is not root, and sudo refuses: so it must say."""
    if change == "pyproject.toml":
        (place / change).write_text("[project]\n")
    elif change == "stamp":
        (place / ".venv/ready").unlink()
    else:
        os.utime(place / ".venv/ready", (0, 0))  # older than the state of dpkg
    path = pretend(
        place,
        **{"dpkg-query": "printf 'installed=gcc '", "apt-get": "exit 99", "dpkg": "exit 99"},
        id="echo 1000",
        sudo="exit 1",
    )
    done = start(place, "run", PATH=path)
    assert done.returncode == 1
    assert done.stdout == ""
    assert "sudo was refused, and Debian packages are missing: python3-dolfinx-real" in done.stderr
    assert " gcc" not in done.stderr


@pytest.mark.skipif(not DEBIAN, reason="the launcher installs on Debian only")
def test_when_apt_fails_its_output_is_shown_and_nothing_is_stamped(place: Path) -> None:
    (place / ".venv/ready").unlink()
    failing = {
        "dpkg-query": "exit 1",
        "apt-get": "echo 'E: Unable to fetch some archives'; exit 100",
        "dpkg": "exit 0",
    }
    done = start(place, "run", PATH=pretend(place, **failing, id="echo 0"))
    assert done.returncode == 1
    assert "    E: Unable to fetch some archives" in done.stderr
    assert "apt-get could not install: python3-dolfinx-real" in done.stderr
    assert not (place / ".venv/ready").exists()


def test_the_shell_of_debian_reads_it() -> None:
    shell = shutil.which("dash") or "sh"
    for script in ("contact", ".ci/run", ".ci/chroot"):
        done = subprocess.run([shell, "-n", REPOSITORY / script], capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
