"""Rates of convergence if the edge of contact lies within a boundary, for degree 1 and 2.

A block slides along its plane of symmetry and is pushed by its foot against a round rigid obstacle
(Signorini's problem with smooth data). The only singularity is at the edge of contact, where the
pressure falls to zero like a square root. The displacement is in H^s for all s < 5/2, so that
errors in energy norm fall like h for degree 1, and for degree 2 like h^1.5 at best on uniform
meshes (P. Hild, P. Laborde, *Quadratic finite element methods for unilateral contact problems*,
Appl. Numer. Math. 41, 2002).

Errors are distances from the solution of degree 2 on a mesh several times finer. Single errors are
erratic, since they depend on the place of the edge of contact within a cell. The table therefore
holds the geometric mean over several depths of pushing.

    python -m contact_app.studies.contact_rates
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration
from contact_app.scene.material import Material
from contact_app.studies.fields_on_meshes import PointsOfMesh
from contact_app.studies.reference import Fields
from contact_app.studies.single_run import fields_of

EDGE, RADIUS = 2.0, 4.0
DEPTHS = (0.02, 0.03, 0.04, 0.05, 0.065, 0.08)
FINE = {2: 96, 3: 24}
CELLS = {2: (8, 16, 32), 3: (3, 6, 12)}
NAMES = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}


def scene(cell: str, n: int, degree: int, depth: float) -> dict[str, Any]:
    """A block of n cells an edge, pushed by `depth` against a disc or ball above it."""
    d = 3 if cell in NAMES[3] else 2
    up, axes = "xyz"[d - 1], range(d)
    box = {"lower": [0.0] * d, "upper": [EDGE] * d, "cells": [n] * d, "cell": cell}
    slides: list[dict[str, Any]] = [
        {"on": f"block.{'xyz'[k]}-", "displacement": [0.0 if i == k else None for i in axes]}
        for k in range(d - 1)
    ]
    push = {"on": f"block.{up}-", "displacement": [None] * (d - 1) + [depth]}
    centre = [0.0] * (d - 1) + [EDGE + RADIUS]
    ball = {"sphere": {"center": centre, "radius": RADIUS}}
    return {
        "title": "a block against a round obstacle",
        "dimension": d,
        "bodies": [
            {
                "name": "block",
                "mesh": {"box": box},
                "degree": degree,
                "material": {"young": 1000.0, "poisson": 0.3},
            }
        ],
        "conditions": [*slides, push],
        "contacts": [{"on": f"block.{up}+", "obstacle": ball}],
        "solver": {"tolerance": 1e-9},
    }


def errors(
    cell: str,
    degrees: Sequence[int] = (1, 2),
    depths: Sequence[float] = DEPTHS,
    cells: Sequence[int] | None = None,
    fine: int | None = None,
) -> dict[int, NDArray[np.float64]]:
    """Mean relative errors in energy norm by degree, one for each number of cells an edge."""
    d = 3 if cell in NAMES[3] else 2
    fine = fine or FINE[d]
    found: dict[int, list[list[float]]] = {degree: [] for degree in degrees}
    for depth in depths:
        best, materials, plane = _solved(cell, fine, 2, depth)
        points, u_best = PointsOfMesh(best.nodes(0)), best.displacement
        norm = points.energy(u_best, materials, plane)
        for degree in degrees:
            row = []
            for n in cells or CELLS[d]:
                answer, _, _ = _solved(cell, n, degree, depth)
                away = points.sample(answer.nodes(0), answer.displacement) - u_best
                row.append(np.sqrt(points.energy(away, materials, plane) / norm))
            found[degree].append(row)
    return {degree: np.exp(np.log(rows).mean(axis=0)) for degree, rows in found.items()}


def _solved(
    cell: str, n: int, degree: int, depth: float
) -> tuple[Fields, tuple[Material, ...], str | None]:
    """Nodal values of a solution; materials and plane of its scene."""
    made = build_scene(Configuration.model_validate(scene(cell, n, degree, depth)))
    found = fields_of(solve_scene(made, MPI.COMM_SELF))
    assert found is not None
    return found, made.bodies[0].materials, made.plane


def rate(found: NDArray[np.float64], cells: Sequence[int]) -> float:
    """Order in the size of cells, by least squares."""
    return -float(np.polyfit(np.log(cells), np.log(found), 1)[0])


def table() -> list[str]:
    """Errors and rates in Markdown."""
    lines = []
    for d, names in NAMES.items():
        sizes = [f"{n} cells" for n in CELLS[d]]
        lines += [f"| {d}D | {' | '.join(sizes)} | rate |", "|---" * (2 + len(sizes)) + "|"]
        for cell in names:
            for degree, found in errors(cell, depths=DEPTHS if d == 2 else DEPTHS[3:]).items():
                row = " | ".join(f"{100 * e:.2f} %" for e in found)
                order = rate(found, CELLS[d])
                lines.append(f"| {cell}, degree {degree} | {row} | {order:.2f} |")
        lines.append("")
    return lines[:-1]


if __name__ == "__main__":
    print("\n".join(table()))
