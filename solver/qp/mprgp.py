"""MPRGP: modified proportioning with reduced gradient projections (paper, Algorithm 1).

Minimises f(x) = ½ xᵀAx - bᵀx over l ≤ x ≤ u, or over another separable convex set. While the free
gradient dominates, the iteration minimises over the free components by conjugate gradients; a CG
step that would leave the box is replaced by an expansion of the active set; when the chopped
gradient dominates, a proportioning step releases active components.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver.qp.expansion import Expansion, expansion_by_name
from solver.qp.iterate import Iterate, Watch
from solver.qp.preconditioner import Preconditioner
from solver.qp.result import Monitor, Reason, Result
from solver.qp.separable_qp import SeparableQP
from solver.vectors import Vector

#: Returns the reason to stop, or None to go on.
Stop = Callable[[Iterate], "Reason | None"]

#: The caller's own test of an iterate (local part); must answer the same on all ranks.
AcceptIterate = Callable[[Vector], bool]


@dataclass(frozen=True)
class MPRGP:
    """Solver for box-constrained convex quadratic programs."""

    expansion: str | Expansion = "projcg-safe"
    """Name (see ``expansion_names()``) or object; paper, section 3. The default is the projected CG
    step with a guaranteed descent; the paper's own is ``projcg``."""
    alpha_u: float = 1.9
    """Multiple of the expansion's step length, 0 < α_u ≤ 2 (``projcg`` has none)."""
    gamma: float = 1.0
    """Γ of the proportioning test ‖g^c‖² ≤ Γ² g^rᵀg^f. The paper's inequality 2 prints ‖g^f‖² at
    the right; its counts come from Dostál's g^rᵀg^f, with the step length that an expansion used
    last. The two are one where no step length is in use (``projcg``)."""
    rtol: float = 1e-6
    atol: float = 0.0
    """The solve ends when ‖g^P‖ ≤ max(rtol ‖b‖, atol); where b = 0, relative to the gradient at the
    initial guess."""
    max_iterations: int = 10_000
    """Limit of inner iterations."""
    norm: float | None = None
    """‖A‖ if known; else the power method finds it where the expansion needs it."""
    preconditioner: Preconditioner | None = None
    """Applied to the free gradient; its result is cut to the free components."""
    tighten: float = 0.3
    """Factor on the tolerance where the caller's own test fails."""

    def solve(
        self,
        qp: SeparableQP,
        x0: object = None,
        monitor: Monitor | None = None,
        accept: AcceptIterate | None = None,
        watch: Watch | None = None,
        from_zero: bool = False,
    ) -> Result:
        """Minimise from x0 (projected into the box; zeros if None).

        Parameters
        ----------
        accept : callable of the iterate (local part)
            The caller's own test, called where the tolerance is met. If it fails, the solve goes on
            with the same search directions to `tighten` times the tolerance.
        watch : callable of Iterate
            Called with the iterate after each step, after the monitor.
        from_zero : bool
            Whether x0 is zero and feasible. Its gradient is -b, so that no multiplication is spent;
            the paper's counts include one.

        Raises
        ------
        UnboundedError, IndefiniteError, NotFiniteError
            Naming the component.
        """
        it = Iterate(qp, x0, norm=self.norm, preconditioner=self.preconditioner)
        it.watch = watch
        it.measure_b()
        self.strategy.prepare(it)
        if from_zero:
            it.begin()
        else:
            it.evaluate()
        scale = it.b_norm if it.b_norm > 0.0 else it.reduction.norm(it.g)
        tolerance = max(self.rtol * scale, self.atol)

        def stop(it: Iterate) -> Reason | None:
            nonlocal tolerance
            while it.projected_gradient_norm <= tolerance:
                if it.drift > 0.5 * tolerance:  # the recurrences lost too many digits
                    it.evaluate()
                elif accept is None or tolerance <= self.atol or accept(it.x):
                    return Reason.CONVERGED
                else:
                    tolerance = max(self.tighten * tolerance, self.atol)
            return None

        reason = self.minimise(it, stop, monitor)
        it.settle()
        return Result(
            x=qp.wrap(it.x),
            reason=reason,
            counts=it.counts,
            gradient=qp.wrap(it.g),
            projected_gradient_norm=it.projected_gradient_norm,
            history=it.history,
        )

    @property
    def strategy(self) -> Expansion:
        """The expansion as an object."""
        if isinstance(self.expansion, str):
            return expansion_by_name(self.expansion, self.alpha_u)
        return self.expansion

    def minimise(self, it: Iterate, stop: Stop, monitor: Monitor | None = None) -> Reason:
        """Algorithm 1 from an iterate whose gradient is known and split."""
        expansion = self.strategy
        last = self.max_iterations  # limit over all outer iterations together
        if it.record("start", monitor):
            return Reason.STOPPED
        while (reason := stop(it)) is None:
            if it.iterations >= last:
                return Reason.DIVERGED if it.diverges() else Reason.MAX_ITERATIONS
            if it.iterations == last - self.max_iterations // 2:
                it.mark()
            if it.at_round_off():
                return Reason.ROUND_OFF
            if it.chopped_square > self.gamma**2 * it.reduced_free:
                step = proportioning_step(it)
            else:
                alpha_cg, alpha_f = it.probe()
                if math.isinf(alpha_cg) and math.isinf(alpha_f):
                    it.raise_unbounded()
                if alpha_cg <= alpha_f:
                    step = conjugate_gradient_step(it, alpha_cg)
                else:
                    step = expansion_step(it, expansion, alpha_cg, alpha_f)
            it.iterations += 1
            if it.record(step, monitor):
                return Reason.STOPPED
        return reason


