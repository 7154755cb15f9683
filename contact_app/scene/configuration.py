"""The configuration: the YAML file as typed, every key documented here.

The models below are the schema (``contact-app schema``), and their descriptions the manual.
They check types and ranges; what needs more than one key (names, dimensions) is checked when the
scene is built.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from contact_app.errors import ConfigurationError
from contact_app.scene import yaml_reader
from contact_app.scene.yaml_reader import Key, key_text

FIELDS = (
    "displacement", "stress", "von_mises", "nodal_stress", "nodal_von_mises", "contact_pressure",
    "smoothed_contact_pressure", "gap", "friction_traction", "slip", "contact_status", "body",
    "material",
)  # fmt: skip
EXPANSIONS = (
    "fixed",
    "grgr-optapprox",
    "gfgr-optapprox",
    "gfgf-optapprox",
    "grgr-opt",
    "gfgr-opt",
    "gfgf-opt",
    "projcg",
    "projcg-safe",
)
SPACES = {
    "2": (2, "strain"),
    "plane_strain": (2, "strain"),
    "plane_stress": (2, "stress"),
    "3": (3, None),
}

# Beyond these no unit of measurement leads, and products of a few such numbers stay finite.
LARGEST, SMALLEST = 1e50, 1e-50
MOST_REFINEMENTS = 6
MOST_ITERATIONS = 1_000_000_000
MOST_INCREMENTS = 10_000

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]
Numbers = Annotated[list[Number], Field(min_length=1, max_length=3)]
Counts = Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=1, max_length=3)]


class Model(BaseModel):
    """Base of all sections: unknown keys are errors with the nearest right one."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            allowed = cls.known_keys()
            for key in data:
                if key not in allowed:
                    near = difflib.get_close_matches(str(key), allowed, 1, 0.5)
                    hint = f"did you mean {near[0]}? " if near else ""
                    raise PydanticCustomError(
                        "unknown_key",
                        "is an unknown key; {hint}allowed: {allowed}",
                        {"key": key, "hint": hint, "allowed": ", ".join(allowed)},
                    )
        return data

    @classmethod
    def known_keys(cls) -> list[str]:
        """The keys of this section, as they are typed."""
        return [f.alias or name for name, f in cls.model_fields.items()]


class Box(Model):
    """A box of equal cells."""

    lower: Numbers = Field(description="Corner with the smallest coordinates (length).")
    upper: Numbers = Field(description="Corner with the largest coordinates (length).")
    cells: Counts = Field(
        description="Cells along each axis; a tetrahedron mesh has six and a triangle mesh two "
        "cells in each."
    )
    cell: Literal["hexahedron", "tetrahedron", "quadrilateral", "triangle"] | None = Field(
        None, description="Cell type; hexahedron in 3D and quadrilateral in 2D unless given."
    )


class Rotation(Model):
    """A turn about a line through the origin."""

    angle: Number = Field(description="Degrees, counter-clockwise seen against the axis.")
    axis: Numbers | None = Field(None, description="Direction of the axis, 3D only.")


class Mesh(Model):
    """Where a body's mesh comes from: a box or a file, which may be scaled, turned and moved."""

    box: Box | None = Field(None, description="A box of equal cells.")
    file: str | None = Field(
        None,
        description="A mesh file meshio reads (Gmsh .msh and others), from the directory of this "
        "file on; physical groups become names of boundaries and materials.",
    )
    group: str | Annotated[list[str], Field(min_length=1)] | None = Field(
        None, description="Cell groups of the file that make this body; all cells unless given."
    )
    scale: Positive = Field(1.0, description="Factor of the file's coordinates, above 0; first.")
    rotate: Rotation | None = Field(
        None, description="Turn about the origin: {angle, axis}; after scaling."
    )
    translate: Numbers | None = Field(None, description="Displacement (length); last.")
    refine: Annotated[int, Field(ge=0, le=MOST_REFINEMENTS)] = Field(
        0, description="How often every edge of the file's cells is halved, 0 to 6."
    )

    @field_validator("group", mode="wrap")
    @classmethod
    def _group(cls, value: Any, check: Callable[[Any], Any]) -> Any:
        try:
            return check(value)
        except ValidationError:
            raise PydanticCustomError(
                "told", "is {value}; allowed: the name of a group of cells or a list of them",
                {"value": _shown(value)},
            ) from None  # fmt: skip


