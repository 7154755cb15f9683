"""The arguments of a solve, handed from the driver to its algorithms."""

from __future__ import annotations

from dataclasses import dataclass, field

from solver.contact.active_set import ActiveSetOptions
from solver.contact.checkpoint import Checkpoint
from solver.contact.stopping import StoppingRule
from solver.qp.mprgp import MPRGP
from solver.qp.result import Monitor
from solver.tfeti.dual import DualProblem


@dataclass(frozen=True, eq=False)
class Task:
    """A dual problem, when its answer is good enough, and who listens.

    Attributes
    ----------
    rule
        Decides when an answer is good enough; it may tighten its tolerance during a solve.
    inner
        MPRGP with the options of the user; limits the iterations of all algorithms together.
    monitor
        Sees each step; may stop the solve.
    checkpoint
        Where the state is saved, and where a stopped solve goes on from.
    active_sets
        Options of the active-set loop.
    """

    problem: DualProblem
    rule: StoppingRule
    inner: MPRGP
    monitor: Monitor | None = None
    checkpoint: Checkpoint | None = None
    active_sets: ActiveSetOptions = field(default_factory=ActiveSetOptions)
