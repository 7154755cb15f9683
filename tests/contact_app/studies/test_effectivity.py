"""The study of the error estimate: effectivity in range, and its own tools."""

from dataclasses import replace

import numpy as np
import pytest

from contact_app.studies import effectivity as study


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_a_function_keeps_its_energy_on_a_finer_mesh(cell: str) -> None:
    case = replace(study.CASES[0 if cell in ("hexahedron", "tetrahedron") else 2], cell=cell)
    coarse, fine = (study.estimated_answer(case, n) for n in (4, 8))
    assert fine.product(coarse.on(fine)) == pytest.approx(coarse.square, rel=1e-9)


def test_extrapolations_find_their_limits() -> None:
    assert study.aitken([1 + 0.5**k for k in (1, 2, 3)]) == pytest.approx(1.0)
    errors = [0.7**k for k in range(5)]
    differences = [float(np.sqrt(e**2 - errors[-1] ** 2)) for e in errors[:-1]]
    found, finest = study.errors_from_differences(differences)
    np.testing.assert_allclose(found, errors[:-1], rtol=1e-6)
    assert finest == pytest.approx(errors[-1], rel=1e-6)


@pytest.mark.parametrize("case", study.CASES, ids=lambda c: f"{c.scene}-{c.element}")
def test_effectivity_is_in_range(case: study.Case) -> None:
    """On coarser sweeps than the published ones, which `contact-app effectivity` has."""
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
