"""B applied node by node where it can be, beside the same rows entry by entry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI
from scipy import sparse

from contact_app.model.model import build_model
from solver.contact.row_kinds import RowKind
from solver.tfeti.constraints.matrix import ConstraintMatrix, RowWeights
from solver.tfeti.constraints.nodal import NodalProduct, nodal_rows
from tests import scenes
from tests.ranks import execute

CASES = {
    "cube": ("wall", "hexahedron", [2, 2, 2]),
    "plane": ("two_bodies", "quadrilateral", [2, 2]),
    "tetrahedra": ("wall", "tetrahedron", 5),
    "bodies that hang in springs": ("rollers_and_floor", "quadrilateral", 3),
}


@st.composite
def kronecker(draw: st.DrawFn) -> tuple[sparse.csr_matrix, int]:
    """A ⊗ I with no empty row, and the components of a node."""
    components, rows, columns = (draw(st.integers(low, 4)) for low in (2, 0, 1))
    rng = np.random.default_rng(draw(st.integers(0, 1000)))
    nodes = rng.integers(-2, 3, (rows, columns)) * 0.5
    nodes[np.arange(rows), rng.integers(columns, size=rows)] = 1.0
    return sparse.csr_matrix(np.kron(nodes, np.eye(components))), components


@given(kronecker())
def test_products_node_by_node(given: tuple[sparse.csr_matrix, int]) -> None:
    matrix, components = given
    np.testing.assert_array_equal(nodal_rows(matrix, components), np.arange(matrix.shape[0]))
    rng = np.random.default_rng(0)
    u, x = (rng.standard_normal(n) for n in matrix.shape[::-1])
    product = NodalProduct(matrix, components)
    out, back = np.full(len(x), np.nan), np.full(len(u), np.nan)
    product.apply(u, out)
    product.apply_transpose(x, back)
    np.testing.assert_allclose(out, matrix @ u, atol=1e-14)
    np.testing.assert_allclose(back, matrix.T @ x, atol=1e-14)


@pytest.mark.parametrize(
    ("row", "entries"),
    [
        (1, {1: 2.0, 4: -1.0}),  # another value
        (1, {1: 1.0, 5: -1.0}),  # another component
        (1, {1: 1.0}),  # fewer entries
        (0, {}),  # an empty row
        (2, {2: 1.0, 3: -1.0}),  # the first components are not in one place
    ],
)
def test_rows_that_differ_between_components_are_not_nodal(row: int, entries: dict) -> None:
    nodes = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    rows = np.kron(nodes, np.eye(3))
    rows[row] = 0.0
    rows[row, list(entries)] = list(entries.values())
    np.testing.assert_array_equal(nodal_rows(sparse.csr_matrix(rows), 3), [3, 4, 5])


def test_runs_begin_at_the_first_component_of_a_column() -> None:
    shifted = np.kron([[1.0, -1.0]], np.eye(3))
    shifted = np.pad(shifted, ((0, 0), (1, 2)))
    assert len(nodal_rows(sparse.csr_matrix(shifted), 3)) == 0
    mixed = np.zeros((3, 9))  # the second entries would belong to different nodes
    mixed[np.arange(3), np.arange(3)], mixed[np.arange(3), 4 + np.arange(3)] = 1.0, -1.0
    assert len(nodal_rows(sparse.csr_matrix(mixed), 3)) == 0


def constraints_of(case: str, comm: MPI.Intracomm = MPI.COMM_SELF) -> ConstraintMatrix:
    name, cell, subdomains = CASES[case]
    B = build_model(scenes.build(scenes.ALL[name](cell, 4), subdomains), comm).problem.B
    assert isinstance(B, ConstraintMatrix)
    return B


def errors_of(B: ConstraintMatrix) -> float:
    """Largest difference of B, W B and their transposes from the same PETSc matrices."""
    rng = np.random.default_rng(B.comm.rank)
    weights = RowWeights(rng.uniform(0.5, 1.0, B.rows))
    worst = 0.0
    for matrix in (B, B.scaled(weights)):
        u, x = rng.standard_normal(B.columns), rng.standard_normal(B.rows)
        out, back = np.full(B.rows, np.nan), np.full(B.columns, np.nan)
        matrix.apply(u, out)
        matrix.apply_transpose(x, back)
        whole = matrix.matrix
        source, target = whole.createVecs()
        source.array, target.array = u, np.nan
        whole.mult(source, target)
        worst = max(worst, float(np.abs(out - target.array).max(initial=0.0)))
        target.array = x
        whole.multTranspose(target, source)
        worst = max(worst, float(np.abs(back - source.array).max(initial=0.0)))
    return float(B.comm.allreduce(worst, op=MPI.MAX))


@pytest.mark.parametrize("case", CASES)
def test_it_is_its_petsc_matrix(case: str) -> None:
    assert errors_of(constraints_of(case)) < 1e-14


def test_gluing_of_boxes_is_nodal_on_one_rank() -> None:
    """All of it, for reflections keep the components of a node together; contact rows are not."""
    name, cell, _ = CASES["cube"]
    problem = build_model(scenes.build(scenes.ALL[name](cell, 8), [2, 2, 2]), MPI.COMM_SELF).problem
    inner = problem.kinds == RowKind.GLUING
    assert 0.9 * inner.sum() < problem.B.nodal <= (problem.kinds != RowKind.CONTACT).sum()


def test_weighted_rows_stay_sorted() -> None:
    """PETSc sorts rows on several ranks: entries in another order would be taken for others."""
    B = constraints_of("bodies that hang in springs")
    weights = np.random.default_rng(0).uniform(0.5, 1.0, B.rows)
    weights[::3] = 0.0
    local = B.scaled(RowWeights(weights)).local
    places = [local.indices[a:b] for a, b in zip(local.indptr[:-1], local.indptr[1:], strict=True)]
    assert max(map(len, places)) > 1
    assert all((np.diff(row) > 0).all() for row in places)
    assert not any(map(len, places[::3]))
    assert abs(local - sparse.diags(weights) @ B.local).max() == 0.0


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_on_ranks(ranks: int) -> None:
    program = (
        "from mpi4py import MPI\n"
        "from tests.contact_app.tfeti.test_matrix import CASES, constraints_of, errors_of\n"
        "for case in CASES:\n"
        "    error = errors_of(constraints_of(case, MPI.COMM_WORLD))\n"
        "    assert error < 1e-13, (case, error)\n"
    )
    execute(program, ranks=ranks)
