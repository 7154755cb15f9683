"""The scene: a configuration with resolved names and checked numbers.

All later stages read only the scene, not the input file.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    RigidTie,
    Temperature,
    Tie,
    TotalLoad,
    Traction,
)
from contact_app.scene.obstacles import kind_of
from contact_app.scene.rigid import Placement, RigidBodies
from contact_app.scene.schema.options import FIELDS

if TYPE_CHECKING:
    from solver.contact.options import SolverOptions


CONDITIONS = (
    "displacements", "tractions", "pressures", "forces", "total_loads", "temperatures",
)  # fmt: skip
"""The fields of a scene that hold conditions, whose records have a `name` and are `scaled`; those
of rigid bodies are in `rigid`."""


@dataclass(frozen=True)
class Decomposition:
    """Decomposition: None (automatic), a number (graph partition), or sub-boxes along each axis."""

    subdomains: None | int | tuple[int, ...] = None


@dataclass(frozen=True)
class Section:
    """A plane through a body at which the force between the two sides is computed."""

    name: str
    body: int
    """Number of the body; if the scene was cut, number of the body whose mirror image it is."""
    of: str
    """Name of the body in the file."""
    point: tuple[float, float, float]
    normal: tuple[float, float, float]
    """Point and normal of the plane, in the whole scene."""
    across: tuple[int, ...] = ()
    """Axes of the planes of symmetry between the body and the body whose mirror image it is."""


@dataclass(frozen=True)
class InnerSection:
    """An inner surface of a body at which the force between its two sides is computed."""

    name: str
    body: int
    boundary: str
    """Name of the surface: of the mesh, or of an expression of the body."""
    behind: tuple[float, float, float]
    """A point of the side on which the force acts."""


@dataclass(frozen=True)
class OutputOptions:
    """Options of the output."""

    xdmf: bool = True
    vtu: bool = False
    fields: tuple[str, ...] = FIELDS
    probes: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    """Name and coordinates (x, y, z) of points at which the displacement is written."""
    sections: tuple[Section | InnerSection, ...] = ()
    """Planes and inner surfaces at which the force between the two sides of a body is written."""


@dataclass(frozen=True)
class LoadCase:
    """Factors of named conditions in a load case; other names have factor zero."""

    name: str
    factors: tuple[tuple[str, float], ...]
    """Pairs of a condition's name and its factor."""

    def of(self, name: str | None) -> float:
        """Factor of the condition of this name; one for conditions without a name."""
        return 1.0 if name is None else dict(self.factors).get(name, 0.0)


@dataclass(frozen=True)
class LoadStep:
    """A step of a load history: named conditions reach factors linearly at its end."""

    factors: tuple[tuple[str, float], ...]
    """Pairs of a condition's name and its factor at the end, for all names given so far; other
    names have factor zero."""
    increments: int = 1
    """Number of equal parts in which the step is solved."""


