"""The configuration: a scene file as typed by the user, read and checked.

`contact_app.scene.schema` has its sections.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationError,
    WithJsonSchema,
    field_validator,
)
from pydantic_core import PydanticCustomError

from contact_app.errors import ConfigurationError
from contact_app.scene import yaml_reader
from contact_app.scene.key_messages import message, where
from contact_app.scene.overrides import override
from contact_app.scene.schema.base import WEIGHT, Model, Number, not_allowed
from contact_app.scene.schema.bodies import Body, RigidBody, body_form
from contact_app.scene.schema.conditions import Condition, Contact, Step
from contact_app.scene.schema.options import Certificate, Output, Solver, Split
from contact_app.scene.yaml_reader import Key

SPACES = {
    "2": (2, "strain"),
    "plane_strain": (2, "strain"),
    "plane_stress": (2, "stress"),
    "3": (3, None),
}


AXISYMMETRIC = (
    "; a body of revolution is drawn in 3D, a quarter of it between two planes of symmetry, or "
    "solved with forms of your own in Python (ContactProblem)"
)
"""Advice for a dimension that scenes do not have."""


class Configuration(Model):
    """A contact scene."""

    why_absent: ClassVar[dict[str, str]] = dict.fromkeys(("weight", "gravity"), WEIGHT)

    title: str = Field("", max_length=200, description="One line for reports.")
    dimension: Annotated[
        int | str, WithJsonSchema({"enum": [3, 2, "plane_strain", "plane_stress"]})
    ] = Field(description="3, or 2 (which means plane_strain), or plane_strain or plane_stress.")
    bodies: list[
        Annotated[
            Annotated[Body, Tag("{elastic}")] | Annotated[RigidBody, Tag("{rigid}")],
            Discriminator(body_form),
        ]
    ] = Field(min_length=1, description="Elastic bodies, and rigid ones that have no mesh.")
    conditions: list[Condition] = Field(
        default_factory=list, description="Displacements and loads."
    )
    contacts: list[Contact] = Field(
        default_factory=list, description="Boundaries that may touch obstacles or other bodies."
    )
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
                "refused",
                "is {value}; one line of printable text is allowed",
                {"value": repr(value)},
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
            raise not_allowed(value, "auto or {subdomains: N | [nx, ny, nz]}")
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
        return where(path, str(self._source), self._lines, self._overridden)


def _space(value: Any) -> tuple[int, str | None]:
    text = str(value).lower() if isinstance(value, str) or type(value) is int else ""
    words = re.sub(r"[^a-z0-9_]+", " ", text).split()
    if len(words) == 2 and words[0] == "2":
        words = words[1:]
    if len(words) != 1 or words[0] not in SPACES:
        remedy = AXISYMMETRIC if text.startswith(("axi", "cylindric", "rotation")) else ""
        raise not_allowed(value, f"3, 2, plane_strain, plane_stress{remedy}")
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
    """The value in the types of YAML; tuples, arrays, numbers of numpy and paths are converted."""
    if isinstance(value, Mapping):
        # YAML 1.1, and so PyYAML, reads the key `on` as True
        return {"on" if key is True else key: _as_read(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_as_read(item) for item in value]
    if hasattr(value, "tolist"):  # numpy's arrays and numbers, without importing numpy
        return _as_read(value.tolist())
    return str(value) if isinstance(value, Path) else value


def _checked(
    data: dict[str, Any], lines: dict[Key, int], path: Path, overrides: Sequence[str]
) -> Configuration:
    """The configuration of data after overrides; `lines` has the line of each key."""
    overridden: dict[Key, str] = {}
    for text in overrides:
        override(data, text, overridden)
    try:
        configuration = Configuration.model_validate(data)
    except ValidationError as error:
        messages = [
            message(details, data, str(path), lines, overridden) for details in error.errors()
        ]
        raise ConfigurationError("\n".join(dict.fromkeys(messages))) from None
    configuration._lines = lines
    configuration._overridden = overridden
    configuration._source = path
    return configuration
