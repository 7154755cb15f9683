"""The first active set: contact on coarse levels, each row a one-sided spring, coarse to fine.

On the coarse space of a level, Q = C P₁ … P_k,

    min ½ xᵀ A x - bᵀ x + ½ Σ s_i max(0, (Q x - c)_i)² + ½ Σ w s_i (Q x - c)_i²

is solved by Newton's method with an exact line search, which ends after finitely many steps
(D. Sun, J. Han, 1997). s_i is the stiffness that K has against row i alone, so that the springs
yield by what the finest mesh cannot resolve. The faint springs (w) keep bodies in place which only
contact holds, and pull open rows near. The coarsest level is solved by a factor, the others by a
few conjugate gradients with a cycle of the levels below. The rows that press are the first active
set, and the displacement is where its solve begins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from solver.primal.cholesky import factored
from solver.primal.cycle import Cycle
from solver.primal.factor import (
    change_springs,
    row_stiffness,
    spread_supports,
    squared_rows,
    with_springs,
)
from solver.primal.hierarchy import Hierarchy, galerkin
from solver.primal.merged import MergedSystem
from solver.primal.rigid_bodies import with_motions
from solver.tfeti.constraints.matrix import lent

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
        Unknowns up to which a level is solved by a factor.
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
    springs = system.multiply_transposed(squared_rows(system), row_stiffness(system))
    hierarchy, A = with_motions(system, hierarchy, _with_supports(system, hierarchy), springs)
    P = hierarchy.prolongations
    start = system.at_rest
    if not P:  # the problem is coarse itself
        level = _Level(system, A[0], system.C, system.load, options)
        x = level.minimise(np.zeros(system.size), options.exact_steps, level.by_factor)
        return FirstSet(level.pressed(x) | system.equality, x)
    Q, loads = [system.C], [system.load - system.multiply(system.K, start)]
    for prolongation in P:
        Q.append(Q[-1].matMult(prolongation))
        loads.append(system.multiply_transposed(prolongation, loads[-1]))
    depth = len(P)
    while depth > 1 and A[depth - 1].getSize()[0] <= options.largest:
        depth -= 1
    x, pressed = np.zeros(len(loads[depth])), system.equality
    for k in range(depth, 0, -1):
        level = _Level(system, A[k], Q[k], loads[k], options)
        if k == depth and A[k].getSize()[0] <= options.largest:
            x = level.minimise(x, options.exact_steps, level.by_factor)
        else:
            x = level.minimise(x, options.steps, level.by_cycle(hierarchy, k))
        pressed = level.pressed(x)
        x = system.multiply(P[k - 1], x)
    return FirstSet(pressed | system.equality, start + x)


def _with_supports(system: MergedSystem, hierarchy: Hierarchy) -> Sequence[PETSc.Mat]:
    """The stiffness of each level with springs for motions held in the mean (collective)."""
    if not system.comm.allreduce(int(system.wide_supports.any())):
        return hierarchy.operators
    extra = PETSc.Mat().createAIJ(system.K.getSizes(), nnz=1, comm=system.comm)
    extra.setUp()
    with lent(system.comm, spread_supports(system) * system.diagonal) as (diagonal,):
        extra.setDiagonal(diagonal)
    extra.assemble()
    result = []
    for k, operator in enumerate(hierarchy.operators):
        held = operator.copy()
        held.axpy(1.0, extra, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        result.append(held)
        if k < len(hierarchy.prolongations):
            extra = galerkin(extra, hierarchy.prolongations[k])
    return result


class _Level:
    """The problem with springs on one level."""

    def __init__(
        self,
        system: MergedSystem,
        A: PETSc.Mat,
        Q: PETSc.Mat,
        load: Array,
        options: FirstSetOptions,
    ) -> None:
        self.system, self.A, self.Q, self.load, self.options = system, A, Q, load, options
        self.s = row_stiffness(system)
        stiff = np.asarray(A.getDiagonal().getArray())
        most = system.comm.allreduce(float(stiff.max(initial=0.0)), op=MPI.MAX)
        self.near = options.near * np.maximum(stiff, SMALL * most)
        self._cycle: Cycle | None = None
        self._sprung: tuple[PETSc.Mat, Array] | None = None

    def pressed(self, x: Array) -> NDArray[np.bool_]:
        """Rows whose spring presses, (rows,)."""
        jump = self.system.multiply(self.Q, x) - self.system.c
        return np.asarray(jump > 0.0)

    def minimise(self, x: Array, steps: int, solve: Solve) -> Array:
        """Newton's method."""
        system = self.system
        jump = system.multiply(self.Q, x) - system.c
        Ax = system.multiply(self.A, x)
        for _ in range(steps):
            weights = self._weights(jump)
            gradient = Ax - self.load + self.near * x
            gradient += system.multiply_transposed(self.Q, weights * jump)
            step = solve(self._hessian(weights), -gradient)
            image, product = system.multiply(self.Q, step), system.multiply(self.A, step)
            length = self._length(jump, image, float(step @ (Ax - self.load + self.near * x)),
                                  float(step @ (product + self.near * step)))  # fmt: skip
            x, jump, Ax = x + length * step, jump + length * image, Ax + length * product
            settled = bool((self._weights(jump) == weights).all()) and abs(length - 1.0) < 1e-3
            if system.comm.allreduce(settled, op=MPI.LAND):
                break
        return x

    def _weights(self, jump: Array) -> Array:
        """Stiffness of each spring, (rows,)."""
        stiff = (jump > 0.0) | self.system.equality
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
        """The minimum along a step: the root of a piecewise linear, increasing function."""
        comm = self.system.comm
        slope, bent = (float(v) for v in comm.allreduce(np.array([slope, bent])))

        def rising(t: float) -> float:
            at = jump + t * image
            push = float(comm.allreduce(float(image @ (self._weights(at) * at))))
            return slope + bent * t + push

        begin = abs(rising(0.0))
        if abs(rising(1.0)) <= 1e-9 * begin:
            return 1.0
        low, high = 0.0, 1.0
        while rising(high) < 0.0 and high < 1e6:
            low, high = high, 2.0 * high
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if rising(middle) < 0.0 else (low, middle)
        return 0.5 * (low + high)

    def by_factor(self, matrix: PETSc.Mat, loads: Array) -> Array:
        """A Newton step on the coarsest level."""
        out, pc = np.empty_like(loads), factored(matrix)
        with lent(self.system.comm, loads, out) as (x, y):
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
            return _conjugate_gradients(self.system, matrix, loads, self._cycle, self.options)

        return solve


def _conjugate_gradients(
    system: MergedSystem, matrix: PETSc.Mat, loads: Array, cycle: Cycle, options: FirstSetOptions
) -> Array:
    """A few steps from zero; in the norm of the preconditioner (collective)."""
    comm = system.comm
    x, residual, z = np.zeros_like(loads), loads.copy(), np.empty_like(loads)
    cycle.apply(residual, z)
    direction, square = z.copy(), comm.allreduce(float(residual @ z))
    wanted = options.reduction**2 * square
    if not square > 0.0:
        return x
    for _ in range(options.iterations):
        product = system.multiply(matrix, direction)
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
