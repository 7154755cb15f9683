"""The first active set: contact on coarse levels, each row a one-sided spring, coarse to fine.

On the coarse space of a level, Q = C P₁ … P_k,

    min ½ xᵀ A x - bᵀ x + ½ Σ s_i max(0, (Q x - c)_i)² + ½ Σ w s_i (Q x - c)_i²

is solved by Newton's method with an exact line search, which ends after finitely many steps
(D. Sun, J. Han, 1997). s_i is the stiffness that K has against row i alone, so that the springs
yield by what the finest mesh cannot resolve. The faint springs (w) keep bodies in place which only
contact holds, and pull open rows near; tangential rows have no others. The coarsest level is solved
by a factor, the others by a few conjugate gradients with a cycle of the levels below. The rows that
press are the first active set, and the displacement is where its solve begins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from solver.primal.cholesky import factored, gathered
from solver.primal.cycle import Cycle
from solver.primal.factor import (
    change_springs,
    row_stiffness,
    spread_means,
    squared,
    squared_rows,
    with_springs,
)
from solver.primal.hierarchy import Hierarchy
from solver.primal.merged import MergedSystem, multiply, multiply_transposed
from solver.primal.rigid_bodies import with_motions
from solver.tfeti.constraints.matrix import lent, local_rows

SMALL = 1e-2
"""Share of the largest stiffness of a level that an unknown counts as if it had at least.

