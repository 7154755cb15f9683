"""A sparse factor in place of the V-cycle: for small problems, and where multigrid is slow.

Smoothed aggregation cannot resolve the bending of thin plates and strips: it takes a hundred
iterations per set and more. Their factors are inexpensive, since separators are small. On a set

    K + C_Aᵀ W C_A + faint springs on open rows

is factored, W a multiple of the stiffness that K has against each row. Inside Π that is nearly the
inverse on the displacements that leave the active rows alone, and a set takes a few iterations.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from solver.distributed import local_rows, petsc_rows
from solver.factors import factor_seconds, factored
from solver.primal.block_rows import BlockRows
from solver.primal.blocks import made_once, rows_in_blocks
from solver.primal.merged import MergedSystem
from solver.primal.products import chosen_rows, multiply, multiply_transposed
from solver.primal.projector import Projector
from solver.vectors import Array, on_arrays


@dataclass(frozen=True)
class FactorOptions:
    """Limits for the use of a factor."""

    small: float = 0.02
    """Predicted seconds of a factor in the plane, or with friction, below which it is used at once:
    all sets together then take less time than the levels of a multigrid. In space V-cycles are
    faster on small problems without friction: a leaf spring of 9,018 unknowns takes 0.34 s of CPU
    time and 3.1 s by factors, `configs/hertz_sphere.yaml` 0.22 and 0.60 s."""
    thin: float = 12.0
    """Longest over shortest extent of a body from which on its contact may peel off row by row, and
    its bending, which smoothed aggregation cannot resolve, takes a hundred iterations on a set."""
    thin_seconds: float = 3.0
    """Predicted seconds up to which a factor is taken for thin bodies at once. In space bodies that
    contact holds have the V-cycle: on the leaf spring and the beam on rollers of `make_trials.py
    --size 1.8`, of degree 2, it takes 2.4 and 1.2 s of CPU time, factors 6.7 and 1.6 s. So have
    bodies with friction, where many sets would have a factor each and contact hardly peels off.
    With more seconds, up to `slow_seconds`, factors begin where contact peels off: a pressed plate
    of degree 2 (75,615 unknowns, `pressed_plate --size 1.2`) takes 4.9 s by V-cycles and 7.7 s by
    factors, a lifted one (72,225) 19 s and 9.5 s."""
    slow: int = 40
    slow_digit: int = 12
    slow_seconds: float = 10.0
    step: float = 2e-7
    least_step: float = 1e-3
    """Iterations on one set after which a factor replaces the V-cycle if each digit of the residual
    took so many, and predicted seconds up to which it does. A bracket of hexahedra takes 52 in all,
    six a digit: a factor for the last twelve of them doubled its seconds. The iterations on the set
    have to take as long as the factor, where one takes `least_step` and `step` seconds for each
    unknown: a ring in a groove of degree 2 (46,161 unknowns) takes 130 and 2.5 s of CPU time, and
    73 and 4.2 s with a factor after 40."""
    penalty: float = 1e4
    """W over the stiffness of K against a row. Each iteration reduces the error by this factor;
    larger penalties lose digits in the factor."""
    most_changed: int = 40
    """Rows in which later sets may differ from the set of a factor until a new one is made. Each
    costs one solve. A pressed plate of degree 2 (33,135 unknowns, `make_trials.py pressed_plate
    --size 1.8`) takes 5.3, 4.0 and 3.1 s of CPU time with 10, 20 and 40 rows, and 10.4 s with a
    factor for each set."""
    singular: float = 1e-4
    """Least eigenvalue of Vᵀ K V of these rows (`solver.primal.factor_on_sets`), scaled to a
    diagonal of one, below which a new factor is made: the rows that stay active constrain a body
    too weakly. With 1e-7 rounding errors turned a body without a driving moment by 0.03 on one of
    two platforms (`test_least_motion.py`); with 1e-5 to 0.1 they do not."""
    faint: float = 1e-8
    near: float = 1e-12
    """Stiffness of faint springs on open rows, over that of K, and on every unknown, over the
    diagonal of K. They stop motions that nothing else stops."""


def predicted_seconds(system: MergedSystem) -> float:
    """Predicted seconds of one factor of K (collective).

    By the size of K and, on one rank, by its bandwidth after reverse Cuthill-McKee: a bound for
    slender bodies.
    """
    d = system.problem.dimension
    size = system.comm.allreduce(system.size)
    seconds = factor_seconds(size, 1, d)
    if system.comm.size > 1 or d == 2 or size == 0:
        return seconds
    begins, places, _ = system.K.getValuesCSR()
    graph = sparse.csr_matrix((np.ones(len(places), np.int8), places, begins), shape=(size, size))
    nodes = graph[::d][:, ::d].tocsr()
    order = reverse_cuthill_mckee(nodes, symmetric_mode=True)
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    rows = np.repeat(np.arange(len(order)), np.diff(nodes.indptr))
    band = d * float(np.abs(place[rows] - place[nodes.indices]).max(initial=0))
    return float(min(seconds, 1e-10 * size * band**2))


def thinness(system: MergedSystem) -> float:
    """Longest over shortest extent of the thinnest body (collective)."""
    most = 1.0
    d = system.problem.dimension
    for body in range(system.problem.bodies.count):
        points = system.nodes.points[system.nodes.body == body][:, :d]
        low = points.min(axis=0) if len(points) else np.full(d, np.inf)
        high = points.max(axis=0) if len(points) else np.full(d, -np.inf)
        low = np.min(system.comm.allgather(low), axis=0)
        extent = np.max(system.comm.allgather(high), axis=0) - low
        most = max(most, float(extent.max() / max(extent.min(), 1e-300)))
    return most


class Factor:
    """The factor of one set; applied like a V-cycle (collective).

    Raises
    ------
    ArithmeticError
        The matrix has no factor.
    """

    def __init__(
        self,
        system: MergedSystem,
        projector: Projector,
        options: FactorOptions | None = None,
        springs: Array | None = None,
        coupling: BlockRows | None = None,
    ) -> None:
        """Springs have a stiffness (rows,) on rows that are not active; zero on others.

        With a coupling (`Coupling.matrix`) the matrix is unsymmetric.
        """
        self.options = options = options or FactorOptions()
        self.comm = system.comm
        stiff = row_stiffness(system)
        weights = options.faint * stiff
        if springs is not None:
            weights = np.maximum(weights, springs)
        weights[projector.rows] = options.penalty * stiff[projector.rows]
        near = options.near + spread_means(system)
        rows = BlockRows.of_rows(system.C, system.K.getBlockSize())
        matrix = with_springs(system.K, rows, weights, near * system.diagonal, coupling)
        self._pc = factored(matrix, symmetric=coupling is None)
        self._residual, self._correction = matrix.createVecs()

    def apply(self, residual: Array, out: Array) -> None:
        """Put the correction into out."""
        on_arrays(self._pc.apply, self._residual, residual, self._correction, out)


SPREAD = 1e-2
"""Stiffness of the springs of a row that holds a rigid motion in the mean, relative to that of an
unknown."""


def row_stiffness(system: MergedSystem) -> Array:
    """Stiffness of K against each row alone, 1 / (C D⁻¹ Cᵀ)_ii, (rows,); made once (collective).

    Rigid bodies count as held. Zero for rows that hold rigid motions in the mean: over many nodes
    they would fill a matrix.
    """
    stiff: Array = made_once(system.C, "stiffness", lambda: _row_stiffness(system))
    return stiff


def _row_stiffness(system: MergedSystem) -> Array:
    flexible = multiply(squared_rows(system), system.flexibility)
    stiff = np.divide(1.0, flexible, out=np.zeros_like(flexible), where=flexible > 0.0)
    if system.has_rigid_bodies:  # rows between these and held unknowns meet no stiffness
        top = system.comm.allreduce(float(stiff.max(initial=0.0)), op=MPI.MAX)
        stiff[flexible == 0.0] = top
    return np.asarray(np.where(system.means, 0.0, stiff))


def spread_means(system: MergedSystem) -> Array:
    """Springs for rows that hold rigid motions in the mean, over the diagonal of K, (unknowns,).

    The springs of a row add up to a share of the stiffness of an unknown, divided among its
    unknowns like its squared entries. They hold the motion and hardly stiffen other displacements
    (collective).
    """
    squares = squared_rows(system)
    sums = multiply(squares, np.ones(system.size))
    shares = np.divide(1.0, sums, out=np.zeros_like(sums), where=system.means)
    return SPREAD * multiply_transposed(squares, shares)


def squared_rows(system: MergedSystem) -> PETSc.Mat:
    """C with squared entries; made once (collective)."""
    return made_once(system.C, "squares", lambda: squared(system.C))


def squared(matrix: PETSc.Mat) -> PETSc.Mat:
    """A matrix with squared entries (collective)."""
    rows = local_rows(matrix)
    rows.data *= rows.data
    return petsc_rows(matrix.comm.tompi4py(), rows, matrix.getLocalSize()[1])


def diagonal_below(P: PETSc.Mat, springs: Array) -> Array:
    """Diagonal of Pᵀ diag(springs) P of springs on few unknowns (collective)."""
    some = np.flatnonzero(springs)
    return multiply_transposed(squared(chosen_rows(P, some)), springs[some])


def with_springs(
    A: PETSc.Mat, Q: BlockRows, weights: Array, near: Array, coupling: BlockRows | None = None
) -> PETSc.Mat:
    """A + Qᵀ diag(weights) Q + diag(near) + coupling, in single entries (collective)."""
    springs = spring_matrix(Q, weights).plus_diagonal(near)
    if coupling is not None:
        springs = springs.plus(coupling)
    return rows_in_blocks(A).plus(springs).to_petsc()


def spring_matrix(Q: BlockRows, weights: Array) -> BlockRows:
    """Qᵀ diag(weights) Q of rows in blocks of one row (collective)."""
    some = np.flatnonzero(weights > 0.0)
    return Q.some(some).scaled(np.sqrt(weights[some])).gram()