class Material(Model):
    """Isotropic linear elasticity."""

    young: Positive = Field(description="Young's modulus (force per area), above 0.")
    poisson: Number = Field(description="Poisson's ratio, -1 < ν < 0.5.")
    expansion: Number = Field(
        0.0, description="Coefficient of thermal expansion (strain per degree)."
    )
    yield_stress: Positive | None = Field(
        None,
        alias="yield",
        description="Yield stress (force per area): the certificate warns where the von Mises "
        "stress exceeds it.",
    )


def _material_form(value: Any) -> str:
    """Which of the two forms of `material` was meant."""
    groups = isinstance(value, dict) and value and all(isinstance(v, dict) for v in value.values())
    return "{groups}" if groups else "{one}"


class Boundary(Model):
    """A named part of a body's surface."""

    where: str = Field(
        description="Condition in x, y, z that its nodes satisfy, e.g. `z < 1e-9`; arithmetic, "
        "comparisons and functions, parsed and never executed."
    )


class Body(Model):
    """An elastic body."""

    name: str = Field(description="Name by which conditions and contacts refer to it.")
    mesh: Mesh = Field(description="Where the mesh comes from: {box: …} or {file: …}.")
    degree: int = Field(1, description="Polynomial degree of the displacement, 1 or 2.")
    mean_dilatation: bool = Field(
        False,
        description="Change of volume taken as its mean over each cell (B-bar), so that "
        "first-order quadrilaterals and hexahedra do not lock as Poisson's ratio nears 0.5.",
    )
    material: Annotated[
        Annotated[Material, Tag("{one}")] | Annotated[dict[str, Material], Tag("{groups}")],
        Discriminator(_material_form),
    ] = Field(description="{young, poisson}, or {group: {young, poisson}, …} by cell group.")
    boundaries: dict[str, Boundary] = Field(
        default_factory=dict,
        description="Named parts of the surface; boxes also know x-, x+, y-, y+, z-, z+, and "
        "meshes from files their groups of facets.",
    )
    hold: list[str] = Field(
        default_factory=list,
        description="Rigid motions of the body that are held in the mean: x, y, z move it, rx, ry, "
        "rz turn it about its centre.",
    )


class Plane(Model):
    """Half space; the normal points out of it."""

    point: Numbers = Field(description="Any point of the plane (length).")
    normal: Numbers = Field(description="Direction out of the obstacle.")


class Sphere(Model):
    """Ball (a circle in 2D)."""

    center: Numbers = Field(description="Centre (length).")
    radius: Positive = Field(description="Radius (length), above 0.")
    hollow: bool = Field(False, description="True: the obstacle is what lies outside.")


class Cylinder(Model):
    """Infinite round bar (3D)."""

    point: Numbers = Field(description="Any point of the axis (length).")
    axis: Numbers = Field(description="Direction of the axis.")
    radius: Positive = Field(description="Radius (length), above 0.")
    hollow: bool = Field(False, description="True: the obstacle is what lies outside.")


class Obstacle(Model):
    """A rigid obstacle: exactly one shape."""

    plane: Plane | None = Field(None, description="Half space: {point, normal}.")
    sphere: Sphere | None = Field(
        None, description="Ball, a circle in 2D: {center, radius, hollow}."
    )
    cylinder: Cylinder | None = Field(
        None, description="Infinite round bar, 3D only: {point, axis, radius, hollow}."
    )


class RigidBody(Model):
    """A rigid body: no mesh, no material."""

    name: str = Field(description="Name by which conditions and contacts refer to it.")
    rigid: Annotated[list[Obstacle], Field(min_length=1)] = Field(
        description="Its shape as obstacles have it, {plane: …}, {sphere: …} or {cylinder: …}, or "
        "a list of several that move as one; the centre or point of the first is where forces "
        "act and what it turns about."
    )

    @field_validator("rigid", mode="before")
    @classmethod
    def _one_or_several(cls, value: Any) -> Any:
        return [value] if isinstance(value, dict) else value


def _body_form(value: Any) -> str:
    """Whether a body is elastic or rigid."""
    return "{rigid}" if isinstance(value, dict) and "rigid" in value else "{elastic}"


