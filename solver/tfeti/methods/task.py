"""The arguments of a solve, which the driver passes to its algorithms."""

from __future__ import annotations

from dataclasses import dataclass, field

from solver.contact.active_set_options import ActiveSetOptions
from solver.contact.checkpoint import Checkpoint
from solver.contact.stopping import StoppingRule
from solver.qp.mprgp import MPRGP
from solver.qp.result import Monitor
from solver.tfeti.dual import DualProblem


@dataclass(frozen=True, eq=False)
class Task:
    """A dual problem with the stopping rule, the options and the callbacks of its solve.

    Attributes
    ----------
    rule
        Stopping rule; it may tighten its tolerance during a solve.
    inner
        MPRGP with the options of the user; its limit is for the iterations of all algorithms
        together.
    monitor
        Called with each step; may stop the solve.
    checkpoint
        Checkpoint to save the state to, and to resume from.
    active_sets
        Options of the active-set loop.
    """

    problem: DualProblem
    rule: StoppingRule
    inner: MPRGP
    monitor: Monitor | None = None
    checkpoint: Checkpoint | None = None
    active_sets: ActiveSetOptions = field(default_factory=ActiveSetOptions)
