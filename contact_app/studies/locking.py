"""Locking and its remedies: a slender cantilever and a block of nearly incompressible material.

Prints two tables: the tip deflection of a cantilever 1:100 (ν = 0) relative to F L³ / 3 E I of
Euler and Bernoulli, and the largest settlement of a block of ν = 0.4999 between walls that is
pushed on half of its top, relative to that of a fine mesh of degree 2.

    python -m contact_app.studies.locking
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration

LENGTH, YOUNG, LOAD = 100.0, 1.2e5, 0.01
EXACT = LOAD * LENGTH**3 / (3.0 * YOUNG / 12.0)


def beam(cell: str, cells: tuple[int, int], **options: Any) -> dict[str, Any]:
    """A cantilever 1:100 in the plane, loaded at its end."""
    box = {"lower": [0.0, 0.0], "upper": [LENGTH, 1.0], "cells": list(cells), "cell": cell}
    return {
        "title": "slender cantilever",
        "dimension": 2,
        "bodies": [
            {
                "name": "beam",
                "mesh": {"box": box},
                "material": {"young": YOUNG, "poisson": 0.0},
                **options,
            }
        ],
        "conditions": [
            {"on": "beam.x-", "displacement": [0.0, 0.0]},
            {"on": "beam.x+", "traction": [0.0, -LOAD]},
        ],
    }


def block(cell: str, cells: tuple[int, int], **options: Any) -> dict[str, Any]:
    """A block of ν = 0.4999 between walls, pushed down on the left half of its top."""
    box = {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "cells": list(cells), "cell": cell}
    return {
        "title": "confined block",
        "dimension": 2,
        "bodies": [
            {
                "name": "block",
                "mesh": {"box": box},
                "material": {"young": 1.0, "poisson": 0.4999},
                "boundaries": {"left": {"where": "y > 1 - 1e-9 and x < 0.5 + 1e-9"}},
                **options,
            }
        ],
        "conditions": [
            {"on": "block.x-", "displacement": [0.0, None]},
            {"on": "block.x+", "displacement": [0.0, None]},
            {"on": "block.left", "pressure": 0.01},
        ],
        "contacts": [
            {"on": "block.y-", "obstacle": {"plane": {"point": [0, 0], "normal": [0, 1]}}}
        ],
    }


def solved(made: dict[str, Any]) -> tuple[float, int]:
    """Largest displacement downwards, and degrees of freedom."""
    scene = build_scene(Configuration.model_validate(made))
    found = solve_scene(scene, MPI.COMM_SELF)
    return float(-found.nodes.displacement[:, 1].min()), int(found.summary["mesh"]["dofs"])


REMEDIES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("quadrilaterals", "quadrilateral", {}),
    ("quadrilaterals, `mean_dilatation`", "quadrilateral", {"mean_dilatation": True}),
    ("quadrilaterals, degree 2", "quadrilateral", {"degree": 2}),
    ("triangles", "triangle", {}),
    ("triangles, degree 2", "triangle", {"degree": 2}),
)
BEAMS, BLOCKS = ((25, 1), (100, 1), (200, 2)), ((4, 4), (8, 8), (16, 16))
FINE = 32


def tables() -> list[str]:
    """Both tables in Markdown; beside each ratio the degrees of freedom."""
    fine, _ = solved(block("quadrilateral", (FINE, FINE), degree=2))
    lines = []
    cases = (
        ("cantilever 1:100", BEAMS, beam, EXACT),
        ("block, ν = 0.4999", BLOCKS, block, fine),
    )
    for title, meshes, made, exact in cases:
        names = [f"{n} × {m} cells" for n, m in meshes]
        lines += [f"| {title} | {' | '.join(names)} |", "|---" * (1 + len(meshes)) + "|"]
        for name, cell, options in REMEDIES:
            row = []
            for mesh in meshes:
                value, dofs = solved(made(cell, mesh, **options))
                row.append(f"{value / exact:.3f} ({dofs})")
            lines.append(f"| {name} | {' | '.join(row)} |")
        lines.append("")
    return lines[:-1]


if __name__ == "__main__":
    print("\n".join(tables()))
