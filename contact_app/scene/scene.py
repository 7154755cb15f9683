"""The scene: a configuration with every name resolved and every number checked.

All that comes later reads the scene and nothing else of the input.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from contact_app.errors import ConfigurationError
from contact_app.machine.memory import ROWS_PER_DOF, available_bytes, needed_bytes, surface_bytes
from contact_app.scene import configuration as c
from contact_app.scene.expressions import Expression, ExpressionError
from contact_app.scene.obstacles import SHAPES, Obstacle, kind_of

if TYPE_CHECKING:
    from solver.contact.options import SolverOptions

FACES = ("x-", "x+", "y-", "y+", "z-", "z+")
CELLS = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}
CELLS_PER_CUBE = {"tetrahedron": 6, "triangle": 2}

SHORTEST_EDGE = 1e-15
"""Shortest edge of a cell; dolfinx takes boxes a few times shorter for empty."""

LONGEST_CELL = 1e4
"""Longest over shortest edge of a cell; beyond, round-off hides the short edge's stiffness."""

NEAREST_HALF = 1e-6
"""Distance of Poisson's ratio from 0.5 and -1, where the stiffness grows beyond all bounds."""


@dataclass(frozen=True)
class Material:
    """Isotropic linear elasticity: Young's modulus (force per area) and Poisson's ratio.

    Attributes
    ----------
    mean_dilatation
        Whether the change of volume is taken as its mean over each cell (B-bar).
    yield_stress
        Von Mises stress (force per area) above which the answer is warned of, if any.
    """

    young: float
    poisson: float
    mean_dilatation: bool = False
    yield_stress: float | None = None


class BodyMesh(Protocol):
    """What anyone may ask of a body's mesh, wherever it comes from."""

    @property
    def dimension(self) -> int:
        """Number of axes."""

    @property
    def cell(self) -> str:
        """Cell type: triangle, quadrilateral, tetrahedron or hexahedron."""

    @property
    def lower(self) -> tuple[float, ...]:
        """Smallest coordinates."""

    @property
    def upper(self) -> tuple[float, ...]:
        """Largest coordinates."""

    @property
    def nodes(self) -> int:
        """Nodes."""

    @property
    def total_cells(self) -> int:
        """Cells."""

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Names of the parts of the surface the mesh itself knows."""

    @property
    def congruent(self) -> bool:
        """Whether `auto` cuts it into equal parts, which share one factor."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was repaired or left out, a sentence each."""

    def nodes_of(self, degree: int) -> int:
        """Nodes a displacement of a degree has."""

    def shape(self, degree: int) -> Any:
        """What `meshes.decompose` cuts, with the nodes of a degree."""

    def describe(self) -> str:
        """A phrase for reports."""

    def uncuttable(self, parts: tuple[int, ...], name: str) -> str:
        """Why the body of this name cannot be cut into so many parts; empty where it can."""


