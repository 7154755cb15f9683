"""Scenes solved on one rank or several."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests import scenes
from tests.ranks import execute, python

RUN = """
import sys
from pathlib import Path
from contact_app.run.run import run
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load

assert run(build_scene(load(Path(sys.argv[1]))), Path(sys.argv[2])) == 0, "not certified"
"""


def run_scene(path: Path, directory: Path, ranks: int) -> subprocess.CompletedProcess[str]:
    """`contact-app run`, where exit code and messages are the question."""
    return python(
        "-m", "contact_app", "run", str(path), "-o", str(directory), ranks=ranks, limit=180
    )


def summary_of(made: scenes.Config, directory: Path, ranks: int) -> dict[str, Any]:
    """The `summary.json` of a scene, which is in `out1`, `out2` … of the directory."""
    path = scenes.write(made, directory / "scene.yaml")
    out = directory / f"out{ranks}"
    execute(RUN, str(path), str(out), ranks=ranks)
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary


def one_and_two(
    made: scenes.Config, directory: Path, subdomains: int | None = None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The summaries of a scene, in so many subdomains, on one rank and on two."""
    if subdomains is not None:
        made = {**made, "decomposition": {"subdomains": subdomains}}
    one, two = (summary_of(made, directory, ranks) for ranks in (1, 2))
    assert two["environment"]["ranks"] == 2
    return one, two


def same_solution(one: dict[str, Any], two: dict[str, Any], part: float) -> None:
    """Hold the numbers of two answers against each other, to a part of each."""
    for key, value in one["solution"].items():
        if key != "pair_forces":
            assert two["solution"][key] == pytest.approx(value, rel=part, abs=1e-8), key
