"""One run of a study: this application or a method of PETSc on a scene, and its row."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from contact_app.studies.peers import METHODS
from contact_app.studies.processes import RunError, parallel_ranks, python

STAGES = ("setup", "assembly", "factorization", "solve")
"""Stages in the reported seconds: from the mesh to the certified solution, without output."""


def run_one(
    method: str,
    scene: Path,
    overrides: Sequence[str],
    tolerance: float | str,
    limit: float | None = None,
    fields: Path | None = None,
    parallel: bool = False,
) -> dict[str, Any]:
    """Solve a scene in a process of its own: dofs, seconds, memory, operator applications, energy.

    Parameters
    ----------
    method
        One of `peers.METHODS`; any other name is this application.
    overrides
        ``key=value`` each, for the scene.
    limit
        Seconds, start-up included.
    fields
        A ``.npz`` file for the fields at the nodes.
    parallel
        Whether this application gets one rank per core instead of threads of BLAS. Methods of PETSc
        have their own rule.

    Raises
    ------
    RunError
        The run failed, did not converge, was not certified or ran out of time.
    """
    peer = METHODS.get(method)
    words = ["--set", f"solver.tolerance={tolerance}"]
    if peer is not None:
        parallel, words = peer.parallel, ["--method", method, "--tolerance", str(tolerance)]
    words += ["--fields", str(fields)] if fields else []
    row = printed_row(scene, overrides, *words, parallel=parallel, limit=limit)
    if peer is None:
        return from_summary(row)
    if not row["converged"]:
        raise RunError("it did not converge")
    return {**row, "subdomains": 1}


def printed_row(
    scene: Path, overrides: Sequence[str], *words: str, parallel: bool, limit: float | None = None
) -> dict[str, Any]:
    """The row that `single_run` prints in a process of its own, given the words of its command."""
    settings = [part for override in overrides for part in ("--set", override)]
    return python(
        "-m", "contact_app.studies.single_run", str(scene), *settings, *words,
        limit=limit, ranks=parallel_ranks() if parallel else 1,
    )  # fmt: skip


def from_summary(summary: dict[str, Any]) -> dict[str, Any]:
    """Row of a ``summary.json``."""
    if not summary["certificate"]["passed"]:
        raise RunError("it was not certified")
    seconds = sum(summary["timings"][stage] for stage in STAGES)
    levels = summary.get("levels")
    return {
        "dofs": summary["mesh"]["dofs"],
        "seconds": sum(level["seconds"] for level in levels) if levels else seconds,
        # the summary holds the largest of one rank
        "peak_rss_gb": summary["environment"]["peak_rss_gb"] * summary["environment"]["ranks"],
        "steps": summary["solver"]["outer_iterations"],
        "applications": summary["solver"]["hessian_multiplications"],
        "energy": summary["solution"]["energy"],
        "penetration": summary["certificate"]["max_penetration"],
        "subdomains": summary["decomposition"]["subdomains"],
        "ranks": summary["environment"]["ranks"],
    }
