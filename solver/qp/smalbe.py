"""SMALBE-M: semimonotonic augmented Lagrangians for bounds and equalities (Dostál).

Minimises ½ xᵀAx - bᵀx over l ≤ x ≤ u and Cx = c. Outer iteration k minimises the augmented
Lagrangian

    L(x, μ_k, ρ) = ½ xᵀAx - bᵀx + μ_kᵀ(Cx - c) + ρ/2 ‖Cx - c‖²

over the box by MPRGP until ‖g^P‖ ≤ min(M_k ‖Cx - c‖, η), and then sets
μ_{k+1} = μ_k + ρ(Cx - c). M is divided where the Lagrangian grew too little,

    L(x_k, μ_k, ρ) < L(x_{k-1}, μ_{k-1}, ρ) + ρ/2 ‖Cx_k - c‖²,

while ρ stays. A new multiplier changes the gradient by Cᵀ(μ_{k+1} - μ_k), so the next outer
iteration starts from a known gradient, without a product with the Hessian; the paper's
implementation spends one, which ``recompute_gradient`` repeats.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from solver.errors import NotFiniteError, QPError
from solver.qp.box_qp import BoxQP
from solver.qp.iterate import Iterate
from solver.qp.mprgp import MPRGP
from solver.qp.operators import Operator, estimate_norm
from solver.qp.result import Counts, Monitor, Reason, Result
from solver.vectors import Vector, on_arrays

WINDOW = 10
"""Outer iterations in which ‖Cx - c‖ should fall tenfold, once the first few are over."""

NEGLIGIBLE = 1e-9
"""Change of the gradient by a new multiplier, over ‖g^P‖, that leaves the directions conjugate."""

LAGRANGIAN_DIGITS = 1e-12
"""Relative accuracy to which two values of the Lagrangian can be compared."""


@runtime_checkable
class Equalities(Protocol):
    """The matrix C of the equalities, on distributed vectors.

    Attributes
    ----------
    comm : MPI.Comm
    rows : int
        Rows of this rank. An optional attribute ``norm`` is ‖C‖ where it is known (1 for a
        projector); else the power method finds it.
    """

    comm: MPI.Comm
    rows: int

    def apply(self, x: Vector, out: Vector, /) -> None:
        """Put Cx (rows,) into out."""

    def apply_transpose(self, m: Vector, out: Vector, /) -> None:
        """Put Cᵀm (size,) into out."""

    def penalised(self, operator: Operator, rho: float, /) -> Operator:
        """The operator x -> Ax + ρ CᵀCx."""


@dataclass(frozen=True)
class OuterState:
    """An outer iteration at its end, for the caller's own test of convergence.

    Attributes
    ----------
    iteration : int
        From 1.
    x, gradient : ndarray (local part)
        The iterate, and the gradient of the augmented Lagrangian with the multiplier that the
        inner solve used, ``A x - b + Cᵀ(multiplier + ρ residual)``: with the *next* multiplier,
        ``next_multiplier``, it is the gradient of the plain Lagrangian.
    residual : ndarray (local rows)
        Cx - c.
    multiplier, next_multiplier : ndarray (local rows)
    transposed_multiplier : ndarray (local part)
        Cᵀ next_multiplier.
    projected_gradient_norm, residual_norm : float
    rho, M, target : float
        Penalty, balance and inner tolerance that led here.
    counts : Counts
    """

    iteration: int
    x: Vector
    gradient: Vector
    residual: Vector
    multiplier: Vector
    next_multiplier: Vector
    transposed_multiplier: Vector
    projected_gradient_norm: float
    residual_norm: float
    rho: float
    M: float
    target: float
    counts: Counts


#: The caller's own test; must answer the same on all ranks.
Accept = Callable[[OuterState], bool]


@dataclass(frozen=True)
class Restart:
    """All that an outer iteration starts or goes on from, beside the problem itself.

    Attributes
    ----------
    outer : int
        Outer iterations done.
    x, multiplier : ndarray (local part, local rows)
    rho, M, target : float
        Penalty, balance and inner tolerance in force.
    lagrangian : float
        L(x, μ, ρ) at the end of the last outer iteration; -inf where none can be compared with.
    sizes : tuple of float
        ‖Cx - c‖ by outer iteration since ρ was set.
    counts : Counts
        Work so far, of an outer iteration that is not over, too.
    """

    outer: int
    x: Vector
    multiplier: Vector
    rho: float
    M: float
    target: float
    lagrangian: float
    sizes: tuple[float, ...]
    counts: Counts


#: Told of a state; copies what it wants to keep.
Save = Callable[[Restart], None]

#: Whether the state is wanted at this step; must answer the same on all ranks.
Due = Callable[[], bool]


@dataclass(frozen=True)
class SMALBE:
    """Solver for convex quadratic programs with bounds and equalities.

    Attributes
    ----------
    inner : MPRGP
        Inner solver; its ``rtol`` and ``atol`` are the tolerance of the whole: the solve ends
        when ‖g^P‖ and the scaled ‖Cx - c‖ are below max(rtol ‖b‖, atol).
    rho : float
        Penalty ρ in units of ‖A‖/‖C‖². With 1, CᵀC adds no eigenvalue outside A's; larger ones
        save outer iterations, which cost no product here, at the price of more inner ones.
    M : float
        First M in units of ‖A‖/‖C‖.
    shrink : float
        Divisor of M where the Lagrangian grew too little.
    eta : float
        η in units of ‖b‖.
    max_outer : int
    growth : float
        Factor of ρ whenever ‖Cx - c‖ has not fallen tenfold in ten outer iterations, which
        happens where few rows carry the load (a body on the edge of its support); 1 keeps ρ.
    recompute_gradient : bool
        Spend one product on the gradient at each outer iteration, as the paper counts.
    scaled_residual : bool
        Measure ‖Cx - c‖ in units of the gradient, by ‖A‖/‖C‖, so that the test does not depend
        on the units of A and C; False compares it with ‖b‖ as it is (paper).
    """

    inner: MPRGP = field(default_factory=MPRGP)
    rho: float = 1.0
    M: float = 3.0
    shrink: float = 2.0
    eta: float = 0.1
    max_outer: int = 500
    growth: float = 4.0
    recompute_gradient: bool = False
    scaled_residual: bool = True

    @classmethod
    def paper(cls, inner: MPRGP | None = None) -> SMALBE:
        """The paper's rule (section 5.1): ρ = 1.1‖A‖, M = 100‖A‖, divided by 10.

        Its "η = 1.1‖A‖" is ρ. The residual stays scaled: the paper's plain comparison of ‖Cx‖
        with ‖b‖ depends on the units (``scaled_residual=False`` has it).
        """
        return cls(inner or MPRGP(), 1.1, 100.0, 10.0, growth=1.0, recompute_gradient=True)

    @classmethod
    def permon(cls, inner: MPRGP | None = None) -> SMALBE:
        """PERMON's defaults: as the paper, with M divided by 2."""
        return cls(inner or MPRGP(), 1.1, 100.0, 2.0, growth=1.0, recompute_gradient=True)

    def solve(
        self,
        qp: BoxQP,
        C: Any,
        c: Any = None,
        x0: object = None,
        multiplier0: Any = None,
        monitor: Monitor | None = None,
        accept: Accept | None = None,
        save: Save | None = None,
        restart: Restart | None = None,
        due: Due | None = None,
    ) -> Result:
        """Minimise the cost of qp with Cx = c.

        Parameters
        ----------
        C : dense or sparse array, LinearOperator or PETSc.Mat (m, n), or Equalities
        c : array (m,) or PETSc.Vec, local part; zeros if None
        multiplier0 : array (m,) or PETSc.Vec
            First multiplier; zeros if None.
        accept : callable of OuterState
            When given, it alone decides convergence, at the end of every outer iteration.
        save : callable of Restart
            Told of the state at the end of each outer iteration.
        due : callable
            Asked after each inner step, after the monitor, whether `save` is told of the state
            there, too.
        restart : Restart
            Go on from there, instead of from x0 and multiplier0, for one product more than the
            solve that was not interrupted.
        """
        if restart is not None:
            x0, multiplier0 = restart.x, restart.multiplier
        equalities = as_equalities(C, qp.comm)
        rows = equalities.rows
        right = _local_rows(c, rows, "c", qp)
        multiplier = _local_rows(multiplier0, rows, "multiplier0", qp)
        norm, products = self._norm(qp)
        C_norm = _equalities_norm(equalities, qp.size)
        rho = restart.rho if restart else self.rho * norm / C_norm**2
        M = restart.M if restart else self.M * norm / C_norm
        to_gradient = norm / C_norm if self.scaled_residual else 1.0
        b_norm = qp.reduction.norm(qp.b)

        change = np.zeros(qp.size)
        transposed = np.zeros(qp.size)  # Cᵀ multiplier
        equalities.apply_transpose(multiplier, transposed)
        equalities.apply_transpose(rho * right, change)
        augmented = BoxQP(
            equalities.penalised(qp.operator, rho), qp.b - transposed + change, qp.lower, qp.upper
        )
        inner_norm = None if self.inner.norm is None else norm + rho * C_norm**2
        it = Iterate(
            augmented,
            x0,
            norm=inner_norm,
            preconditioner=self.inner.preconditioner,
            memory=self.inner.memory,
        )
        it.counts.norm_estimation += products
        if restart is not None:
            it.counts = replace(restart.counts)
            it.iterations = it.counts.inner
        it.measure_b()
        self.inner.strategy.prepare(it)
        it.evaluate()

        scale = b_norm or it.b_norm or it.reduction.norm(it.g)
        tolerance = max(self.inner.rtol * scale, self.inner.atol)
        eta = self.eta * scale
        residual = np.zeros(rows)
        previous = restart.lagrangian if restart else -math.inf
        right_square = qp.reduction.sums(float(np.dot(right, right)))[0]
        # of the inner solve, tightened when a caller's test asks for more
        target = restart.target if restart else tolerance

        measured, known_size = -1, 0.0  # the step at which the residual was taken, and its norm

        def measure(it: Iterate) -> float:
            nonlocal measured, known_size
            if measured != it.iterations:
                equalities.apply(it.x, residual)
                np.subtract(residual, right, out=residual)
                measured, known_size = it.iterations, qp.reduction.norm(residual)
            it.equality_residual = known_size
            return known_size

        peak = 0.0  # largest ‖Cx‖ carried along so far: it sets the rounding errors of the others

        def carried(it: Iterate) -> tuple[float, float] | None:
            """‖Cx‖ by recurrence and what rounding may have done to it; None if it takes C."""
            nonlocal peak
            if it.image is None or right_square > 0.0:
                return None
            it.equality_residual = size = it.operator.image_norm(it.image)  # type: ignore[attr-defined]
            peak = max(peak, size)
            steps = 100.0 + it.iterations
            return size, 1e-3 * size + steps * float(np.finfo(np.float64).eps) * peak

        def inner_stop(it: Iterate) -> Reason | None:
            gradient = it.projected_gradient_norm
            if gradient > eta:
                return None
            known = carried(it)
            if known is not None:  # a look at Cx itself only where it can decide
                size, error = known
                limit = tolerance if accept is None else target
                small = gradient <= limit and (size - error) * to_gradient <= limit
                if gradient > M * (size + error) and not small:
                    return None
            size = measure(it)
            if gradient <= M * size:
                return Reason.CONVERGED
            done = accept is None and gradient <= tolerance and size * to_gradient <= tolerance
            small = accept is not None and gradient <= target and size * to_gradient <= target
            return Reason.CONVERGED if done or small else None

        reason = Reason.MAX_OUTER_ITERATIONS
        # ‖Cx - c‖ by outer iteration since ρ was set
        sizes: list[float] = list(restart.sizes) if restart else []
        done = restart.outer if restart else 0
        next_multiplier = multiplier.copy()
        before = it.reduction.collectives

        def state(outer: int) -> Restart:
            return Restart(
                outer, it.x, multiplier, rho, M, target, previous, tuple(sizes), replace(it.counts)
            )

        def watch(it: Iterate) -> None:
            if save is not None and due is not None and due():
                save(state(it.outer - 1))

        it.watch = watch
        for outer in range(done + 1, self.max_outer + 1):
            it.outer = it.counts.outer = outer
            if outer > done + 1 and (self.recompute_gradient or it.drift > 0.1 * tolerance):
                it.evaluate()
            inner_reason = self.inner.minimise(it, inner_stop, monitor)
            size = measure(it)
            np.multiply(residual, rho, out=next_multiplier)
            equalities.apply_transpose(next_multiplier, change)  # Cᵀ(μ_{k+1} - μ_k)
            np.add(next_multiplier, multiplier, out=next_multiplier)
            np.add(transposed, change, out=transposed)
            if inner_reason in (Reason.STOPPED, Reason.MAX_ITERATIONS, Reason.DIVERGED):
                reason = inner_reason
                break
            small = it.projected_gradient_norm <= tolerance and size * to_gradient <= tolerance
            if accept is None and small and it.drift <= 0.5 * tolerance:
                reason = Reason.CONVERGED
                break
            if accept is not None and accept(
                OuterState(
                    outer,
                    it.x,
                    it.g,
                    residual,
                    multiplier,
                    next_multiplier,
                    transposed,
                    it.projected_gradient_norm,
                    size,
                    rho,
                    M,
                    target,
                    replace(it.counts),
                )  # fmt: skip
            ):
                reason = Reason.ACCEPTED
                break
            if inner_reason is Reason.ROUND_OFF and size * to_gradient <= it.round_off:
                reason = Reason.ROUND_OFF
                break
            lagrangian = self._lagrangian(it, multiplier, right, rho, right_square)
            gain = 0.5 * rho * size**2
            # below round-off of L the test would be a coin toss, and counts depend on the units
            if gain > LAGRANGIAN_DIGITS * abs(lagrangian) and lagrangian < previous + gain:
                M /= self.shrink
            previous = lagrangian
            if it.projected_gradient_norm <= target and size * to_gradient <= target:
                target *= 0.1
            np.copyto(multiplier, next_multiplier)
            np.add(it.g, change, out=it.g)
            np.subtract(augmented.b, change, out=augmented.b)
            sizes.append(size)
            moved = it.reduction.norm(change) > NEGLIGIBLE * it.projected_gradient_norm
            if self.growth > 1.0 and len(sizes) > WINDOW + 5 and size > 0.1 * sizes[-1 - WINDOW]:
                # A + ρ CᵀC has a larger ρ from here on: the gradient follows without a product
                added = (self.growth - 1.0) * rho
                equalities.apply_transpose(added * residual, change)
                np.add(it.g, change, out=it.g)
                equalities.apply_transpose(added * right, change)
                np.add(augmented.b, change, out=augmented.b)
                rho += added
                it.replace_operator(
                    equalities.penalised(qp.operator, rho),
                    None if self.inner.norm is None else norm + rho * C_norm**2,
                )
                sizes.clear()
                moved = True
                previous = -math.inf
            if save is not None:
                save(state(outer))
            it.measure_b()
            if moved and not self.recompute_gradient:
                it.restart()
        it.watch = None  # it knows the iterate, which would keep itself alive
        it.settle()
        it.counts.collectives += it.reduction.collectives - before
        return Result(
            x=qp.wrap(it.x),
            reason=reason,
            counts=it.counts,
            gradient=qp.wrap(it.g),
            projected_gradient_norm=it.projected_gradient_norm,
            multiplier=next_multiplier,
            equality_residual=it.equality_residual,
            history=it.history,
        )

    def _norm(self, qp: BoxQP) -> tuple[float, int]:
        """‖A‖ and the products it took."""
        if self.inner.norm is not None:
            return self.inner.norm, 0
        norm, products = estimate_norm(qp.operator)
        return norm or 1.0, products

    @staticmethod
    def _lagrangian(
        it: Iterate, multiplier: Vector, right: Vector, rho: float, right_square: float
    ) -> float:
        """L(x, μ, ρ) = ½ xᵀ(g - b_aug) - μᵀc + ρ/2 ‖c‖², without a product."""
        xg, xb, mc = it.reduction.sums(
            float(np.dot(it.x, it.g)),
            float(np.dot(it.x, it.qp.b)),
            float(np.dot(multiplier, right)),
        )
        return 0.5 * (xg - xb) - mc + 0.5 * rho * right_square


