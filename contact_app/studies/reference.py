"""An extrapolated answer of stated accuracy, and how far other answers are from it.

A scene of boxes is solved on three meshes, each with cells half as long as the one before. The
distances of neighbours, e₁ of the two finest and e₂ of the two coarser, give the rate 2ᵖ = e₂/e₁
and with it what is left between the finest and the limit,

    r = e₁/√(4ᵖ - 1)  in energy norm, where errors are orthogonal,
    r = e₁/(2ᵖ - 1)   in displacement and pressure.

The error of another answer is its distance from the finest, in energy norm √(distance² + r²).
All are relative: energy norms to that of the finest, displacements and pressures in the root mean
square over volume and contact boundary. An error near r says no more than that it is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_app.scene import Scene
from contact_app.studies.lattice import Lattice, Mesh

Array = NDArray[np.float64]
LEAST_KNOWN = 0.01
"""Weight of nodes with a contact row from which on their pressure is continued."""
QUANTITIES = ("energy", "displacement", "pressure")


@dataclass(frozen=True, eq=False)
class Fields:
    """An answer at the nodes of all bodies, one body after the other.

    Attributes
    ----------
    points : (nodes, 3)
    displacement : (nodes, dimension)
    pressure : (nodes,)
    watched : (nodes,)
        Nodes with a contact row.
    first_node : (bodies + 1,)
    degree : (bodies,)
    """

    points: Array
    displacement: Array
    pressure: Array
    watched: NDArray[np.bool_]
    first_node: NDArray[np.int64]
    degree: NDArray[np.int64]

    @classmethod
    def load(cls, path: str) -> Fields:
        """Read what a run of a study left."""
        with np.load(path) as data:
            return cls(**{name: data[name] for name in cls.__dataclass_fields__})

    def meshes(self, cell: str, lattices: Sequence[Lattice]) -> list[Mesh]:
        """Meshes of the bodies, all of one kind of cell."""
        return [
            Mesh.through(cell, int(degree), lattice.places(self.points[self.body(number)]))
            for number, (degree, lattice) in enumerate(zip(self.degree, lattices, strict=True))
        ]

    def body(self, number: int) -> slice:
        """Nodes of one body."""
        return slice(int(self.first_node[number]), int(self.first_node[number + 1]))


@dataclass(frozen=True, eq=False)
class Sampled:
    """An answer on the lattice of each body: (points, dimension) and (points,)."""

    displacement: list[Array]
    pressure: list[Array]


@dataclass(frozen=True, eq=False)
class Ruler:
    """Measures distances of answers on one lattice a body.

    Attributes
    ----------
    watched
        Lattice points with a contact row, by body.
    """

    scene: Scene
    lattices: tuple[Lattice, ...]
    watched: list[NDArray[np.bool_]]

    def sample(self, fields: Fields, cell: str) -> Sampled:
        """Evaluate an answer on cells of one kind on the lattices.

        Where a facet has nodes without a contact row, held ones for instance, the pressure of the
        others is continued, instead of falling to a zero that means nothing.
        """
        displacement, pressure = [], []
        meshes = fields.meshes(cell, self.lattices)
        for number, (lattice, mesh) in enumerate(zip(self.lattices, meshes, strict=True)):
            mine = fields.body(number)
            known = fields.watched[mine] | (fields.pressure[mine] > 0.0)
            values = np.column_stack([fields.displacement[mine], fields.pressure[mine], known])
            found = lattice.evaluate(mesh, fields.points[mine], values)
            displacement.append(found[:, :-2])
            pressure.append(found[:, -2] / np.where(found[:, -1] > LEAST_KNOWN, found[:, -1], 1.0))
        return Sampled(displacement, pressure)

    def norms(self, one: Sampled, other: Sampled | None = None) -> Array:
        """Energy norm, and root of sums of squares of displacement and pressure, (3,).

        Of the difference, or of `one` alone.
        """
        squares = np.zeros(3)
        for number, lattice in enumerate(self.lattices):
            u, p = one.displacement[number], one.pressure[number]
            if other is not None:
                u, p = u - other.displacement[number], p - other.pressure[number]
            material = self.scene.bodies[number].materials[0]
            squares[0] += lattice.energy(u, material, self.scene.plane)
            squares[1] += lattice.weights @ (u**2).sum(axis=1)
            seen = self.watched[number]
            squares[2] += lattice.weights[seen] @ p[seen] ** 2
        return np.sqrt(squares)


@dataclass(frozen=True, eq=False)
class ReferenceAnswer:
    """The finest answer and what is left to the limit.

    Attributes
    ----------
    accuracy : (3,)
        Relative r of energy norm, displacement and pressure.
    rates : (3,)
        p.
    """

    ruler: Ruler
    finest: Sampled
    norms: Array
    accuracy: Array
    rates: Array

    @classmethod
    def of(cls, ruler: Ruler, answers: Sequence[Sampled]) -> ReferenceAnswer:
        """Extrapolate three answers, the coarsest first."""
        coarse, middle, finest = answers
        norms = ruler.norms(finest)
        near, far = ruler.norms(middle, finest), ruler.norms(coarse, middle)
        rates, accuracy = extrapolate(near, far)
        with np.errstate(invalid="ignore", divide="ignore"):
            return cls(ruler, finest, norms, accuracy / norms, rates)

    def errors(self, answer: Sampled) -> Array:
        """Relative errors in energy norm, displacement and pressure, (3,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            distance = self.ruler.norms(answer, self.finest) / self.norms
        distance[0] = np.hypot(distance[0], self.accuracy[0])
        return distance

    def describe(self) -> str:
        """Its accuracy in a sentence."""
        parts = [
            f"{name} {accuracy:.1e} (rate {rate:.2f})"
            for name, accuracy, rate in zip(QUANTITIES, self.accuracy, self.rates, strict=True)
            if np.isfinite(accuracy)
        ]
        return f"relative accuracy of the reference: {', '.join(parts)}"


SLOWEST, FASTEST = 0.25, 4.0
"""Rates that are believed; one outside of them is taken for the nearest."""


def extrapolate(near: Array, far: Array) -> tuple[Array, Array]:
    """Rates and what is left to the limit, from the distances of neighbours, (3,) each.

    Parameters
    ----------
    near, far
        Of the two finest answers, and of the two coarser.

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
