"""Preconditioner weights for rows that share nodes.

Rows over several nodes connect bodies that may differ in stiffness. They are not orthonormal, and B
S Bᵀ is no approximate inverse of B K⁺ Bᵀ: it adds the stiffnesses of both sides, but F adds their
compliances. Let D be a diagonal measure of each subdomain's stiffness, and M = B D⁻¹ Bᵀ the
compliance of these rows if every unknown were a separate spring. Then

    M⁻¹ B D⁻¹ S D⁻¹ Bᵀ M⁻¹

is an approximate inverse (A. Klawonn, O. Widlund, FETI and Neumann-Neumann iterative substructuring
methods, Comm. Pure Appl. Math. 54 (2001)). For orthonormal rows between equal stiffnesses it equals
B S Bᵀ. M also contains rows of one node that are not perpendicular to these rows, for example where
an obstacle reaches a tied boundary. M contains free rows only, because open contact connects
nothing. M is as large as a contact surface; every rank holds and factors it.
"""

from copy import copy

import numpy as np
from mpi4py import MPI
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from solver.contact.row_kinds import RowKind
from solver.distributed import lent, local_rows, petsc_rows
from solver.factors import CholeskyFactor
from solver.problem.constraints.matrix import REDUNDANT, ConstraintMatrix
from solver.problem.decomposed import DecomposedProblem
from solver.vectors import Array, Ints, Mask

NEGLIGIBLE = 1e-12
"""Cosine of the angle between rows up to which they count as perpendicular."""

MOST_PARTS = 12
"""Number of parts of M, as three components of four ties, above which they have one factor."""


def _compliance(problem: DecomposedProblem) -> Array:
    """D⁻¹, (interface,); zero for rigid bodies, which have no springs."""
    parts = [np.zeros(0)]
    for cls in problem.classes:
        parts.append(np.full(cls.members * len(cls.interface), 1.0 / cls.resistance.mean()))
    return np.concatenate(parts)


def _rows_near(rows: sparse.csr_matrix, wide: Mask, comm: MPI.Intracomm) -> Ints:
    """The rows of several nodes, and those that share an unknown with one (collective)."""
    touched = np.unique(np.concatenate(comm.allgather(np.unique(rows[wide].indices))))
    met = np.concatenate([[0], np.cumsum(np.isin(rows.indices, touched))])[rows.indptr]
    return np.flatnonzero(wide | (np.diff(met) > 0))


def _of_all_ranks(rows: sparse.csr_matrix, comm: MPI.Intracomm) -> sparse.csr_matrix:
    """The rows of all ranks, on every rank (collective)."""
    return rows if comm.size == 1 else sparse.vstack(comm.allgather(rows), format="csr")


def _with_rows(B: ConstraintMatrix, rows: sparse.csr_matrix, places: Ints) -> ConstraintMatrix:
    """B with some rows replaced by rows with the same columns."""
    local = B.local.copy()
    first, last = local.indptr[places], local.indptr[places + 1]
    filled = np.repeat(first - rows.indptr[:-1], last - first) + np.arange(len(rows.data))
    assert np.array_equal(local.indices[filled], rows.indices), "rows of B are not sorted"
    local.data[filled] = rows.data
    return ConstraintMatrix(B.comm, local, B.columns)


def coupled_rows(problem: DecomposedProblem) -> "CoupledRows | None":
    """The coupled rows of a problem; None where no rank has a row of several nodes (collective)."""
    return (
        CoupledRows(problem)
        if problem.comm.allreduce(int(problem.constraints.wide.any()))
        else None
    )


