"""SMALBE-M: semimonotonic augmented Lagrangians for bounds and equalities (Dostál).

Minimises ½ xᵀAx - bᵀx over l ≤ x ≤ u and Cx = c. Outer iteration k minimises the augmented
Lagrangian

    L(x, μ_k, ρ) = ½ xᵀAx - bᵀx + μ_kᵀ(Cx - c) + ρ/2 ‖Cx - c‖²

over the box by MPRGP until ‖g^P‖ ≤ min(M_k ‖Cx - c‖, η), and then sets
μ_{k+1} = μ_k + ρ(Cx - c). M is divided where the Lagrangian grew too little,

    L(x_k, μ_k, ρ) < L(x_{k-1}, μ_{k-1}, ρ) + ρ/2 ‖Cx_k - c‖²,

while ρ stays. A new multiplier changes the gradient by Cᵀ(μ_{k+1} - μ_k), so the next outer
iteration starts from a known gradient, without a Hessian multiplication; the paper's
implementation spends one, as does ``recompute_gradient`` here.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from petsc4py import PETSc

from solver.errors import NotFiniteError, QPError
from solver.qp.equalities import Equalities, as_equalities, equalities_norm
from solver.qp.iterate import Iterate
from solver.qp.mprgp import MPRGP
from solver.qp.operators import estimate_norm
from solver.qp.outer_state import Accept, Hooks, OuterState, Restart
from solver.qp.result import Monitor, Reason, Result
from solver.qp.separable_qp import SeparableQP
from solver.vectors import Vector

NEGLIGIBLE = 1e-9
"""Change of the gradient by a new multiplier, over ‖g^P‖, that leaves the directions conjugate."""

LAGRANGIAN_DIGITS = 1e-12
"""Relative accuracy to which two values of the Lagrangian can be compared."""


@dataclass(frozen=True)
class SMALBE:
    """Solver for convex quadratic programs with bounds and equalities."""

    inner: MPRGP = field(default_factory=MPRGP)
    """Inner solver; its ``rtol`` and ``atol`` are the tolerances of the whole solve, which ends
    when ‖g^P‖ and the scaled ‖Cx - c‖ are below max(rtol ‖b‖, atol)."""
    rho: float = 1.0
    """Penalty ρ in units of ‖A‖/‖C‖². With 1, CᵀC adds no eigenvalue outside A's; larger ones save
    outer iterations, which cost no multiplication here, at the price of more inner ones."""
    M: float = 3.0
    """First M in units of ‖A‖/‖C‖."""
    shrink: float = 2.0
    """Divisor of M where the Lagrangian grew too little."""
    eta: float = 0.1
    """η in units of ‖b‖."""
    max_outer: int = 500
    growth: float = 4.0
    window: int = 10
    """Factor of ρ whenever ‖Cx - c‖ has not fallen tenfold in so many outer iterations, once the
    first few are over, which happens where few rows carry the load (a body on the edge of its
    support); a factor of 1 keeps ρ."""
    recompute_gradient: bool = False
    """Spend one multiplication on the gradient at each outer iteration, as the paper counts."""

    @classmethod
    def paper(cls, inner: MPRGP | None = None) -> "SMALBE":
        """The paper's rule (section 5.1): ρ = 1.1‖A‖, M = 100‖A‖, divided by 10.

        Its "η = 1.1‖A‖" is ρ. The paper compares ‖Cx‖ with ‖b‖ as it is, which depends on the
        units; here ‖Cx - c‖ is scaled by ‖A‖/‖C‖.
        """
        return cls(inner or MPRGP(), 1.1, 100.0, 10.0, growth=1.0, recompute_gradient=True)

    def begin(
        self,
        qp: SeparableQP,
        C: Any,
        c: Any = None,
        x0: object = None,
        multiplier0: Any = None,
        restart: Restart | None = None,
        hooks: Hooks | None = None,
    ) -> "OuterIterations":
        """The outer iterations for the cost of qp with Cx = c, ready for the first step.

        Parameters
        ----------
        C : dense or sparse array, LinearOperator or PETSc.Mat (m, n), or Equalities
        c : array (m,) or PETSc.Vec, local part; zeros if None
        multiplier0 : array (m,) or PETSc.Vec
            First multiplier; zeros if None.
        restart : Restart
            State to go on from, instead of x0 and multiplier0. It costs one multiplication more
            than an uninterrupted solve.
        """
        if restart is not None:
            x0, multiplier0 = restart.x, restart.multiplier
        equalities = as_equalities(C, qp.comm)
        right = _local_rows(c, equalities.rows, "c", qp)
        multiplier = _local_rows(multiplier0, equalities.rows, "multiplier0", qp)
        problem = _Problem(qp, equalities, right, *self._norms(qp, equalities))
        return OuterIterations(self, problem, x0, multiplier, restart, hooks or Hooks())

    def solve(
        self,
        qp: SeparableQP,
        C: Any,
        c: Any = None,
        x0: object = None,
        multiplier0: Any = None,
        monitor: Monitor | None = None,
        accept: Accept | None = None,
    ) -> Result:
        """Minimise the cost of qp with Cx = c; parameters as in `begin`.

        Parameters
        ----------
        accept : callable of OuterState
            When given, it alone decides convergence, at the end of every outer iteration.
        """
        hooks = Hooks(monitor)
        return self.begin(qp, C, c, x0, multiplier0, hooks=hooks).run(accept)

    def _norms(self, qp: SeparableQP, equalities: Equalities) -> tuple[float, int, float]:
        """‖A‖, the multiplications it took, and ‖C‖."""
        norm, multiplications = self.inner.norm, 0
        if norm is None:
            norm, multiplications = estimate_norm(qp.operator)
            norm = norm or 1.0
        return norm, multiplications, equalities_norm(equalities, qp.size)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Cost and feasible set, equalities Cx = c, and norms."""

    qp: SeparableQP
    equalities: Equalities
    right: Vector  # (rows,)
    """c, local part."""
    norm: float
    """‖A‖."""
    multiplications: int
    """Hessian multiplications spent on ‖A‖."""
    C_norm: float
    """‖C‖."""