class MatrixEqualities:
    """Equalities from a dense or sparse array or a LinearOperator, on one rank."""

    def __init__(self, matrix: Any) -> None:
        self.comm = MPI.COMM_SELF
        self.rows = int(matrix.shape[0])
        self.matrix = matrix
        self._transpose = matrix.T

    def apply(self, x: Vector, out: Vector) -> None:
        """Put Cx into out."""
        out[:] = self.matrix @ x

    def apply_transpose(self, m: Vector, out: Vector) -> None:
        """Put Cᵀm into out."""
        out[:] = self._transpose @ m

    def penalised(self, operator: Operator, rho: float) -> Operator:
        """The operator x -> Ax + ρ CᵀCx."""
        return Penalised(operator, self, rho)


class PETScEqualities:
    """Equalities from a PETSc matrix of any type."""

    def __init__(self, matrix: PETSc.Mat) -> None:
        self.comm = matrix.getComm().tompi4py()
        self.rows = int(matrix.getLocalSize()[0])
        self.matrix = matrix
        self._x, self._rows = matrix.createVecs()

    def apply(self, x: Vector, out: Vector) -> None:
        """Put Cx into out."""
        on_arrays(self.matrix.mult, self._x, x, self._rows, out)

    def apply_transpose(self, m: Vector, out: Vector) -> None:
        """Put Cᵀm into out."""
        on_arrays(self.matrix.multTranspose, self._rows, m, self._x, out)

    def penalised(self, operator: Operator, rho: float) -> Operator:
        """The operator x -> Ax + ρ CᵀCx."""
        return Penalised(operator, self, rho)


