"""Every scene in configs/ runs, is certified, and does what its comments say.

Boxes are coarsened to half the cells along each axis, so that each takes about a second.
"""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from contact_app.scene.configuration import load
from contact_app.scene.schema.bodies import RigidBody
from tests.contact_app.test_cli import contact_app

CONFIGS = sorted((Path(__file__).parents[3] / "configs").glob("*.yaml"))
BY_NAME = {config.stem: config for config in CONFIGS}


def coarser(config: Path) -> list[str]:
    """Overrides that halve the cells of each box, to no fewer than four."""
    words = []
    for i, body in enumerate(load(config).bodies):
        if isinstance(body, RigidBody) or body.mesh.box is None:
            continue
        cells = [max(min(n, 4), n // 2) for n in body.mesh.box.cells]
        words += ["--set", f"bodies.{i}.mesh.box.cells={cells}"]
    return words


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The results of a scene by its name; its run must end well."""

    @cache
    def results(name: str) -> Path:
        config, directory = BY_NAME[name], tmp_path_factory.mktemp(name)
        assert contact_app("run", config, "-o", directory, *coarser(config)) == 0
        return directory

    return results


@pytest.fixture
def summary_of(ran: Callable[[str], Path]) -> Callable[[str], dict[str, Any]]:
    return lambda name: json.loads((ran(name) / "summary.json").read_text())


def test_there_are_several() -> None:
    assert 6 <= len(CONFIGS) <= 42


@pytest.mark.parametrize("name", BY_NAME)
def test_runs_and_is_certified(
    name: str, ran: Callable[[str], Path], summary_of: Callable[[str], dict[str, Any]]
) -> None:
    summary = summary_of(name)
    cases = summary.get("cases", {"": summary})
    assert all(case["certificate"]["passed"] for case in cases.values())
    warnings = [w for case in cases.values() for w in case["certificate"]["warnings"]]
    coarse = (
        "varies within single facets",
        "varies as that of Hertz's contact with only about",
        "contact is narrower than a facet",
        "are stiff in bending; use degree: 2 or a finer mesh",
        "are round there and meet by flat facets",
        "halving this increment changes",
        "halving the increments of this step",
        "Tresca friction acts on",
        "with a coefficient of friction of 1 the answer need not be unique",
        "differ from these only in their numbers",
    )  # of half the cells, of a mesh that is shipped small, of few increments, of floors that rub
    assert [w for w in warnings if not any(words in w for words in coarse)] == []
    tied = "tied" in summary["decomposition"]
    assert tied or all(case["solution"]["active_contacts"] > 0 for case in cases.values())
    assert all((ran(name) / case / "solution.xdmf").exists() for case in cases)


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: c.stem)
def test_is_checked(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert contact_app("check", config) == 0
    assert "nothing was solved" in capsys.readouterr().out


@pytest.mark.parametrize("config", CONFIGS, ids=lambda c: c.stem)
def test_is_explained(config: Path) -> None:
    text = config.read_text()
    assert text.startswith("#")
    assert "# Units:" in text


# Contact forces that equilibrium alone decides (loads the obstacles must carry).
BALANCED = {"block_2d": [0, 2000], "plate_and_pins": [0, 24], "corner": [1000, 1500, 2000]}


@pytest.mark.parametrize("name", BALANCED)
def test_the_obstacles_carry_the_load(
    name: str, summary_of: Callable[[str], dict[str, Any]]
) -> None:
    force = summary_of(name)["solution"]["contact_force"]
    expected = BALANCED[name]
    assert force[: len(expected)] == pytest.approx(expected, rel=1e-4, abs=1e-2)


def test_the_patch_has_the_pressure_of_its_comment(
    summary_of: Callable[[str], dict[str, Any]],
) -> None:
    solution = summary_of("block_2d")["solution"]
    assert solution["max_contact_pressure"] == pytest.approx(100.0, rel=1e-5)


def test_both_shoes_carry_half_of_the_jack(summary_of: Callable[[str], dict[str, Any]]) -> None:
    forces = [contact["force"][2] for contact in summary_of("tied_beam")["contacts"]]
    assert forces[1:] == pytest.approx([-600.0, 1500.0, 1500.0], rel=1e-5)
