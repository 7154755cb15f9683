"""An extrapolated solution of known accuracy, and the distances of other solutions from it.

A scene is solved on three meshes, each with cells half as long as the one before. The distances
between successive solutions, e₁ of the two finest and e₂ of the two coarser, give the rate 2ᵖ =
e₂/e₁ and with it the distance r of the finest solution from the limit,

    r = e₁/√(4ᵖ - 1)  in energy norm, where errors are orthogonal,
    r = e₁/(2ᵖ - 1)   in displacement and pressure.

The error of another solution is its distance from the finest one, in energy norm √(distance² + r²).
All errors are relative to the finest solution; displacements and pressures are compared in the root
mean square over volume and contact boundary. An error near r is known only to be small.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.scene import Scene
from contact_app.studies.fields_on_meshes import BodyNodes, PointsOfMesh
from meshes.arrays import Array, Ints, Mask

LEAST_KNOWN = 0.01
"""Weight of nodes with a contact row from which on their pressure is extrapolated."""
QUANTITIES = ("energy", "displacement", "pressure")


@dataclass(frozen=True, eq=False)
class Fields:
    """A solution at the nodes of all bodies, one body after the other."""

    points: Array  # (nodes, 3)
    displacement: Array  # (nodes, dimension)
    pressure: Array  # (nodes,)
    watched: Mask  # (nodes,)
    """Nodes with a contact row."""
    first_node: Ints  # (bodies + 1,)
    degree: Ints  # (bodies,)
    cell: NDArray[np.str_]  # (bodies,)
    cells: list[Ints] = field(default_factory=list)
    tags: list[NDArray[np.int32]] = field(default_factory=list)
    facets: list[Ints] = field(default_factory=list)
    """Data of each body, as in `BodyNodes`; solutions by PETSc's solvers have no facets."""

    LISTS = ("cells", "tags", "facets")

    @classmethod
    def load(cls, path: str) -> "Fields":
        """Read the fields that `save` wrote."""
        with np.load(path) as data:
            single = {name: data[name] for name in data if "_0" not in name}
            fields = cls(**single)
            for name in cls.LISTS:
                keys = sorted(key for key in data if key.startswith(f"{name}_0"))
                getattr(fields, name).extend(data[key] for key in keys)
            return fields

    def save(self, path: Path) -> None:
        """Write the fields for `load`."""
        named = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name in self.LISTS:
            named |= {f"{name}_0{i:03}": part for i, part in enumerate(named.pop(name))}
        np.savez(path, **named)

    def body(self, number: int) -> slice:
        """Nodes of one body."""
        return slice(int(self.first_node[number]), int(self.first_node[number + 1]))

    def nodes(self, number: int) -> BodyNodes:
        """Nodes and cells of one body."""
        return BodyNodes(
            cell=str(self.cell[number]),
            degree=int(self.degree[number]),
            points=self.points[self.body(number)],
            cells=self.cells[number],
            tags=self.tags[number],
            facets=self.facets[number] if self.facets else np.zeros((0, 0), np.int64),
        )


@dataclass(frozen=True, eq=False)
class Sampled:
    """A solution at the points of each body: (points, dimension) and (points,)."""

    displacement: list[Array]
    pressure: list[Array]


@dataclass(frozen=True, eq=False)
class Distances:
    """Measures distances between solutions at the nodes of the finest one, body by body."""

    scene: Scene
    places: tuple[PointsOfMesh, ...]

    @classmethod
    def of(cls, scene: Scene, finest: Fields) -> "Distances":
        """Distances at the nodes of the finest solution."""
        return cls(scene, tuple(PointsOfMesh(finest.nodes(i)) for i in range(len(scene.bodies))))

    def sample(self, fields: Fields) -> Sampled:
        """Evaluate an answer at the points; pressures are linear between nodes.

        If a facet has nodes without a contact row, for instance held nodes, the pressure of the
        other nodes is extrapolated to them. Their stored zero has no meaning.
        """
        displacement, pressure = [], []
        for number, place in enumerate(self.places):
            of_body, nodes = fields.body(number), fields.nodes(number)
            displacement.append(place.sample(nodes, fields.displacement[of_body]))
            watched = fields.watched[of_body] | (fields.pressure[of_body] > 0.0)
            values = np.column_stack([fields.pressure[of_body], watched])
            p, weight = place.sample(nodes, values, first_order=True).T
            pressure.append(p / np.where(weight > LEAST_KNOWN, weight, 1.0))
        return Sampled(displacement, pressure)

    def norms(self, one: Sampled, other: Sampled | None = None) -> Array:
        """Energy norm, and root of sums of squares of displacement and pressure, (3,).

        Norms of the difference, or of `one` alone.
        """
        squares = np.zeros(3)
        for number, place in enumerate(self.places):
            u, p = one.displacement[number], one.pressure[number]
            if other is not None:
                u, p = u - other.displacement[number], p - other.pressure[number]
            squares[0] += place.energy(u, self.scene.bodies[number].materials, self.scene.plane)
            squares[1] += place.volume(u)
            squares[2] += place.areas @ p**2
        return np.sqrt(squares)


@dataclass(frozen=True, eq=False)
class ReferenceAnswer:
    """The finest solution and its distance from the limit."""

    distances: Distances
    finest: Sampled
    norms: Array
    accuracy: Array  # (3,)
    """Relative r of energy norm, displacement and pressure."""
    rates: Array  # (3,)
    """p."""

    @classmethod
    def of(cls, distances: Distances, answers: Sequence[Sampled]) -> "ReferenceAnswer":
        """Extrapolate three solutions, the coarsest first."""
        coarse, middle, finest = answers
        norms = distances.norms(finest)
        near, far = distances.norms(middle, finest), distances.norms(coarse, middle)
        rates, accuracy = extrapolate(near, far)
        with np.errstate(invalid="ignore", divide="ignore"):
            return cls(distances, finest, norms, accuracy / norms, rates)

    def errors(self, answer: Sampled) -> Array:
        """Relative errors in energy norm, displacement and pressure, (3,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            distance = self.distances.norms(answer, self.finest) / self.norms
        distance[0] = np.hypot(distance[0], self.accuracy[0])
        return distance

    def describe(self) -> str:
        """The accuracy of the reference in a sentence."""
        parts = [
            f"{name} {accuracy:.1e} (rate {rate:.2f})"
            for name, accuracy, rate in zip(QUANTITIES, self.accuracy, self.rates, strict=True)
            if np.isfinite(accuracy)
        ]
        return f"relative accuracy of the reference: {', '.join(parts)}"


SLOWEST, FASTEST = 0.25, 4.0
"""Limits of rates; a rate outside is replaced by the nearest limit."""


def extrapolate(near: Array, far: Array) -> tuple[Array, Array]:
    """Rates and distances from the limit, from distances of successive solutions, (3,) each.

    Parameters
    ----------
    near, far
        Distances of the two finest solutions, and of the two coarser ones.

    Examples
    --------
    >>> rates, left = extrapolate(np.array([0.5, 0.25, 1.0]), np.array([1.0, 1.0, 2.0]))
    >>> rates
    array([1., 2., 1.])
    >>> left.round(3)  # 0.5/√3, 0.25/3, 1/1
    array([0.289, 0.083, 1.   ])
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        rates = np.clip(np.log2(far / near), SLOWEST, FASTEST)
    factor = 2.0**rates
    left = near / (factor - 1.0)
    left[0] = near[0] / np.sqrt(factor[0] ** 2 - 1.0)
    return rates, left