class OuterIterations:
    """The outer iterations of one solve, step by step.

    `step` is one inner solve, `ended` says whether the solve ends with it, and `update` moves
    multiplier, M and ρ to the next outer iteration. `run` is the loop of the three. A caller that
    acts in between, for example to certify the answer, has a loop of its own.

    Attributes
    ----------
    outer : int
        Outer iterations begun.
    """

    def __init__(
        self,
        rules: SMALBE,
        problem: _Problem,
        x0: object,
        multiplier: Vector,
        restart: Restart | None,
        hooks: Hooks,
    ) -> None:
        self._rules, self._problem, self._hooks = rules, problem, hooks
        qp, equalities, right = problem.qp, problem.equalities, problem.right
        self._multiplier, self._next_multiplier = multiplier, multiplier.copy()
        self._to_gradient = ratio = problem.norm / problem.C_norm  # units of ‖Cx - c‖ to those of g
        self._rho = restart.rho if restart else rules.rho * problem.norm / problem.C_norm**2
        self._M = restart.M if restart else rules.M * ratio
        self._change = np.zeros(qp.size)
        self._transposed = np.zeros(qp.size)  # Cᵀ multiplier
        equalities.apply_transpose(multiplier, self._transposed)
        equalities.apply_transpose(self._rho * right, self._change)
        self._augmented = SeparableQP(
            equalities.penalised(qp.operator, self._rho), qp.b - self._transposed + self._change,
            qp.feasible,
        )  # fmt: skip
        self._it = it = Iterate(
            self._augmented, x0, norm=self._inner_norm,
            preconditioner=rules.inner.preconditioner,
        )  # fmt: skip
        it.counts.norm_estimation += problem.multiplications
        if restart is not None:
            it.counts = replace(restart.counts)
            it.iterations = it.counts.inner
        it.measure_b()
        rules.inner.strategy.prepare(it)
        it.evaluate()

        scale = qp.reduction.norm(qp.b) or it.b_norm or it.reduction.norm(it.g)
        self._tolerance = max(rules.inner.rtol * scale, rules.inner.atol)
        self._eta = rules.eta * scale
        self._residual = np.zeros(equalities.rows)
        self._right_square = qp.reduction.sums(float(np.dot(right, right)))[0]
        self._previous = restart.lagrangian if restart else -math.inf
        # of the inner solve, tightened when a caller's test asks for more
        self._target = restart.target if restart else self._tolerance
        # ‖Cx - c‖ by outer iteration since ρ was set
        self._sizes = list(restart.sizes) if restart else []
        self.outer = self._begun = restart.outer if restart else 0
        self._measured, self._size = -1, 0.0  # the step at which ‖Cx - c‖ was taken, and what it is
        self._peak = 0.0  # largest ‖Cx‖ carried along so far: it sets the rounding errors of others
        self._inner_reason = Reason.CONVERGED
        it.watch = self._watch

    @property
    def _inner_norm(self) -> float | None:
        """‖A + ρ CᵀC‖ where ‖A‖ is known."""
        problem = self._problem
        if self._rules.inner.norm is None:
            return None
        return problem.norm + self._rho * problem.C_norm**2

    # ------------------------------------------------------------------ the loop

    def run(self, accept: Accept | None = None) -> Result:
        """All outer iterations; parameters and result of `SMALBE.solve`."""
        while self.outer < self._rules.max_outer:
            state = self.step(own_test=accept is not None)
            reason = self.interrupted
            if reason is None and accept is not None and accept(state):
                reason = Reason.ACCEPTED
            if reason is None:
                reason = self.ended(own_test=accept is not None)
            if reason is not None:
                return self.result(reason)
            self.update()
        return self.result(Reason.MAX_OUTER_ITERATIONS)

    def step(self, own_test: bool = False) -> OuterState:
        """One inner solve and the multiplier that follows from it.

        Parameters
        ----------
        own_test
            Whether the caller tests the answer: the inner solve is tightened until the test passes.
        """
        rules, it, equalities = self._rules, self._it, self._problem.equalities
        self.outer += 1
        it.outer = it.counts.outer = self.outer
        drifted = it.drift > 0.1 * self._tolerance
        if self.outer > self._begun + 1 and (rules.recompute_gradient or drifted):
            it.evaluate()

        def stop(it: Iterate) -> Reason | None:
            return self._inner_stop(it, own_test)

        self._inner_reason = rules.inner.minimise(it, stop, self._hooks.monitor)
        size = self._measure(it)
        np.multiply(self._residual, self._rho, out=self._next_multiplier)
        equalities.apply_transpose(self._next_multiplier, self._change)  # Cᵀ(μ_{k+1} - μ_k)
        np.add(self._next_multiplier, self._multiplier, out=self._next_multiplier)
        np.add(self._transposed, self._change, out=self._transposed)
        return OuterState(
            self.outer, it.x, it.g, self._residual, self._multiplier, self._next_multiplier,
            self._transposed, it.projected_gradient_norm, size, self._rho, self._M, self._target,
            replace(it.counts),
        )  # fmt: skip

    @property
    def interrupted(self) -> Reason | None:
        """The reason why the inner solve ended before its tolerance; None where it met it."""
        stopped = (Reason.STOPPED, Reason.MAX_ITERATIONS, Reason.DIVERGED)
        return self._inner_reason if self._inner_reason in stopped else None

    def ended(self, own_test: bool = False) -> Reason | None:
        """The reason why the solve ends with the last step; None where it goes on.

        The tolerance ends it only where the caller has no test of its own; round-off always does.
        """
        it, size = self._it, self._size * self._to_gradient
        small = it.projected_gradient_norm <= self._tolerance and size <= self._tolerance
        if not own_test and small and it.drift <= 0.5 * self._tolerance:
            return Reason.CONVERGED
        if self._inner_reason is Reason.ROUND_OFF and size <= it.round_off:
            return Reason.ROUND_OFF
        return None

    def update(self) -> None:
        """Multiplier, M, inner tolerance and ρ of the next outer iteration."""
        rules, it, size = self._rules, self._it, self._size
        lagrangian = self._lagrangian()
        gain = 0.5 * self._rho * size**2
        # below round-off of L the test would be random, and counts would depend on the units
        if gain > LAGRANGIAN_DIGITS * abs(lagrangian) and lagrangian < self._previous + gain:
            self._M /= rules.shrink
        self._previous = lagrangian
        target = self._target
        if it.projected_gradient_norm <= target and size * self._to_gradient <= target:
            self._target *= 0.1
        np.copyto(self._multiplier, self._next_multiplier)
        np.add(it.g, self._change, out=it.g)
        np.subtract(self._augmented.b, self._change, out=self._augmented.b)
        self._sizes.append(size)
        moved = it.reduction.norm(self._change) > NEGLIGIBLE * it.projected_gradient_norm
        slow = len(self._sizes) > rules.window + 5 and size > 0.1 * self._sizes[-1 - rules.window]
        if rules.growth > 1.0 and slow:
            self._raise_penalty()
            moved = True
        if self._hooks.save is not None:
            self._hooks.save(self._restart(self.outer))
        it.measure_b()
        if moved and not rules.recompute_gradient:
            it.restart()

    def with_another_set(self) -> Restart:
        """The state after `update` from which a solve with another feasible set goes on."""
        return replace(self._restart(self.outer), lagrangian=-math.inf, sizes=())

    def result(self, reason: Reason) -> Result:
        """The result with the iterate of the last step."""
        it, qp = self._it, self._problem.qp
        it.watch = None  # it refers to this object: the circle would keep the memory allocated
        it.settle()
        return Result(
            x=qp.wrap(it.x),
            reason=reason,
            counts=it.counts,
            gradient=qp.wrap(it.g),
            projected_gradient_norm=it.projected_gradient_norm,
            multiplier=self._next_multiplier,
            equality_residual=it.equality_residual,
            history=it.history,
        )

    # ------------------------------------------------------------------ parts of a step

    def _inner_stop(self, it: Iterate, own_test: bool) -> Reason | None:
        """The reason to end the inner solve: ‖g^P‖ ≤ min(M ‖Cx - c‖, η), or small residuals."""
        gradient = it.projected_gradient_norm
        if gradient > self._eta:
            return None
        limit = self._target if own_test else self._tolerance
        carried = self._carried(it)
        if carried is not None:  # Cx itself is computed only where it can decide
            size, error = carried
            small = gradient <= limit and (size - error) * self._to_gradient <= limit
            if gradient > self._M * (size + error) and not small:
                return None
        size = self._measure(it)
        if gradient <= self._M * size:
            return Reason.CONVERGED
        small = gradient <= limit and size * self._to_gradient <= limit
        return Reason.CONVERGED if small else None

    def _measure(self, it: Iterate) -> float:
        """‖Cx - c‖, by a multiplication with C where x has moved."""
        if self._measured != it.iterations:
            self._problem.equalities.apply(it.x, self._residual)
            np.subtract(self._residual, self._problem.right, out=self._residual)
            self._measured = it.iterations
            self._size = self._problem.qp.reduction.norm(self._residual)
        it.equality_residual = self._size
        return self._size

    def _carried(self, it: Iterate) -> tuple[float, float] | None:
        """‖Cx‖ by recurrence and a bound on its rounding error; None where c or A prevent this."""
        if it.image is None or self._right_square > 0.0:
            return None
        it.equality_residual = size = it.operator.image_norm(it.image)  # type: ignore[attr-defined]
        self._peak = max(self._peak, size)
        steps = 100.0 + it.iterations
        return size, 1e-3 * size + steps * float(np.finfo(np.float64).eps) * self._peak

    def _raise_penalty(self) -> None:
        """Enlarge ρ in A + ρ CᵀC: the gradient is updated without a multiplication."""
        it, problem = self._it, self._problem
        added = (self._rules.growth - 1.0) * self._rho
        problem.equalities.apply_transpose(added * self._residual, self._change)
        np.add(it.g, self._change, out=it.g)
        problem.equalities.apply_transpose(added * problem.right, self._change)
        np.add(self._augmented.b, self._change, out=self._augmented.b)
        self._rho += added
        penalised = problem.equalities.penalised(problem.qp.operator, self._rho)
        it.replace_operator(penalised, self._inner_norm)
        self._sizes.clear()
        self._previous = -math.inf

    def _lagrangian(self) -> float:
        """L(x, μ, ρ) = ½ xᵀ(g - b_aug) - μᵀc + ρ/2 ‖c‖², without a multiplication."""
        it = self._it
        xg, xb, mc = it.reduction.sums(
            float(np.dot(it.x, it.g)),
            float(np.dot(it.x, it.qp.b)),
            float(np.dot(self._multiplier, self._problem.right)),
        )
        return 0.5 * (xg - xb) - mc + 0.5 * self._rho * self._right_square

    def _restart(self, outer: int) -> Restart:
        """The state after `outer` outer iterations."""
        it = self._it
        return Restart(
            outer, it.x, self._multiplier, self._rho, self._M, self._target, self._previous,
            tuple(self._sizes), replace(it.counts),
        )  # fmt: skip

    def _watch(self, it: Iterate) -> None:
        """Save the state at an inner step where that is due."""
        due, save = self._hooks.due, self._hooks.save
        if save is not None and due is not None and due():
            save(self._restart(it.outer - 1))


def _local_rows(values: Any, rows: int, name: str, qp: SeparableQP) -> Vector:
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