Aggregates with held or too few nodes have unknowns without any stiffness."""

Array = NDArray[np.float64]
Solve = Callable[[PETSc.Mat, Array], Array]


@dataclass(frozen=True)
class FirstSetOptions:
    """The tuned numbers of the first set.

    Attributes
    ----------
    faint
        w. A hundredth moves contact zones visibly; below 1e-6 bodies that nothing else holds are
        moved so far that no digits are left.
    exact_steps, steps
        Most Newton steps on the coarsest level, which a factor solves, and on finer ones.
    reduction, iterations
        Of the conjugate gradients of one Newton step. With 0.03 and eight steps the first set takes
        half as long again, and the sets after it no fewer iterations (pillow block 31, flange 58
        instead of 52).
    near
        Added to the diagonal, relatively: for motions that no row and no support stops.
    largest
        Unknowns up to which a level is solved by a factor, a dense one.
    """

    faint: float = 1e-4
    exact_steps: int = 60
    steps: int = 5
    reduction: float = 0.3
    iterations: int = 25
    near: float = 1e-9
    largest: int = 2500


@dataclass(frozen=True, eq=False)
class FirstSet:
    """Where the active-set loop begins.

    Attributes
    ----------
    active : (rows,)
    u : (unknowns,)
    """

    active: NDArray[np.bool_]
    u: Array


def find_first_set(
    system: MergedSystem, hierarchy: Hierarchy, options: FirstSetOptions | None = None
) -> FirstSet:
    """The rows that press on coarse levels (collective)."""
    options = options or FirstSetOptions()
    springs = multiply_transposed(squared_rows(system), row_stiffness(system))
    hierarchy, A = with_motions(system, hierarchy, _with_means(system, hierarchy), springs)
    P = hierarchy.prolongations
    rows = _Rows(system.comm, system.c, system.normal, system.equality, row_stiffness(system))
    start = system.at_rest
    if not P:  # the problem is coarse itself
        level = _Level(rows, A[0], system.C, system.load, options)
        x = level.minimise(np.zeros(system.size), options.exact_steps, level.by_factor)
        return FirstSet(level.pressed(x) | system.equality, x)
    Q, loads = [system.C], [system.load - multiply(system.K, start)]
    for prolongation in P:
        Q.append(Q[-1].matMult(prolongation))
        loads.append(multiply_transposed(prolongation, loads[-1]))
    depth = len(P)
    while depth > 1 and A[depth - 1].getSize()[0] <= options.largest:
        depth -= 1
    x, pressed = np.zeros(len(loads[depth])), system.equality
    for k in range(depth, 0, -1):
        level = _Level(rows, A[k], Q[k], loads[k], options)
        if k == depth and A[k].getSize()[0] <= options.largest:
            x = level.on_every_rank()
        else:
            x = level.minimise(x, options.steps, level.by_cycle(hierarchy, k))
        pressed = level.pressed(x)
        x = multiply(P[k - 1], x)
    return FirstSet(pressed | system.equality, start + x)


def _with_means(system: MergedSystem, hierarchy: Hierarchy) -> Sequence[PETSc.Mat]:
    """The stiffness of each level with springs for motions held in the mean (collective).

    On coarser levels they are the diagonal of their Galerkin products.
    """
    if not system.comm.allreduce(int(system.means.any())):
        return hierarchy.operators
    springs = spread_means(system) * system.diagonal
    result = []
    for k, operator in enumerate(hierarchy.operators):
        held = operator.copy()
        held.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        with lent(system.comm, springs) as (extra,):
            held.setDiagonal(held.getDiagonal() + extra)
        result.append(held)
        if k < len(hierarchy.prolongations):
            springs = multiply_transposed(squared(hierarchy.prolongations[k]), springs)
    return result


@dataclass(frozen=True, eq=False)
class _Rows:
    """The contact and tied rows of a problem.

    Attributes
    ----------
    c, stiffness : (rows,)
        Right-hand side, and stiffness of the springs.
    normal, equality : (rows,)
        Which are contact rows, and which hold with equality.
    """

    comm: MPI.Intracomm
    c: Array
    normal: NDArray[np.bool_]
    equality: NDArray[np.bool_]
    stiffness: Array

    def everywhere(self) -> _Rows:
        """All rows, on a rank of its own (collective)."""
        every = [
            np.concatenate(self.comm.allgather(own))
            for own in (self.c, self.normal, self.equality, self.stiffness)
        ]
        return _Rows(MPI.COMM_SELF, *every)


class _Level:
    """The problem with springs on one level."""

    def __init__(
        self, rows: _Rows, A: PETSc.Mat, Q: PETSc.Mat, load: Array, options: FirstSetOptions
    ) -> None:
        self.rows, self.A, self.Q, self.load, self.options = rows, A, Q, load, options
        self.comm, self.s = rows.comm, rows.stiffness
        stiff = np.asarray(A.getDiagonal().getArray())
        most = self.comm.allreduce(float(stiff.max(initial=0.0)), op=MPI.MAX)
        self.near = options.near * np.maximum(stiff, SMALL * most)
        self._cycle: Cycle | None = None
        self._sprung: tuple[PETSc.Mat, Array] | None = None

    def pressed(self, x: Array) -> NDArray[np.bool_]:
        """Rows whose spring presses, (rows,)."""
        return np.asarray(self.rows.normal & (multiply(self.Q, x) > self.rows.c))

    def on_every_rank(self) -> Array:
        """The solution by factors; every rank solves the whole problem (collective).

        A small problem that ranks share costs more messages than work.
        """
        comm, options = self.comm, self.options
        if comm.size == 1:
            return self.minimise(np.zeros(len(self.load)), options.exact_steps, by_dense_factor)
        A, Q = (gathered(comm, local_rows(matrix)) for matrix in (self.A, self.Q))
        load = np.concatenate(comm.allgather(self.load))
        x = _Level(self.rows.everywhere(), A, Q, load, options).on_every_rank()
        return x[slice(*self.A.getOwnershipRange())].copy()

    def minimise(self, x: Array, steps: int, solve: Solve) -> Array:
        """Newton's method."""
        jump = multiply(self.Q, x) - self.rows.c
        Ax = multiply(self.A, x)
        for _ in range(steps):
            weights = self._weights(jump)
            gradient = Ax - self.load + self.near * x
            gradient += multiply_transposed(self.Q, weights * jump)
            step = solve(self._hessian(weights), -gradient)
            image, product = multiply(self.Q, step), multiply(self.A, step)
            length = self._length(jump, image, float(step @ (Ax - self.load + self.near * x)),
                                  float(step @ (product + self.near * step)))  # fmt: skip
            x, jump, Ax = x + length * step, jump + length * image, Ax + length * product
            settled = bool((self._weights(jump) == weights).all()) and abs(length - 1.0) < 1e-3
            if self.comm.allreduce(settled, op=MPI.LAND):
                break
        return x

    def _weights(self, jump: Array) -> Array:
        """Stiffness of each spring, (rows,)."""
        stiff = (self.rows.normal & (jump > 0.0)) | self.rows.equality
        return np.where(stiff, self.s, self.options.faint * self.s)

    def _hessian(self, weights: Array) -> PETSc.Mat:
        """A with the springs: that of the last step, changed in place by the rows that changed."""
        if self._sprung is None:
            matrix = with_springs(self.A, self.Q, weights, self.near)
        else:
            matrix, before = self._sprung
            change_springs(matrix, self.Q, weights - before)
        self._sprung = matrix, weights
        return matrix

    def _length(self, jump: Array, image: Array, slope: float, bent: float) -> float:
        """The minimum along a step: the root of a piecewise linear, increasing function.

        Newton's method finds it once it comes to the right piece; bisection leads there.
        """
        slope, bent = (float(v) for v in self.comm.allreduce(np.array([slope, bent])))

        def rising(t: float) -> tuple[float, float]:
            """Value and slope."""
            at = jump + t * image
            pulls = self._weights(at) * image
            push, stiff = self.comm.allreduce(np.array([pulls @ at, pulls @ image]))
            return slope + bent * t + float(push), bent + float(stiff)

        small = 1e-9 * abs(rising(0.0)[0])
        low, high, t = 0.0, np.inf, 1.0
        for _ in range(60):
            value, steep = rising(t)
            if abs(value) <= small:
                break
            low, high = (t, high) if value < 0.0 else (low, t)
            newton = t - value / steep if steep > 0.0 else np.inf
            if low < newton < high and newton < 1e6:
                t = newton
            else:
                t = 0.5 * (low + high) if high < np.inf else 2.0 * t
        return t

    def by_factor(self, matrix: PETSc.Mat, loads: Array) -> Array:
        """A Newton step on the coarsest level."""
        out, pc = np.empty_like(loads), factored(matrix)
        with lent(self.comm, loads, out) as (x, y):
            pc.apply(x, y)
        pc.destroy()
        return out

    def by_cycle(self, hierarchy: Hierarchy, k: int) -> Solve:
        """Newton steps on level k by conjugate gradients with a cycle of the levels below."""

        def solve(matrix: PETSc.Mat, loads: Array) -> Array:
            if self._cycle is None:
                # without springs on the levels below: these cost more than the steps they save
                operators = [matrix.copy(), *hierarchy.operators[k + 1 :]]
                self._cycle = Cycle(operators, hierarchy.prolongations[k:], hierarchy.options)
            return _conjugate_gradients(matrix, loads, self._cycle, self.options)

        return solve