class Condition(Model):
    """A displacement or a load."""

    name: Annotated[str, Field(min_length=1, max_length=100)] | None = Field(
        None,
        description="Name by which `cases` and `steps` give it a factor; without a name it always "
        "acts in full.",
    )
    on: str | None = Field(None, description="Boundary, as body.boundary.")
    inside: str | None = Field(
        None,
        alias="in",
        description="Body, for a force or a temperature; a rigid body for displacement, rotation, "
        "total_force and total_moment.",
    )
    displacement: Annotated[list[Number | None], Field(min_length=1, max_length=3)] | None = Field(
        None, description="Displacement by component (length); null leaves a component free."
    )
    rotation: Annotated[list[Number | None], Field(min_length=1, max_length=3)] | Number | None = (
        Field(
            None,
            description="Rotation of a rigid body about its centre or point, by component "
            "(radians; one number in 2D); null leaves a component free.",
        )
    )
    traction: Numbers | None = Field(None, description="Force per area.")
    pressure: Number | None = Field(None, description="Pressure against the outward normal.")
    force: Numbers | None = Field(None, description="Force per volume.")
    temperature: Number | str | None = Field(
        None,
        description="Rise over the temperature at which the body is free of stress: a number of "
        "degrees or an expression in x, y, z; several of one body add up.",
    )
    total_force: Numbers | None = Field(
        None,
        description="Force on the whole boundary, as a uniform traction that adds up to it on "
        "every mesh; with `at` it acts there.",
    )
    total_moment: Numbers | Number | None = Field(
        None,
        description="Moment on the whole boundary (a number in 2D), as a traction that is linear "
        "in the place; beside a total_force or alone.",
    )
    at: Numbers | None = Field(
        None,
        description="Point at which total_force and total_moment act, on the body or away from it "
        "(length); the centroid of the boundary unless given.",
    )

    @field_validator("temperature", mode="wrap")
    @classmethod
    def _temperature(cls, value: Any, check: Callable[[Any], Any]) -> Any:
        try:
            return check(value)
        except ValidationError:
            raise PydanticCustomError(
                "told", "is {value}; allowed: a number, or an expression in x, y, z",
                {"value": _shown(value)},
            ) from None  # fmt: skip


NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]


class Friction(Model):
    """What keeps two surfaces from sliding: exactly one law."""

    coulomb: NotNegative | None = Field(
        None,
        description="Coefficient of friction: the friction traction is at most this times the "
        "contact pressure.",
    )
    tresca: NotNegative | None = Field(
        None,
        description="Slip limit (force per area): the friction traction is at most this on the "
        "whole boundary of `on`, open or not.",
    )


class Contact(Model):
    """A boundary that may touch something: an obstacle or another body."""

    on: str = Field(description="Boundary, as body.boundary.")
    obstacle: Obstacle | None = Field(None, description="A rigid obstacle.")
    against: str | None = Field(
        None,
        description="Another body's boundary, as body.boundary; the contact pressure lives on the "
        "nodes of `on`, which had better be the finer mesh. Or the name of a rigid body.",
    )
    tied: bool = Field(
        False,
        description="The two boundaries hold together in all directions; their meshes need not "
        "match.",
    )
    friction: Friction | None = Field(
        None,
        description="Friction: {coulomb: coefficient} or {tresca: slip limit}; without it the "
        "boundary slides freely.",
    )
    interference: Number = Field(
        0.0,
        description="Overlap along the normal (length), added to what the geometry overlaps; a "
        "negative one is a clearance.",
    )
    round: bool = Field(
        False,
        description="Flat facets of both sides stand for smooth surfaces through their nodes: the "
        "gap is that of these. For round bodies of straight edges that touch each other.",
    )


class Split(Model):
    """A decomposition asked for."""

    subdomains: Annotated[int, Field(ge=1)] | Counts = Field(
        description="A number: that many, cut by planes or along the graph of the mesh. A list: "
        "sub-boxes along each axis; a mesh from a file is cut into as many."
    )

    @field_validator("subdomains", mode="wrap")
    @classmethod
    def _subdomains(cls, value: Any, check: Callable[[Any], Any]) -> Any:
        try:
            return check(value)
        except ValidationError:
            raise PydanticCustomError(
                "told", "is {value}; allowed: a whole number from 1 on, or a list of them, one "
                "an axis", {"value": _shown(value)},
            ) from None  # fmt: skip


