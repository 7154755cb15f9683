"""Data exchange with other programs for scenes with friction: plain arrays in files.

This module imports no solver, so that processes of other programs start fast.
"""

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
    """A mesh with its sides and one elastic material."""

    cell: str
    degree: int
    """``triangle``, ``tetrahedron`` or ``hexahedron``, of first or second order."""
    points: Array  # (nodes, d)
    cells: Ints  # (cells, nodes per cell)
    """In VTK order."""
    sides: dict[str, Ints]
    """Numbers (facets, nodes per facet) by name, vertices first."""
    young: float
    poisson: float


@dataclass(frozen=True, eq=False)
class PlainScene:
    """Elastic bodies, one contact, and a history of factors."""

    bodies: list[PlainBody]
    coefficient: float
    on: tuple[int, str]
    against: tuple[int, str] | None
    """Body and side; without `against` the floor, where the last coordinate is zero."""
    fixed: list[Fixed]
    """Displacements."""
    pressure: tuple[int, str, float] | None
    """Body, side and value, times the factor ``press``."""
    factors: list[dict[str, float]]
    """Load factors of each increment."""
    forces: Sequence[tuple[int, str, Sequence[float]]] = ()
    """Body, flat side and total force, which act in full."""
    loose: Sequence[int] = ()
    """Bodies that contact alone holds."""
    push: Fixed | None = None
    """Displacement that CalculiX applies first, to bring bodies into contact."""
    penalty: float | None = None
    """Stiffness of contact in CalculiX, force per volume; chosen unless given."""

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return self.bodies[0].points.shape[1]

    def save(self, file: Path) -> None:
        """For a process of this study alone."""
        file.write_bytes(pickle.dumps(self))

    @staticmethod
    def load(file: Path) -> "PlainScene":
        """Read the file that `save` wrote."""
        scene: PlainScene = pickle.loads(file.read_bytes())
        return scene


@dataclass(frozen=True, eq=False)
class Outcome:
    """The answer of a program at the end of the history."""

    points: list[Array]
    displacement: list[Array]
    """(nodes, d) of each body."""
    places: Array
    traction: Array
    """Points with known friction on the body of `on` (nodes or centres of facets), and the friction
    force per area on that body. Shape (n, d)."""
    force: Array  # (d,)
    """Contact force on that body."""

    def save(self, file: Path) -> None:
        """Write the outcome."""
        file.write_bytes(pickle.dumps(self))

    @staticmethod
    def load(file: Path) -> "Outcome":
        """Read the file that `save` wrote."""
        outcome: Outcome = pickle.loads(file.read_bytes())
        return outcome
