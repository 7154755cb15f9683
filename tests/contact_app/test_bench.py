"""The benchmark's methods solve one problem, each in a process of its own."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from contact_app.studies import bench, processes
from contact_app.studies.bench import CONTACT, LINEAR, OURS


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, dict]]:
    output = tmp_path_factory.mktemp("bench")
    found: dict[str, dict[str, dict]] = {}
    for row in bench.bench(output, [4], [3], limit=60.0):
        found.setdefault(row["series"], {})[row["method"]] = row
    with (output / "bench.csv").open() as file:
        assert len(list(csv.DictReader(file))) == sum(len(f) for f in found.values())
    assert (output / "bench.png").stat().st_size > 10_000
    return found


@pytest.mark.slow
@pytest.mark.parametrize("series", ["hexahedra", "tetrahedra"])
def test_all_methods_reach_one_energy(rows: dict, series: str) -> None:
    found = rows[series]
    assert set(found) == {OURS, *CONTACT, *LINEAR}
    assert not any(row["note"] for row in found.values())
    energy = found[OURS]["energy"]
    for method in CONTACT:
        assert found[method]["energy"] == pytest.approx(energy, rel=1e-8)
        assert found[method]["penetration"] < 1e-8
    for method in LINEAR:
        assert found[method]["energy"] == pytest.approx(found["linear-cholmod"]["energy"], rel=1e-9)
        assert found[method]["energy"] < energy * 1.005
        assert found[method]["penetration"] > 1e-3
    assert found["one-factor"]["subdomains"] == 1
    assert found[OURS]["subdomains"] >= (1 if series == "hexahedra" else 2)
    assert max(row["energy_error"] for row in found.values()) < 1e-8


def test_a_method_that_takes_too_long_is_left_out_from_then_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def run(method, series, n, dofs, tolerance, limit):
        asked.append((method, n))
        if method == "tao-bnls" and n > 4:
            raise processes.RunError("not done after 1 s")
        return {"energy": -1.0, "seconds": 1.0, "peak_rss_gb": 1.0}

    monkeypatch.setattr(bench, "_run", run)
    found = list(bench.bench(tmp_path, [4, 6, 8], [], methods=[OURS, "tao-bnls"]))
    notes = [row["note"] for row in found if row["method"] == "tao-bnls"]
    assert notes == ["", "not done after 1 s", "left out after a smaller mesh"]
    assert ("tao-bnls", 8) not in asked
    assert (OURS, 8) in asked
    assert bench.line(found[-1]).endswith("left out after a smaller mesh")

    def faster(*_):
        return {"energy": -1.0, "seconds": 0.5, "peak_rss_gb": 1.0}

    monkeypatch.setattr(bench, "_run", faster)
    list(bench.bench(tmp_path, [6], [], methods=["tao-bnls"]))
    rows = {(row["cells"], row["method"]): row for row in bench.read(tmp_path / "bench.csv")}
    assert len(rows) == 6
    assert rows[6, "tao-bnls"]["seconds"] == 0.5
    assert rows[6, "tao-bnls"]["energy_error"] == 0.0
    assert rows[6, OURS]["seconds"] == 1.0
    table = (tmp_path / "bench.md").read_text()
    assert "| 1,029 | 1 s, 1 GB | 0.5 s, 1 GB |" in table
    assert "| 2,187 | 1 s, 1 GB | left out after a smaller mesh |" in table


def test_a_process_out_of_time_or_in_error_says_so() -> None:
    with pytest.raises(processes.RunError, match=r"not done after 0\.5 s"):
        processes.python("-c", "import time; time.sleep(30)", limit=0.5)
    with pytest.raises(processes.RunError, match="ValueError: of this"):
        processes.python("-c", "raise ValueError('of this')")
    with pytest.raises(processes.RunError, match="no result"):
        processes.python("-c", "print('text')")
    assert processes.python("-c", "print(1); print('{\"a\": 2}')") == {"a": 2}


def test_energies_are_compared_within_their_family() -> None:
    rows = [
        {"method": OURS, "energy": -1.0, "note": ""},
        {"method": "snes-vi", "energy": -1.1, "note": ""},
        {"method": "linear-gamg", "energy": -3.0, "note": ""},
        {"method": "linear-cholmod", "note": "out of time"},
    ]
    ours, snes, gamg, cholmod = bench.with_energy_error(rows)
    assert ours["energy_error"] == pytest.approx(1 - 1.0 / 1.1)
    assert snes["energy_error"] == 0.0
    assert gamg["energy_error"] == 0.0
    assert "energy_error" not in cholmod