class Solver(Model):
    """How far and by what to solve."""

    method: Literal["auto", "active-set", "smalbe", "primal"] = Field(
        "auto",
        description="auto: multigrid (primal) for bodies from mesh files of degree "
        "1 in space from 20,000 unknowns on, else primal-dual active sets by Total FETI, with "
        "SMALBE-M where they do not settle. active-set: Total FETI without SMALBE-M. smalbe: the "
        "algorithm of Kružík et al. (2020), MPRGP with the named expansion inside SMALBE-M; it is "
        "meant where an expansion is named "
        "without a method. primal: active sets on the undecomposed bodies, conjugate gradients "
        "with algebraic multigrid on each set; Total FETI where that ends without a certificate. "
        "Where another method does, the scene is solved again in as few subdomains as possible and "
        "then by Newton's method. A warning says so.",
    )
    tolerance: Annotated[
        float | Literal["auto"],
        WithJsonSchema(
            {"anyOf": [{"const": "auto"}, {"type": "number", "minimum": 1e-14, "maximum": 1}]}
        ),
    ] = Field(
        1e-6,
        description="The run ends when penetration and gluing jumps (over the largest "
        "displacement), complementarity and equality residuals (over the load) and the duality "
        "gap (over the energy) are all below it; 1e-14 to 1. auto: a tenth of the estimated "
        "relative error of the mesh, which also bounds the error of the solver in energy norm.",
    )
    expansion: Literal[EXPANSIONS] = Field(  # type: ignore[valid-type]
        "projcg-safe",
        description="Expansion step of MPRGP (Kružík et al. 2020, section 3); in gfgr the first "
        "is the direction, the second the gradient that sets the length. projcg-safe is projcg "
        "with a guarantee of descent, at no extra product.",
    )
    alpha_u: Annotated[float, Field(gt=0, le=2)] = Field(
        1.9, description="Step length of fixed, optapprox and opt expansions, 0 < α ≤ 2."
    )
    gamma: Positive = Field(1.0, description="Γ of the proportioning test, above 0.")
    max_iterations: Annotated[int, Field(ge=1, le=MOST_ITERATIONS)] = Field(
        10_000, description="Limit of inner iterations."
    )

    @model_validator(mode="before")
    @classmethod
    def _an_expansion_means_smalbe(cls, value: Any) -> Any:
        if isinstance(value, dict) and "expansion" in value and "method" not in value:
            return {**value, "method": "smalbe"}
        return value

    @field_validator("tolerance", mode="wrap")
    @classmethod
    def _tolerance(cls, value: Any, check: Callable[[Any], Any]) -> Any:
        if not isinstance(value, str):
            return _TOLERANCE.validate_python(value)
        if value != "auto":
            raise PydanticCustomError(
                "told", "is {value}; allowed: auto, or a number from 1e-14 to 1",
                {"value": _shown(value)},
            )  # fmt: skip
        return value


_TOLERANCE: TypeAdapter[float] = TypeAdapter(
    Annotated[float, Field(ge=1e-14, lt=1)], config=ConfigDict(strict=True, allow_inf_nan=False)
)


class Certificate(Model):
    """What the certificate holds beyond what it always does."""

    guaranteed: bool = Field(
        False,
        description="Bound the error of mesh and solver together, guaranteed, by a stress in "
        "equilibrium: boxes of degree 1 and flat obstacles parallel to their faces.",
    )


class SectionPlane(Model):
    """A plane through a body."""

    point: Numbers = Field(description="Any point of the plane (length).")
    normal: Numbers = Field(
        description="Direction across it, out of the side whose force and moment are told."
    )


class Section(Model):
    """Where a body is cut in thought, to tell the force between the two sides."""

    plane: SectionPlane = Field(description="{point, normal}.")
    inside: str = Field(alias="in", description="Name of the body.")


