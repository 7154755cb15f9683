"""run.log, summary.json and the table at the end of a run."""

import copy
import io
import json
import logging
import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from contact_app.errors import ConfigurationError
from contact_app.results.report import (
    cases_table,
    print_steps,
    print_summary,
    run_log,
    write_summary,
)
from contact_app.results.report_rows import contact_force

SUMMARY = {
    "scene": {"title": "a cube [bold] beside a wall", "dimension": 3},
    "mesh": {"cells": 8000, "nodes": 9261, "dofs": 27783},
    "decomposition": {"subdomains": 8, "contact": 441},
    "solver": {
        "converged": True,
        "reason": "accepted",
        "outer_iterations": 4,
        "hessian_multiplications": 1234,
    },
    "solution": {
        "energy": -1.0,
        "max_displacement": 2.5e-3,
        "active_contacts": 300,
        "contact_force": [-12.5, 0.0, 1e-3],
        "max_contact_pressure": 99.5,
    },
    "certificate": {
        "max_penetration": 1e-8,
        "max_gluing_jump": 2e-7,
        "min_multiplier": 0.0,
        "complementarity": 3e-5,
        "equilibrium": 4e-12,
        "duality_gap": 5e-9,
        "passed": False,
        "warnings": ["strains reach 0.3 [really]"],
    },
    "accuracy": {"discretisation": 0.0502, "algebraic": 1.9e-6, "total": 0.0502},
    "timings": {"solve": 1.5, "total": 4.0},
    "environment": {"blas": "OpenBLAS", "ranks": 2, "peak_rss_gb": 0.5},
}


def printed(summary: dict, **options: object) -> list[str]:
    text = io.StringIO()
    print_summary(summary, console=Console(file=text, width=100), **options)
    return [line.rstrip() for line in text.getvalue().splitlines()]


def line_with(lines: list[str], start: str) -> str:
    (line,) = [line for line in lines if line.startswith(start)]
    return line


def test_the_table_has_the_main_results(tmp_path: Path) -> None:
    lines = printed(SUMMARY, tolerance=1e-6, files=[tmp_path / "solution.xdmf"])
    assert lines[0].strip() == "a cube [bold] beside a wall"
    assert line_with(lines, "degrees of freedom").endswith("27,783")
    assert line_with(lines, "Hessian multiplications").endswith("1,234")
    assert line_with(lines, "largest displacement").endswith("0.0025")
    assert line_with(lines, "nodes in contact").endswith("300 of 441")
    assert line_with(lines, "contact force").endswith("(-12.5, 0, 0.001)")
    assert line_with(lines, "time").endswith("4.0 s, 1.5 s of it solving")
    assert line_with(lines, "memory").endswith("0.50 GB on a rank")
    assert "warning: strains reach 0.3 [really]" in lines
    assert lines[-1] == f"wrote {tmp_path / 'solution.xdmf'}"
    assert not any(line.startswith("not converged") for line in lines)


def test_each_line_of_the_certificate_has_its_verdict() -> None:
    lines = printed(SUMMARY, tolerance=1e-6)
    assert line_with(lines, "penetration").split()[-2:] == ["1e-08", "passed"]
    assert line_with(lines, "complementarity").endswith("failed")
    assert line_with(lines, "certificate").endswith("failed")
    good = copy.deepcopy(SUMMARY)
    good["certificate"].update(complementarity=1e-7, passed=True)
    assert not any("failed" in line for line in printed(good, tolerance=1e-6))


def contact(number: int) -> dict:
    return {
        "on": f"cube.face{number}",
        "with": "plane",
        "force": [float(number), 0.0, -2.5],
        "max_pressure": 0.25 + number,
    }


def test_each_of_several_contacts_has_a_line() -> None:
    one = printed({**SUMMARY, "contacts": [contact(3)]})
    assert line_with(one, "contact force").endswith("(3, 0, -2.5)")
    assert len(one) == len(printed(SUMMARY))
    two = printed({**SUMMARY, "contacts": [contact(0), contact(1)]})
    line = line_with(two, "  cube.face1 on plane")
    assert line.split("plane")[1].strip() == "(1, 0, -2.5), 1.25"
    assert len(two) == len(printed(SUMMARY)) + 3
    many = printed({**SUMMARY, "contacts": [contact(i) for i in range(20)]})
    assert len(many) == len(printed(SUMMARY)) + 14
    assert line_with(many, "  and 8 more")
    assert not any("face12" in line for line in many)


