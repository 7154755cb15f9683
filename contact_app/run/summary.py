"""The summary of a solved scene, the content of `summary.json`."""

from dataclasses import replace
from typing import Any

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.environment import environment
from contact_app.results.summary import summary_of


def summary_of_scene(solved: SolvedScene) -> dict[str, Any]:
    """`summary.json` of a solved scene (collective)."""
    peaks = [None if coarse is None else coarse.peak for coarse in solved.coarse_pressures]
    return {
        **summary_of(solved.model, solved.solution, solved.nodes, peaks),
        "accuracy": solved.accuracy.as_dict(),
        "timings": solved.timings.as_dict(),
        "environment": environment(solved.model.comm),
    }


def warned(solved: SolvedScene, texts: list[str]) -> SolvedScene:
    """The answer with more warnings, in its summary, too; this is made once."""
    summary = solved.summary or summary_of_scene(solved)
    certificate = solved.solution.certificate
    certificate = replace(certificate, warnings=(*certificate.warnings, *texts))
    of_summary = {**summary["certificate"], "warnings": list(certificate.warnings)}
    solution = replace(solved.solution, certificate=certificate)
    return replace(solved, solution=solution, summary={**summary, "certificate": of_summary})
