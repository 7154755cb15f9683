"""The study of the error estimate: effectivity in range, and its own tools."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from contact_app.studies import effectivity as study
from contact_app.studies.best_mesh import Mesh, graded_meshes, smallest


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_a_function_keeps_its_energy_on_a_finer_mesh(cell: str) -> None:
    case = replace(study.CASES[0 if cell in ("hexahedron", "tetrahedron") else 2], cell=cell)
    coarse, fine = (study.estimated_answer(case, n) for n in (4, 8))
    assert fine.product(coarse.on(fine)) == pytest.approx(coarse.square, rel=1e-9)


def test_the_smallest_mesh_that_meets_a_target() -> None:
    meshes = [Mesh("a", 10, 0.2, 0.3), Mesh("b", 20, 0.09, 0.15), Mesh("c", 30, 0.05, 0.09)]
    assert smallest(meshes, 0.1).name == "b"
    assert smallest(meshes, 0.1, by_estimate=True).name == "c"
    with pytest.raises(ValueError, match="empty"):
        smallest(meshes, 0.01)


def test_lines_laid_anew_leave_less_error() -> None:
    """Hertz on ten layers: the study's measure falls with the estimate as lines settle."""
    case = next(c for c in study.CASES if c.scene == "hertz" and c.targets)
    known = study.Sweep((), 0.0, 1.0)
    second = replace(case, degree=2)
    start, scene = (c.scene_of(n, "accuracy=0.1") for c, n in ((case, 8), (second, 10)))
    equal = study.measured(second, solve_scene(scene), known)
    meshes = graded_meshes(start, scene, 10, lambda s: study.measured(case, s, known))
    assert meshes[0].error < 0.7 * equal
    assert meshes[-1].error < 0.3 * equal
    assert all(0.9 < m.estimate / m.error < 2.0 for m in meshes)


def test_extrapolations_find_their_limits() -> None:
    assert study.aitken([1 + 0.5**k for k in (1, 2, 3)]) == pytest.approx(1.0)
    errors = [0.7**k for k in range(5)]
    differences = [float(np.sqrt(e**2 - errors[-1] ** 2)) for e in errors[:-1]]
    found, finest = study.errors_from_differences(differences)
    np.testing.assert_allclose(found, errors[:-1], rtol=1e-6)
    assert finest == pytest.approx(errors[-1], rel=1e-6)


@pytest.mark.parametrize("case", study.CASES, ids=lambda c: f"{c.scene}-{c.element}")
def test_effectivity_is_in_range(case: study.Case) -> None:
    """On coarser sweeps than the published ones, which the slow test below has."""
    meshes = (2, 4, 8, 16) if case.scene == "paper_cube" else (8, 16, 32, 64)
    if case.degree == 2:
        meshes = tuple(n // 2 for n in meshes)
    known = study.sweep(replace(case, meshes=meshes))
    sampled = case.cell in ("hexahedron", "quadrilateral") and not case.mean_dilatation
    for row in known.rows:
        known_well = row.reference_accuracy < 0.05 and row.dofs > 500  # Hertz: more than a node
        if sampled and known_well:
            assert 0.9 < row.effectivity < 1.4, row
        else:
            assert 0.8 < row.effectivity < 2.0, row


@pytest.mark.slow
def test_all_sweeps_and_targets(tmp_path: Path) -> None:
    lines = list(study.effectivity(tmp_path))
    assert any(line.startswith("| hertz | triangle | 64 |") for line in lines)
    with (tmp_path / "effectivity.csv").open() as file:
        for row in csv.DictReader(file):
            assert 0.8 < float(row["effectivity"]) < 3.0, row
    with (tmp_path / "targets.csv").open() as file:
        for row in csv.DictReader(file):
            assert not row["missed"]
            assert float(row["error"]) <= float(row["target"]), row
            assert float(row["dofs"]) <= 1.5 * float(row["knowable_dofs"]), row
            assert float(row["dofs"]) <= 1.5 * float(row["best_dofs"]), row