class Output(Model):
    """What is written."""

    xdmf: bool = Field(True, description="Write solution.xdmf and solution.h5 for ParaView.")
    vtu: bool = Field(False, description="Write solution.vtu, the same in one file.")
    fields: list[Literal[FIELDS]] = Field(  # type: ignore[valid-type]
        default_factory=lambda: list(FIELDS), description="Fields to write."
    )
    probes: dict[str, Numbers] = Field(
        default_factory=dict,
        description="Points by name, {tip: [x, y, z]} (length): `probes` in summary.json has their "
        "displacements.",
    )
    sections: dict[str, Section] = Field(
        default_factory=dict,
        description="Sections by name, {neck: {plane: {point, normal}, in: body}}: `sections` in "
        "summary.json has the force and moment that the side in front of the plane exerts on the "
        "side behind it.",
    )


class Step(Model):
    """A step of a load history: factors of named conditions at its end."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Number]

    increments: Annotated[int, Field(ge=1, le=MOST_INCREMENTS)] = Field(
        1, description="Equal parts in which the step is solved; 1 to 10000."
    )

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        """Names of conditions are checked where these are known."""
        return data


class Configuration(Model):
    """A contact scene."""

    title: str = Field("", max_length=200, description="One line for reports.")
    dimension: Annotated[
        int | str, WithJsonSchema({"enum": [3, 2, "plane_strain", "plane_stress"]})
    ] = Field(description="3, or 2 (which means plane_strain), or plane_strain or plane_stress.")
    bodies: list[
        Annotated[
            Annotated[Body, Tag("{elastic}")] | Annotated[RigidBody, Tag("{rigid}")],
            Discriminator(_body_form),
        ]
    ] = Field(min_length=1, description="Elastic bodies, and rigid ones that have no mesh.")
    conditions: list[Condition] = Field(
        default_factory=list, description="Displacements and loads."
    )
    contacts: list[Contact] = Field(default_factory=list, description="What may touch what.")
    cases: Annotated[dict[str, dict[str, Number]], Field(min_length=1)] | None = Field(
        None,
        description="Load cases, {case: {condition name: factor}}, each from the unloaded state. A "
        "named condition that a case leaves out has factor 0; conditions without a name act in "
        "full. A displacement condition always holds, its factor scales its value.",
    )
    steps: Annotated[list[Step], Field(min_length=1)] | None = Field(
        None,
        description="Load history, [{condition name: factor, …, increments: 1}, …]: named "
        "conditions reach the factors linearly at the end of each step. A named condition has "
        "factor 0 before the first step that names it and keeps its last factor afterwards; "
        "conditions without a name act in full throughout. Not with `cases`.",
    )
    decomposition: Literal["auto"] | Split = Field(
        "auto", description="auto, or {subdomains: N | [nx, ny, nz]}."
    )
    symmetry: Literal["none", "allow"] = Field(
        "none",
        description="allow: a scene that mirrors about planes midway through its bodies is "
        "solved on one side of them and written as a whole; none.",
    )
    accuracy: Annotated[float, Field(ge=1e-4, lt=1)] | None = Field(
        None,
        description="Relative error in energy norm to reach: meshes are refined, those given being "
        "the start, until the estimated total error is below it; 1e-4 to 1.",
    )
    solver: Solver = Field(
        Solver.model_validate({}), description="Tolerance and method of the solver."
    )
    certificate: Certificate = Field(
        Certificate.model_validate({}), description="What to certify beyond the usual."
    )
    output: Output = Field(Output.model_validate({}), description="Files and fields to write.")

    _lines: dict[Key, int] = PrivateAttr(default_factory=dict)
    _overridden: dict[Key, str] = PrivateAttr(default_factory=dict)
    _source: Path = PrivateAttr(default=Path("scene"))

    @field_validator("title")
    @classmethod
    def _title(cls, value: str) -> str:
        if not value.isprintable():
            raise PydanticCustomError(
                "told", "is {value}; one line of printable text is allowed", {"value": repr(value)}
            )
        return value

    @field_validator("dimension", mode="before")
    @classmethod
    def _dimension(cls, value: Any) -> Any:
        _space(value)
        return value

    @field_validator("decomposition", mode="before")
    @classmethod
    def _decomposition(cls, value: Any) -> Any:
        if isinstance(value, dict):
            return Split.model_validate(value)
        if value != "auto" and not isinstance(value, Split):
            raise PydanticCustomError(
                "told", "is {value}; allowed: auto or {form}",
                {"value": _shown(value), "form": "{subdomains: N | [nx, ny, nz]}"},
            )  # fmt: skip
        return value

    @property
    def space(self) -> tuple[int, str | None]:
        """Dimension and, in 2D, `strain` or `stress`."""
        return _space(self.dimension)

    @property
    def source(self) -> Path:
        """The file it was read from."""
        return self._source

    def where(self, path: Sequence[str | int]) -> str:
        """File, line and key of a place, to begin a message with."""
        return _where(path, str(self._source), self._lines, self._overridden)


def _space(value: Any) -> tuple[int, str | None]:
    text = str(value).lower() if isinstance(value, str) or type(value) is int else ""
    words = re.sub(r"[^a-z0-9_]+", " ", text).split()
    if len(words) == 2 and words[0] == "2":
        words = words[1:]
    if len(words) != 1 or words[0] not in SPACES:
        raise PydanticCustomError(
            "told", "is {value}; allowed: 3, 2, plane_strain, plane_stress",
            {"value": _shown(value)},
        )  # fmt: skip
    return SPACES[words[0]]


def load(path: Path | str, overrides: Sequence[str] = ()) -> Configuration:
    """Read and check a configuration.

    Parameters
    ----------
    path
        The YAML file.
    overrides
        Changes as ``path.to.key=value``: list items by number, values as YAML; missing mappings
        are made, and a scalar on the way is replaced.

    Raises
    ------
    ConfigurationError
        With one line for each problem: file, line, key and what is allowed.
    """
    path = Path(path)
    data, lines = yaml_reader.read(path)
    if not isinstance(data, dict):
        raise ConfigurationError(f"{path}:1: holds no mapping; a scene is a mapping of keys")
    return _checked(data, lines, path, overrides)


def from_mapping(data: Mapping[str, Any], overrides: Sequence[str] = ()) -> Configuration:
    """Check a configuration given as a mapping of the keys of a file.

    Errors are those of `load`, without file and line.
    """
    return _checked(_as_read(data), {}, Path("scene"), overrides)


def _as_read(value: Any) -> Any:
    """The same in the types that YAML has: tuples, arrays, numpy's numbers and paths are known."""
    if isinstance(value, Mapping):
        return {key: _as_read(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_as_read(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's arrays and numbers, without importing numpy
        return _as_read(value.tolist())
    return str(value) if isinstance(value, Path) else value


def _checked(
    data: dict[str, Any], lines: dict[Key, int], path: Path, overrides: Sequence[str]
) -> Configuration:
    """The configuration of data, after changes; `lines` has the line of each key."""
    overridden: dict[Key, str] = {}
    for text in overrides:
        _override(data, text, overridden)
    try:
        configuration = Configuration.model_validate(data)
    except ValidationError as error:
        messages = [
            _message(details, data, str(path), lines, overridden) for details in error.errors()
        ]
        raise ConfigurationError("\n".join(dict.fromkeys(messages))) from None
    configuration._lines = lines
    configuration._overridden = overridden
    configuration._source = path
    return configuration


def _override(data: Any, text: str, overridden: dict[Key, str]) -> None:
    """Carry out one ``--set``."""
    name = "--set " + (text if len(text) <= 80 else text[:77] + "...")
    key, equals, value_text = text.partition("=")
    words = re.sub(r"\[([0-9]+)\]", r".\1", key.strip()).split(".")  # bodies[0] as messages say it
    parts = [int(p) if re.fullmatch("[0-9]{1,9}", p) else p for p in words]
    if not equals or not all(p != "" for p in parts):
        raise ConfigurationError(f"{name}: has the form path.to.key=value")
    if len(parts) > yaml_reader.DEEPEST:
        raise ConfigurationError(f"{name}: is nested deeper than {yaml_reader.DEEPEST} levels")
    value = yaml_reader.scalar(value_text, name)
    for depth, (part, following) in enumerate(zip(parts, [*parts[1:], None], strict=True)):
        here = key_text(parts[:depth]) or "the file"
        if isinstance(data, list):
            if not isinstance(part, int) or part > len(data):
                raise ConfigurationError(
                    f"{name}: {here} is a list of {len(data)}; an item is named by its number"
                )
            if part == len(data):
                data.append(None)
        else:
            part = str(part)
            data.setdefault(part, None)
        parts[depth] = part
        if following is None:
            data[part] = value
        elif not isinstance(data[part], (dict, list)):
            data[part] = [] if following == 0 else {}
        else:
            data = data[part]
            continue
        _claim(tuple(parts[: depth + 1]), name, overridden)
        data = data[part]


def _claim(key: Key, name: str, overridden: dict[Key, str]) -> None:
    """From here on all below `key` is the doing of the override `name`."""
    for earlier in [k for k in overridden if k[: len(key)] == key]:
        del overridden[earlier]
    overridden[key] = name


def _where(
    path: Sequence[str | int], file: str, lines: dict[Key, int], overridden: dict[Key, str]
) -> str:
    key = tuple(path)
    for length in range(len(key), 0, -1):
        if key[:length] in overridden:
            return f"{overridden[key[:length]]}: {key_text(path)}"
    for length in range(len(key), -1, -1):
        if key[:length] in lines:
            return f"{file}:{lines[key[:length]]}: {key_text(path)}"
    return f"{file}: {key_text(path)}"


def _message(
    details: ErrorDetails,
    data: Any,
    file: str,
    lines: dict[Key, int],
    overridden: dict[Key, str],
) -> str:
    """One readable line from one of pydantic's errors."""
    path = _real_path(details["loc"], data)
    kind, context = details["type"], details.get("ctx", {})
    value = details["input"]
    if kind == "unknown_key":
        path = (*path, str(context["key"]))
    if kind == "missing":
        allowed = f"is missing in {key_text(path[:-1]) or 'the file'}"
        at = _where(path[:-1], file, lines, overridden)
        return f"{at.rsplit(': ', 1)[0]}: {key_text(path)} {allowed}"
    at = _where(path, file, lines, overridden)
    shown = _shown(value)
    if kind in ("unknown_key", "told"):
        return f"{at} {details['msg']}"
    section = globals().get(str(context.get("class_name")))
    keys = ""
    if isinstance(section, type) and issubclass(section, Model):
        keys = f", with the keys {', '.join(section.known_keys())}"
    limit = next((f"{context[k]:g}" for k in ("gt", "ge", "lt", "le") if k in context), "")
    if context.get("ge") == SMALLEST:
        limit = f"{SMALLEST:g}, that is above 0"
    wanted = {
        "finite_number": "a finite number is allowed",
        "float_type": "a number is allowed",
        "int_type": "a whole number is allowed",
        "string_type": "text is allowed",
        "string_unicode": "one line of printable text is allowed",
        "bool_type": "true or false is allowed",
        "list_type": "a list is allowed",
        "model_type": f"a mapping is allowed{keys}",
        "dict_type": "a mapping of keys is allowed",
        "literal_error": f"allowed: {context.get('expected', '')}",
        "greater_than": f"it must be above {limit}",
        "greater_than_equal": f"it must be at least {limit}",
        "less_than": f"it must be below {limit}",
        "less_than_equal": f"it must be at most {limit}",
        "too_short": "it must not be empty",
        "too_long": f"at most {context.get('max_length')} items are allowed",
        "string_too_long": f"at most {context.get('max_length')} characters are allowed",
    }.get(kind, details["msg"])
    if kind == "literal_error" and isinstance(value, str):
        near = difflib.get_close_matches(value, re.findall(r"'([^']+)'", wanted), 1)
        wanted += f"; did you mean {near[0]}?" if near else ""
    return f"{at} is {shown}; {wanted}"


def _real_path(location: Sequence[str | int], data: Any) -> Key:
    """The part of pydantic's location that exists in the data (unions add names of their own)."""
    path: list[str | int] = []
    for part in location:
        if isinstance(data, dict) and isinstance(part, str):
            if part in data:
                data = data[part]
            elif part != location[-1] or part.startswith("{"):
                continue
            path.append(part)
        elif isinstance(data, list) and isinstance(part, int) and part < len(data):
            data = data[part]
            path.append(part)
    return tuple(path)


def _shown(value: Any) -> str:
    text = "empty" if value is None else repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."
