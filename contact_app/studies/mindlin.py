"""The case `contact-app verify mindlin`: a block pressed against a rigid ball and pushed.

Normal and tangential tractions do not couple in an incompressible block, so that the pressure is
Hertz's, nodes within c = a (1 - Q/(μ P))^(1/3) stick, and the tractions are along the push,

    q = μ p0 (√(1 - r²/a²) - (c/a) √(1 - r²/c²)),   the second root zero beyond c

(R. D. Mindlin, *Compliance of elastic bodies in contact*, J. Appl. Mech. 16, 1949; K. L. Johnson,
*Contact Mechanics*, 1985, section 7.2). P, Q and a are taken from the solution, a from a line
fitted to p² over r². c is the radius of a circle with the area of the sticking nodes, where each
node has its share of the cells around it. Half of the block is modelled, symmetric about y = 0.

The theory's pressure is normal to a plane. Normals of the ball are inclined by up to a/R, and
friction balances the tangential part of the pressure: tractions of a/(μ R) of their limit, towards
the middle, on any mesh. With R = 20 a and six cells over a these tractions, which are odd in x,
were 9 % in the root mean square out of a total difference of 11 %. With R = 200 a the total is 6 %,
and it falls with the size of cells.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from contact_app.run.increments import SolvedIncrement
from contact_app.scene.obstacles import Sphere
from contact_app.studies.hertz import Quantity, fitted
from contact_app.studies.history_cases import graded_lines
from contact_app.studies.perturbed import write_mesh
from meshes.arrays import Array
from meshes.graded import graded_box

SIZE = 10.0
"""Half the width of the block, and its height, for a contact radius of 1."""

GROWTH = 1.6
"""Growth factor of cells outside the contact."""


def mindlin(increments: Sequence[SolvedIncrement]) -> list[Quantity]:
    """The block at the end of the push: radii, and tractions as a root mean square of μ p0."""
    solved = increments[-1].solved
    nodes, coefficient = solved.nodes, solved.model.scene.contacts[0].law.coefficient
    at = nodes.contact_pressure > 0.0
    r2 = (nodes.points[at, :2] ** 2).sum(axis=1)
    a, peak = fitted(r2, nodes.contact_pressure[at])
    force = np.abs(solved.summary["contacts"][0]["force"])
    stick = float((1.0 - force[0] / (coefficient * force[2])) ** (1.0 / 3.0))
    sticks = (nodes.contact_status == 1.0) & at
    area = 2.0 * float(_areas(nodes.points)[sticks].sum())
    exact = _root(r2, a) - stick * _root(r2, stick * a)
    side = np.sign(solved.summary["contacts"][0]["force"][0])
    traction = side * nodes.friction_traction[at, 0] / (coefficient * peak)
    rms = float(np.sqrt(np.mean((traction - exact) ** 2)))
    (material,) = solved.model.scene.bodies[0].materials
    obstacle = solved.model.scene.contacts[0].obstacle
    assert isinstance(obstacle, Sphere)
    radius = obstacle.radius
    modulus = material.young / (1.0 - material.poisson**2)
    return [
        Quantity("a", a, float((1.5 * force[2] * radius / modulus) ** (1.0 / 3.0))),
        Quantity("c/a", float(np.sqrt(area / np.pi)) / a, stick),
        Quantity("1 + rms of tractions", 1.0 + rms, 1.0),
    ]


def _root(r2: Array, radius: float) -> Array:
    return np.asarray(np.sqrt(np.maximum(1.0 - r2 / radius**2, 0.0)))


def _areas(points: Array) -> Array:
    """Area of each node of the top of a grid of boxes: a quarter of each adjacent cell."""
    x, y = (_lengths(points[:, i]) for i in (0, 1))
    return x * y


def _lengths(values: Array) -> Array:
    """Half the length of the intervals on both sides of each coordinate (n,) of the grid."""
    grid, number = np.unique(np.round(values, 9), return_inverse=True)
    steps = np.pad(np.diff(grid), 1)
    return np.asarray(0.5 * (steps[1:] + steps[:-1])[number])


def graded_half_block(path: Path, cells: int) -> Path:
    """Write half of a block whose cells are smallest around (0, 0, 0), the middle of its top.

    Parameters
    ----------
    cells
        Number of cells per unit of length there.
    """
    return write_mesh(path, graded_box("hexahedron", graded_lines(cells, SIZE, GROWTH)))