@dataclass(frozen=True)
class Box:
    """A box of equal cells between two corners."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cells: tuple[int, ...]
    cell: str

    congruent: ClassVar[bool] = True
    notes: ClassVar[tuple[str, ...]] = ()

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return len(self.cells)

    @property
    def nodes(self) -> int:
        """Nodes of the mesh."""
        return self.nodes_of(1)

    def nodes_of(self, degree: int) -> int:
        """Nodes a displacement of a degree has."""
        return math.prod(degree * n + 1 for n in self.cells)

    @property
    def total_cells(self) -> int:
        """Cells of the mesh."""
        return math.prod(self.cells) * CELLS_PER_CUBE.get(self.cell, 1)

    @property
    def boundaries(self) -> tuple[str, ...]:
        """The faces."""
        return FACES[: 2 * self.dimension]

    def shape(self, degree: int) -> Any:
        """The box as `meshes` knows it."""
        from meshes import BoxShape

        return BoxShape(self.lower, self.upper, self.cells, self.cell, degree)

    def describe(self) -> str:
        """A phrase for reports."""
        lower, upper = (", ".join(f"{v:g}" for v in p) for p in (self.lower, self.upper))
        cells = " x ".join(map(str, self.cells))
        unit = "cubes" if self.cell == "tetrahedron" else "cells"
        return f"box ({lower}) to ({upper}) of {cells} {unit} ({self.cell})"

    def uncuttable(self, parts: tuple[int, ...], name: str) -> str:
        """Why the body of this name cannot be cut into so many parts; empty where it can."""
        for axis, (part, cells) in enumerate(zip(parts, self.cells, strict=True)):
            if part > cells:
                where = f"along {'xyz'[axis]}, where {name} has {cells} cells"
                return f"asks for {part} sub-boxes {where}"
        return ""


@dataclass(frozen=True, eq=False)
class Body:
    """An elastic body.

    Attributes
    ----------
    materials
        By the number each cell of the mesh is tagged with; a box has one.
    boundaries
        Those defined by an expression.
    degree_given
        Whether the file names a degree or asks for what holds for degree 1 alone: else a run to an
        accuracy chooses one.
    cuts
        Boundaries at which it was cut from the rest of a symmetric body, whose surface has no part
        of them.
    """

    name: str
    mesh: BodyMesh
    degree: int
    materials: tuple[Material, ...]
    boundaries: dict[str, Expression]
    degree_given: bool = True
    cuts: tuple[str, ...] = ()

    @property
    def nodes(self) -> int:
        """Nodes of its displacement."""
        return self.mesh.nodes_of(self.degree)

    @property
    def plain(self) -> bool:
        """Whether its cells are of first order and fully integrated: they lock."""
        return self.degree == 1 and not any(m.mean_dilatation for m in self.materials)


@dataclass(frozen=True)
class DisplacementCondition:
    """Displacement of a boundary by component, None where free."""

    body: int
    boundary: str
    values: tuple[float | None, ...]
    source: str


@dataclass(frozen=True)
class Traction:
    """Force per area on a boundary."""

    body: int
    boundary: str
    vector: tuple[float, ...]
    source: str


@dataclass(frozen=True)
class Pressure:
    """Pressure against the outward normal of a boundary."""

    body: int
    boundary: str
    value: float
    source: str


@dataclass(frozen=True)
class BodyForce:
    """Force per volume in a body."""

    body: int
    vector: tuple[float, ...]
    source: str


@dataclass(frozen=True)
class Contact:
    """A boundary that may touch an obstacle."""

    body: int
    boundary: str
    obstacle: Obstacle
    source: str


@dataclass(frozen=True)
class BodyContact:
    """A boundary that may touch the boundary of another body."""

    body: int
    boundary: str
    other: int
    other_boundary: str
    source: str


@dataclass(frozen=True)
class ContactName:
    """What a contact of the scene file is called.

    Attributes
    ----------
    source
        Its key in the file, ``contacts[0]``.
    on, against
        The boundary that touches, body.boundary, and what it touches: such a boundary, or the kind
        of an obstacle.
    """

    source: str
    on: str
    against: str


@dataclass(frozen=True)
class Decomposition:
    """None: chosen automatically; a number: graph partition; a tuple: sub-boxes along each axis."""

    subdomains: None | int | tuple[int, ...] = None


@dataclass(frozen=True)
class OutputOptions:
    """What is written."""

    xdmf: bool = True
    fields: tuple[str, ...] = c.FIELDS


@dataclass(frozen=True)
class Mirror:
    """A plane across an axis (0, 1 or 2) at a coordinate, about which a scene mirrors.

    Attributes
    ----------
    partners
        Sources of contacts that are images of each other, not of themselves.
    contacts
        Those of the scene before it was cut there.
    """

    axis: int
    at: float
    partners: tuple[tuple[str, str], ...] = ()
    contacts: tuple[ContactName, ...] = ()

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

    def _where(self, body: int, boundary: str) -> str:
        return f"{self.bodies[body].name}.{boundary}"


def build_scene(configuration: c.Configuration, surface_only: bool = False) -> Scene:
    """Resolve a configuration.

    Parameters
    ----------
    surface_only
        The answer will be evaluated on the surface alone, which takes a fraction of the memory.

    Raises
    ------
    ConfigurationError
        Naming file, line, key and what is allowed.
    """
    return _Builder(configuration, surface_only).scene()


class _Builder:
    """Resolves one configuration, knowing where each key stands in the file."""

    def __init__(self, configuration: c.Configuration, surface_only: bool) -> None:
        self.c, self.surface_only = configuration, surface_only
        self.dimension, self.plane = configuration.space

    def scene(self) -> Scene:
        bodies = tuple(self._body(i, b) for i, b in enumerate(self.c.bodies))
        self.names = [b.name for b in bodies]
        for i, name in enumerate(self.names):
            if name in self.names[:i]:
                self._fail(("bodies", i, "name"), f"is {name!r}, the name of an earlier body")
        self.bodies = bodies
        decomposition = self._decomposition()
        self._memory(decomposition)
        kinds: dict[str, list[Any]] = {k: [] for k in ("displacement", "traction", "pressure",
                                                       "force")}  # fmt: skip
        for i, condition in enumerate(self.c.conditions):
            kind, made = self._condition(i, condition)
            kinds[kind].append(made)
        touching = [self._contact(i, k) for i, k in enumerate(self.c.contacts)]
        contacts = tuple(t for t in touching if isinstance(t, Contact))
        pairs = tuple(t for t in touching if isinstance(t, BodyContact))
        self._some_load(kinds, contacts, pairs)
        return Scene(
            title=self.c.title,
            dimension=self.dimension,
            plane=self.plane,
            bodies=bodies,
            displacements=tuple(kinds["displacement"]),
            tractions=tuple(kinds["traction"]),
            pressures=tuple(kinds["pressure"]),
            forces=tuple(kinds["force"]),
            contacts=contacts,
            pairs=pairs,
            decomposition=decomposition,
            accuracy=self.c.accuracy,
            solver=self._solver(),
            output=OutputOptions(self.c.output.xdmf, tuple(dict.fromkeys(self.c.output.fields))),
            source=self.c.source,
            symmetry=self.c.symmetry == "allow",
            guaranteed=self.c.certificate.guaranteed,
            places=self._places(),
        )

    def _solver(self) -> SolverOptions:
        """With an accuracy the solver follows the mesh, unless a tolerance is given."""
        from solver.contact.options import SolverOptions  # with PETSc, which reading needs not

        given, accuracy = self.c.solver, self.c.accuracy
        options = SolverOptions(**given.model_dump())
        if accuracy is not None and "tolerance" not in given.model_fields_set:
            options = replace(options, tolerance="auto")
        if accuracy is None:
            return options
        return replace(options, tightest=min(options.tightest, 0.1 * accuracy))

    def _places(self) -> dict[str, str]:
        """Where conditions, contacts and the decomposition stand in the file."""
        keys = [("conditions", i) for i in range(len(self.c.conditions))]
        keys += [("contacts", i) for i in range(len(self.c.contacts))]
        places = {f"{name}[{i}]": self.c.where((name, i)) for name, i in keys}
        places["accuracy"] = self.c.where(("accuracy",))
        places["certificate.guaranteed"] = self.c.where(("certificate", "guaranteed"))
        places["decomposition"] = self.c.where(("decomposition",))
        return places

    def _fail(self, path: tuple[str | int, ...], message: str) -> NoReturn:
        raise ConfigurationError(self.c.where(path) + " " + message)

    def _vector(
        self, values: Sequence[float], path: tuple[str | int, ...], what: str
    ) -> tuple[float, ...]:
        if len(values) != self.dimension:
            self._fail(
                path,
                f"has {len(values)} components; {what} in {self.dimension}D has {self.dimension}",
            )
        return tuple(values)

    def _space(self, values: Sequence[float], path: tuple[str | int, ...], what: str) -> Any:
        vector = self._vector(values, path, what)
        return (*vector, *(0.0,) * (3 - len(vector)))

    def _body(self, i: int, body: c.Body) -> Body:
        path: tuple[str | int, ...] = ("bodies", i)
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_-]{0,99}", body.name):
            self._fail(
                (*path, "name"),
                f"is {body.name!r}; a letter or _ first, then letters, digits, _ and - are allowed",
            )
        if body.degree not in (1, 2):
            self._fail((*path, "degree"), f"is {body.degree}; 1 or 2 is allowed")
        mesh = self._mesh(body.mesh, body.degree, (*path, "mesh"))
        materials, mesh = self._materials(body, mesh, (*path, "material"))
        if body.mean_dilatation:
            at = (*path, "mean_dilatation")
            if body.degree != 1 or mesh.cell not in ("quadrilateral", "hexahedron"):
                self._fail(
                    at,
                    "is for quadrilaterals and hexahedra of degree 1, not "
                    f"{mesh.cell}s of degree {body.degree}"
                    + (": use degree 2 there" if body.degree == 1 else ", which needs none"),
                )
            if self.plane == "stress":
                self._fail(at, "is for plane strain and 3D: in plane stress the volume is free")
            materials = tuple(replace(m, mean_dilatation=True) for m in materials)
        boundaries = {}
        for name, boundary in body.boundaries.items():
            at = (*path, "boundaries", name)
            if name in mesh.boundaries:
                self._fail(
                    at, f"redefines {name}, which the mesh knows already; choose another name"
                )
            if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_+-]{0,99}", name):
                self._fail(
                    at,
                    "is no name for a boundary; a letter or _ first, then letters, digits, _, + "
                    "and - are allowed",
                )
            variables = ("x", "y", "z")[: self.dimension]
            try:
                boundaries[name] = Expression.parse(boundary.where, variables)
            except ExpressionError as error:
                self._fail((*at, "where"), str(error))
        return Body(
            name=body.name,
            mesh=mesh,
            degree=body.degree,
            materials=materials,
            boundaries=boundaries,
            degree_given="degree" in body.model_fields_set or self.c.certificate.guaranteed,
        )

    def _materials(
        self, body: c.Body, mesh: BodyMesh, path: tuple[str | int, ...]
    ) -> tuple[tuple[Material, ...], BodyMesh]:
        """The materials of a body, and its mesh with each cell tagged by the number of its own."""
        given = body.material
        if isinstance(given, c.Material):
            return (self._material(given, path),), mesh
        if body.mesh.box is not None:
            self._fail(path, "by tag needs a mesh from a file; a box takes {young, poisson}")
        from meshes import MeshError

        materials = tuple(self._material(m, (*path, name)) for name, m in given.items())
        try:
            return materials, mesh.tagged(tuple(given))  # type: ignore[attr-defined]
        except MeshError as error:
            self._fail(path, str(error))

    def _material(self, material: c.Material, path: tuple[str | int, ...]) -> Material:
        poisson = material.poisson
        if not -1.0 < poisson < 0.5:
            self._fail(
                (*path, "poisson"),
                f"is {poisson:g}; an isotropic solid needs -1 < ν < 0.5 "
                "(nearly incompressible: ν ≤ 0.4999, and mind the certificate's warning)",
            )
        if min(0.5 - poisson, 1.0 + poisson) < NEAREST_HALF:
            self._fail(
                (*path, "poisson"),
                f"is within {NEAREST_HALF:g} of {0.5 if poisson > 0 else -1}, where round-off "
                "would decide the answer; at most 0.4999 is recommended",
            )
        return Material(material.young, poisson, yield_stress=material.yield_stress)

    def _mesh(self, mesh: c.Mesh, degree: int, path: tuple[str | int, ...]) -> BodyMesh:
        if (mesh.box is None) == (mesh.file is None):
            both = "has both; exactly one of" if mesh.box else "needs"
            self._fail(path, f"{both} `box: {{lower, upper, cells, cell}}` or `file: part.msh`")
        if mesh.box is not None:
            for key in ("group", "scale", "rotate", "translate", "refine"):
                if key in mesh.model_fields_set:
                    self._fail((*path, key), "belongs to a mesh from a file; a box has corners")
            return self._box(mesh.box, (*path, "box"))
        return self._file(mesh, degree, path)

    def _file(self, mesh: c.Mesh, degree: int, path: tuple[str | int, ...]) -> BodyMesh:
        from meshes import (
            MeshError,
            Placement,
            load_mesh,
            refined,
        )  # dolfinx, which boxes need later only

        axis: Any = (0.0, 0.0, 1.0)
        if mesh.rotate is not None and mesh.rotate.axis is not None:
            if self.dimension == 2:
                self._fail((*path, "rotate", "axis"), "has no place in 2D; give the angle alone")
            axis = self._direction(mesh.rotate.axis, (*path, "rotate", "axis"))
        elif mesh.rotate is not None and self.dimension == 3:
            self._fail((*path, "rotate"), "needs an axis in 3D: {axis: [0, 0, 1], angle: 90}")
        placement = Placement(
            scale=mesh.scale,
            axis=axis,
            angle=mesh.rotate.angle if mesh.rotate else 0.0,
            translation=self._space(
                mesh.translate or (0.0,) * self.dimension, (*path, "translate"), "a translation"
            ),
        )
        groups = [mesh.group] if isinstance(mesh.group, str) else mesh.group or []
        if not mesh.file or not mesh.file.isprintable():
            self._fail((*path, "file"), f"is {mesh.file!r}, which is no name of a file")
        file = self.c.source.parent / mesh.file
        try:
            found = load_mesh(file, self.dimension, placement, groups, degree)
        except MeshError as error:
            self._fail((*path, "file"), f"is {file}, which {error}")
        dofs = float(found.nodes * self.dimension * 2 ** (self.dimension * mesh.refine))
        needed, available = needed_bytes(dofs), available_bytes()
        if needed > available:
            self._fail(
                (*path, "refine"),
                f"makes about {dofs:.3g} degrees of freedom, which need {needed / 1e9:.3g} GB; "
                f"{available / 1e9:.3g} GB are available",
            )
        for _ in range(mesh.refine):
            found = refined(found)
        return found

    def _box(self, box: c.Box, path: tuple[str | int, ...]) -> Box:
        lower = self._vector(box.lower, (*path, "lower"), "a corner")
        upper = self._vector(box.upper, (*path, "upper"), "a corner")
        if len(box.cells) != self.dimension:
            self._fail(
                (*path, "cells"),
                f"has {len(box.cells)} numbers; a box in {self.dimension}D has {self.dimension}",
            )
        for axis, (a, b) in enumerate(zip(lower, upper, strict=True)):
            if not b > a:
                self._fail(
                    (*path, "upper"),
                    f"is {b:g} along {'xyz'[axis]}, not above lower ({a:g}): the box has no volume",
                )
            if (b - a) / box.cells[axis] <= 1e-12 * max(abs(a), abs(b)):
                self._fail(
                    (*path, "cells"),
                    f"are too small along {'xyz'[axis]} to tell their nodes apart",
                )
        edges = [(b - a) / n for a, b, n in zip(lower, upper, box.cells, strict=True)]
        if min(edges) < SHORTEST_EDGE:
            self._fail(
                (*path, "cells"),
                f"make cells of {min(edges):.3g} along an edge; at least {SHORTEST_EDGE:g} is "
                "allowed: choose a smaller unit of length",
            )
        if max(edges) > LONGEST_CELL * min(edges):
            self._fail(
                (*path, "cells"),
                f"make cells {max(edges) / min(edges):.3g} times as long as wide; up to "
                f"{LONGEST_CELL:g} is allowed",
            )
        cell = box.cell or CELLS[self.dimension][0]
        if cell not in CELLS[self.dimension]:
            self._fail(
                (*path, "cell"),
                f"is {cell}; in {self.dimension}D {' or '.join(CELLS[self.dimension])} is allowed",
            )
        return Box(lower, upper, tuple(box.cells), cell)

    def _memory(self, decomposition: Decomposition) -> None:
        """Refuse what cannot fit: the mesh, and factors of subdomains that are too large."""
        bodies, d = self.bodies, self.dimension
        dofs = sum(b.nodes for b in bodies) * d
        parts = decomposition.subdomains
        factors: list[tuple[float, int]] = []
        for body in bodies:
            unknowns = float(body.nodes * d)
            if isinstance(parts, int):
                factors += [(dofs / parts, d)] * min(math.ceil(parts / len(bodies)), 1000)
            elif isinstance(parts, tuple):  # congruent sub-boxes: one factor for each body
                count = math.prod(parts)
                factors += [(unknowns / count, d)] * (1 if body.mesh.congruent else count)
            elif not body.mesh.congruent:
                from meshes.decompose import choose_parts  # at hand: the mesh was read

                count = choose_parts(body.nodes, d, degree=body.degree)
                factors += [(unknowns / count, d)] * count
        needed, available = needed_bytes(dofs, factors=tuple(factors)), available_bytes()
        if self.surface_only:
            needed = surface_bytes(dofs, ROWS_PER_DOF * dofs / 2.0)
        if needed > available:
            largest = int(np.argmax([float(b.nodes) for b in bodies]))
            key = ("box", "cells") if self.c.bodies[largest].mesh.box else ("file",)
            self._fail(
                ("bodies", largest, "mesh", *key),
                f"{'make' if len(key) == 2 else 'makes'} {float(dofs):.3g} degrees of freedom in "
                f"all, which need about {needed / 1e9:.3g} GB; {available / 1e9:.3g} GB are "
                "available",
            )

    def _name(self, text: str, path: tuple[str | int, ...]) -> int:
        if text not in self.names:
            near = difflib.get_close_matches(text, self.names, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            self._fail(path, f"names the body {text!r}{hint} (known: {', '.join(self.names)})")
        return self.names.index(text)

    def _boundary(self, text: str, path: tuple[str | int, ...]) -> tuple[int, str]:
        name, dot, boundary = text.partition(".")
        if not dot or not boundary:
            self._fail(path, f"is {text!r}; it has the form body.boundary, e.g. {self.names[0]}.x-")
        body = self._name(name, path)
        known = [*self.bodies[body].mesh.boundaries, *self.bodies[body].boundaries]
        if boundary not in known:
            near = difflib.get_close_matches(boundary, known, 1)
            hint = f"; did you mean {name}.{near[0]}?" if near else ""
            self._fail(
                path, f"names the boundary {boundary!r} of {name}{hint} (known: {', '.join(known)})"
            )
        return body, boundary

    def _condition(self, i: int, condition: c.Condition) -> tuple[str, Any]:
        path: tuple[str | int, ...] = ("conditions", i)
        source = f"conditions[{i}]"
        given = [k for k in ("displacement", "traction", "pressure", "force")
                 if getattr(condition, k) is not None]  # fmt: skip
        if len(given) != 1:
            self._fail(
                path,
                f"has {' and '.join(given) or 'no kind'}; exactly one of displacement, traction, "
                "pressure, force is allowed",
            )
        kind = given[0]
        if kind == "force":
            if condition.inside is None or condition.on is not None:
                self._fail(path, "a force acts `in` a body, e.g. {in: cube, force: [0, 0, -1]}")
            body = self._name(condition.inside, (*path, "in"))
            vector = self._vector(condition.force or [], (*path, "force"), "a force")
            return kind, BodyForce(body, vector, source)
        if condition.on is None or condition.inside is not None:
            self._fail(path, f"a {kind} acts `on` a boundary, e.g. {{on: cube.z+, {kind}: …}}")
        body, boundary = self._boundary(condition.on, (*path, "on"))
        if kind == "pressure":
            return kind, Pressure(body, boundary, condition.pressure or 0.0, source)
        if kind == "traction":
            vector = self._vector(condition.traction or [], (*path, kind), "a traction")
            return kind, Traction(body, boundary, vector, source)
        values = condition.displacement or []
        if len(values) != self.dimension:
            self._fail(
                (*path, kind),
                f"has {len(values)} components; in {self.dimension}D it has {self.dimension} "
                "(null leaves one free)",
            )
        if all(v is None for v in values):
            self._fail((*path, kind), "leaves every component free; give a number for one")
        return kind, DisplacementCondition(body, boundary, tuple(values), source)

    def _contact(self, i: int, contact: c.Contact) -> Contact | BodyContact:
        path: tuple[str | int, ...] = ("contacts", i)
        if (contact.obstacle is None) == (contact.against is None):
            forms = " or ".join(f"{{{kind}: …}}" for kind in SHAPES)
            both = "has both; " if contact.obstacle else ""
            self._fail(
                path, f"{both}needs an `obstacle`: {forms}; or `against`: another body.boundary"
            )
        body, boundary = self._boundary(contact.on, (*path, "on"))
        if contact.obstacle is not None:
            obstacle = self._obstacle(contact.obstacle, (*path, "obstacle"))
            return Contact(body, boundary, obstacle, f"contacts[{i}]")
        other, other_boundary = self._boundary(contact.against or "", (*path, "against"))
        if other == body:
            self._fail(
                (*path, "against"),
                f"is a boundary of {self.names[body]} itself; contact of a body with itself is not "
                "modelled",
            )
        for k, earlier in enumerate(self.c.contacts[:i]):
            if {earlier.on, earlier.against} == {contact.on, contact.against}:
                self._fail(path, f"repeats contacts[{k}]: each pair of boundaries is given once")
        return BodyContact(body, boundary, other, other_boundary, f"contacts[{i}]")

    def _obstacle(self, given: c.Obstacle, path: tuple[str | int, ...]) -> Obstacle:
        known = given.known_keys()
        kinds = [key for key in known if getattr(given, key) is not None]
        if len(kinds) != 1:
            self._fail(
                path,
                f"has {' and '.join(kinds) or 'no shape'}; exactly one of {', '.join(known)} is "
                "allowed",
            )
        at, shape = (*path, kinds[0]), SHAPES[kinds[0]]
        if self.dimension == 2 and shape.not_in_plane:
            self._fail(at, shape.not_in_plane)
        fields = dict(getattr(given, kinds[0]))
        for key, value in fields.items():
            if key in shape.directions:
                fields[key] = self._direction(value, (*at, key))
            elif isinstance(value, list):
                fields[key] = self._space(value, (*at, key), "a point")
        obstacle: Obstacle = shape(**fields)
        return obstacle

    def _direction(self, values: Sequence[float], path: tuple[str | int, ...]) -> Any:
        vector = self._space(values, path, "a direction")
        if not any(vector):
            self._fail(path, "is zero, which is no direction")
        scale = max(abs(v) for v in vector)
        return tuple(v / scale for v in vector)

    def _decomposition(self) -> Decomposition:
        given = self.c.decomposition
        if isinstance(given, str):
            return Decomposition(None)
        parts = given.subdomains
        if isinstance(parts, int):
            cells = sum(b.mesh.total_cells for b in self.bodies)
            if parts > cells:
                self._fail(
                    ("decomposition", "subdomains"),
                    f"is {parts}; at most one a cell is allowed, {cells} here",
                )
            return Decomposition(parts)
        if len(parts) != self.dimension:
            self._fail(
                ("decomposition", "subdomains"),
                f"has {len(parts)} numbers; along the axes of {self.dimension}D there are "
                f"{self.dimension}",
            )
        for body in self.bodies:
            why = body.mesh.uncuttable(tuple(parts), body.name)
            if why:
                self._fail(("decomposition", "subdomains"), why)
        return Decomposition(tuple(parts))

    def _some_load(
        self,
        kinds: dict[str, list[Any]],
        contacts: tuple[Contact, ...],
        pairs: tuple[BodyContact, ...],
    ) -> None:
        loaded = any(any(t.vector) for t in (*kinds["traction"], *kinds["force"]))
        loaded |= any(p.value for p in kinds["pressure"])
        loaded |= any(v for d in kinds["displacement"] for v in d.values)
        overlap = any(self._overlaps(contact) for contact in contacts)
        if not loaded and not overlap and not any(self._may_overlap(pair) for pair in pairs):
            self._fail(
                ("conditions",),
                "load nothing: give a traction, pressure, force or non-zero displacement, or an "
                "obstacle or a body that overlaps another body",
            )

    def _overlaps(self, contact: Contact) -> bool:
        box = self.bodies[contact.body].mesh
        lower, upper = (np.array([*v, *(0.0,) * (3 - len(v))]) for v in (box.lower, box.upper))
        return contact.obstacle.may_overlap(lower, upper)

    def _may_overlap(self, pair: BodyContact) -> bool:
        """Whether the boxes of two bodies have a part in common."""
        a, b = self.bodies[pair.body].mesh, self.bodies[pair.other].mesh
        lower, upper = np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper)
        return bool((lower < upper).all())
