"""The run of the paper in small."""

import json
from pathlib import Path

import pytest
from mpi4py import MPI

from contact_app.studies.cube import cube_scene
from contact_app.studies.paper_run import Settings, paper_run


@pytest.mark.ratchet
def test_the_papers_run_in_small(tmp_path: Path) -> None:
    """Both rules end at one energy, certified; the second run of a directory starts anew."""
    scene = cube_scene(9, 3)
    lines = list(paper_run(tmp_path, scene, (Settings.paper, Settings.default), MPI.COMM_SELF))
    assert [line.split(":")[0] for line in lines[::2]] == ["paper", "ours"]
    summaries = [
        json.loads((tmp_path / name / "summary.json").read_text()) for name in ("paper", "ours")
    ]
    for summary, name in zip(summaries, ("paper", "ours"), strict=True):
        assert summary["certificate"]["passed"]
        left = {p.name for p in (tmp_path / name).iterdir()}
        assert {"history.csv", "summary.json"} <= left
        assert not any(file.startswith("checkpoint") for file in left)
    paper, default = (s["solution"] for s in summaries)
    assert default["energy"] == pytest.approx(paper["energy"], rel=1e-6)
    assert default["active_contacts"] == paper["active_contacts"] > 0
    fewer, more = (s["solver"]["hessian_multiplications"] for s in reversed(summaries))
    assert fewer < 0.6 * more