def conjugate_gradient_step(it: Iterate, alpha: float) -> str:
    """Algorithm 2: the minimum along p, which is feasible; the next p is A-orthogonal to p."""
    it.advance(alpha)
    it.conjugate()
    it.counts.cg += 1
    return "cg"


def expansion_step(it: Iterate, expansion: Expansion, alpha_cg: float, alpha_f: float) -> str:
    """Algorithm 3 or 5: a feasible point with more active components."""
    expansion.expand(it, alpha_cg, alpha_f)
    it.counts.expansion += 1
    return "expansion"


def proportioning_step(it: Iterate, length: float = 1.9) -> str:
    """Algorithm 4: the minimum along the chopped gradient, which releases active components.

    The paper leaves the step uncut; a component with two bounds could cross the box, so it ends
    at the first bound it meets. The cost still falls. Where the boundary is curved, the
    chopped gradient may be tangent to it: the step then goes towards the projected gradient step,
    to the minimum along this way (Dostál and Kozubek 2012). Its length is the inverse of the
    curvature along the last such step (E. G. Birgin, J. M. Martínez, M. Raydan, *Nonmonotone
    spectral projected gradient methods on convex sets*, SIAM J. Optim. 10, 2000), at least
    `length` over ‖A‖, by which the cost falls if it is below two: two boxes with friction take 484
    multiplications instead of 676.
    """
    if it.curved:
        it.aim_projected(max(it.spectral_step, length / it.norm))
        alpha, _ = it.probe()
        if it.slope <= 0.0:  # rounding errors hide the slope; the shorter step always contracts
            alpha, it.spectral_step = 1.0, 0.0
        elif it.curvature > 0.0:
            it.spectral_step = it.reduction.sums(float(np.dot(it.p, it.p)))[0] / it.curvature
        it.advance(min(alpha, 1.0), restart=True, snap=True)
        it.counts.proportioning += 1
        return "proportioning"
    it.aim_chopped()
    alpha, alpha_f = it.probe()
    if math.isinf(alpha) and math.isinf(alpha_f):
        it.raise_unbounded()
    it.advance(min(alpha, alpha_f), restart=True, snap=alpha_f < alpha)
    it.counts.proportioning += 1
    return "proportioning"