def test_a_reaction_of_rounding_errors_is_zero() -> None:
    summary = {**SUMMARY, "contacts": [contact(3)],
               "reactions": [{"on": "cube.x-", "force": [0.0, -4.2e-12, 0.0]}]}  # fmt: skip
    assert line_with(printed(summary), "  cube.x-").endswith("(0, 0, 0)")


def test_the_sum_over_obstacles_is_not_shown_where_bodies_touch_each_other_alone() -> None:
    pair = {**contact(1), "with": "other.top"}
    assert line_with(printed({**SUMMARY, "contacts": [pair]}), "contact force").endswith("-2.5)")
    lines = printed({**SUMMARY, "contacts": [pair, pair | {"on": "cube.face2"}]})
    assert not any(line.startswith("contact force") for line in lines)
    assert line_with(lines, "  cube.face2 on other.top")


def test_reactions_sections_and_probes_have_lines() -> None:
    lines = printed(
        {
            **SUMMARY,
            "reactions": [
                {"on": "cube.z-", "force": [1.0, 2.0, 3.0]},
                {"on": "cube.x-", "force": [1e-12, 2.0, -3e-10]},
            ],
            "sections": {"neck": {"force": [4.0, 5.0, 6.0], "moment": [7.0, 8.0, 9.0]}},
            "probes": {"tip": {"displacement": [0.5, 0.25]}},
        }
    )
    assert line_with(lines, "  cube.z-").split("z-")[1].strip() == "(1, 2, 3)"
    assert line_with(lines, "  cube.x-").split("x-")[1].strip() == "(0, 2, 0)"
    assert line_with(lines, "  neck").split("neck")[1].strip() == "(4, 5, 6), (7, 8, 9)"
    assert line_with(lines, "  tip").split("tip")[1].strip() == "(0.5, 0.25)"
    assert len(lines) == len(printed(SUMMARY)) + 7
    flat = {"neck": {"force": [4.0, 5.0, 0.0], "moment": 7.5}}
    assert line_with(printed({**SUMMARY, "sections": flat}), "  neck").endswith("(4, 5, 0), 7.5")


def test_missing_values_are_not_shown_as_numbers() -> None:
    summary = copy.deepcopy(SUMMARY)
    summary["certificate"]["duality_gap"] = None
    summary["solver"].update(converged=False, reason="the limit was reached")
    summary["decomposition"]["contact"] = 0
    lines = printed(summary, tolerance=1e-6)
    assert "unknown" in line_with(lines, "duality gap")
    assert line_with(lines, "duality gap").endswith("failed")
    assert "not converged: the limit was reached" in lines
    assert not any(line.startswith("contact force") for line in lines)


def test_summary_json_is_valid_for_any_numbers(tmp_path: Path) -> None:
    path = tmp_path / "new" / "summary.json"
    summary = {
        "nan": float("nan"),
        "list": [np.float64(1.5), math.inf, (1, np.int64(2))],
        "array": np.array([[1.0, np.nan]]),
        "flag": np.bool_(True),
        "text": "σ",
        "path": Path("a/b"),
    }
    write_summary(path, summary)

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    assert json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse) == {
        "nan": None,
        "list": [1.5, None, [1, 2]],
        "array": [[1.0, None]],
        "flag": True,
        "text": "σ",
        "path": "a/b",
    }
    assert [p.name for p in path.parent.iterdir()] == ["summary.json"]


