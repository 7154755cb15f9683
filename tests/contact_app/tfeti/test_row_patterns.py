"""Rows of B that repeat, and G applied kind by kind, beside G as a matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.model.model import build_model
from solver.contact.row_kinds import RowKind
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.coarse.gram import Blocks, KernelRows
from solver.tfeti.coarse.row_patterns import PatternProduct, RowPattern, blocks_of, patterns_of
from solver.tfeti.constraints.matrix import ConstraintMatrix
from solver.tfeti.dual import DualProblem
from solver.tfeti.options import TotalFetiOptions
from tests import scenes
from tests.ranks import execute

CASES = {
    "cube": ("wall", "hexahedron", [2, 3, 2]),
    "tetrahedra": ("wall", "tetrahedron", 5),
    "two bodies": ("two_bodies", "hexahedron", 4),
    "plane": ("rollers_and_floor", "quadrilateral", 3),
    "in a hollow sphere": ("rolling_in_hollow_sphere", "tetrahedron", 3),
}

Kernels = list[tuple[int, NDArray[np.float64]]]


ALWAYS = TotalFetiOptions(pattern_rows=0, pattern_rows_on_ranks=0, other_rows=1.0)
"""G is applied pattern by pattern wherever there are any."""


def problem_of(
    case: str, comm: MPI.Intracomm = MPI.COMM_SELF, options: TotalFetiOptions | None = None
) -> DualProblem:
    name, cell, subdomains = CASES[case]
    scene = scenes.build(scenes.ALL[name](cell, 4), subdomains)
    return build_model(scene, comm, options=options).problem


def matrix_of(B: ConstraintMatrix, kernels: Kernels) -> NDArray[np.float64]:
    """Gᵀ = B R."""
    R = sparse.block_diag([sparse.kron(np.eye(n), R) for n, R in kernels])
    return np.asarray((B.local @ R).todense())


def coarse_of(problem: DualProblem) -> CoarseProblem:
    assert problem.coarse is not None
    return problem.coarse


def error_of(problem: DualProblem) -> float:
    """Largest difference of G and Gᵀ from B and the kernels, one after the other."""
    coarse, rng = coarse_of(problem), np.random.default_rng(problem.comm.rank)
    x, alpha = rng.standard_normal(problem.size), rng.standard_normal(coarse.kernels)
    force, motion = np.empty(coarse.kernels), np.empty(problem.size)
    coarse.restrict(x, force)
    coarse.extend(alpha, motion)
    loads = problem.constraint_forces(x)
    u = np.zeros_like(loads)
    expected = np.empty_like(force)
    begin = at = 0
    for cls in problem.classes:
        R = cls.kernel[cls.interface]
        for _ in range(cls.members):
            here, of = slice(begin, begin + len(R)), slice(at, at + R.shape[1])
            expected[of], u[here] = R.T @ loads[here], R @ alpha[of]
            begin, at = here.stop, of.stop
    moved = np.empty_like(motion)
    problem.B.apply(u, moved)
    differences = [np.abs(force - expected), np.abs(motion - moved)]
    worst = max(float(d.max(initial=0.0)) for d in differences)
    return float(problem.comm.allreduce(worst, op=MPI.MAX))


@pytest.mark.parametrize("case", CASES)
def test_it_is_g(case: str) -> None:
    problem = problem_of(case, options=ALWAYS)
    assert coarse_of(problem).by_patterns
    assert error_of(problem) < 1e-13


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_on_ranks(ranks: int) -> None:
    program = (
        "from mpi4py import MPI\n"
        "from solver.tfeti.coarse.row_patterns import PatternProduct\n"
        "from tests.contact_app.tfeti.test_row_patterns import ALWAYS, CASES, coarse_of\n"
        "from tests.contact_app.tfeti.test_row_patterns import error_of, problem_of\n"
        "for case in CASES:\n"
        "    problem = problem_of(case, MPI.COMM_WORLD, ALWAYS)\n"
        "    assert coarse_of(problem).by_patterns, case\n"
        "    error = error_of(problem)\n"
        "    assert error < 1e-13, (case, error)\n"
    )
    execute(program, ranks=ranks)


@st.composite
def glued(draw: st.DrawFn) -> tuple[sparse.csr_matrix, Kernels, int]:
    """Random nodal rows between members of two classes, which repeat often."""
    components, motions = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    members, nodes = 4, 2
    kernels: Kernels = [
        (members, rng.standard_normal((nodes * components, motions))) for _ in range(2)
    ]
    # one node or several of neither, one or both classes, and members at random
    patterns = [
        [(cls, node) for cls in range(2) for node in rng.permutation(nodes)[: rng.integers(2)]]
        for _ in range(3)
    ]
    rows = np.zeros((draw(st.integers(0, 16)), 2 * members * nodes))
    for row in rows:
        pattern = patterns[rng.integers(3)] or [(0, 0)]
        for cls, node in pattern:
            member = rng.integers(members)
            row[(cls * members + member) * nodes + node] = rng.choice([1.0, -1.0])
    return sparse.csr_matrix(np.kron(rows, np.eye(components))), kernels, components


@given(glued())
def test_kinds_of_any_rows(
    given: tuple[sparse.csr_matrix, Kernels, int],
) -> None:
    rows, kernels, components = given
    columns, total = rows.shape[1], sum(n * R.shape[1] for n, R in kernels)
    before = ConstraintMatrix(MPI.COMM_SELF, rows, columns)
    runs = np.arange(0, rows.shape[0], components)
    order, kinds = patterns_of(KernelRows(before, kernels), runs, components)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(runs)))
    taken = (runs[order][:, None] + np.arange(components)).ravel()
    B = ConstraintMatrix(MPI.COMM_SELF, rows[taken], columns)
    G, motions = matrix_of(B, kernels), kernels[0][1].shape[1]
    assert sum(k.rows.stop - k.rows.start for k in kinds) == len(G)
    for kind in kinds:
        rows_of_sets = G[kind.rows].reshape(len(kind.starts), len(kind.V), -1)
        for starts, found in zip(kind.starts, rows_of_sets, strict=True):
            seen = (starts[:, None] + np.arange(motions)).ravel()
            np.testing.assert_allclose(found[:, seen], kind.V, atol=1e-14)
            assert np.count_nonzero(found) == np.count_nonzero(found[:, seen])

    rng = np.random.default_rng(0)
    metric, weights = np.ones(len(G)), np.ones(len(G))
    for kind in kinds:  # the same for all its sets, but for the last one now and then
        metric[kind.rows] = np.tile(rng.integers(1, 3, len(kind.V)), len(kind.starts))
        metric[kind.rows.stop - 1] = rng.integers(1, 3)
    # no more groups at once than it has to take
    product = PatternProduct(KernelRows(B, kernels), kinds, total, metric, rows_at_once=1)
    x, alpha = rng.standard_normal(len(G)), rng.standard_normal(total)
    force, motion, left = np.empty(total), np.empty(len(G)), x.copy()
    for oblique, W in ((False, np.ones(len(G))), (True, metric)):
        product.restrict(x, force, oblique)
        product.extend(alpha, motion, oblique)
        product.remove(alpha, left, oblique)
        np.testing.assert_allclose(force, G.T @ (W * x), atol=1e-12)
        np.testing.assert_allclose(motion, W * (G @ alpha), atol=1e-12)
    np.testing.assert_allclose(left, x - (1.0 + metric) * (G @ alpha), atol=1e-12)

    weights[rng.integers(len(G), size=len(G) // 4)] = 0.5
    blocks, inside = blocks_of(kinds, motions, weights)
    np.testing.assert_allclose(
        dense(blocks, total), G.T @ (G * (weights * inside)[:, None]), atol=1e-12
    )


def dense(blocks: Blocks, total: int) -> NDArray[np.float64]:
    """The sum of blocks as a matrix."""
    result = np.zeros((total, total))
    motions = np.arange(blocks.motions)
    for (row, column), values in zip(blocks.starts, blocks.values, strict=True):
        result[row + motions[:, None], column + motions] += values
    return result


def patterns_in(split: int) -> tuple[list[RowPattern], DualProblem]:
    """Number of patterns of a cube cut into sub-boxes along each edge, each with two cells an
    edge."""
    scene = scenes.build(scenes.wall("hexahedron", 2 * split), [split, split, split])
    problem = build_model(scene, MPI.COMM_SELF, options=ALWAYS).problem
    return list(coarse_of(problem).patterns), problem


def test_patterns_do_not_grow_with_the_number_of_subdomains() -> None:
    """Faces, edges and corners of a regular split, inside and at the held side."""
    few, _ = patterns_in(5)
    many, problem = patterns_in(6)
    assert len(few) == len(many)
    inside = sum(k.rows.stop - k.rows.start for k in many)
    assert inside == (problem.kinds != RowKind.CONTACT).sum()


def test_bodies_without_repetition_keep_their_interface() -> None:
    assert not coarse_of(problem_of("tetrahedra")).by_patterns
