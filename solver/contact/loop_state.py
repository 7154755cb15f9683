"""The state of the active-set loop between two sets, and the history of the sets before.

The records are immutable: each step of `solver.contact.active_set.active_set_loop` makes the next
state from the last one.
"""

from dataclasses import dataclass, replace
from typing import Generic

import numpy as np
from mpi4py import MPI

from solver.backend import S, Statuses
from solver.contact.active_set_options import SetHistory
from solver.contact.active_set_update import SetRules
from solver.contact.solve_on_set import Outcome
from solver.qp.result import Counts
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class SlidingSets:
    """Sets on which no point sticks, and the sets after them on which points stick again.

    Friction of given size and direction moves the bodies too far on such sets. If many points stick
    again after two of them, the sliding points yield like springs on the next ones. After that a
    single point that sticks again is enough, and the points yield for more sets each time.
    """

    rows: int = 0
    """Tangential rows of the sliding points if no point sticks on the last set; zero otherwise."""
    followed: int = 0
    """Number of such sets after which many points stuck."""
    sticks: bool = False
    """Whether they stuck after the last such set."""
    yielded: int = 0
    """Number of sets in a row whose sliding points yield, the last one included."""

    def after(
        self, comm: MPI.Intracomm, statuses: Statuses, tangential: Mask, share: float
    ) -> "SlidingSets":
        """The record with one set more (collective).

        Parameters
        ----------
        tangential : (rows,)
            Mask of the tangential rows.
        share
            `ActiveSetOptions.stuck_again`.
        """
        assert statuses.tractions is not None
        sliding_rows = np.count_nonzero(statuses.tractions[tangential])
        local = [int((statuses.holding & tangential).sum()), sliding_rows]
        sticking, sliding = comm.allreduce(np.array(local))
        followed, sticks = self.followed, self.sticks
        if self.rows:
            sticks = bool(sticking >= (1 if followed >= 2 else share * self.rows))
            followed += int(sticks)
        rows = 0 if sticking else int(sliding)
        yields = rows > 0 and followed >= 2 and (sticks or 0 < self.yielded < followed)
        return SlidingSets(rows, followed, sticks, self.yielded + 1 if yields else 0)


@dataclass(frozen=True, eq=False)
class LoopState(Generic[S]):
    """The next set, the outcome of the last one, and the history of all."""

    rules: SetRules[S]
    """Rules by which the set is solved and changed."""
    statuses: Statuses
    """Statuses of the rows on the set."""
    multiplier: Array | None  # (rows,)
    """Multiplier with which the solve begins; None for the smallest one in equilibrium."""
    outcome: Outcome[S]
    """Outcome of the last set."""
    counts: Counts
    """Work of all sets, that of earlier loops included."""
    released: bool = False
    """Whether points of this rank were released before a state showed that they slide."""
    number: int = 0
    """Number of the set, from 0."""
    unheld: int = 0
    """Number of sets in a row that left a body unheld."""
    sliding: SlidingSets = SlidingSets()
    """Sets on which no point sticks."""
    history: SetHistory = SetHistory()
    """The sets before."""

    @property
    def result(self) -> Outcome[S]:
        """The outcome of the last set, with the work of all."""
        return replace(self.outcome, counts=self.counts)
