"""The equilibrium of a group of bodies that may touch each other or are tied."""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.linalg import block_diag

from solver.contact.equilibrium import (
    BodyBalance,
    FrictionCones,
    balance,
    by_body,
    held_motions,
    holds,
    loose_motions,
    spanned,
)
from solver.vectors import Array, Mask


@dataclass(frozen=True, eq=False)
class GroupRows:
    """This rank's rows on the rigid motions of a group of bodies."""

    held: list[Array]  # one (k, motions) array per body
    """Rows that hold each body by itself."""
    joined: Array  # (k, bodies · motions)
    """Rows that hold the bodies together, or on request."""
    contact: Array  # (rows, bodies · motions)
    moved: Array | None  # (rows · dimension, bodies · motions) or None
    """Relative motion of the sides of the contact rows; None if a body of the group is rigid."""
    cones: FrictionCones
    """Friction of the contact rows."""

    @property
    def holding(self) -> Array:
        """All rows that hold bodies without contact, (k, bodies · motions)."""
        return np.concatenate([block_diag(*self.held), self.joined])

    def balance(self, comm: MPI.Intracomm, load: Array, size: float) -> BodyBalance:
        """The equilibrium of the group under a load, as `balance` has it (collective)."""
        return balance(comm, self.holding, self.contact, load, size, self.cones)

    def balances(self, comm: MPI.Intracomm, group: BodyBalance, elastic: Mask) -> list[BodyBalance]:
        """The equilibrium of each body of a group that is in equilibrium (collective).

        Parameters
        ----------
        elastic : (bodies,)
            Bodies that are not rigid; only these have loose motions.
        """
        holding, count = self.holding, len(self.held)
        m = holding.shape[1] // count
        sliding = np.zeros((holding.shape[1], 0))
        if self.moved is not None:
            resisting = np.concatenate([self.contact, self.cones.slips])
            sliding = loose_motions(comm, holding, resisting, self.moved)
        # the motions of elastic bodies in the span of slides and free motions
        both = np.hstack([sliding, group.free_motions])
        loose = spanned(np.where(np.repeat(elastic, m)[:, None], both, 0.0)).reshape(count, m, -1)
        allowed = held_motions(comm, holding).reshape(count, m, -1)
        free = by_body(group.free_motions, m)
        return [
            BodyBalance(
                free[nth], None, holds(comm, self.held[nth]), group.held, loose[nth], allowed[nth]
            )
            for nth in range(count)
        ]
