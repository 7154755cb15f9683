"""How far the front between what sticks and what slides moves when overloaded points let go.

A set that holds too many points overloads those at the front alone: once they slide, each carries
its limit, and the next ones behind the front have to carry the rest. Sets that let go only what is
overloaded move the front by one ring of points each. Instead the force beyond the limit is handed
on: what a point has to let go goes to the nearest points that still stick, and those that it
overloads let go in turn, until all is carried. On a thin rod all of it arrives there. In a body
that spreads forces farther less does; what slides too early slips against its force and sticks
again in the next set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from solver.contact.friction_points import FrictionPoints

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

APART = 10.0
"""Distance that is put between contacts, over the extent of all: none is near another."""


@dataclass(frozen=True)
class FrontOptions:
    """The tuned numbers of the rule, measured by `contact_app.studies.friction_cost`.

    Attributes
    ----------
    rounds
        Times that forces are handed on.
    takers
        Nearest sticking points that take what a point lets go, in the plane and in space.
    shares
        Of the force beyond the limit that is handed on each time, in the plane and in space. With
        all of it a sheet took 231 operator applications, with 0.8 of it 206, with 0.7 of it 237; in
        the plane with less a rod took 13 sets instead of 4.
    carried
        Share of the limits of a contact that its forces may come to, where friction may be all that
        holds a body: a plate near the load at which it slides would be let go altogether.
    """

    rounds: int = 300
    takers: tuple[int, int] = (1, 3)
    shares: tuple[float, float] = (1.0, 0.8)
    carried: float = 0.8


class SlipFront:
    """Contact points of all ranks, and where they are; made collectively.

    Parameters
    ----------
    points
        Those of this rank.
    held
        Whether all bodies are held without friction, so that all points may slide.
    """

    def __init__(
        self,
        points: FrictionPoints,
        comm: MPI.Intracomm,
        held: bool,
        options: FrontOptions | None = None,
    ) -> None:
        self._points, self._comm, self._held = points, comm, held
        self.options = options or FrontOptions()
        counts = comm.allgather(len(points.first))
        begin = sum(counts[: comm.rank])
        self._own = slice(begin, begin + len(points.first))
        places = np.concatenate(comm.allgather(points.places))
        self._sources = np.concatenate(comm.allgather(points.sources))
        extent = float(np.linalg.norm(np.ptp(places, axis=0))) if len(places) else 0.0
        self._places = np.column_stack([places / (extent or 1.0), APART * self._sources])

    def sliding(self, forces: Array, limits: Array, sticks: Mask) -> tuple[Mask, Array]:
        """Points within their limits that let go because others do (collective).

        Parameters
        ----------
        forces : (k,)
            Of the tangential rows.
        limits, sticks : (points,)
            Slip limits, and which points stuck; those beyond their limits let go.

        Returns
        -------
        (points,), and the forces of all once everything is carried, (k,).
        """
        points, comm = self._points, self._comm
        vectors = np.zeros((len(points.first), points.tangents.shape[1]))
        np.add.at(vectors, points.point, forces[:, None] * points.tangents)
        all_forces, all_limits, stuck = (
            np.concatenate(comm.allgather(part)) for part in (vectors, limits, sticks)
        )
        within = stuck & (np.linalg.norm(all_forces, axis=1) <= all_limits)
        after, sticking = self._handed_on(all_forces, all_limits, stuck)
        early = within & ~sticking
        if not self._held:
            early &= self._may_go(all_forces, all_limits)
        own = after[self._own][points.point]
        return early[self._own], np.einsum("ij,ij->i", own, points.tangents)

    def _may_go(self, forces: Array, limits: Array) -> Mask:
        """Points of contacts that are far from sliding as a whole, (points,)."""
        contacts = int(self._sources.max(initial=-1)) + 1
        total = np.zeros((contacts, forces.shape[1]))
        np.add.at(total, self._sources, forces)
        most = self.options.carried * np.bincount(self._sources, limits, contacts)
        return np.asarray((np.linalg.norm(total, axis=1) <= most)[self._sources])

    def _handed_on(self, forces: Array, limits: Array, sticks: Mask) -> tuple[Array, Mask]:
        """Forces (points, d) once all is carried, and which points still stick."""
        forces, sticks, options = forces.copy(), sticks.copy(), self.options
        space = forces.shape[1] - 2
        most, share = options.takers[space], options.shares[space]
        for _ in range(options.rounds):
            size = np.linalg.norm(forces, axis=1)
            over = np.flatnonzero(sticks & (size > limits))
            sticks[over] = False
            left = np.flatnonzero(sticks)
            if not len(over) or not len(left):
                break
            kept = forces[over] * (limits[over] / size[over])[:, None]
            excess, forces[over] = share * (forces[over] - kept), kept
            distance, which = cKDTree(self._places[left]).query(
                self._places[over], np.arange(1, min(most, len(left)) + 1)
            )
            weight = np.where(distance < 0.5 * APART, 1.0 / np.maximum(distance, 1e-12), 0.0)
            total = weight.sum(axis=1, keepdims=True)
            weight = np.divide(weight, total, out=np.zeros_like(weight), where=total > 0.0)
            for takers, shares in zip(which.T, weight.T, strict=True):
                np.add.at(forces, left[takers], shares[:, None] * excess)
        return forces, sticks
