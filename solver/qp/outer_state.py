"""Outer iterations of SMALBE-M: what one ends with, what the next goes on from, who is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from solver.qp.result import Counts, Monitor
from solver.vectors import Vector


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
class Hooks:
    """Who is told of a solve while it runs.

    Attributes
    ----------
    monitor
        Told of each inner step; a true answer stops the solve.
    save : callable of Restart
        Told of the state at the end of each outer iteration.
    due : callable
        Asked after each inner step, after the monitor, whether `save` is told of the state there,
        too.
    """

    monitor: Monitor | None = None
    save: Save | None = None
    due: Due | None = None