class Penalised:
    """The operator x -> Ax + ρ CᵀCx."""

    def __init__(self, operator: Operator, equalities: Equalities, rho: float) -> None:
        self.comm, self.size = operator.comm, operator.size
        self.operator, self.equalities, self.rho = operator, equalities, rho
        self._rows, self._column = np.zeros(equalities.rows), np.zeros(operator.size)

    def apply(self, x: Vector, out: Vector) -> None:
        """Put the product with x into out."""
        self.operator.apply(x, out)
        self.equalities.apply(x, self._rows)
        np.multiply(self._rows, self.rho, out=self._rows)
        self.equalities.apply_transpose(self._rows, self._column)
        np.add(out, self._column, out=out)


def as_equalities(C: Any, comm: MPI.Comm) -> Equalities:
    """Adapt an array, LinearOperator or PETSc.Mat; pass Equalities through."""
    if isinstance(C, PETSc.Mat):
        return PETScEqualities(C)
    if isinstance(C, Equalities):
        return C
    if scipy.sparse.issparse(C):
        C = scipy.sparse.csr_array(C, dtype=np.float64)
    elif not hasattr(C, "matvec"):
        C = np.atleast_2d(np.asarray(C, dtype=np.float64))
    if comm.size > 1:
        raise QPError("a distributed problem needs distributed equalities, such as a PETSc.Mat")
    data = getattr(C, "data", None) if scipy.sparse.issparse(C) else C
    if isinstance(data, np.ndarray) and not np.isfinite(data).all():
        raise NotFiniteError("the matrix of the equalities has entries that are not finite")
    return MatrixEqualities(C)


def _equalities_norm(equalities: Equalities, size: int) -> float:
    """‖C‖: known, or by the power method on CᵀC."""
    known = getattr(equalities, "norm", None)
    if known:
        return float(known)

    class Gram:
        comm = equalities.comm

        def __init__(self) -> None:
            self.size = size
            self._rows = np.zeros(equalities.rows)

        def apply(self, x: Vector, out: Vector) -> None:
            equalities.apply(x, self._rows)
            equalities.apply_transpose(self._rows, out)

    return math.sqrt(estimate_norm(Gram())[0]) or 1.0


def _local_rows(values: Any, rows: int, name: str, qp: BoxQP) -> Vector:
    if values is None:
        return np.zeros(rows)
    if isinstance(values, PETSc.Vec):
        values = values.getArray(readonly=True)
    array = np.array(values, dtype=np.float64).reshape(-1)
    if qp.reduction.sums(float(array.shape != (rows,)))[0]:
        raise QPError(f"{name} has {array.size} components; C has {rows} rows")
    if qp.reduction.sums(float(not np.isfinite(array).all()))[0]:
        raise NotFiniteError(f"{name} has components that are not finite")
    return array
