"""The benchmark's methods solve one problem."""

from __future__ import annotations

from pathlib import Path

import pytest

from contact_app.studies import peers
from contact_app.studies.bench import bench


def test_contact_peers_and_ours_agree_and_files_are_written(tmp_path: Path) -> None:
    rows = {row["method"]: row for row in bench(tmp_path, [4])}
    assert set(rows) == {"contact-app", *peers.METHODS}
    energy = rows["contact-app"]["energy"]
    for method in ("snes-vi", "tao-bnls"):
        assert rows[method]["energy"] == pytest.approx(energy, rel=1e-7)
        assert rows[method]["penetration"] < 1e-8
    for method in ("linear-gamg", "linear-cholmod"):
        assert rows[method]["energy"] < energy
        assert rows[method]["penetration"] > 1e-3
    assert (tmp_path / "bench.csv").read_text().count("\n") == 6
    assert (tmp_path / "bench.png").stat().st_size > 0
