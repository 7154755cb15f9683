"""Friction at contact points: tangential rows, and the discs in which their multipliers lie.

A contact point has one normal row and, with friction, one tangential row for each direction in
which its node can slide. With λ_n and λ_t the forces of these rows Coulomb's law requires

    |λ_t| ≤ μ λ_n,      Tresca's for      |λ_t| ≤ s,

and both require a slip w = 0 where |λ_t| is below its limit, and a slip along λ_t where |λ_t| is at
its limit. The friction force on the body is -λ_t, against the slip (N. Kikuchi, J. T. Oden,
*Contact Problems in Elasticity*, 1988, chapters 10 and 13). With prescribed slips c, w = B u - c.
"""

from dataclasses import dataclass

import numpy as np

from solver.contact.friction_points import FrictionPoints
from solver.problem.constraints.conditions import ContactRows, points_of
from solver.vectors import Array, Ints, Mask, runs


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """This rank's tangential rows, sorted by node and then by contact."""

    rows: ContactRows
    """Rows of slips, Σ value · ū; their `normals` are minus the tangents."""
    coefficients: Array  # (rows,)
    """μ of Coulomb's law; 0 where the slip limit is given."""
    limits: Array  # (rows,)
    """Slip limit of the point, a force; 0 where it is μ λ_n."""
    acts: bool = True
    """Whether a contact of any rank has friction."""

    @classmethod
    def none(cls, contact: ContactRows) -> "FrictionRows":
        """No rows, of contacts without friction."""
        return cls(contact.none(), np.zeros(0), np.zeros(0), acts=False)

    def of(self, keep: Mask) -> "FrictionRows":
        """Some of the rows, (rows,)."""
        chosen = self.coefficients[keep], self.limits[keep]
        return FrictionRows(self.rows.of(keep), *chosen, self.acts)

    def at(self, contact: ContactRows) -> "FrictionRows":
        """The rows of points whose normal row is one of some contact rows."""
        return self.of(self.places(contact) >= 0)

    def places(self, contact: ContactRows) -> Ints:
        """Number (rows,) of the contact row of each row's point; -1 without a contact row."""
        count = len(contact.nodes)
        keys = [np.stack([part.nodes, part.sources]) for part in (contact, self.rows)]
        every, place = np.unique(np.hstack(keys), axis=1, return_inverse=True)
        place = place.reshape(-1)
        number = np.full(every.shape[1], -1, np.int64)
        number[place[:count]] = np.arange(count)
        return number[place[count:]]


def friction_points(
    friction: FrictionRows, contact: ContactRows, tangential: Mask, inequality: Mask
) -> FrictionPoints:
    """Contact points with friction: the normal row of each tangential row is found.

    Parameters
    ----------
    tangential, inequality : (dual,)
        Masks of the rows of B that `friction` and `contact` describe.
    """
    normal = friction.places(contact)
    point = points_of(friction.rows)
    _, first = np.unique(point, return_index=True)
    normals, nodes = np.flatnonzero(inequality), friction.rows.nodes[first]
    begins, ends = (np.searchsorted(contact.nodes, nodes, side) for side in ("left", "right"))
    shared, other_rows = (
        np.repeat(np.arange(len(first)), ends - begins),
        runs(begins, ends - begins),
    )
    other = other_rows != normal[first][shared]
    pressed = _without_room(friction.rows, contact, normal, point)
    shared = np.concatenate([shared[other], pressed])
    other_rows = np.concatenate([other_rows[other], normal[first][pressed]])
    return FrictionPoints(
        rows=np.flatnonzero(tangential), normals=normals[normal],
        point=point, first=first, coefficients=friction.coefficients[first],
        limits=friction.limits[first], spread=friction.rows.spread,
        normal_spread=contact.spread[normal],
        shared=shared, other_rows=normals[other_rows],
        places=friction.rows.points[first], sources=friction.rows.sources[first],
        tangents=-friction.rows.normals, acts=friction.acts,
    )  # fmt: skip


def _without_room(rows: ContactRows, contact: ContactRows, normal: Ints, point: Ints) -> Ints:
    """Points whose node has fewer free components than rows.

    While such a point is closed, prescribed displacements fix its slip.

    Parameters
    ----------
    normal, point : (rows,), (rows,)
        Contact row and point of each tangential row.
    """
    count = int(point.max(initial=-1)) + 1
    of_contact = np.full(len(contact.nodes), -1, np.int64)
    of_contact[normal] = point
    entries = rows.entries, contact.entries
    points = np.concatenate([point[entries[0].row], of_contact[entries[1].row]])
    places = np.hstack([np.stack([part.node, part.component]) for part in entries])
    some = points >= 0
    unknowns = np.unique(places[:, some], axis=1, return_inverse=True)[1].reshape(-1)
    pairs = np.unique(np.stack([points[some], unknowns]), axis=1)
    unknowns_of_point = np.bincount(pairs[0], minlength=count)
    return np.flatnonzero(unknowns_of_point < np.bincount(point, minlength=count) + 1)