class FactorOfParts:
    """The factor of M on the free rows of the last call.

    Where nothing couples the components of a tie, they have equal parts of M, which share a factor.
    """

    def __init__(self, matrix: sparse.csr_matrix) -> None:
        self._matrix = matrix
        self._free: bytes | None = None

    def solve(self, values: Array, free: Mask) -> Array:
        """M⁻¹ of the values of free rows, zero elsewhere, (coupled rows,)."""
        if free.tobytes() != self._free:
            self._free, self._parts = free.tobytes(), self._factored(np.flatnonzero(free))
        result = np.zeros(len(values))
        for rows, factor in self._parts:
            result[rows] = factor.solve(values[rows, None])[:, 0]
        return result

    def _factored(self, chosen: Ints) -> list[tuple[Ints, CholeskyFactor]]:
        """Rows of M that nothing couples to other chosen ones, and their factors."""
        if not len(chosen):
            return []
        matrix = self._matrix[chosen][:, chosen]
        number = connected_components(matrix, directed=False)[1]
        sizes, result = np.bincount(number), list[tuple[Ints, CholeskyFactor]]()
        if len(sizes) > MOST_PARTS:
            return [(chosen, CholeskyFactor(matrix))]
        parts: list[sparse.csr_matrix] = []
        for rows in np.split(np.argsort(number, kind="stable"), np.cumsum(sizes)[:-1]):
            parts.append(matrix[rows][:, rows])
            equal = next(k for k, part in enumerate(parts) if _are_equal(part, parts[-1]))
            new = equal == len(parts) - 1
            result.append((chosen[rows], CholeskyFactor(parts[-1]) if new else result[equal][1]))
        return result


def _are_equal(one: sparse.csr_matrix, other: sparse.csr_matrix) -> bool:
    """Whether two matrices differ by rounding errors at most."""
    pairs = [(part.indptr, part.indices) for part in (one, other)]
    if one.shape != other.shape or not all(map(np.array_equal, *pairs)):
        return False
    return bool(np.allclose(one.data, other.data, rtol=0.0, atol=NEGLIGIBLE * one.data.max()))


class CoupledRows:
    """M⁻¹ on the free coupled rows, and B with the coupled rows divided by D.

    Coupled rows are the rows of several nodes, and rows that are not perpendicular to one of them.
    They are made once for a problem; its active sets take them `on` the rows they keep.
    """

    B: ConstraintMatrix  # (dual, interface)
    """Coupled rows times D⁻¹; the other rows unchanged."""

    def __init__(self, problem: DecomposedProblem) -> None:
        self.comm, deforming = problem.comm, problem.deforming
        others = np.flatnonzero(~np.isin(problem.kinds, (RowKind.GLUING, RowKind.DIRICHLET)))
        wide = problem.constraints.wide[others]
        near = _rows_near(deforming.local[others], wide, self.comm)
        others, wide = others[near], wide[near]
        local = deforming.local[others]
        rows = petsc_rows(self.comm, local.copy(), deforming.columns)
        with lent(self.comm, _compliance(problem)) as (right,):
            rows.diagonalScale(R=right)
        divided = local_rows(rows)
        rows.destroy()
        M = _of_all_ranks(divided, self.comm) @ _of_all_ranks(local, self.comm).T
        every = np.concatenate(self.comm.allgather(wide))
        narrow, coupled = np.flatnonzero(~every), np.ones(len(every), bool)
        coupled[narrow] = abs(M[narrow]) @ every > NEGLIGIBLE * M.diagonal()[narrow]
        if not coupled.all():
            M = M[coupled][:, coupled]
        M = (M + sparse.diags(REDUNDANT * M.diagonal())).tocsr()
        M.sort_indices()  # equal parts have equal arrays
        before = self.comm.exscan(len(near)) or 0
        local_part = coupled[before : before + len(near)]
        self._rows = others[local_part]
        self.B = _with_rows(deforming, divided[local_part], self._rows)
        counts = self.comm.allgather(len(self._rows))
        first = sum(counts[: self.comm.rank])
        self._own_part = slice(first, first + len(self._rows))
        self._filled, self._factor = M.diagonal() > 0.0, FactorOfParts(M)

    def on(self, rows: Mask) -> "CoupledRows":
        """The coupled rows of the problem in which only some rows (dual,) are left (collective)."""
        result = copy(self)
        result.B = self.B.scaled(rows.astype(np.float64))
        every = np.concatenate(self.comm.allgather(rows[self._rows]))
        result._filled = self._filled & every
        return result

    def divide(self, x: Array, free: Mask | None) -> None:
        """Replace x on the coupled rows by M⁻¹ x on the free ones, and by zero on the others.

        Parameters
        ----------
        x : (dual,)
        free : (dual,)
            Rows that are free; None for all rows.
        """
        is_free = np.ones(len(self._rows), bool) if free is None else free[self._rows]
        values, in_set = x[self._rows], is_free
        if self.comm.size > 1:
            pairs = self.comm.allgather((values, is_free))
            values, in_set = (np.concatenate(part) for part in zip(*pairs, strict=True))
        x[self._rows] = self._factor.solve(values, in_set & self._filled)[self._own_part]