def by_dense_factor(matrix: PETSc.Mat, loads: Array) -> Array:
    """A Newton step on the coarsest level of this rank alone, whose Hessian is nearly full.

    On 1,080 unknowns of a pair CHOLMOD takes 53 ms, this 21.

    Raises
    ------
    ArithmeticError
        The matrix has no factor.
    """
    try:
        factor = cho_factor(local_rows(matrix).toarray(order="F"), lower=True, overwrite_a=True)
    except LinAlgError as error:
        raise ArithmeticError("the Hessian of a coarse level has no Cholesky factor") from error
    return np.asarray(cho_solve(factor, loads))


def _conjugate_gradients(
    matrix: PETSc.Mat, loads: Array, cycle: Cycle, options: FirstSetOptions
) -> Array:
    """A few steps from zero; in the norm of the preconditioner (collective)."""
    comm = cycle.comm.tompi4py()
    x, residual, z = np.zeros_like(loads), loads.copy(), np.empty_like(loads)
    cycle.apply(residual, z)
    direction, square = z.copy(), comm.allreduce(float(residual @ z))
    wanted = options.reduction**2 * square
    if not square > 0.0:
        return x
    for _ in range(options.iterations):
        product = multiply(matrix, direction)
        curvature = comm.allreduce(float(direction @ product))
        if not curvature > 0.0:
            break
        length = square / curvature
        x += length * direction
        residual -= length * product
        cycle.apply(residual, z)
        before, square = square, comm.allreduce(float(residual @ z))
        if square <= wanted:
            break
        direction = z + square / before * direction
    return x
