"""A cube without congruent subdomains: tetrahedra whose inner nodes are moved at random.

Written to a file it represents meshes of a mesher: no two subdomains are congruent.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np

from meshes import BoxShape, CellMesh

MOVE = 0.15
"""Largest move along each axis in edges of a brick.

A tetrahedron has an edge along each axis. Moves change any component of these by at most 0.3, so
that their matrix has at least 0.7 on its diagonal and at most 0.6 beside it in each row: no cell is
inverted.
"""


def perturbed_cube(bricks: int) -> CellMesh:
    """The unit cube of bricks³ times six tetrahedra; nodes on the surface stay."""
    box = BoxShape((0.0,) * 3, (1.0,) * 3, (bricks,) * 3, "tetrahedron").cell_mesh()
    points, half = box.points.copy(), 0.5 / bricks
    inside = ((points > half) & (points < 1.0 - half)).all(axis=1)
    random = np.random.default_rng(1)
    points[inside] += MOVE / bricks * random.uniform(-1.0, 1.0, (int(inside.sum()), 3))
    return replace(box, points=points)


def write_cube(path: Path, bricks: int) -> None:
    """Write the cube to a mesh file."""
    cube = perturbed_cube(bricks)
    meshio.write(path, meshio.Mesh(cube.points, [("tetra", cube.cells)]))