def test_a_summary_that_cannot_be_written_leaves_the_older_one(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_summary(path, {"run": 1})
    with pytest.raises(TypeError):
        write_summary(path, {"run": object()})
    assert json.loads(path.read_text()) == {"run": 1}


def test_the_log_keeps_messages_and_warnings(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    path = tmp_path / "new" / "run.log"
    with run_log(path) as log:
        log.info("assembling %d subdomains", 8)
        log.warning("slow BLAS")
        log.debug("not this")
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("from a library", UserWarning, stacklevel=1)
        logging.getLogger().setLevel(logging.INFO)
        logging.info("running build_ext")
        logging.getLogger("library").warning("of a library")
    log.info("after the end")
    assert capfd.readouterr().err == ""
    text = path.read_text(encoding="utf-8")
    assert "INFO    assembling 8 subdomains" in text
    assert "WARNING slow BLAS" in text
    assert "UserWarning: from a library" in text
    assert "of a library" in text
    assert "not this" not in text
    assert "build_ext" not in text
    assert "after the end" not in text


def test_the_log_has_the_error_that_ended_the_run(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    with pytest.raises(ConfigurationError), run_log(path):
        raise ConfigurationError("cube.yaml:3: no mesh")
    text = path.read_text()
    assert "ERROR   cube.yaml:3: no mesh" in text
    assert "Traceback" not in text
    with pytest.raises(KeyboardInterrupt), run_log(path):
        raise KeyboardInterrupt
    assert "Traceback" in path.read_text()


def test_other_ranks_write_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with run_log(None) as log:
        log.warning("nowhere")
    assert list(tmp_path.iterdir()) == []


def test_the_force_of_a_case_is_that_of_its_contact() -> None:
    """Two bodies press each other and no obstacle: the table shows their force, not zero."""
    pair = {"on": "a.z+", "with": "b.z-", "force": [0.0, 0.0, -36.0]}
    case = {"solution": {"contact_force": [0.0, 0.0, 0.0]}, "contacts": [pair]}
    assert contact_force(case) == "(0, 0, -36)"
    both = {"solution": {"contact_force": [1.0, 0.0, 2.0]}, "contacts": [pair, pair]}
    assert contact_force(both) == "(1, 0, 2)"
    ring = {**pair, "force": [1e-12, 0.0, 3e-13], "max_pressure": 8.0, "area": 5.0}
    assert contact_force({**case, "contacts": [ring]}) == "(0, 0, 0)"


def test_the_table_of_cases_has_the_force_of_each_contact() -> None:
    contacts = [
        {"on": "eye.bore", "with": "pin.skin", "force": [0.0, 0.0, -900.0], "max_pressure": 7.5},
        {"on": "fork.bore", "with": "pin.skin", "force": [0.0, 0.0, 900.0], "max_pressure": 6.5},
    ]
    case = {**SUMMARY, "solution": {**SUMMARY["solution"], "max_von_mises": 3.0}}
    cases = {"one": {**case, "contacts": contacts[:1]}, "two": {**case, "contacts": contacts}}
    text = io.StringIO()
    table = cases_table({"scene": SUMMARY["scene"], "cases": cases})
    Console(file=text, width=120).print(table)
    rows = [line.rstrip() for line in text.getvalue().splitlines()][2:]
    assert rows[0].startswith("one")
    assert "(0, 0, -900)" in rows[0]
    assert rows[1].startswith("two")
    assert "(" not in rows[1]
    for row, contact in zip(rows[2:], contacts, strict=True):
        assert row.startswith(f"  {contact['on']} on pin.skin")
        assert f"{contact['max_pressure']}" in row
        assert f"(0, 0, {contact['force'][2]:g})" in row


def test_a_narrow_terminal_cuts_no_number_of_the_table_of_increments(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    pair = {"on": "a.z+", "with": "b.z-", "force": [-1234.5, 2345.6, -36.125], "nodes": {"slip": 3}}
    record = {
        "step": 1, "factor": 0.3333, "contacts": [pair],
        "solution": {"max_displacement": 0.12345, "dissipated_work": 12.345},
        "certificate": {"passed": True},
    }  # fmt: skip
    summary = {**SUMMARY, "solver": {**SUMMARY["solver"], "tolerance": 1e-6}, "steps": [record]}
    print_steps(summary)
    lines = capsys.readouterr().out.splitlines()
    assert line_with(lines, "1 ").split()[:6] == [
        "1",
        "0.3333",
        "0.1235",
        "(-1234,",
        "2346,",
        "-36.12)",
    ]
    assert not any("…" in line for line in lines[:2])
