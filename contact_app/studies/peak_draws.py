"""The largest pressures of Hertz's contacts at random positions of the mesh, and what is right.

``python -m contact_app.studies.peak_draws [KIND …] [--draws 20] [--seed 0] [--facets 3 4 5 6 8]
[--half]``
presses a rigid ball into a block, and a rigid roller into a plane block, at random places between
the nodes. The load is that of Hertz's contact with so many facets across (half facets for cells of
degree 2). For each kind of cell it prints the facets that the warning counts, how far the largest
nodal pressure, that of the smoothed field and `max_smoothed_pressure` are off (mean and worst), and
in how many draws the field is further off than the warning says. With ``--half`` the ball presses
at the planes of symmetry of a half or quarter model.

Right is Hertz's peak for the given force; of a block it is right to about 1 %.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_app.accuracy.contact_limits import LIMITS, pressed_facets
from contact_app.accuracy.hertz import expected_error
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration

YOUNG, POISSON, RADIUS = 1000.0, 0.3, 4.0


@dataclass(frozen=True)
class Kind:
    """Cells of the block."""

    cell: str
    degree: int
    cells: int
    """Along an edge of the surface."""

    @property
    def dimension(self) -> int:
        """Dimension of the block."""
        return 2 if self.cell in ("quadrilateral", "triangle") else 3


KINDS = {
    f"{cell} {degree}": Kind(cell, degree, cells // degree)
    for degree in (1, 2)
    for cell, cells in (
        ("quadrilateral", 80), ("triangle", 80), ("hexahedron", 24), ("tetrahedron", 24)
    )
}  # fmt: skip


@dataclass(frozen=True)
class Draw:
    """One position: facets across as the warning counts them, and how far peaks are off."""

    across: float
    nodal: float
    smoothed: float
    of_contact: float


def hertz_scene(kind: Kind, facets: float, centre: Sequence[float]) -> tuple[dict[str, Any], float]:
    """A block under a ball or a roller at a centre of its surface, and Hertz's peak."""
    d, modulus = kind.dimension, YOUNG / (1.0 - POISSON**2)
    half = facets / (kind.cells * kind.degree)
    peak = modulus * half / (2.0 * RADIUS)
    force = np.pi * half * peak / 2.0
    if d == 3:
        peak = 2.0 * modulus * half / (np.pi * RADIUS)
        force = 2.0 * np.pi * half**2 * peak / 3.0
    down: list[float] = [0.0] * (d - 1) + [-float(force)]
    cells = [kind.cells] * (d - 1) + [kind.cells // 2]
    box = {"lower": [-1] * d, "upper": [1] * (d - 1) + [0], "cells": cells, "cell": kind.cell}
    up = "xyz"[d - 1]
    return {
        "dimension": "plane_strain" if d == 2 else 3,
        "bodies": [
            {"name": "block", "mesh": {"box": box}, "degree": kind.degree,
             "material": {"young": YOUNG, "poisson": POISSON}},
            {"name": "ball", "rigid": {"sphere": {"center": [*centre, RADIUS], "radius": RADIUS}}},
        ],
        "conditions": [
            {"on": f"block.{up}-", "displacement": [0] * d},
            {"in": "ball", "displacement": [0] * (d - 1) + [None],
             "rotation": [0] * 3 if d == 3 else 0},
            {"in": "ball", "total_force": down},
        ],
        "contacts": [{"on": f"block.{up}+", "against": "ball"}],
    }, float(peak)  # fmt: skip


def half_scene(kind: Kind, facets: float) -> tuple[dict[str, Any], float]:
    """The half of `hertz_scene` in the plane, a quarter in space, and Hertz's peak."""
    d = kind.dimension
    made, peak = hertz_scene(kind, facets, [0.0] * (d - 1))
    box, conditions = made["bodies"][0]["mesh"]["box"], made["conditions"]
    box["lower"] = [0] * (d - 1) + [-1]
    box["cells"] = [kind.cells // 2] * d
    conditions[2]["total_force"][-1] /= 2 ** (d - 1)
    for axis in range(d - 1):
        held = [0 if k == axis else None for k in range(d)]
        conditions.append({"on": f"block.{'xyz'[axis]}-", "displacement": held})
    return made, peak


def draw(kind: Kind, made: dict[str, Any], right: float) -> Draw:
    """Solve one position whose peak is known."""
    solved = solve_scene(build_scene(Configuration.model_validate(made)))
    (record,) = solved.summary["contacts"]
    (pressed,) = pressed_facets(solved.model, solved.nodes)
    return Draw(
        pressed.across_narrow_side(solved.model.comm, kind.dimension),
        record["max_pressure"] / right - 1.0,
        float(solved.nodes.smoothed_contact_pressure.max()) / right - 1.0,
        record["max_smoothed_pressure"] / right - 1.0,
    )


def draws(kind: Kind, facets: float, count: int, random: np.random.Generator) -> list[Draw]:
    """Solve at random positions between the nodes in the middle of the surface."""
    places = (random.random((count, kind.dimension - 1)) - 0.5) * 2.0 / kind.cells
    return [draw(kind, *hertz_scene(kind, facets, place.tolist())) for place in places]


def _row(name: str, facets: float, of_row: Sequence[Draw]) -> str:
    off = 100.0 * np.array([[d.nodal, d.smoothed, d.of_contact] for d in of_row]).T
    counted = [d for d in of_row if LIMITS.fewest_facets <= d.across < LIMITS.enough_facets]
    beyond = sum(abs(d.smoothed) > expected_error(d.across) for d in counted)
    across = np.mean([d.across for d in of_row])
    peaks = " | ".join(f"{v.mean():+.1f} | {v[np.abs(v).argmax()]:+.1f}" for v in off)
    return f"| {name} | {facets:g} | {across:.1f} | {peaks} | {beyond} of {len(counted)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", help=f"of {', '.join(KINDS)}; all unless given")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--half", action="store_true", help="half models, the ball at their planes")
    parser.add_argument("--facets", type=float, nargs="+", default=[3.0, 4.0, 5.0, 6.0, 8.0])
    arguments = parser.parse_args()
    random = np.random.default_rng(arguments.seed)
    off = "nodal, % | worst | smoothed field, % | worst | max_smoothed_pressure, % | worst"
    print(f"| cells | facets | in the warning | {off} | beyond it |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in arguments.kinds or KINDS:
        for facets in arguments.facets:
            kind = KINDS[name]
            if arguments.half:
                of_row = [draw(kind, *half_scene(kind, facets))]
            else:
                of_row = draws(kind, facets, arguments.draws, random)
            print(_row(name, facets, of_row), flush=True)


if __name__ == "__main__":
    main()
