"""Scenes solved on one rank or several by the command line."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

from tests import scenes
from tests.ranks import python


def run_scene(path: Path, directory: Path, ranks: int) -> subprocess.CompletedProcess[str]:
    """`contact-app run`."""
    return python(
        "-m", "contact_app", "run", str(path), "-o", str(directory), ranks=ranks, limit=180
    )


def summary_of(made: scenes.Config, directory: Path, ranks: int) -> dict[str, Any]:
    """What a scene's `summary.json` holds; it is in `out1`, `out2` … of the directory."""
    path = scenes.write(made, directory / "scene.yaml")
    out = directory / f"out{ranks}"
    done = run_scene(path, out, ranks)
    assert done.returncode == 0, done.stdout + done.stderr
    summary: dict[str, Any] = json.loads((out / "summary.json").read_text())
    return summary
