"""Programs on one rank or several, each in processes of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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
