"""The body of each subdomain, interface unknown and row, and the sizes of each body.

A certificate is only as good as its reference sizes. A weak body beside a strong body has smaller
displacements, loads and energy. Relative to those of the strong body, an entirely wrong answer of
the weak body would be a negligible error. So all relative numbers are measured body by body. Bodies
that can touch each other form a group, directly or through other bodies. They support one another,
and the duality gap bounds the error of a group as a whole.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from solver.vectors import Array, Ints, Mask

FAINT = 1e-6
"""Smallest reference of a body, as a share of the largest displacement or load in its group.

In contact with a body a million times as soft, its own displacement would be below the solver's
error in that of the other body.
"""

MOTIONLESS = 1e-9
"""A body with a smaller displacement, over that without constraint forces, counts as motionless.

Its displacement has no correct digits.
"""


@dataclass(frozen=True, eq=False)
class Bodies:
    """The bodies of this rank's subdomains, unknowns and rows."""

    groups: Ints  # (bodies,)
    """Number of the group of each body, from 0."""
    members: tuple[Ints, ...]  # one (members,) array for each class
    """Body of each subdomain."""
    columns: Ints  # (interface,)
    """Body of each interface unknown."""
    rows: Ints  # (dual, 2)
    """The two bodies that a row of B connects; twice the same body for rows of one body."""
    rigid: Mask  # (bodies,)
    """Mask of the bodies without stiffness. Their displacements are no reference for the bodies
    that they touch."""

    @property
    def count(self) -> int:
        """Bodies of the scene."""
        return len(self.groups)

    @property
    def group_count(self) -> int:
        """Groups of the scene."""
        return int(self.groups.max()) + 1

    def by_group(self, values: Array) -> Array:
        """The largest of values (bodies,) in each group, (groups,)."""
        result = np.zeros(self.group_count)
        np.maximum.at(result, self.groups, values)
        return result

    def sum_by_group(self, values: Array) -> Array:
        """Sums of values (bodies,) in each group, (groups,)."""
        return np.bincount(self.groups, values, self.group_count).astype(np.float64)

    def of_rows(self, values: Array) -> Array:
        """The larger of the values (bodies,) of the bodies of each row, (dual,).

        If one body is rigid, the value of the other body.
        """
        if self.count == 1:
            return np.full(len(self.rows), values[0])
        if not self.rigid.any():
            return self._larger(values)
        elastic = self._larger(np.where(self.rigid, 0.0, values))
        return np.where(self.rigid[self.rows].all(axis=1), values[self.rows[:, 0]], elastic)

    def _larger(self, values: Array) -> Array:
        first, second = self.rows.T  # not by max along an axis of two: it is ten times as slow
        return np.asarray(np.maximum(values[first], values[second]))

    def sum_members(self, values: Sequence[Array]) -> Array:
        """This rank's sums by body, (bodies,), of one value per subdomain, in arrays by class."""
        result = np.zeros(self.count)
        for body, each in zip(self.members, values, strict=True):
            result += np.bincount(body, each, self.count)
        return result

    def sum_rows(self, values: Array, rows: Mask) -> Array:
        """Sums by body, (bodies,), of values (dual,) of some rows.

        Rows of a pair count for both bodies.
        """
        first, second = self.rows[rows].T
        result = np.bincount(first, values[rows], self.count)
        other = first != second
        result = result + np.bincount(second[other], values[rows][other], self.count)
        return result.astype(np.float64)

    def largest_on_interface(self, comm: MPI.Intracomm, values: Array) -> Array:
        """Largest magnitude of values (interface,) by body, (bodies,) (collective)."""
        local = np.zeros(self.count)
        begins = run_begins(self.columns)
        if len(begins):
            most = np.maximum.reduceat(np.abs(values), begins)
            np.maximum.at(local, self.columns[begins], most)
        return largest(comm, local)


def run_begins(columns: Ints) -> Ints:
    """First indices of the runs of unknowns of one body, given the body of each, (interface,)."""
    new = np.ones(len(columns), bool)
    new[1:] = columns[1:] != columns[:-1]
    return np.flatnonzero(new)


def body_lengths(bodies: Bodies, displacement: Array, free: Array) -> Array:
    """The reference length of each body, (bodies,); never zero.

    The reference is the largest displacement of the body. If the body does not move, it is the
    displacement that the body would have without constraint forces. It is at least a small share of
    the largest displacement in the group. For a rigid body it is the largest in its group.

    Parameters
    ----------
    displacement : (bodies,)
        Largest displacement of each body.
    free : (bodies,)
        Largest displacement of each body without constraint forces.
    """
    values = np.where(displacement > MOTIONLESS * free, displacement, free)
    if bodies.rigid.any():
        elastic = np.where(bodies.rigid, 0.0, values)
        values = np.where(bodies.rigid, bodies.by_group(elastic)[bodies.groups], values)
    return reference_sizes(bodies, values)


def reference_sizes(bodies: Bodies, values: Array) -> Array:
    """Values (bodies,), raised to a small share of the largest in the group.

    One in place of zero.
    """
    values = np.maximum(values, FAINT * bodies.by_group(values)[bodies.groups])
    return np.where(values > 0.0, values, 1.0)


def largest(comm: MPI.Intracomm, values: Array) -> Array:
    """Largest of each entry over all ranks (collective); NaN wins."""
    return np.asarray(np.max(comm.allgather(values), axis=0))
