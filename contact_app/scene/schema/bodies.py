"""Sections of bodies: meshes, materials and boundaries of elastic ones, shapes of rigid ones."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag, field_validator

from contact_app.scene.schema.base import WEIGHT, Counts, Model, Number, Numbers, Positive, checked

MOST_REFINEMENTS = 6


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
    """Mesh of a body: a box or a file, which may be scaled, rotated and moved."""

    box: Box | None = Field(None, description="A box of equal cells.")
    file: str | None = Field(
        None,
        description="A mesh file meshio reads (Gmsh .msh and others), from the directory of this "
        "file on; physical groups become names of boundaries and materials.",
    )
    group: str | Annotated[list[str], Field(min_length=1)] | None = Field(
        None, description="Cell groups of the file that make this body; all cells unless given."
    )
    scale: Positive = Field(
        1.0, description="Factor on the file's coordinates, above 0; applied first."
    )
    rotate: Rotation | None = Field(
        None, description="Rotation about the origin: {angle, axis}; applied after scaling."
    )
    translate: Numbers | None = Field(None, description="Translation (length); applied last.")
    refine: Annotated[int, Field(ge=0, le=MOST_REFINEMENTS)] = Field(
        0, description="How often every edge of the file's cells is halved, 0 to 6."
    )

    @field_validator("group", mode="wrap")
    @classmethod
    def _group(cls, value: Any, check: Callable[[Any], Any]) -> Any:
        return checked(value, check, "the name of a group of cells or a list of them")


class Material(Model):
    """Isotropic linear elasticity."""

    why_absent: ClassVar[dict[str, str]] = {
        "density": WEIGHT, "E": "Young's modulus is young", "nu": "Poisson's ratio is poisson",
        "alpha": "the coefficient of thermal expansion is expansion",
    }  # fmt: skip

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
    """Form of `material`: one material, or materials by cell group."""
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
    mesh: Mesh = Field(description="Mesh: {box: …} or {file: …}.")
    degree: Literal[1, 2] = Field(1, description="Polynomial degree of the displacement, 1 or 2.")
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
    hollow: bool = Field(False, description="True: the obstacle is everything outside.")


class Cylinder(Model):
    """Infinite round bar (3D)."""

    point: Numbers = Field(description="Any point of the axis (length).")
    axis: Numbers = Field(description="Direction of the axis.")
    radius: Positive = Field(description="Radius (length), above 0.")
    hollow: bool = Field(False, description="True: the obstacle is everything outside.")


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

    why_absent: ClassVar[dict[str, str]] = dict.fromkeys(
        ("mesh", "degree", "material", "boundaries"), "a rigid body has no mesh and no material"
    )

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


def body_form(value: Any) -> str:
    """Whether a body is elastic or rigid."""
    return "{rigid}" if isinstance(value, dict) and "rigid" in value else "{elastic}"
