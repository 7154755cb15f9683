"""Coulomb friction after sets that did not settle: Newton's method with limits that follow forces.

The springs of the augmented Lagrangian (`solver.primal.augmented_rows`) with the limits μ p_n of
their own pressing forces have no energy, but a residual

    r(u) = f - K u - Cᵀ F(λ + W (C u - c)).

1. A Newton step contains the derivative of friction by the jump of the contact row, too (P. Alart,
   A. Curnier, *A mixed formulation for frictional contact problems prone to Newton like solution
   methods*, Comput. Methods Appl. Mech. Eng. 92, 1991). Its matrix is unsymmetric: GMRES solves it,
   preconditioned for the symmetric part by multigrid, or by an LU factor of the whole matrix. The
   step is halved while |r| is not below the largest of the last few.
2. Once a full step leaves the set as it is, λ becomes the force of the springs, and the set is
   solved with springs as stiff as equality. If the set remains, such steps go on to the answer.
   Otherwise they are dropped, and soft steps go on from the new λ: the method of multipliers.

Where the steps make no progress, for instance where bodies are not yet in their places, the
augmented Lagrangian with given limits goes on, whose steps always lower a function.

A hook on a peg with μ = 0.3, 0.8 and 1 (`test_augmented_friction.py`) takes 28, 28 and 44 operator
applications, and 160, 180 and 584 with given limits alone; a collet with μ = 0.3 and 1 56 and 64
instead of 282 and 628. Half a bearing of three rollers, where the steps make no progress, takes 56
instead of 50.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from solver.contact.solve_on_set import Outcome
from solver.primal.augmented import AugmentedLagrangian, LagrangianIterate
from solver.primal.augmented_rows import FrictionRows
from solver.primal.backend import PrimalSet
from solver.primal.gmres import GMRESLimits
from solver.primal.products import multiply_transposed
from solver.primal.state import PrimalState
from solver.qp.result import Reason
from solver.vectors import Mask


@dataclass(frozen=True)
class CoupledOptions:
    """The tuned numbers of the method."""

    linear: GMRESLimits = GMRESLimits()
    halvings: int = 10
    falls: float = 0.1
    recent: int = 3
    """Most halvings of a step, share of its length by which it has to reduce the residual, and
    number of residuals of which the largest counts (L. Grippo, F. Lampariello, S. Lucidi, *A
    nonmonotone line search technique for Newton's method*, 1986). Below the last one steps become
    short where rows change: a hook of 120 by 8 cells with μ = 0.8 takes 312 operator applications
    then, and 60 now; with five halvings it takes 956 with μ = 1, and 52 now."""
    slow: float = 0.99
    most_stalled: int = 5
    """Residual, over the least one of the steps before, from which on a step makes no progress, and
    number of such steps in a row after which the method ends. Rows that change raise it for a
    while: on a collet it rises from 13 to 43,000 loads and falls in four steps."""
    stiff: float = 1e3
    """Stiffness of springs that count as equality, over that of other springs."""
    most_steps: int = 60
    most_stiff: int = 10
    """Most steps, and most steps in a row on one set as stiff as equality: if these are not
    certified, rounding errors leave no digits."""


class CoupledLagrangian(AugmentedLagrangian):
    """The method for a problem with Coulomb friction."""

    coupled = CoupledOptions()

    def _descend(self, now: LagrangianIterate) -> Outcome[PrimalState]:
        outcome = self._coupled(now)
        if outcome.reason is not None:
            return outcome
        self._faint = self.options.faint
        self.backend.begin_at(now.u, now.left)
        return super()._descend(now)

    def _coupled(self, now: LagrangianIterate) -> Outcome[PrimalState]:
        """Newton steps while they make progress; the reason is None if they end without an answer.

        All steps are collective.
        """
        options, soft = self.coupled, cast(FrictionRows, self.rows)
        settled, least, stalled, stiff, residuals = False, np.inf, 0, 0, list[float]()
        for number in range(1, options.most_steps + 1):
            self._steps, p, firm, before = number, self._p(now), self._firm(now), now
            if settled:
                before = replace(now, forces=soft.at(p).forces(p))
                outcome, now = self._stiff_step(soft, before, firm)
            else:
                residuals = [*residuals, self._residual(now)][-options.recent :]
                outcome, now, length = self._soft_step(now, max(residuals))
            if outcome.reason is not None or outcome.state is None:
                return outcome
            same = not self._differ(firm | soft.turned_back(p, self._p(now)), self._firm(now))
            if not settled:
                residual, stiff = self._residual(now), 0
                stalled = stalled + 1 if residual > options.slow * least else 0
                least = min(least, residual)
                if stalled == options.most_stalled:
                    break
                self._soft_set, settled = self._last, same and length == 1.0
                continue
            state = self._soft_set.state_at(now.u, now.left, now.forces)
            if self.test.required_reduction(state) <= 1.0 and self.test.accept(state):
                return replace(outcome, state=state, reason=Reason.ACCEPTED, counts=self._counts)
            least, stalled, residuals = np.inf, 0, []
            if not same and not stiff:
                now = before
            settled, stiff = same, stiff + 1
            if stiff > options.most_stiff:
                break
            self.backend.begin_at(now.u, now.left)
        return replace(outcome, counts=self._counts)

    def _firm(self, now: LagrangianIterate) -> Mask:
        """Contact rows that press, and rows of points that stick, (rows,)."""
        p = self._p(now)
        return cast(FrictionRows, self.rows).at(p).firm(p)

    def _residual(self, now: LagrangianIterate) -> float:
        """The 2-norm of r, without the forces of tied rows (collective)."""
        p = self._p(now)
        forces = cast(FrictionRows, self.rows).at(p).forces(p)
        left = now.left - multiply_transposed(self.system.C, forces)
        return self._norm(self._tied.apply_transpose(left))

    def _soft_step(
        self, now: LagrangianIterate, before: float
    ) -> tuple[Outcome[PrimalState], LagrangianIterate, float]:
        """A Newton step, halved while its residual is not below one before, and its length."""
        outcome = self._coupled_on_set(now)
        if outcome.reason is not None or outcome.state is None:
            return outcome, now, 0.0
        left, trials = self.backend.left(), list[tuple[float, float]]()
        for k in range(self.coupled.halvings + 1):
            length = 0.5**k
            u = now.u + length * (outcome.state.u - now.u)
            trial = self._iterate(u, now.left + length * (left - now.left), now.forces)
            trials.append((self._residual(trial), length))
            if trials[-1][0] < (1.0 - self.coupled.falls * length) * before:
                break
        else:
            length = min(trials)[1]
        self._damp(length)
        return outcome, self._moved(now, outcome.state, length), length

    def _stiff_step(
        self, soft: FrictionRows, before: LagrangianIterate, firm: Mask
    ) -> tuple[Outcome[PrimalState], LagrangianIterate]:
        """The answer of a set that nearly holds with equality.

        Parameters
        ----------
        before
            An iterate with the forces of its springs.
        firm : (rows,)
            Its set, whose rows have no jump.
        """
        held = replace(before, jumps=np.where(soft.rows & firm, 0.0, before.jumps))
        self.rows, faint, after = soft.stiffened(self.coupled.stiff), self._faint, before
        self._faint = self.options.faint / self.coupled.stiff
        outcome = self._coupled_on_set(held)
        if outcome.reason is None and outcome.state is not None:
            after = self._moved(before, outcome.state, 1.0)
            p = self._p(after)
            after = replace(after, forces=self.rows.at(p).forces(p))
        self.rows, self._faint = soft, faint
        return outcome, after

    def _coupled_on_set(self, now: LagrangianIterate) -> Outcome[PrimalState]:
        """The solution of a Newton step (collective); none where nothing holds some body."""
        rows, p = cast(FrictionRows, self.rows), self._p(now)
        at_limits, offset = rows.at(p), now.jumps + self.system.c

        def solve(on_set: PrimalSet) -> Reason:
            if self._inner().max_iterations <= 0:
                return Reason.MAX_ITERATIONS
            coupling, monitor = at_limits.coupling(p), self._monitor(on_set.statuses)
            stops = on_set.solve_coupled(coupling, offset, self.coupled.linear, monitor)
            return Reason.STOPPED if stops else Reason.CONVERGED

        self.rows = at_limits
        outcome = self._on_set(now, solve)
        self.rows = rows
        return outcome
