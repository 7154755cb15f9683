"""Paths, functions and links that the documentation names exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), ROOT / "solver" / "README.md"]

NAMED = re.compile(r"`((?:solver|meshes|contact_app|tests|configs|docs)/[\w/.]+\.\w+)(?::(\w+))?`")

LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_names_exists(page: Path) -> None:
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
    for target in LINK.findall(text):
        if "://" not in target:
            assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_modules_that_a_page_runs_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for module in re.findall(r"python -m ((?:contact_app|tests)[\w.]+)", text):
        assert ROOT.joinpath(*module.split(".")).with_suffix(".py").is_file(), module


def test_the_tour_has_a_function_at_each_step() -> None:
    steps = re.findall(r"^\| (\d+) \| (.*?) \|", (ROOT / "docs/theory/tour.md").read_text(), re.M)
    assert [int(number) for number, _ in steps] == list(range(1, len(steps) + 1))
    assert all(NAMED.search(where) for _, where in steps)
