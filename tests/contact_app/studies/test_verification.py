"""The cases with known answers: small meshes here, the whole studies where it is slow."""

import math
from pathlib import Path

import pytest

from contact_app.errors import ConfigurationError
from contact_app.studies.hertz import Quantity
from contact_app.studies.verification import CASES, Level, Row, find, rate, study
from contact_app.studies.verification_report import verify


def errors(row: Row) -> list[float]:
    return [abs(quantity.error) for quantity in row.quantities]


def box(*cells: int) -> Level:
    return Level("box", (f"bodies.0.mesh.box.cells={list(cells)}",))


def test_the_confined_column_is_exact() -> None:
    (case,) = find(["confined_column"])
    for row in study(case, [box(1, 1, 2), box(2, 2, 4)]):
        assert row.certified
        assert max(errors(row)) < 1e-6, row
        assert row.quantities[0].theory == pytest.approx(1667.1, rel=1e-4)


def test_the_punch_comes_closer() -> None:
    (case,) = find(["flat_punch"])
    coarse, fine = study(case, [box(32, 32), box(96, 96)])
    assert errors(fine)[0] < errors(coarse)[0], (coarse, fine)
    assert errors(fine)[0] < 0.1
    assert fine.certified


@pytest.mark.parametrize(
    ("name", "level", "most"),
    [
        ("rough_rod", box(100, 1), (1e-3, 0.03)),  # the length that slips to a cell
        ("rod_cycle", box(50, 1), 2e-3),
        ("incline", box(4, 1), 2e-6),
        ("roller_with_friction", 1, 0.02),
        ("cattaneo", Level("20 cells over a", size=20), (0.03, 0.04, 0.05)),
        ("mindlin", Level("2 cells over a", size=2), (math.inf, 0.15, math.inf)),
        pytest.param("mindlin", 0, (math.inf, 0.04, 0.12), marks=pytest.mark.slow),
        *(
            pytest.param(name, -1, 0.02, marks=pytest.mark.slow)
            for name in ("hertz_sphere", "hertz_disc", "roller_on_block", "press_fit")
        ),
    ],
)
def test_quantities_are_those_of_theory(
    name: str, level: Level | int, most: float | tuple[float, ...]
) -> None:
    """On a mesh, or on one of the case; each quantity within its own limit or all within one."""
    (case,) = find([name])
    (row,) = study(case, [case.levels[level] if isinstance(level, int) else level])
    assert row.certified
    assert row.equilibrium < 1e-6
    assert row.dofs < 150_000
    limits = most if isinstance(most, tuple) else (most,) * len(row.quantities)
    assert all(error < limit for error, limit in zip(errors(row), limits, strict=True)), row


def test_a_plate_on_a_rough_plane_moves_as_published() -> None:
    """SSNV128: the published means, and Code_Aster's own values (modelling P) to 0.3 %."""
    (case,) = find(["plate_on_rough_plane"])
    (row,) = study(case, [box(32, 32)])
    assert row.certified
    assert max(errors(row)[:4]) < 5e-3, row
    assert errors(row)[4] < 0.03, row
    found = [quantity.computed for quantity in row.quantities]
    assert found == pytest.approx([28.5985, 27.2076, 22.8269, 19.7916, 15.4064], rel=3e-3)


def test_the_press_fit_on_the_shipped_mesh() -> None:
    (case,) = find(["press_fit"])
    (row,) = study(case, [Level("shipped")])
    assert row.quantities[0].theory == pytest.approx(403.85, rel=1e-5)
    assert errors(row)[0] < 0.01, row
    assert row.certified


def test_the_rate_of_a_study() -> None:
    def row(dofs: int, error: float) -> Row:
        quantity = Quantity("q", 1.0 + error, 1.0)
        return Row("case", "", 2, dofs, 0.0, 0.0, True, (quantity,))

    rows = [row(n * n, 3.0 / n**2) for n in (10, 20, 40)]
    assert rate(rows, 0) == pytest.approx(2.0)
    assert rate(rows[:1], 0) is None
    assert rate([*rows, row(6400, 1e-12)], 0) is None


def test_a_case_that_does_not_exist() -> None:
    with pytest.raises(ConfigurationError, match="no case 'hertz'; known are hertz_sphere, "):
        find(["hertz"])


@pytest.mark.slow
def test_the_document(tmp_path: Path) -> None:
    """Every case on every mesh is certified; the finest is within 2 %, the punch within 5 %."""
    list(verify([], tmp_path))
    text = (tmp_path / "verification.md").read_text()
    assert all(f"## {case.title}" in text for case in CASES)
    assert "| no |" not in text
    assert (tmp_path / "pictures" / "verification.png").stat().st_size > 10_000


def test_a_polygon_in_a_round_hole_touches_with_its_corners() -> None:
    """Its pressure is 110.4 in the mean, not the three times as much of forces over shares."""
    (case,) = find(["thick_ring_straight"])
    (row,) = study(case, case.levels[:1])
    mean = next(q for q in row.quantities if q.name == "mean pressure")
    assert mean.computed == pytest.approx(110.41, rel=1e-3)
