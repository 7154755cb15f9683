"""Data exchange with other programs for scenes with friction: plain arrays in files.

This module imports no solver, so that processes of other programs start fast.
"""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from meshes.arrays import Array, Ints


class Fixed(NamedTuple):
    """Prescribed displacement of a side along one axis, times a factor if it names one."""

    body: int
    side: str
    axis: int
    value: float
    name: str


@dataclass(frozen=True, eq=False)
class PlainBody:
    """A mesh with its sides and one elastic material.

    Attributes
    ----------
    cell, degree
        ``triangle``, ``tetrahedron`` or ``hexahedron``, of first or second order.
    points : (nodes, d)
    cells : (cells, nodes per cell)
        In VTK order.
    sides
        Numbers (facets, nodes per facet) by name, vertices first.
    """

    cell: str
    degree: int
    points: Array
    cells: Ints
    sides: dict[str, Ints]
    young: float
    poisson: float


@dataclass(frozen=True, eq=False)
class PlainScene:
    """Elastic bodies, one contact, and a history of factors.

    Attributes
    ----------
    on, against
        Body and side; without `against` the floor, where the last coordinate is zero.
    fixed
        Displacements.
    pressure
        Body, side and value, times the factor ``press``.
    factors
        Load factors of each increment.
    forces
        Body, flat side and total force, which act in full.
    loose
        Bodies that contact alone holds.
    push
        Displacement that CalculiX applies first, to bring bodies into contact.
    penalty
        Stiffness of contact in CalculiX, force per volume; chosen unless given.
    """

    bodies: list[PlainBody]
    coefficient: float
    on: tuple[int, str]
    against: tuple[int, str] | None
    fixed: list[Fixed]
    pressure: tuple[int, str, float] | None
    factors: list[dict[str, float]]
    forces: Sequence[tuple[int, str, Sequence[float]]] = ()
    loose: Sequence[int] = ()
    push: Fixed | None = None
    penalty: float | None = None

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return self.bodies[0].points.shape[1]

    def save(self, file: Path) -> None:
        """For a process of this study alone."""
        file.write_bytes(pickle.dumps(self))

    @staticmethod
    def load(file: Path) -> PlainScene:
        """Read the file that `save` wrote."""
        scene: PlainScene = pickle.loads(file.read_bytes())
        return scene


@dataclass(frozen=True, eq=False)
class Outcome:
    """The answer of a program at the end of the history.

    Attributes
    ----------
    points, displacement
        (nodes, d) of each body.
    places, traction : (n, d)
        Points with known friction on the body of `on` (nodes or centres of facets), and the
        friction force per area on that body.
    force : (d,)
        Contact force on that body.
    """

    points: list[Array]
    displacement: list[Array]
    places: Array
    traction: Array
    force: Array

    def save(self, file: Path) -> None:
        """Write the outcome."""
        file.write_bytes(pickle.dumps(self))

    @staticmethod
    def load(file: Path) -> Outcome:
        """Read the file that `save` wrote."""
        outcome: Outcome = pickle.loads(file.read_bytes())
        return outcome
