"""Round contacts that slide everywhere: a belt around a drum, and a ring turned on a plate.

* Belt: a quarter of a thin ring lies on a rigid drum. The force T pulls at one end, and the other
  end is moved along the drum. If all of the belt slides, this takes T' = T exp(μ φ) (L. Euler,
  1769; J. A. Eytelwein, 1808) for a belt without thickness: finer meshes have thinner belts.
* Turned ring: a hollow cylinder without lateral contraction is pressed on a plate by P and turned.
  The pressure is uniform, and the friction moment is 2/3 μ P (b³ - a³)/(b² - a²) with the radii a
  and b (K. L. Johnson, *Contact Mechanics*, 1985, section 7.5: 2/3 μ P R for a disc).
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.studies.hertz import Quantity
from contact_app.studies.perturbed import write_mesh
from meshes import CellMesh
from meshes.graded import graded_box

DRUM, THICK, PULL = 100.0, 0.25, 1.0
"""Radius of the drum, thickness of the belt over the length of its cells, and the force T."""

INNER, OUTER, HEIGHT = 10.0, 20.0, 5.0
"""Radii and height of the turned ring."""

BELT = (
    "title=a belt around a drum",
    "dimension=plane_stress",
    "bodies.0.degree=1",
    "bodies.0.material={young: 1.0e5, poisson: 0}",
    f"bodies.0.boundaries={{inner: {{where: 'hypot(x, y) < {DRUM + 1e-6}'}},"
    " pulled: {where: x < 1e-6}, moved: {where: y < 1e-6}}",
    "conditions=[{on: ring.moved, displacement: [null, -0.1]},"
    f" {{on: ring.pulled, total_force: [{-PULL}, 0]}}]",
    f"contacts=[{{on: ring.inner, obstacle: {{sphere: {{center: [0, 0], radius: {DRUM}}}}},"
    " friction: {coulomb: 0.4}}]",
)
"""Overrides of the scene thick_ring."""

TURNED_RING = (
    "title=a ring pressed and turned",
    "bodies=[{name: ring, mesh: {file: ring.vtu}, material: {young: 1000, poisson: 0},"
    f" boundaries: {{foot: {{where: z < 1e-6}}, top: {{where: 'z > {HEIGHT - 1e-6}'}}}}}},"
    f" {{name: plate, rigid: {{plane: {{point: [0, 0, {HEIGHT}], normal: [0, 0, -1]}}}}}}]",
    "conditions=[{on: ring.foot, displacement: [0, 0, 0]},"
    " {in: plate, displacement: [0, 0, null], rotation: [0, 0, 0.05]},"
    " {in: plate, total_force: [0, 0, -1000]}]",
    "contacts=[{on: ring.top, against: plate, friction: {coulomb: 0.3}}]",
)
"""Overrides of the scene rigid_plate."""


def write_belt(path: Path, cells: int) -> Path:
    """Write a quarter of a ring with that many cells along it, and two across."""
    angle = np.linspace(0.0, 0.5 * np.pi, cells + 1)
    radius = np.linspace(DRUM, DRUM + THICK * DRUM * angle[1], 3)
    return write_mesh(path, _bent(graded_box("quadrilateral", [radius, angle])))


def write_ring(path: Path, cells: int) -> Path:
    """Write a hollow cylinder with that many cells across its wall."""
    radius = np.linspace(INNER, OUTER, cells + 1)
    angle = np.linspace(0.0, 2.0 * np.pi, 8 * cells + 1)
    z = np.linspace(0.0, HEIGHT, max(cells // 2, 1) + 1)
    ring = _bent(graded_box("hexahedron", [radius, angle, z]))
    _, first, node = np.unique(ring.points.round(9), axis=0, return_index=True, return_inverse=True)
    closed = replace(ring, points=ring.points[first], cells=node.reshape(-1)[ring.cells])
    return write_mesh(path, closed)


def _bent(box: CellMesh) -> CellMesh:
    """A box of radii and angles as a sector of a ring."""
    radius, angle, *height = box.points.T
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), *height])
    return replace(box, points=points)


def belt(solved: SolvedScene) -> list[Quantity]:
    """The ratio of the forces at both ends."""
    mu = _coefficient(solved)
    held = abs(solved.summary["reactions"][0]["force"][1])
    return [Quantity("T'/T", held / PULL, math.exp(mu * 0.5 * math.pi))]


def turned_ring(solved: SolvedScene) -> list[Quantity]:
    """The friction moment about the axis."""
    contact = solved.summary["contacts"][0]
    arm = 2.0 / 3.0 * (OUTER**3 - INNER**3) / (OUTER**2 - INNER**2)
    pressed = abs(contact["force"][2])
    return [Quantity("M", abs(contact["moment"][2]), _coefficient(solved) * pressed * arm)]


def _coefficient(solved: SolvedScene) -> float:
    return solved.model.scene.contacts[0].law.coefficient
