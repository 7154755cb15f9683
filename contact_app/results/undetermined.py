"""Rigid motions along which an answer may be moved: its place is one of several.

A part that is held by contact alone may press at so few points that it can still tilt or shift
until another point closes: a dovetail with play, a bolt that floats in its bores. Let v be a rigid
motion of bodies that may touch, with D v = 0 on held rows, N v = 0 on the contact rows that press
and T v = 0 on the tangential rows of points with a slip limit. It strains nothing, nothing slips,
and as the forces of these rows balance the loads, fᵀ v = 0. So all u + t v with gaps
g - N (u + t v) ≥ 0 have one energy, one stress and one contact force:

    max_{(N v)_i < 0} g_i / (N v)_i ≤ t ≤ min_{(N v)_i > 0} g_i / (N v)_i,

with g_i the distance left at row i. `free_motions` reports motions that no row resists.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI
from scipy import sparse

from contact_app.model.equilibrium import (
    directions_in_words,
    groups_in_contact,
    motion_size,
    upward,
)
from contact_app.model.geometry import Geometry
from solver.contact.equilibrium import undetermined_motions
from solver.contact.solution import Solution
from solver.problem.constraints.conditions import ContactRows
from solver.rigid_motions import MOTIONS
from solver.tfeti.dual import DualProblem
from solver.vectors import Array, Ints, largest_magnitude

PRESSING = 1e-6
"""Contact force over the largest of all below which a point does not hold a body in its place."""

SMALL_PLAY = 0.05
"""Play over the largest displacement of the body, below which no warning names it."""

SEEN = 1e-9
"""Coefficient of a row along a motion, over the largest, below which it is a rounding error."""


@dataclass(frozen=True, eq=False)
class Undetermined:
    """A motion of one body, with others perhaps, that leaves energy and forces as they are."""

    name: str
    along: str
    """The motion in words."""
    reach: float
    """How far its points can move, from one end to the other; infinite where only one end stops
    them."""

    @property
    def play(self) -> str:
        """The motion as a clause of the warning."""
        play = "can move without limit, one way,"
        if np.isfinite(self.reach):
            play = f"has a play of {self.reach:.3g}"
            if "turn" in self.along:
                play += ", at its point that moves most,"
        return f"{self.name} {play} along {self.along}"


def play_warnings(motions: list[Undetermined], remedy: str) -> list[str]:
    """One sentence that names every body once, with its largest play; none without plays.

    Parameters
    ----------
    remedy
        What determines the position.
    """
    if not motions:
        return []
    largest: dict[str, Undetermined] = {}
    for one in sorted(motions, key=lambda one: -one.reach):
        largest.setdefault(one.name, one)
    motion, it = ("this motion", "it") if len(largest) == 1 else ("these motions", "them")
    return [
        f"{'; '.join(one.play for one in largest.values())}: the contact forces do not resist "
        f"{motion} and no load drives {it}. Of all positions with the same stresses and contact "
        f"forces, the answer has the one that moves {it} least; {remedy} determines the position"
    ]


@dataclass(frozen=True, eq=False)
class Movable:
    """Bodies that may move."""

    groups: Sequence[Ints]
    """Numbers of the bodies of each group that may touch."""
    names: Sequence[str]
    size_of: Callable[[int, Array], float]
    """Largest displacement of a body, by its number, in a rigid motion (motions,)."""

    @classmethod
    def of(cls, geometry: Geometry) -> "Movable":
        """The bodies of a scene."""
        size_of = partial(motion_size, geometry.bodies)
        return cls(groups_in_contact(geometry), geometry.body_names, size_of)

    def fastest(self, group: Ints, motion: Array) -> tuple[int, str, float]:
        """The body of a group that moves most in a motion, its motion in words, and its size."""
        parts = motion.reshape(len(group), -1)
        speeds = [self.size_of(int(b), part) for b, part in zip(group, parts, strict=True)]
        most = int(np.argmax(speeds))
        return int(group[most]), directions_in_words(upward(parts[most][:, None])), speeds[most]


def undetermined(
    problem: DualProblem,
    solution: Solution,
    motions_of: Callable[[ContactRows], sparse.csr_matrix],
    bodies: Movable,
) -> list[Undetermined]:
    """The motions of bodies that an answer leaves open (collective).

    Parameters
    ----------
    motions_of
        Rows applied to the rigid motions of each body, (rows, bodies · motions).
    """
    free, contact, comm = problem.free_motions, problem.contact, problem.comm
    if free is None:
        return []
    m = MOTIONS[problem.dimension]
    left = -problem.jumps(solution.displacements)[problem.inequality]
    left = np.maximum(left / contact.spread, 0.0)
    force = solution.multiplier[problem.inequality] * contact.spread
    largest = comm.allreduce(float(force.max(initial=0.0)), op=MPI.MAX)
    seen, points, friction = motions_of(contact), problem.friction, problem.shared.friction
    resists = points.slip_limits(solution.multiplier) > PRESSING * largest
    rough = motions_of(friction.rows)[resists[points.point]]
    motions = []
    for group in bodies.groups:
        columns = (group[:, None] * m + np.arange(m)).ravel()
        of_group = seen[:, columns]
        acting = np.diff(of_group.indptr) > 0
        closing, stuck = of_group[acting].toarray(), rough[:, columns].toarray()
        holds = np.append(force[acting] > PRESSING * largest, np.ones(len(stuck), bool))
        allowed, loose = (
            np.concatenate([some[b] for b in group])
            for some in (free.loose.allowed, free.loose.along)
        )
        dense = np.vstack([closing, stuck])
        for motion in undetermined_motions(comm, allowed, dense, holds, loose).T:
            body, along, speed = bodies.fastest(group, motion)
            reach = speed * reach_of(comm, closing @ motion, left[acting], SEEN)
            if reach > SMALL_PLAY * solution.measures.displacements[body]:
                motions.append(Undetermined(bodies.names[body], along, reach))
    return motions


def reach_of(comm: MPI.Intracomm, closing: Array, left: Array, seen: float) -> float:
    """Length of the interval of t in which no row closes, left - t closing ≥ 0 (collective).

    Parameters
    ----------
    closing, left : (rows,)
    seen
        Share of the largest speed of closing, below which a row does not count.
    """
    size, reach = largest_magnitude(comm, closing), 0.0
    for toward in (closing, -closing):
        closes = toward > seen * size
        steps = left[closes] / toward[closes]
        reach += comm.allreduce(float(steps.min(initial=np.inf)), op=MPI.MIN)
    return reach
