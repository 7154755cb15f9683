"""The keys of a scene file: messages that name file, line and key, and vectors checked."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from contact_app.errors import ConfigurationError
from contact_app.machine.memory import available_bytes
from contact_app.scene.configuration import Configuration

if TYPE_CHECKING:
    from mpi4py import MPI

Place = tuple[str | int, ...]
"""Place of a value: keys and list positions from the top of the file."""

Vector = tuple[float, float, float]
"""A vector in space."""


class Keys:
    """A configuration with the place of each key in the file.

    Attributes
    ----------
    dimension, plane
        Dimension of the scene, and "strain" or "stress" in the plane; `plane` is None in space.
    memory
        Bytes the scene may take.
    comm
        Ranks that build this scene together and share the checks of meshes; None for one alone.
    """

    def __init__(
        self,
        configuration: Configuration,
        memory: float | None = None,
        comm: "MPI.Intracomm | None" = None,
    ) -> None:
        self.configuration, self.comm = configuration, comm
        self.memory = available_bytes() if memory is None else memory
        self.dimension, self.plane = configuration.space

    def fail(self, path: Place, message: str) -> NoReturn:
        """Raise a ConfigurationError: file, line and key, then the message."""
        raise ConfigurationError(self.configuration.where(path) + " " + message)

    def vector(self, values: Sequence[float], path: Place, kind: str) -> tuple[float, ...]:
        """A vector with one component per axis of the scene."""
        if len(values) != self.dimension:
            self.fail(
                path,
                f"has {len(values)} components; {kind} in {self.dimension}D has {self.dimension}",
            )
        return tuple(values)

    def components(self, values: Sequence[object], path: Place) -> None:
        """Refuse a displacement with a wrong number of components."""
        d = self.dimension
        if len(values) != d:
            self.fail(
                path, f"has {len(values)} components; in {d}D it has {d} (null leaves one free)"
            )

    def space(self, values: Sequence[float], path: Place, kind: str) -> Vector:
        """A vector of the scene with three components, zero across a plane."""
        vector = self.vector(values, path, kind)
        x, y, z = (*vector, *(0.0,) * (3 - len(vector)))
        return x, y, z

    def direction(self, values: Sequence[float], path: Place) -> Vector:
        """A vector in space that is not zero, its largest component 1 or -1."""
        x, y, z = self.space(values, path, "a direction")
        scale = max(abs(x), abs(y), abs(z))
        if scale == 0.0:
            self.fail(path, "is zero, which is no direction")
        return x / scale, y / scale, z / scale
