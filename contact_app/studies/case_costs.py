"""Cost of ten load cases compared with one: whole runs, from the scene file to the written results.

    python -m contact_app.studies.case_costs [NAME …] [-o DIR]

Each run is a process of its own. The cost of one case is the mean of two runs, with the first and
with the last of the ten cases. The table holds processor time, which depends less on other work of
the machine than wall-clock time.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from contact_app.run.cases import run_cases
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.yaml_reader import read
from contact_app.studies.processes import python

ROOT = Path(__file__).parents[2]
CASES = 10


class Loaded(NamedTuple):
    """A shipped scene whose loads are replaced, and how ten cases combine the new ones."""

    scene: str
    limit: float
    """Largest cost of ten cases relative to one."""
    loads: tuple[dict[str, Any], ...]
    """Conditions with a name, in place of the tractions, pressures and forces of the file."""
    first: tuple[float, ...]
    last: tuple[float, ...]
    """Factors of the first and of the last case; the others lie between them."""
    cells: tuple[int, ...] | None = None
    """Cells of the first body's box, in place of the file's."""


SCENES = {
    "cube": Loaded(
        "configs/cube.yaml", 3.0,
        (
            {"name": "press", "on": "cube.z+", "traction": [0, 0, -465]},
            {"name": "push", "on": "cube.z+", "traction": [60, 0, 0]},
        ),
        (1.0, -1.0), (1.0, 1.0),
    ),
    "large cube": Loaded(
        "configs/cube.yaml", 3.0,
        (
            {"name": "press", "on": "cube.z+", "traction": [0, 0, -465]},
            {"name": "push", "on": "cube.z+", "traction": [60, 0, 0]},
        ),
        (1.0, -1.0), (1.0, 1.0), cells=(40, 40, 40),
    ),
    "bracket": Loaded(
        "configs/bracket.yaml", 6.0,
        (
            {"name": "shelf", "on": "bracket.seat", "traction": [0, 0, -1.0e4]},
            {"name": "tip", "on": "bracket.tip", "traction": [0, 0, -2.0e4]},
        ),
        (1.0, 0.0), (0.0, 1.0),
    ),
    "remote_load": Loaded(
        "configs/remote_load.yaml", 6.0,
        (
            {"name": "down", "on": "post.z+", "total_force": [0, 0, -5000]},
            {"name": "tilt", "on": "post.z+", "total_moment": [0, 6.0e4, 0], "at": [20, 20, 120]},
        ),
        (1.0, -1.0), (1.0, 1.0),
    ),
    "flange": Loaded(
        "configs/bolted_flange.yaml", 6.0,
        (
            {"on": "upper.upper_washers", "total_force": [0, 0, -60000]},
            {"on": "lower.lower_washers", "total_force": [0, 0, 60000]},
            {"name": "pull", "on": "upper.pull", "total_force": [0, 0, 24000]},
            {"name": "tilt", "on": "upper.pull", "total_moment": [0, 2.0e5, 0]},
        ),
        (0.0, 0.0), (1.0, 1.0),
    ),
}  # fmt: skip


def with_cases(loaded: Loaded, numbers: Sequence[int]) -> dict[str, Any]:
    """The mapping of a scene with the given ones of its ten cases."""
    path = ROOT / loaded.scene
    made = read(path)[0]
    for body in made["bodies"]:
        if "file" in body["mesh"]:
            body["mesh"]["file"] = str((path.parent / body["mesh"]["file"]).resolve())
    if loaded.cells is not None:
        made["bodies"][0]["mesh"]["box"]["cells"] = list(loaded.cells)
    supports = [c for c in made["conditions"] if "displacement" in c]
    made["conditions"] = [*supports, *loaded.loads]
    names = [load["name"] for load in loaded.loads if "name" in load]
    factors = np.linspace(loaded.first, loaded.last, CASES)
    made["cases"] = {
        f"case_{i}": {name: float(f) for name, f in zip(names, factors[i], strict=True)}
        for i in numbers
    }
    return made


def compared(name: str, loaded: Loaded, directory: Path) -> dict[str, float]:
    """Processor seconds and operator applications of ten cases and of one."""
    runs = {}
    for kind, numbers in (("all", range(CASES)), ("first", [0]), ("last", [CASES - 1])):
        place = directory / f"{name}_{kind}"
        place.mkdir(parents=True, exist_ok=True)
        file = place / "scene.yaml"
        file.write_text(json.dumps(with_cases(loaded, list(numbers))), encoding="utf-8")
        module = "contact_app.studies.case_costs"
        runs[kind] = python("-m", module, "--solve", str(file), "-o", str(place), threads=1)
    row = {"dofs": runs["all"]["dofs"]}
    for key in ("seconds", "applications"):
        row[f"{key} of ten"] = runs["all"][key]
        row[f"{key} of one"] = 0.5 * (runs["first"][key] + runs["last"][key])
    return row


def table(names: Sequence[str], directory: Path) -> Iterator[str]:
    """Rows of a table for a page."""
    yield (
        "| scene | unknowns | processor seconds of one case | of ten | ratio | at most | operator "
        "applications of one | of ten |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    for name in names or SCENES:
        loaded = SCENES[name]
        row = compared(name, loaded, directory)
        one, ten = row["seconds of one"], row["seconds of ten"]
        yield (
            f"| {name} | {row['dofs']:,.0f} | {one:.1f} | {ten:.1f} | {ten / one:.2f} | "
            f"{loaded.limit:g} | {row['applications of one']:.0f} | "
            f"{row['applications of ten']:.0f} |"
        )


def main() -> None:
    """The command: the table, or one of its runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(SCENES)}; all unless given")
    parser.add_argument("-o", "--output", type=Path, default=Path("results/case_costs"))
    parser.add_argument("--solve", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(SCENES))
    if unknown:
        parser.error(f"unknown scene {unknown[0]}; known: {', '.join(SCENES)}")
    if arguments.solve is None:
        for line in table(arguments.names, arguments.output):
            print(line, flush=True)
        return
    run_cases(build_scene(load(arguments.solve)), arguments.output / "results", MPI.COMM_SELF)
    spent = time.process_time()
    summary = json.loads((arguments.output / "results/summary.json").read_text(encoding="utf-8"))
    applications = sum(c["solver"]["hessian_multiplications"] for c in summary["cases"].values())
    print(json.dumps({
        "dofs": summary["mesh"]["dofs"], "seconds": spent, "applications": applications,
        "timings": summary["timings"],
    }))  # fmt: skip


if __name__ == "__main__":
    main()
