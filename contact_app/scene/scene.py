"""The scene: a configuration with every name resolved and every number checked.

All that comes later reads the scene and nothing else of the input.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.bodies import Body
from contact_app.scene.conditions import (
    BodyContact,
    BodyForce,
    Contact,
    ContactName,
    DisplacementCondition,
    Pressure,
    Temperature,
    Tie,
    TotalLoad,
    Traction,
)
from contact_app.scene.configuration import FIELDS
from contact_app.scene.obstacles import kind_of

if TYPE_CHECKING:
    from solver.contact.options import SolverOptions


@dataclass(frozen=True)
class Decomposition:
    """None: chosen automatically; a number: graph partition; a tuple: sub-boxes along each axis."""

    subdomains: None | int | tuple[int, ...] = None


@dataclass(frozen=True)
class OutputOptions:
    """What is written.

    Attributes
    ----------
    probes
        Name and place (x, y, z) of points whose displacement is asked for.
    """

    xdmf: bool = True
    fields: tuple[str, ...] = FIELDS
    probes: tuple[tuple[str, tuple[float, float, float]], ...] = ()


@dataclass(frozen=True)
class Mirror:
    """A plane across an axis (0, 1 or 2) at a coordinate, about which a scene mirrors.

    Attributes
    ----------
    partners
        Sources of contacts and displacement conditions that are images of each other, not of
        themselves.
    contacts, conditions
        Those of the scene before it was cut there.
    """

    axis: int
    at: float
    partners: tuple[tuple[str, str], ...] = ()
    contacts: tuple[ContactName, ...] = ()
    conditions: tuple[tuple[str, str], ...] = ()

    def image(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Images of points (…, 3)."""
        image = points.copy()
        image[..., self.axis] = 2.0 * self.at - image[..., self.axis]
        return image


@dataclass(frozen=True)
class Scene:
    """Everything a run needs; `plane` is None in space.

    Attributes
    ----------
    symmetry
        Whether the scene may be cut at planes it mirrors about.
    guaranteed
        Whether a guaranteed bound of the error is asked for.
    mirrors
        The planes at which it was cut: the bodies are what is left below them.
    total_loads
        Forces and moments on boundaries.
    temperatures
        Rises of temperature of bodies; those of one body add up.
    ties
        Pairs of boundaries that hold together; they are no contacts.
    """

    title: str
    dimension: int
    plane: str | None
    bodies: tuple[Body, ...]
    displacements: tuple[DisplacementCondition, ...]
    tractions: tuple[Traction, ...]
    pressures: tuple[Pressure, ...]
    forces: tuple[BodyForce, ...]
    contacts: tuple[Contact, ...]
    pairs: tuple[BodyContact, ...]
    decomposition: Decomposition
    accuracy: float | None
    solver: SolverOptions
    output: OutputOptions
    source: Path
    symmetry: bool = False
    guaranteed: bool = False
    mirrors: tuple[Mirror, ...] = ()
    total_loads: tuple[TotalLoad, ...] = ()
    temperatures: tuple[Temperature, ...] = ()
    ties: tuple[Tie, ...] = ()
    places: Mapping[str, str] = field(default_factory=dict, compare=False)

    def at(self, source: str) -> str:
        """File, line and key of a condition or contact, to begin a message with."""
        return self.places.get(source, f"{self.source}: {source}")

    @property
    def touching(self) -> tuple[Contact | BodyContact, ...]:
        """All contacts, as contact rows count their sources: obstacles first, then pairs."""
        return (*self.contacts, *self.pairs)

    @property
    def contact_names(self) -> tuple[ContactName, ...]:
        """All contacts in the order of the file, of the whole where it was cut."""
        if self.mirrors:
            return self.mirrors[0].contacts
        found = []
        for contact in self.touching:
            if isinstance(contact, Contact):
                against = kind_of(contact.obstacle)
            else:
                against = self._where(contact.other, contact.other_boundary)
            on = self._where(contact.body, contact.boundary)
            found.append(ContactName(contact.source, on, against))
        return tuple(sorted(found, key=lambda name: (len(name.source), name.source)))

    @property
    def condition_names(self) -> tuple[tuple[str, str], ...]:
        """Source and boundary of all displacement conditions, of the whole where it was cut."""
        if self.mirrors:
            return self.mirrors[0].conditions
        return tuple((c.source, self._where(c.body, c.boundary)) for c in self.displacements)

    @property
    def tie_names(self) -> tuple[ContactName, ...]:
        """The tied pairs in the order of the file."""
        return tuple(
            ContactName(
                tie.source, self._where(tie.body, tie.boundary),
                self._where(tie.other, tie.other_boundary),
            )
            for tie in self.ties
        )  # fmt: skip

    def _where(self, body: int, boundary: str) -> str:
        return f"{self.bodies[body].name}.{boundary}"
