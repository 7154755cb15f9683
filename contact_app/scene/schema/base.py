"""Base of all sections of a scene file: types of numbers, and errors for unknown keys."""

import difflib
from collections.abc import Callable, Iterable
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

# No unit of measurement leads to larger numbers, and products of a few such numbers are finite.
LARGEST, SMALLEST = 1e50, 1e-50

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]
NotNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
Numbers = Annotated[list[Number], Field(min_length=1, max_length=3)]
Counts = Annotated[list[Annotated[int, Field(ge=1)]], Field(min_length=1, max_length=3)]


WEIGHT = "the weight of a body is a condition {in: body, force: [0, 0, -ρg]}, a force per volume"
"""Advice for those who look for weight, gravity or density."""


class Model(BaseModel):
    """Base of all sections: unknown keys are errors that suggest the nearest key."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False, extra="forbid")

    why_absent: ClassVar[dict[str, str]] = {}
    """Keys of similar sections that this one does not have, and why."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        """Refuse unknown keys, with the nearest known one."""
        if isinstance(data, dict):
            allowed = cls.known_keys()
            for key in data:
                if key not in allowed:
                    near = difflib.get_close_matches(str(key), allowed, 1, 0.5)
                    hint = f"did you mean {near[0]}? " if near else ""
                    if key in cls.why_absent:
                        hint = f"{cls.why_absent[key]}; "
                    if str(key)[:1].isdigit():
                        hint = "a comma begins a new key: 1000.5 is a number, [1, 2] a list; "
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


def suggestion(text: str, names: Iterable[str], prefix: str = "") -> str:
    """The end of a message that suggests the name nearest to a text; empty if none is near."""
    near = difflib.get_close_matches(text, list(names), 1)
    return f"; did you mean {prefix}{near[0]}?" if near else ""


def not_allowed(value: Any, allowed: str) -> PydanticCustomError:
    """The error for a value, with a phrase that lists what is allowed."""
    return PydanticCustomError(
        "refused", "is {value}; allowed: {allowed}", {"value": shown(value), "allowed": allowed}
    )


def checked(value: Any, check: Callable[[Any], Any], allowed: str) -> Any:
    """A value that passes a check; otherwise an error that lists what is allowed."""
    try:
        return check(value)
    except ValidationError:
        raise not_allowed(value, allowed) from None


def shown(value: Any) -> str:
    """A value in the form of error messages."""
    text = "empty" if value is None else repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."
