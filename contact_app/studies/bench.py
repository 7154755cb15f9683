"""Ours and the peers on the paper's cube, side by side in one run: table, CSV and figure.

Every method runs in a process of its own, one after another. Seconds count from the mesh to the
certified solution, without start-up and without writing files.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from contact_app.studies.peers import METHODS

COLUMNS = ("method", "cells", "dofs", "seconds", "peak_rss_gb", "iterations", "energy",
           "penetration")  # fmt: skip
OURS = "contact-app"
SLOWEST_CELLS = {"linear-gamg": 60, "linear-cholmod": 40, "snes-vi": 40, "tao-bnls": 40}
"""Largest cube a method is run on: beyond it takes minutes or all memory."""


def bench(output: Path, cells: Sequence[int], tolerance: float = 1e-8) -> Iterator[dict[str, Any]]:
    """Run every method on every size, yield its row, write ``bench.csv`` and ``bench.png``."""
    output.mkdir(parents=True, exist_ok=True)
    rows = []
    for n in cells:
        runs: list[Callable[[], dict[str, Any]]] = [partial(_ours, n, tolerance)]
        runs += [partial(_peer, m, n) for m in METHODS if n <= SLOWEST_CELLS[m]]
        for one in runs:
            row = one()
            rows.append(row)
            yield row
    with (output / "bench.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    _draw(rows, output / "bench.png")


def _ours(cells: int, tolerance: float) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as directory:
        _python(
            "-m", "contact_app", "run", str(_config()), "-o", directory,
            "--set", f"bodies.0.mesh.box.cells=[{cells},{cells},{cells}]",
            "--set", "decomposition=auto",
            "--set", f"solver.tolerance={tolerance}",
            "--set", "output.xdmf=false",
        )  # fmt: skip
        summary = json.loads((Path(directory) / "summary.json").read_text(encoding="utf-8"))
    return {
        "method": OURS,
        "cells": cells,
        "dofs": summary["mesh"]["dofs"],
        "seconds": sum(
            summary["timings"][s] for s in ("setup", "assembly", "factorization", "solve")
        ),
        "peak_rss_gb": summary["environment"]["peak_rss_gb"],
        "iterations": summary["solver"]["hessian_multiplications"],
        "energy": summary["solution"]["energy"],
        "penetration": summary["certificate"]["max_penetration"],
    }


def _peer(method: str, cells: int) -> dict[str, Any]:
    return json.loads(_python("-m", "contact_app.studies.peers", method, str(cells)))


def _python(*arguments: str) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)} failed: {done.stderr.strip()[-500:]}")
    return done.stdout


def _config() -> Path:
    return Path(__file__).parents[1] / "data" / "paper_cube.yaml"


def _draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for method in (OURS, *METHODS):
        mine = [r for r in rows if r["method"] == method]
        if mine:
            axes.loglog(
                [r["dofs"] for r in mine],
                [r["seconds"] for r in mine],
                "o-" if method == OURS else "s--",
                label=method + (" (no contact)" if method.startswith("linear") else ""),
                linewidth=2.5 if method == OURS else 1.2,
            )
    axes.set_xlabel("degrees of freedom")
    axes.set_ylabel("seconds from mesh to solution")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)
