"""Proximal multipliers with semismooth Newton steps: slow and safe.

For the displacements u of all subdomains,

    min ½ uᵀ K u - fᵀ u   subject to   E u = e (gluing, held rows),  C u ≤ c (contact rows),

is solved by augmented Lagrangians with a proximal term (R. T. Rockafellar, *Augmented Lagrangians
and applications of the proximal point algorithm in convex programming*, Math. Oper. Res. 1, 1976).
Step k minimises, W a diagonal of penalties,

    ½ uᵀ K u - fᵀ u + ½ ‖λ_E + W (E u - e)‖²_{W⁻¹} + ½ ‖max(0, λ_C + W (C u - c))‖²_{W⁻¹}
        + ε/2 ‖u - u_k‖²_D

and takes λ_E + W (E u - e) and max(0, λ_C + W (C u - c)) for the next multipliers. The function is
convex and piecewise quadratic: Newton's method with an exact line search ends after finitely many
steps from any start (D. Sun, J. Han, *Newton and quasi-Newton methods for a class of nonsmooth
equations*, SIAM J. Optim. 7, 1997). A step takes a sparse factor of

    K + ε D + E^T W E + C_A^T W C_A,   A the rows with λ + W (C u - c) > 0.

Forces between subdomains are not computed by conjugate gradients. Slender bodies, whose dual
operators are dominated by rounding errors, therefore cost no more than others. ε is zero where
gluing and held rows stop every rigid motion.

Most scenes that come this far are certified by multigrid, too. Blocks that slide from under a lid
and come to rest without a load (`tests/contact_app/contact/test_sets_that_hold_no_body.py`) are
not: the other methods leave contact forces of rounding errors there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from solver.factors import compute_factor
from solver.primal.line_search import minimum_along
from solver.qp.result import Counts, Monitor, Reason, Step
from solver.tfeti.constraints.matrix import lent, petsc_rows, scale_rows
from solver.tfeti.decomposed import DecomposedProblem
from solver.tfeti.dual_operator import interface_slices
from solver.vectors import largest_magnitude

Array = NDArray[np.float64]

NOISE = 0.5
"""Residual, relative to that caused by rounding the displacements, below which steps change only
the last digits: a strip of 16,010 unknowns ends at a tenth of it."""


@dataclass(frozen=True)
class NewtonOptions:
    """The tuned numbers of the method.

    Attributes
    ----------
    penalty
        W over the diagonal of B diag(K) Bᵀ. An update of the multipliers reduces violations to
        about four over this number; larger ones lose digits in the factor.
    proximity
        ε D over diag(K), where rigid motions are stopped by contact alone.
    outer, inner
        Most updates of the multipliers, and most Newton steps in all.
    violation
        Violation of the rows over the largest displacement at which the method ends.
    """

    penalty: float = 1e3
    proximity: float = 1e-8
    outer: int = 60
    inner: int = 1000
    violation: float = 1e-13


@dataclass(frozen=True, eq=False)
class NewtonAnswer:
    """The last iterate of the method; local parts.

    Attributes
    ----------
    multiplier : (dual,)
        λ, zero or more on contact rows.
    displacements : one (n, members) array per class
        u, held unknowns included.
    """

    multiplier: Array
    displacements: list[Array]
    counts: Counts
    reason: Reason


@dataclass(frozen=True, eq=False)
class _Iterate:
    """u (free unknowns,) and λ (dual,)."""

    u: Array
    multiplier: Array


def solve_by_newton(
    problem: DecomposedProblem,
    multiplier: Array | None = None,
    monitor: Monitor | None = None,
    options: NewtonOptions | None = None,
) -> NewtonAnswer:
    """Solve to rounding errors (collective).

    Parameters
    ----------
    multiplier : (dual,)
        Initial λ on contact rows; zero by default.

    Raises
    ------
    ArithmeticError
        A matrix has no factor: nothing holds some body, or no digits are left.
    """
    options = options or NewtonOptions()
    system = _System(problem, options)
    clock = _Clock(problem.comm, monitor, options)
    start = np.zeros(problem.size)
    if multiplier is not None:
        start[problem.inequality] = np.maximum(multiplier[problem.inequality], 0.0)
    now = _Iterate(np.zeros(system.size), start)
    reason, previous = Reason.MAX_OUTER_ITERATIONS, np.inf
    for outer in range(options.outer):
        u, ended = _minimise(system, now, outer, clock)
        jump = system.B_times(u) - problem.c
        new = system.forces(now.multiplier, jump)
        violated = np.where(problem.inequality, np.maximum(jump, -now.multiplier / system.W), jump)
        size = largest_magnitude(problem.comm, u)
        violation = largest_magnitude(problem.comm, violated) / (size or 1.0)
        now = _Iterate(u, new)
        if ended is not None:
            reason = ended
            break
        if violation <= options.violation or (violation > 0.5 * previous and violation < 1e-9):
            reason = Reason.CONVERGED
            break
        previous = violation
    return NewtonAnswer(now.multiplier, system.full(now.u), Counts(hessian=clock.steps), reason)


def _minimise(
    system: _System, start: _Iterate, outer: int, clock: _Clock
) -> tuple[Array, Reason | None]:
    """Newton's method for one augmented Lagrangian.

    The reason why the whole solve ended, or None.
    """
    u, settled = start.u.copy(), 0
    best = np.inf
    while True:
        jump = system.B_times(u) - system.problem.c
        gradient = system.gradient(u, start, jump)
        norm = system.norm(gradient)
        active = system.active(start.multiplier, jump)
        if clock.report(outer, norm, active):
            return u, Reason.STOPPED
        if clock.steps >= clock.options.inner:
            return u, Reason.MAX_ITERATIONS
        settled = settled + 1 if norm > 0.5 * best else 0
        best = min(best, norm)
        stuck = settled >= 2 and system.is_factored_for(active)
        if stuck or norm <= NOISE * system.rounding(u):
            return u, None
        step = system.solve(-gradient, active)
        clock.steps += 1
        u = u + system.length(u, step, start, jump, gradient) * step


class _Clock:
    """Counts Newton steps, informs the monitor and asks it whether to stop."""

    def __init__(
        self, comm: MPI.Intracomm, monitor: Monitor | None, options: NewtonOptions
    ) -> None:
        self.comm, self.monitor, self.options, self.steps = comm, monitor, options, 0
        self._began = perf_counter()

    def report(self, outer: int, norm: float, active: NDArray[np.bool_]) -> bool:
        """Whether a monitor on any rank asks to stop (collective)."""
        if self.monitor is None:
            return False
        count = int(self.comm.allreduce(int(active.sum())))
        seconds = perf_counter() - self._began
        step = Step(outer + 1, self.steps, "newton", norm, 0.0, count, seconds, active_rows=count)
        return bool(self.comm.allreduce(int(bool(self.monitor(step)))))


class _System:
    """K, B and the operations of Newton's method on the free unknowns of all subdomains.

    Unknowns of rigid bodies have no stiffness: norms and D use the largest stiffness for them, and
    penalties are those of the other side of their rows.
    """

    def __init__(self, problem: DecomposedProblem, options: NewtonOptions) -> None:
        self.problem, comm = problem, problem.comm
        self.K = _stiffness(problem)
        self.size = self.K.getLocalSize()[0]
        transfer = _interface_to_free(problem)
        self.B = problem.B.matrix.matMult(petsc_rows(comm, transfer, self.size))
        diagonal = np.concatenate(
            [np.empty(0), *(np.tile(c.stiffness.diagonal()[c.free], c.members)
                            for c in problem.classes)]
        )  # fmt: skip
        self.diagonal = np.where(diagonal > 0.0, diagonal, largest_magnitude(comm, diagonal))
        self.loads = np.concatenate(
            [np.empty(0), *(load[cls.free].T.ravel()
                            for cls, load in zip(problem.classes, problem.loads, strict=True))]
        )  # fmt: skip
        squares = self.B.copy()
        squares.setValuesCSR(*_squared(squares))
        squares.assemble()
        self.W = np.empty(problem.size)
        with lent(comm, diagonal, self.W) as (x, y):
            squares.mult(x, y)
        self.W *= options.penalty
        top = options.penalty * largest_magnitude(comm, diagonal)
        self.W = np.where(self.W > 0.0, np.maximum(self.W, 1e-12 * top), top)
        near = 0.0 if problem.held_without_contact else options.proximity
        self.D = near * self.diagonal
        self._active: NDArray[np.bool_] | None = None
        self._pc: PETSc.PC | None = None

    def B_times(self, u: Array) -> Array:
        """B u, (dual,)."""
        out = np.empty(self.problem.size)
        with lent(self.problem.comm, u, out) as (x, y):
            self.B.mult(x, y)
        return out

    def forces(self, multiplier: Array, jump: Array) -> Array:
        """The next multipliers λ + W (B u - c), cut off at zero on contact rows."""
        following = multiplier + self.W * jump
        return np.where(self.problem.inequality, np.maximum(following, 0.0), following)

    def active(self, multiplier: Array, jump: Array) -> NDArray[np.bool_]:
        """Rows with a stiffness: all but contact rows that do not press."""
        return np.asarray(~self.problem.inequality | (multiplier + self.W * jump > 0.0))

    def gradient(self, u: Array, start: _Iterate, jump: Array) -> Array:
        """K u - f + Bᵀ λ + ε D (u - u_k)."""
        out, force = np.empty_like(u), self.forces(start.multiplier, jump)
        with lent(self.problem.comm, u, force, out) as (x, t, y):
            self.K.mult(x, y)
            self.B.multTransposeAdd(t, y, y)
        out -= self.loads
        out += self.D * (u - start.u)
        return out

    def norm(self, gradient: Array) -> float:
        """The energy norm of an error with that residual, by the diagonal of K."""
        square = float(np.sum(gradient**2 / self.diagonal))
        return float(np.sqrt(self.problem.comm.allreduce(square)))

    def rounding(self, u: Array) -> float:
        """The energy norm of the error from rounding u to its last digit."""
        unit = float(np.finfo(np.float64).eps) * largest_magnitude(self.problem.comm, u)
        return unit * float(np.sqrt(self.problem.comm.allreduce(float(self.diagonal.sum()))))

    def length(self, u: Array, step: Array, start: _Iterate, jump: Array, gradient: Array) -> float:
        """The length of the step with the least energy."""
        comm, rows = self.problem.comm, self.problem.inequality
        image, change = self.B_times(step), np.empty_like(step)
        with lent(comm, step, change) as (x, y):
            self.K.mult(x, y)
        curvature = float(step @ (change + self.D * step)) + float((self.W * image**2)[~rows].sum())
        s, w, q = (start.multiplier + self.W * jump)[rows], self.W[rows], image[rows]
        slope = float(step @ gradient) - float(q @ np.maximum(s, 0.0))
        curvature, slope = (float(v) for v in comm.allreduce(np.array([curvature, slope])))
        return minimum_along(comm, slope, curvature, s, w * q, q)

    def is_factored_for(self, active: NDArray[np.bool_]) -> bool:
        """Whether the last factor belongs to these rows (collective)."""
        same = self._active is not None and bool((self._active == active).all())
        return bool(self.problem.comm.allreduce(same, op=MPI.LAND))

    def solve(self, loads: Array, active: NDArray[np.bool_]) -> Array:
        """The Newton step; the factor of the last one where the rows are the same."""
        if not self.is_factored_for(active):
            self._factor(active)
        assert self._pc is not None
        out = np.empty_like(loads)
        with lent(self.problem.comm, loads, out) as (x, y):
            self._pc.apply(x, y)
        return out

    def _factor(self, active: NDArray[np.bool_]) -> None:
        comm = self.problem.comm
        if self._pc is not None:
            self._pc.destroy()
        weighted = self.B.copy()
        scale_rows(weighted, np.where(active, np.sqrt(self.W), 0.0))
        matrix = weighted.transposeMatMult(weighted)
        matrix.axpy(1.0, self.K, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        with lent(comm, self.D) as (extra,):
            matrix.setDiagonal(matrix.getDiagonal() + extra)
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        pc = PETSc.PC().create(comm)
        pc.setType("cholesky" if comm.size == 1 else "lu")
        pc.setFactorSolverType("cholmod" if comm.size == 1 else "mumps")
        try:
            compute_factor(pc, matrix)
        except ArithmeticError as error:
            raise ArithmeticError("no factor: nothing holds some body, or no digits") from error
        weighted.destroy()
        self._pc, self._active = pc, active.copy()

    def full(self, u: Array) -> list[Array]:
        """Displacements of all unknowns, (n, members) of each class, held ones included."""
        result, start = [], 0
        for cls, lift in zip(self.problem.classes, self.problem.lifting, strict=True):
            stop = start + len(cls.free) * cls.members
            displacements = np.array(lift, order="F")
            displacements[cls.free] += u[start:stop].reshape(cls.members, -1).T
            result.append(displacements)
            start = stop
        return result


def _squared(matrix: PETSc.Mat) -> tuple[NDArray, NDArray, Array]:
    """A matrix's rows with squared values."""
    begins, places, values = matrix.getValuesCSR()
    return begins, places, values**2


