"""Boxes without congruent subdomains: tetrahedra whose inner nodes are moved at random.

Written to a file they represent meshes of a mesher: no two subdomains are congruent.
"""

from collections.abc import Sequence
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


def perturbed_box(
    bricks: int, lower: Sequence[float] = (0.0,) * 3, upper: Sequence[float] = (1.0,) * 3
) -> CellMesh:
    """A box of so many bricks along a length of one, six tetrahedra each; surface nodes stay."""
    low, high = np.asarray(lower, float), np.asarray(upper, float)
    counts = tuple(int(n) for n in np.rint(bricks * (high - low)))
    box = BoxShape(tuple(low), tuple(high), counts, "tetrahedron").cell_mesh()
    points, half = box.points.copy(), 0.5 / bricks
    inside = ((points > low + half) & (points < high - half)).all(axis=1)
    random = np.random.default_rng(1)
    points[inside] += MOVE / bricks * random.uniform(-1.0, 1.0, (int(inside.sum()), 3))
    return replace(box, points=points)


def write_box(path: Path, bricks: int, *corners: Sequence[float]) -> None:
    """Write a box to a mesh file."""
    write_mesh(path, perturbed_box(bricks, *corners))


def write_mesh(path: Path, mesh: CellMesh) -> Path:
    """Write points and cells of a mesh to a file, without groups; return its path."""
    names = {"quadrilateral": "quad", "tetrahedron": "tetra"}
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.dimension)))
    meshio.Mesh(points, [(names.get(mesh.cell, mesh.cell), mesh.cells)]).write(path)
    return path
