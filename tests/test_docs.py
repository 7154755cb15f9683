"""Paths, functions and links that the documentation names exist."""

import ast
import doctest
import importlib
import re
import sys
from pathlib import Path
from types import FrameType

import pytest
import typer

from contact_app.cli import app
from contact_app.run.run import run
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load

ROOT = Path(__file__).parents[1]

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), ROOT / "solver" / "README.md"]

NAMED_PLACES = ("solver", "meshes", "contact_app", "tests", "docs")

NAMED = re.compile(r"`((?:solver|meshes|contact_app|tests|configs|docs)/[\w/.]+\.\w+)(?::(\w+))?`")

TOUR = ("bodies.0.mesh.box.cells=[4,4,4]", "decomposition.subdomains=[2,2,2]")
"""A small mesh of the tour's scene."""

FILE = re.compile(r"`(\w+\.py)(?::(\w+))?`")
"""A file without its directory, and perhaps a name in it."""

COMMAND = re.compile(
    r"(?:(?:`|^ {4,})(?:contact-app|\./contact)|^\./contact) ([a-z]\w*)([^`\n]*)", re.MULTILINE
)
PROGRAM = re.compile(r"python -m ((?:contact_app|tests)(?:\.\w+)+)([^`\n]*)")
OPTION = re.compile(r"(?<!\S)(--[a-z][\w-]*)")

OF_LAUNCHER = ("test", "mpirun")
"""Commands that `./contact` has in addition to those of `contact-app`."""

LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


WITH_EXAMPLES = [
    str(path.relative_to(ROOT).with_suffix("")).replace("/", ".")
    for package in ("solver", "meshes", "contact_app")
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_of_docstrings_are_right(module: str) -> None:
    done = doctest.testmod(importlib.import_module(module))
    assert done.attempted > 0
    assert done.failed == 0


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_names_in_pages_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for path, name in NAMED.findall(text):
        file = ROOT / path
        assert file.is_file(), path
        if name:
            tree = ast.parse(file.read_text(encoding="utf-8"))
            defined = {
                node.name for node in ast.walk(tree)
                if isinstance(node, ast.FunctionDef | ast.ClassDef)
            }  # fmt: skip
            assert name in defined, f"{path}:{name}"
    for file, name in FILE.findall(text):
        found = [f for place in NAMED_PLACES for f in (ROOT / place).rglob(file)]
        assert found, file
        assert not name or any(f"{name}" in f.read_text(encoding="utf-8") for f in found), name
    for target in LINK.findall(text):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize(
    "page",
    [*PAGES, *sorted((ROOT / "configs").glob("*.yaml"))],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_modules_that_a_page_runs_are_programs(page: Path) -> None:
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    for module, rest in PROGRAM.findall(text):
        file = ROOT.joinpath(*module.split(".")).with_suffix(".py")
        assert file.is_file(), module
        assert "__main__" in file.read_text(encoding="utf-8"), module
        program = "".join(f.read_text(encoding="utf-8") for f in file.parent.glob("*.py"))
        for option in OPTION.findall(rest):
            assert f'"{option}"' in program or f"{option[2:]}=" in program, (module, option)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_that_a_page_names_have_its_options(page: Path) -> None:
    commands = typer.main.get_command(app)
    for name, rest in COMMAND.findall(page.read_text(encoding="utf-8").replace("\\\n", " ")):
        if name in OF_LAUNCHER:
            continue
        command = commands.commands[name]
        for word in rest.split()[:1]:
            command = getattr(command, "commands", {}).get(word, command)
        known = {option for parameter in command.params for option in parameter.opts}
        assert set(OPTION.findall(rest)) <= known, (name, rest)


def features() -> list[list[str]]:
    """Cells of the rows of the table of features."""
    lines = (ROOT / "docs/guide/features.md").read_text(encoding="utf-8").splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines if line.startswith("| ")]
    assert len(rows) > 25
    return rows[1:]


@pytest.mark.parametrize("row", features(), ids=lambda row: row[0])
def test_each_feature_has_a_test_a_scene_a_page_and_messages(row: list[str]) -> None:
    _, key, verified, where, page, wrong = row
    assert all(name for _, name in NAMED.findall(verified))
    assert "test_" in verified
    assert LINK.search(page)
    assert wrong == "nothing to set" or NAMED.search(wrong)
    ((file, _),) = NAMED.findall(where)
    word = key.strip("`")
    if file.startswith("configs/") and not word.startswith(("--set", "contact-app", "python")):
        text = (ROOT / file).read_text(encoding="utf-8")
        assert re.search(rf"\b{word}:", text.split("\n", 1)[1]), (file, word)


def test_a_run_takes_the_steps_of_the_tour_in_its_order(tmp_path: Path) -> None:
    """Functions called for the scene of the page, in eight subdomains, by their first call."""
    text = (ROOT / "docs/theory/tour.md").read_text(encoding="utf-8")
    steps = re.findall(r"^\| (\d+) \| (.*?) \|", text, re.M)
    assert [int(number) for number, _ in steps] == list(range(1, len(steps) + 1))
    named = [NAMED.search(where) for _, where in steps]
    places = [place.groups() for place in named if place]
    assert len(places) == len(steps) > 10
    met: dict[tuple[str, str], int] = {}

    def see(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(str(ROOT)):
            file = Path(code.co_filename).relative_to(ROOT).as_posix()
            met.setdefault((file, code.co_qualname.split(".")[0]), len(met))

    before = sys.getprofile()
    sys.setprofile(see)
    try:
        scene = build_scene(load(ROOT / "configs/cube.yaml", TOUR))
        assert run(scene, tmp_path) == 0
    finally:
        sys.setprofile(before)
    order = [met[place] for place in places]
    assert order == sorted(order)