def _stiffness(problem: DecomposedProblem) -> PETSc.Mat:
    """K of the free unknowns of all subdomains: blocks on the diagonal."""
    blocks = [
        block
        for cls in problem.classes
        for block in _repeated(cls.stiffness[cls.free][:, cls.free].tocsr(), cls.members)
    ]
    local = sparse.block_diag(blocks, format="csr") if blocks else sparse.csr_matrix((0, 0))
    local.sort_indices()
    size = local.shape[0]
    first = problem.comm.exscan(size) or 0
    total = problem.comm.allreduce(size)
    wide = sparse.csr_matrix((local.data, local.indices + first, local.indptr), (size, total))
    return petsc_rows(problem.comm, wide, size)


def _repeated(block: sparse.csr_matrix, times: int) -> Iterator[sparse.csr_matrix]:
    for _ in range(times):
        yield block


def _interface_to_free(problem: DecomposedProblem) -> sparse.csr_matrix:
    """Picks interface unknowns out of the free ones, (interface, free over all ranks).

    Held components of a rigid body are on the interface, but not free: their rows are empty.
    """
    column = np.empty(problem.B.columns, np.int64)
    free = np.empty(problem.B.columns, bool)
    start = 0
    for cls, part in zip(problem.classes, interface_slices(problem.classes), strict=True):
        place = np.searchsorted(cls.free, cls.interface)
        members = start + np.arange(cls.members)[:, None] * len(cls.free)
        column[part] = (members + place).ravel()
        free[part] = np.tile(np.isin(cls.interface, cls.free), cls.members)
        start += len(cls.free) * cls.members
    first = problem.comm.exscan(start) or 0
    total = problem.comm.allreduce(start)
    begins = np.concatenate([[0], np.cumsum(free)])
    return sparse.csr_matrix(
        (np.ones(begins[-1]), column[free] + first, begins), shape=(len(column), total)
    )
