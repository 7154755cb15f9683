"""What `symmetry: allow` saves: scenes solved whole and in part.

``python -m contact_app.studies.mirrored CONFIG[;KEY=VALUE…]…`` solves each scene as it is and cut
at its planes of symmetry, by turns, and prints unknowns, operator applications, the least seconds
of some solves (the search for planes among them, writing files not) and how far the energies are
apart. Scenes that do not mirror are left out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from contact_app.model.symmetry import halved
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene

ROUNDS = 5
"""Solves of each, by turns; the first compiles forms and is not counted."""


@dataclass(frozen=True)
class Saving:
    """A scene solved whole and in part, two numbers each; and the planes of symmetry."""

    planes: str
    unknowns: tuple[int, int]
    applications: tuple[int, int]
    seconds: tuple[float, float]
    energies: tuple[float, float]


def saving(scene: Scene) -> Saving | None:
    """Solve a scene both ways; None where it does not mirror."""
    planes = ", ".join(f"{'xyz'[m.axis]} = {m.at:g}" for m in halved(scene).scene.mirrors)
    if not planes:
        return None
    ways: tuple[Callable[[], Scene], ...] = (lambda: scene, lambda: halved(scene).scene)
    least = [float("inf")] * len(ways)
    summaries: list[dict[str, Any]] = [{}] * len(ways)
    for turn in range(1 + ROUNDS):
        for i, way in enumerate(ways):
            began = time.perf_counter()
            summaries[i] = solve_scene(way()).summary
            if turn:
                least[i] = min(least[i], time.perf_counter() - began)
    whole, part = summaries
    return Saving(
        planes,
        (whole["mesh"]["dofs"], part["symmetry"]["solved"]["dofs"]),
        tuple(s["solver"]["hessian_multiplications"] for s in summaries),
        (least[0], least[1]),
        (whole["solution"]["energy"], part["solution"]["energy"]),
    )


def main() -> None:
    """Print the table."""
    print(
        "| scene | planes | unknowns | solved | applications | (part) | s | (part) | times "
        "| energy |"
    )
    print("|---|---" + "|---:" * 8 + "|")
    for argument in sys.argv[1:]:
        name, *overrides = argument.split(";")
        found = saving(build_scene(load(Path(name), overrides)))
        if found is None:
            continue
        label = " ".join([Path(name).stem, *overrides])
        (whole, part), energies = found.seconds, found.energies
        print(
            f"| {label} | {found.planes} | {found.unknowns[0]:,} | {found.unknowns[1]:,} "
            f"| {found.applications[0]} | {found.applications[1]} | {whole:.2f} | {part:.2f} "
            f"| {whole / part:.1f} | {abs(energies[1] / energies[0] - 1.0):.0e} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
