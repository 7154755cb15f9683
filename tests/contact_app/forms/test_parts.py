"""The parts that forms are integrated over."""

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.forms.parts import parts_of
from tests import form_problems as problems


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_vertices_carry_linear_functions_to_all_nodes(cell: str) -> None:
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    mesh = problems.box(cell, (3, 2, 2)[:d], (1.0, 0.8, 0.6)[:d], MPI.COMM_SELF)
    parts = parts_of(problems.vector_space(mesh, 2))
    weights = parts.vertex_weights(0)
    assert weights is not None
    np.testing.assert_allclose(weights @ parts.points, parts.points, atol=1e-14)
    vertices = weights.diagonal() > 0.5
    assert vertices.sum() == np.prod((4, 3, 3)[:d])
    assert np.diff(weights[vertices].indptr).tolist() == [1] * int(vertices.sum())
    assert np.diff(weights[~vertices].indptr).min() == 2
    assert parts_of(problems.vector_space(mesh, 1)).vertex_weights(0) is None


@pytest.mark.ratchet
def test_multigrid_of_degree_2_goes_by_the_vertices() -> None:
    """Smoothed aggregation on degree 2 itself takes 55 applications here, by the vertices 43."""
    forms = problems.block("tetrahedron", 2, cells=10, layers=10)
    problem = forms.problem(method="primal", tolerance=1e-6)
    problem.solve()
    assert problem.certificate.passed
    assert problem.summary["solver"]["hessian_multiplications"] <= 48
