"""Sections of options: decomposition, solver, certificate and output."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from contact_app.scene.schema.base import Counts, Model, Numbers, Positive, checked, not_allowed

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

MOST_ITERATIONS = 1_000_000_000


class Split(Model):
    """A requested decomposition."""

    subdomains: Annotated[int, Field(ge=1)] | Counts = Field(
        description="A number of subdomains, cut by planes or along the graph of the mesh. Or a "
        "list: sub-boxes along each axis; a mesh from a file is cut into the same total "
        "number."
    )

    @field_validator("subdomains", mode="wrap")
    @classmethod
    def _subdomains(cls, value: Any, check: Callable[[Any], Any]) -> Any:
        return checked(value, check, "a whole number from 1 on, or a list of them, one an axis")


class Solver(Model):
    """Tolerance and algorithm of the solver."""

    method: Literal["auto", "active-set", "smalbe", "primal"] = Field(
        "auto",
        description="auto: multigrid (primal) for thick bodies from mesh files in space (one body "
        "from 10,000 unknowns on, several of degree 1 from 40,000), otherwise primal-dual "
        "active sets by Total FETI, with SMALBE-M if they do not settle; `check` names the "
        "choice. active-set: Total FETI without SMALBE-M. smalbe: the algorithm of Kružík et "
        "al. (2020), MPRGP with the named expansion inside SMALBE-M; the default if an "
        "expansion is named. primal: active sets on the undecomposed bodies, conjugate "
        "gradients with algebraic multigrid on each set. If a method ends without a "
        "certificate, others follow (Total FETI, fewer subdomains, multigrid), and a "
        "warning says so.",
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
        "with a guarantee of descent, at no further operator application.",
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
            raise not_allowed(value, "auto, or a number from 1e-14 to 1")
        return value


_TOLERANCE: TypeAdapter[float] = TypeAdapter(
    Annotated[float, Field(ge=1e-14, lt=1)], config=ConfigDict(strict=True, allow_inf_nan=False)
)


class Certificate(Model):
    """Optional parts of the certificate."""

    guaranteed: bool = Field(
        False,
        description="Bound the error of mesh and solver together, guaranteed, by a stress in "
        "equilibrium: boxes of degree 1 and flat obstacles parallel to their faces.",
    )


class SectionPlane(Model):
    """A plane through a body."""

    point: Numbers = Field(description="Any point of the plane (length).")
    normal: Numbers = Field(
        description="Normal of the plane, out of the side on which force and moment act."
    )


class PlaneSection(Model):
    """A plane through a body, at which the force between the two sides is computed."""

    why_absent: ClassVar[dict[str, str]] = {"behind": "it is for an inner surface, {on, behind}"}

    plane: SectionPlane = Field(description="{point, normal}.")
    inside: str = Field(alias="in", description="Name of the body.")


class SurfaceSection(Model):
    """An inner surface of a body, at which the force between the two sides is computed."""

    why_absent: ClassVar[dict[str, str]] = dict.fromkeys(
        ("in", "plane"), "`on` names body and surface"
    )

    on: str = Field(
        description="An inner surface, body.name: facets between cells that a group of the mesh "
        "file or a boundary's expression names. It divides the body into two sides.",
    )
    behind: Numbers = Field(
        description="A point in the body on the side on which force and moment act (length).",
    )


def _section_form(value: Any) -> str:
    """Whether a section is an inner surface or a plane."""
    return "{surface}" if isinstance(value, dict) and "on" in value else "{plane}"


Section = Annotated[
    Annotated[PlaneSection, Tag("{plane}")] | Annotated[SurfaceSection, Tag("{surface}")],
    Discriminator(_section_form),
]


class Output(Model):
    """Options of the output."""

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
        description="Sections by name, {neck: {plane: {point, normal}, in: body}} or {ring: {on: "
        "body.surface, behind: point}}: `sections` in summary.json has the force and moment that "
        "the side in front of the plane or surface exerts on the side behind it.",
    )
