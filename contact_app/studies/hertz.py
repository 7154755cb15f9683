"""Hertz's contact of a ball and of a cylinder with a rigid plane, compared with the theory.

Measured are the half-width of the contact a, the peak pressure p0 and, in space, the approach δ of
the loaded equator. a and p0 follow from all touching nodes: the squares of the theory's pressures

    p² = p0² (1 - r²/a²),   a = (3FR/(4E*))^(1/3), p0 = 3F/(2πa²), δ = a²/R   in space,
                            a = √(4F'R/(πE*)),     p0 = 2F'/(πa)              in the plane,

lie on a line over r², which is fitted to the computed pressures (H. Hertz, *Über die Berührung
fester elastischer Körper*, 1882; K. L. Johnson, *Contact Mechanics*, 1985, chapter 4).
"""

from dataclasses import dataclass

import numpy as np

from contact_app.accuracy.solved_scene import SolvedScene
from meshes.arrays import Array


@dataclass(frozen=True)
class Quantity:
    """A computed number and the number of the theory."""

    name: str
    computed: float
    theory: float

    @property
    def error(self) -> float:
        """Error relative to the theory."""
        return self.computed / self.theory - 1.0


def fitted(r2: Array, pressure: Array) -> tuple[float, float]:
    """Half-width a and peak p0 of p² = p0² (1 - r²/a²), fitted where there is pressure.

    Parameters
    ----------
    r2, pressure : (n,)
        Squared distances from the middle of the contact, and nodal pressures.
    """
    touching = pressure > 0.0
    slope, square = np.polyfit(r2[touching], pressure[touching] ** 2, 1)
    return float(np.sqrt(-square / slope)), float(np.sqrt(square))


def hertz_quantities(solved: SolvedScene) -> list[Quantity]:
    """Half-width, peak pressure and, in space, approach of a solved scene with one body."""
    scene, nodes = solved.model.scene, solved.nodes
    d = scene.dimension
    (material,) = scene.bodies[0].materials
    modulus = material.young / (1.0 - material.poisson**2)
    radius = scene.bodies[0].mesh.upper[0]
    force = 2.0 ** (d - 1) * solved.summary["solution"]["contact_force"][d - 1]
    if d == 3:
        half_width = (0.75 * force * radius / modulus) ** (1.0 / 3.0)
        peak = 1.5 * force / (np.pi * half_width**2)
    else:
        half_width = np.sqrt(4.0 * force * radius / (np.pi * modulus))
        peak = 2.0 * force / (np.pi * half_width)

    pressure = nodes.contact_pressure
    computed, top = fitted((nodes.points[:, : d - 1] ** 2).sum(axis=1), pressure)
    equator = nodes.points[:, d - 1] > radius * (1.0 - 1e-9)
    quantities = [
        Quantity("half-width a", computed, float(half_width)),
        Quantity("peak pressure p0", top, float(peak)),
        Quantity("largest nodal pressure", float(pressure.max()), float(peak)),
    ]
    if d == 3:
        approach = -float(nodes.displacement[equator, 2].mean())
        quantities.append(Quantity("approach", approach, float(half_width**2 / radius)))
    return quantities