@dataclass(frozen=True)
class Mirror:
    """A plane of symmetry of a scene, normal to an axis (0, 1 or 2) at a coordinate."""

    axis: int
    at: float
    partners: tuple[tuple[str, str], ...] = ()
    """Sources of contacts and displacement conditions that are images of each other."""
    contacts: tuple[ContactName, ...] = ()
    conditions: tuple[tuple[str, str], ...] = ()
    """Contacts and conditions of the scene before it was cut at this plane."""

    def image(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mirror images of points (…, 3)."""
        image = points.copy()
        image[..., self.axis] = 2.0 * self.at - image[..., self.axis]
        return image


@dataclass(frozen=True)
class Scene:
    """A scene: the complete input of a run; `plane` is None in space."""

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
    solver: "SolverOptions"
    output: OutputOptions
    source: Path
    rigid: RigidBodies
    """Rigid bodies (without mesh); the obstacles of contacts are placed as they are."""
    symmetry: bool = False
    """Whether the scene may be cut at planes of symmetry."""
    guaranteed: bool = False
    """Whether to compute a guaranteed bound of the error."""
    mirrors: tuple[Mirror, ...] = ()
    """The planes at which the scene was cut: the bodies are the parts below them."""
    total_loads: tuple[TotalLoad, ...] = ()
    """Forces and moments on boundaries."""
    temperatures: tuple[Temperature, ...] = ()
    """Rises of temperature of bodies; several rises of one body add up."""
    cases: tuple[LoadCase, ...] = ()
    """Load cases, in the order of the file; empty if all conditions act in full."""
    case: str = ""
    """Name of the load case or of the place in the load history that this scene belongs to; empty
    if none."""
    steps: tuple[LoadStep, ...] = ()
    """The load history; empty if all conditions act in full at once."""
    in_step: bool = False
    """Whether this is the scene of a place in a load history."""
    idle: tuple[str, ...] = ()
    """Sentences on conditions with a name that no case and no step has."""
    ties: tuple[Tie, ...] = ()
    rigid_ties: tuple[RigidTie, ...] = ()
    """Tied pairs of boundaries, and boundaries tied to rigid bodies; they are not among the
    contacts."""
    places: Mapping[str, str] = field(default_factory=dict, compare=False)

    def at(self, source: str) -> str:
        """File, line and key of a condition or contact, to begin a message with."""
        return self.places.get(source, f"{self.source}: {source}")

    def solved_by(self, **options: Any) -> "Scene":
        """The scene with some other options of the solver."""
        return replace(self, solver=replace(self.solver, **options))

    def under(self, case: LoadCase) -> "Scene":
        """The scene of one load case: each condition times its factor in the case."""

        def scaled(items: Iterable[Any]) -> tuple[Any, ...]:
            return tuple(item.scaled(case.of(item.name)) for item in items)

        conditions: dict[str, Any] = {key: scaled(getattr(self, key)) for key in CONDITIONS}
        motions, loads = scaled(self.rigid.motions), scaled(self.rigid.loads)
        title = self.title
        if self.cases:
            title = f"{self.title or self.source.name}, case {case.name}"
        loaded = replace(
            self, **conditions, rigid=replace(self.rigid, motions=motions, loads=loads),
            title=title, cases=(), steps=(), case=case.name, in_step=bool(self.steps),
        )  # fmt: skip
        return loaded.placed_as_held()

    @property
    def unknowns(self) -> int:
        """Displacement components at the nodes of all bodies."""
        return self.dimension * sum(body.nodes for body in self.bodies)

    @property
    def loadings(self) -> tuple[LoadCase, ...]:
        """The load cases, or the ends of the steps; empty if all conditions act in full."""
        ends = tuple(self.loading_at(number, 1.0) for number in range(len(self.steps)))
        return self.cases or ends

    def loading_at(self, step: int, share: float) -> LoadCase:
        """The factors in the load history at a share (0 to 1) of a step; steps count from zero."""
        start = dict(self.steps[step - 1].factors) if step else {}
        factors = tuple(
            (name, (1.0 - share) * start.get(name, 0.0) + share * end)
            for name, end in self.steps[step].factors
        )
        return LoadCase(f"step {step + 1}, factor {share:.6g}", factors)

    def loaded_at(self, step: int, share: float) -> "Scene":
        """The scene with the loads at a share of a step."""
        return self.under(self.loading_at(step, share))

    def digest(self, steps: int) -> str:
        """A hash that identifies the scene up to one of its first steps."""
        parts: list[Any] = [getattr(self, key) for key in CONDITIONS]
        parts += [self.rigid, self.dimension, self.plane, self.contacts, self.pairs]
        parts += [self.all_ties, self.decomposition, [step.factors for step in self.steps[:steps]]]
        for body in self.bodies:
            parts += [body.name, body.materials, body.degree, body.hold, body.mesh.fingerprint]
            parts += sorted(body.boundaries.items())
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    @property
    def names_expressions(self) -> bool:
        """Whether a condition or contact names a boundary given by an expression."""
        items = self.displacements, self.tractions, self.pressures, self.total_loads, self.touching
        sides = [(item.body, item.boundary) for some in items for item in some]
        sides += [(pair.other, pair.other_boundary) for pair in self.pairs]
        return any(boundary in self.bodies[body].boundaries for body, boundary in sides)

    @property
    def moving(self) -> tuple[int, ...]:
        """Numbers of the rigid bodies with a free component; the others act as obstacles."""
        return self.rigid.moving

    def placed(self, placements: Sequence[Placement]) -> "Scene":
        """The scene with its rigid bodies placed."""
        if not self.rigid.bodies:
            return self

        def of(contact: Contact) -> Contact:
            if contact.rigid is None:
                return contact
            rigid = self.rigid.bodies[contact.rigid]
            drawn = rigid.obstacles[contact.part]
            obstacle = placements[contact.rigid].obstacle(drawn, rigid.center)
            return replace(contact, obstacle=obstacle)

        placed = replace(self.rigid, placements=tuple(placements))
        return replace(self, rigid=placed, contacts=tuple(of(c) for c in self.contacts))

    def placed_as_held(self) -> "Scene":
        """The scene with its rigid bodies placed by their prescribed components."""
        motions = [self.rigid.held(k)[1] for k in range(len(self.rigid.bodies))]
        return self.placed([Placement.of(values, self.dimension) for values in motions])

    @property
    def touching(self) -> tuple[Contact | BodyContact, ...]:
        """All contacts in the order of the sources of contact rows: obstacles first, then pairs."""
        return (*self.contacts, *self.pairs)

    @property
    def has_friction(self) -> bool:
        """Whether some contact has friction."""
        return any(contact.law.acts for contact in self.touching)

    @property
    def contact_names(self) -> tuple[ContactName, ...]:
        """All contacts in the order of the file; if the scene was cut, those of the whole."""
        if self.mirrors:
            return self.mirrors[0].contacts
        names = []
        for contact in self.touching:
            if isinstance(contact, Contact) and contact.part:
                continue
            if isinstance(contact, Contact):
                rigid = contact.rigid
                against = (
                    kind_of(contact.obstacle) if rigid is None else self.rigid.bodies[rigid].name
                )
            else:
                against = self._where(contact.other, contact.other_boundary)
            on = self._where(contact.body, contact.boundary)
            names.append(ContactName(contact.source, on, against))
        return tuple(sorted(names, key=lambda name: (len(name.source), name.source)))

    @property
    def condition_names(self) -> tuple[tuple[str, str], ...]:
        """Source and boundary of all displacement conditions; of the whole if the scene was cut.

        Conditions of rigid bodies are not included.
        """
        if self.mirrors:
            return self.mirrors[0].conditions
        return tuple((c.source, self._where(c.body, c.boundary)) for c in self.displacements)

    @property
    def all_ties(self) -> tuple[Tie | RigidTie, ...]:
        """The tied pairs, then the boundaries tied to rigid bodies, as tied rows count them."""
        return (*self.ties, *self.rigid_ties)

    @property
    def tie_names(self) -> tuple[ContactName, ...]:
        """The tied pairs in the order of the file, then the boundaries tied to rigid bodies."""
        others = [self._where(tie.other, tie.other_boundary) for tie in self.ties]
        others += [self.rigid.bodies[tie.rigid].name for tie in self.rigid_ties]
        return tuple(
            ContactName(tie.source, self._where(tie.body, tie.boundary), other)
            for tie, other in zip(self.all_ties, others, strict=True)
        )

    def _where(self, body: int, boundary: str) -> str:
        return f"{self.bodies[body].name}.{boundary}"
