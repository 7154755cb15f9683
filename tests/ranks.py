"""Programs on one rank or several, each in processes of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests import scenes

ROOT = Path(__file__).resolve().parents[1]

ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}


def python(*arguments: str, ranks: int, limit: float) -> subprocess.CompletedProcess[str]:
    """`mpirun -n ranks python …` from the root of the project; one rank without mpirun.

    Parameters
    ----------
    limit
        Seconds after which the test fails.
    """
    command = [sys.executable, *arguments]
    if ranks > 1:
        command = ["mpirun", "--oversubscribe", "-n", str(ranks), *command]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=limit, cwd=ROOT,
        env={**os.environ, **ENVIRONMENT},
    )  # fmt: skip


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
