"""Estimates of `contact-app check` compared with measured runs.

``python -m contact_app.studies.estimates`` runs every scene of a directory (``configs``) and the
paper's cube of 20³ to 120³ hexahedra, each in a process of its own, and prints seconds and
memory, estimated over measured. Seconds are those of the whole run without start-up and writing
files.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from contact_app.model.outline import outline
from contact_app.model.symmetry import halved
from contact_app.run.cost import estimate
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.studies.bench import config
from contact_app.studies.processes import RunError, python

CUBES = (20, 40, 60, 80, 100, 120)


@dataclass(frozen=True)
class Comparison:
    """Estimated and measured seconds and GB of a scene."""

    name: str
    seconds: tuple[float, float]
    memory: tuple[float, float]


def compare(name: str, path: Path, overrides: Sequence[str] = ()) -> Comparison:
    """Estimate a scene, then run it.

    Raises
    ------
    RunError
        The run failed.
    """
    scene = build_scene(load(path, overrides))
    if scene.symmetry:
        scene = halved(scene).scene
    cost = estimate(scene, outline(scene, MPI.COMM_SELF, needed="distinct"))
    more = [part for override in overrides for part in ("--set", override)]
    found = python("-m", "contact_app.studies.single_run", str(path), *more)
    return Comparison(
        name,
        (cost.seconds, found["timings"]["total"]),
        (cost.memory * 1e-9, found["environment"]["peak_rss_gb"]),
    )


def comparisons(directory: Path) -> Iterator[Comparison]:
    """All scenes of a directory, then the cubes."""
    for path in sorted(directory.glob("*.yaml")):
        yield compare(path.stem, path)
    for n in CUBES:
        cells = f"bodies.0.mesh.box.cells=[{n},{n},{n}]"
        yield compare(f"cube of {n}³", config(), (cells, "decomposition=auto"))


def main() -> None:
    """Print the table."""
    directory = Path(sys.argv[1] if len(sys.argv) > 1 else "configs")
    print("| scene | estimated (s) | took (s) | ratio | estimated (GB) | took (GB) | ratio |")
    print("|---" + "|---:" * 6 + "|")
    try:
        for c in comparisons(directory):
            numbers = " | ".join(
                f"{estimated:.2g} | {measured:.2g} | {estimated / measured:.2f}"
                for estimated, measured in (c.seconds, c.memory)
            )
            print(f"| {c.name} | {numbers} |", flush=True)
    except RunError as error:
        sys.exit(f"a run failed: {error}")


if __name__ == "__main__":
    main()
