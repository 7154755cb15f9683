"""Records of SMALBE-M: the state after an outer iteration, the state to restart from, callbacks."""

from collections.abc import Callable
from dataclasses import dataclass

from solver.qp.result import Counts, Monitor
from solver.vectors import Vector


@dataclass(frozen=True)
class OuterState:
    """The end of an outer iteration, for the caller's own test of convergence."""

    iteration: int
    """Number of the outer iteration, from 1."""
    x: Vector
    gradient: Vector
    """The iterate, and the gradient of the augmented Lagrangian with the multiplier that the inner
    solve used, ``A x - b + Cᵀ(multiplier + ρ residual)``: with the *next* multiplier,
    ``next_multiplier``, it is the gradient of the plain Lagrangian. Shape ndarray (local part)."""
    residual: Vector  # ndarray (local rows)
    """Cx - c."""
    multiplier: Vector
    next_multiplier: Vector
    """Shape ndarray (local rows)."""
    transposed_multiplier: Vector  # ndarray (local part)
    """Cᵀ next_multiplier."""
    projected_gradient_norm: float
    residual_norm: float
    rho: float
    M: float
    target: float
    """Penalty, balance and inner tolerance of this outer iteration."""
    counts: Counts


#: The caller's own test; must return the same on all ranks.
Accept = Callable[[OuterState], bool]


@dataclass(frozen=True)
class Restart:
    """The state from which an outer iteration starts or goes on, besides the problem itself."""

    outer: int
    """Outer iterations done."""
    x: Vector
    multiplier: Vector
    """Shape ndarray (local part, local rows)."""
    rho: float
    M: float
    target: float
    """Penalty, balance and inner tolerance in force."""
    lagrangian: float
    """L(x, μ, ρ) at the end of the last outer iteration; -inf where there is no last one."""
    sizes: tuple[float, ...]
    """‖Cx - c‖ by outer iteration since ρ was set."""
    counts: Counts
    """Work so far, including an unfinished outer iteration."""


#: Called with a state; has to copy the arrays that it stores.
Save = Callable[[Restart], None]

#: Whether to save the state at this step; must return the same on all ranks.
Due = Callable[[], bool]


@dataclass(frozen=True)
class Hooks:
    """Callbacks of a solve."""

    monitor: Monitor | None = None
    """Called with each inner step; a true result stops the solve."""
    save: Save | None = None
    """Called with the state at the end of each outer iteration."""
    due: Due | None = None
    """Called after each inner step, after the monitor; returns whether to call `save` there,
    too."""
