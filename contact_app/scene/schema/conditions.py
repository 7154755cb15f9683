"""Conditions, contacts, and the steps that give conditions their factors."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field, field_validator, model_validator

from contact_app.scene.schema.base import WEIGHT, Model, NotNegative, Number, Numbers, checked
from contact_app.scene.schema.bodies import Obstacle

MOST_INCREMENTS = 10_000


class Condition(Model):
    """A displacement or a load."""

    why_absent: ClassVar[dict[str, str]] = dict.fromkeys(("weight", "gravity"), WEIGHT)

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
        "in the position; with a total_force or alone.",
    )
    at: Numbers | None = Field(
        None,
        description="Point at which total_force and total_moment act, on the body or away from it "
        "(length); the centroid of the boundary unless given.",
    )

    @field_validator("temperature", mode="wrap")
    @classmethod
    def _temperature(cls, value: Any, check: Callable[[Any], Any]) -> Any:
        return checked(value, check, "a number, or an expression in x, y, z")


class Friction(Model):
    """Friction between two surfaces: exactly one law."""

    why_absent: ClassVar[dict[str, str]] = {"mu": "the coefficient of friction is coulomb"}

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
        description="Another body's boundary, as body.boundary; the contact pressure is computed "
        "at the nodes of `on`, which should be the finer mesh. Or the name of a rigid body.",
    )
    tied: bool = Field(
        False,
        description="The two boundaries are glued in all directions; their meshes need not match.",
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
        description="The gap is that of smooth surfaces through the nodes of both sides, instead "
        "of their flat facets. For round bodies with straight edges that touch each other.",
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
        """Accept all keys: names of conditions are checked later, when they are known."""
        return data
