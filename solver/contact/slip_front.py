"""Prediction of the front between sticking and sliding points when overloaded points slide.

If too many points stick, only the points at the front are overloaded. Once they slide, each carries
its limit, and the points behind the front have to carry the rest. So each set would move the front
by one ring of points only. Instead the force beyond the limit of a point is passed on to the
nearest points that still stick. Points that this overloads slide in turn, until all force is
carried. On a thin rod all of the force arrives at the nearest points. In a body that spreads forces
farther, less arrives. A point that is released too early slips against its force and sticks again
in the next set.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from solver.contact.friction_points import FrictionPoints
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class FrontOptions:
    """The tuned numbers of the rule, measured by `contact_app.studies.friction_cost`."""

    rounds: int = 300
    """Number of times that forces are passed on."""
    takers: tuple[int, int] = (1, 3)
    """Number of nearest sticking points that take the excess force of a point, in the plane and in
    space."""
    shares: tuple[float, float] = (1.0, 0.8)
    """Share of the excess force that is passed on each time, in the plane and in space. A sheet in
    space took 231 operator applications with a share of 1, 206 with 0.8 and 237 with 0.7. A rod in
    the plane took 4 sets with a share of 1 and 13 with less."""
    separation: float = 10.0
    """Distance added between contacts, over the extent of all points, so that no force passes
    between them."""
    carried: float = 0.8
    """If only friction may hold a body, the rule applies to contacts whose forces are below this
    share of their limits. Otherwise a plate near its sliding load would be released altogether."""


class SlipFront:
    """Contact points of all ranks with their positions; made collectively.

    Parameters
    ----------
    points
        Contact points with friction of this rank.
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
        self._of_rank = slice(begin, begin + len(points.first))
        places = np.concatenate(comm.allgather(points.places))
        self._sources = np.concatenate(comm.allgather(points.sources))
        extent = float(np.linalg.norm(np.ptp(places, axis=0))) if len(places) else 0.0
        contacts = self.options.separation * self._sources
        self._places = np.column_stack([places / (extent or 1.0), contacts])

    def sliding(self, forces: Array, limits: Array, sticks: Mask) -> tuple[Mask, Array]:
        """Points within their limits that slide because other points do (collective).

        Parameters
        ----------
        forces : (k,)
            Friction forces of the tangential rows.
        limits, sticks : (points,), (points,)
            Slip limits (forces), and the points that stuck. Points beyond their limits slide.

        Returns
        -------
        Mask (points,) of these points, and all friction forces after the redistribution, (k,).
        """
        points, comm = self._points, self._comm
        vectors = np.zeros((len(points.first), points.tangents.shape[1]))
        np.add.at(vectors, points.point, forces[:, None] * points.tangents)
        all_forces, all_limits, stuck = (
            np.concatenate(comm.allgather(part)) for part in (vectors, limits, sticks)
        )
        within = stuck & (np.linalg.norm(all_forces, axis=1) <= all_limits)
        after, sticking = self._redistributed(all_forces, all_limits, stuck)
        early = within & ~sticking
        if not self._held:
            early &= self._far_from_sliding(all_forces, all_limits)
        slips = after[self._of_rank][points.point]
        return early[self._of_rank], np.einsum("ij,ij->i", slips, points.tangents)

    def _far_from_sliding(self, forces: Array, limits: Array) -> Mask:
        """Points of contacts that are far from sliding as a whole, (points,)."""
        contacts = int(self._sources.max(initial=-1)) + 1
        total = np.zeros((contacts, forces.shape[1]))
        np.add.at(total, self._sources, forces)
        most = self.options.carried * np.bincount(self._sources, limits, contacts)
        return np.asarray((np.linalg.norm(total, axis=1) <= most)[self._sources])

    def _redistributed(self, forces: Array, limits: Array, sticks: Mask) -> tuple[Array, Mask]:
        """Forces (points, d) after the redistribution, and the points that still stick."""
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
            at_limit = forces[over] * (limits[over] / size[over])[:, None]
            excess, forces[over] = share * (forces[over] - at_limit), at_limit
            distance, which = cKDTree(self._places[left]).query(
                self._places[over], np.arange(1, min(most, len(left)) + 1)
            )
            near = distance < 0.5 * options.separation
            weight = np.where(near, 1.0 / np.maximum(distance, 1e-12), 0.0)
            total = weight.sum(axis=1, keepdims=True)
            weight = np.divide(weight, total, out=np.zeros_like(weight), where=total > 0.0)
            for takers, shares in zip(which.T, weight.T, strict=True):
                np.add.at(forces, left[takers], shares[:, None] * excess)
        return forces, sticks
