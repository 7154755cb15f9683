"""The result of a solver: solution, reason why it ended, counts and history."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple


class Reason(Enum):
    """Reasons why a solve ended; the value is a sentence for the user."""

    CONVERGED = "The projected gradient and the equality residual are below the tolerance."
    ACCEPTED = "The caller's own test accepted the solution."
    MAX_ITERATIONS = (
        "The limit of inner iterations was reached before the tolerance; "
        "raise max_iterations or the tolerance, or scale the problem better."
    )
    MAX_OUTER_ITERATIONS = (
        "The limit of outer iterations was reached before the tolerance; "
        "are the equalities consistent with the bounds?"
    )
    ROUND_OFF = (
        "The gradient is at the level of rounding errors and cannot be reduced further; "
        "the tolerance asks for more digits than the data hold."
    )
    DIVERGED = (
        "The iterates kept growing along a direction of next to no curvature while the cost fell: "
        "it seems to be unbounded below."
    )
    UNSETTLED = "The active sets did not settle."
    SLIDES = (
        "Friction does not hold a body: in one active set after the other no contact point sticks, "
        "and the body slides on. Smaller loads or more friction may hold it."
    )
    STOPPED = "The monitor asked to stop; the result holds the last iterate."

    @property
    def converged(self) -> bool:
        """Whether the tolerance, or the caller's own test, was met."""
        return self in (Reason.CONVERGED, Reason.ACCEPTED)

    def __str__(self) -> str:
        return self.value


@dataclass
class Counts:
    """Work done, counted as the paper counts it (its Table 1 and Appendix A).

    Every row satisfies ``hessian = gradients + cg + k * expansion + proportioning``, with
    ``gradients`` the multiplications for initial gradients (one per solve, or per outer iteration
    where SMALBE recomputes it) and ``k`` those of an expansion step: 2, or 3 for ``opt``.
    """

    hessian: int = 0
    cg: int = 0
    expansion: int = 0
    proportioning: int = 0
    outer: int = 0
    #: multiplications of the power method; as in the paper, not part of ``hessian``
    norm_estimation: int = 0

    @property
    def inner(self) -> int:
        """Inner iterations: CG, expansion and proportioning steps together."""
        return self.cg + self.expansion + self.proportioning

    def __add__(self, other: "Counts") -> "Counts":
        """Work of two solves."""
        return Counts(**{name: value + getattr(other, name) for name, value in vars(self).items()})


class Step(NamedTuple):
    """One inner iteration as the monitor sees it."""

    outer: int  #: outer iteration, from 1 in SMALBE; 0 in plain MPRGP
    iteration: int  #: inner iterations so far, over all outer ones
    type: str  #: "start", "cg", "expansion" or "proportioning"
    projected_gradient_norm: float
    equality_residual: float  #: ||Cx - c|| when last evaluated, 0 without equalities
    active: int  #: components at a bound, over all ranks
    seconds: float  #: seconds since the solve began
    active_set: int = 0  #: number of the active set, from 1; 0 in methods without
    active_rows: int | None = None  #: contact rows that are closed, over all ranks


#: Called for every step; a true result stops the solve.
Monitor = Callable[[Step], Any]


@dataclass(frozen=True)
class Result:
    """Outcome of a solve."""

    x: Any  # ndarray (local part) or PETSc.Vec, the kind of the problem's b
    """Last iterate; always within the bounds."""
    reason: Reason
    """An enum whose value is a sentence; ``reason.converged`` says whether the solve succeeded."""
    counts: Counts
    gradient: Any  # ndarray (local part)
    """Gradient of the cost; in SMALBE of the augmented Lagrangian, which at the end is ``A x - b +
    C^T multiplier``."""
    projected_gradient_norm: float
    """||g^P||, over all ranks."""
    multiplier: Any = None  # ndarray (local rows of C) or None
    """Multiplier of the equalities C x = c."""
    equality_residual: float = 0.0
    """||C x - c||, over all ranks."""
    history: list[Step] = field(default_factory=list, repr=False)

    @property
    def converged(self) -> bool:
        """Whether the solve met its tolerance."""
        return self.reason.converged
