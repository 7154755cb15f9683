"""Parts from a mesher: contact beside one linear solve of the same part and PETSc's solvers.

    python -m contact_app.studies.parts [SCENE …] [--meshes DIR] [--degree N] [--tolerance T]
        [--methods M,…] [--ranks N] [--limit SECONDS]

Each run is a process of its own, from the mesh file to the solution (`contact_app.studies.part_run`
says what counts). Without scenes the parts of the tutorials are taken, each in its last load case.
``--meshes`` reads the meshes of the same names from another directory, where
``meshes/samples/make_parts.py --size`` has drawn finer ones. The columns:

"over linear"
    Seconds over those of ``linear-gamg``: conjugate gradients with GAMG to the same tolerance, the
    part glued where it may touch.
"CPU"
    Seconds of CPU, summed over ranks: what other work on the machine changes less.
"iterations"
    Products with the stiffness, or with the dual operator of Total FETI.
"contact known"
    Products of one linear solve of ours: the rows that press in the answer hold with equality, and
    the solve begins at zero.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from contact_app.scene.yaml_reader import read
from contact_app.studies.part_run import OURS
from contact_app.studies.peers import METHODS
from contact_app.studies.processes import RunError, python

CONFIGS = Path(__file__).parents[2] / "configs"
PARTS = ("pillow_block", "pin_in_lug", "bolted_flange", "hub_on_shaft", "ball_in_grooves")
CHOSEN = ("linear-gamg", "primal", "active-set", "tao-bnls", "snes-vi")

HEADING = (
    "| part | unknowns | method | read | assembly | solve | seconds | over linear | CPU "
    "| over linear | iterations | contact known | GB | note |\n"
    "|---|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|"
)


def overrides_of(path: Path, degree: int, meshes: Path | None) -> list[str]:
    """``key=value`` for the degree of all bodies and the meshes of another directory."""
    values = []
    for i, body in enumerate(read(path)[0]["bodies"]):
        values.append(f"bodies.{i}.degree={degree}")
        if meshes is not None:
            file = meshes.resolve() / Path(body["mesh"]["file"]).name
            values.append(f"bodies.{i}.mesh.file={file}")
    return values


def run(
    path: Path, method: str, overrides: Sequence[str], tolerance: float, ranks: int, limit: float
) -> dict[str, Any]:
    """The row of one method on one part; why there is none under ``note``."""
    more = [part for override in overrides for part in ("--set", override)]
    row: dict[str, Any] = {"part": path.stem, "method": method, "note": ""}
    try:
        row |= python(
            "-m", "contact_app.studies.part_run", method, str(path), *more,
            "--tolerance", str(tolerance), limit=limit, ranks=ranks, threads=1,
        )  # fmt: skip
    except RunError as error:
        return {**row, "note": str(error)}
    if not row["converged"]:
        row["note"] = "not certified" if method in OURS else "did not converge"
    elif row["used"] != method:
        row["note"] = row["used"]
    return row


def line(row: dict[str, Any], linear: dict[str, Any] | None) -> str:
    """A row of the table in Markdown, beside that of the linear solve."""
    if "seconds" not in row:
        return f"| {row['part']} | | {row['method']} |" + " |" * 10 + f" {row['note']} |"

    def ratio(key: str) -> str:
        return "" if linear is None else f"{row[key] / linear[key]:.2f}"

    seconds = " | ".join(f"{row[key]:.3g}" for key in ("read", "assembly", "solve", "seconds"))
    return (
        f"| {row['part']} | {row['unknowns']:,} | {row['method']} | {seconds} | {ratio('seconds')} "
        f"| {row['cpu']:.3g} | {ratio('cpu')} | {row['iterations']} | {row.get('known', '')} "
        f"| {row['memory']:.2f} | {row['note']} |"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", help=f"files; the parts {', '.join(PARTS)} if none")
    parser.add_argument("--meshes", type=Path)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--tolerance", type=float, default=1e-8)
    parser.add_argument("--methods", default=",".join(CHOSEN))
    parser.add_argument("--ranks", type=int, default=1)
    parser.add_argument("--limit", type=float, default=1800.0)
    given = parser.parse_args(arguments)
    methods = given.methods.split(",")
    for method in methods:
        if method not in (*OURS, *METHODS):
            parser.error(f"no method {method}: {', '.join((*OURS, *METHODS))}")
    print(HEADING)
    for scene in given.scenes or [str(CONFIGS / f"{name}.yaml") for name in PARTS]:
        path, linear = Path(scene), None
        overrides = overrides_of(path, given.degree, given.meshes)
        for method in methods:
            row = run(path, method, overrides, given.tolerance, given.ranks, given.limit)
            if method == "linear-gamg" and not row["note"].startswith("did") and "cpu" in row:
                linear = row
            print(line(row, linear), flush=True)


if __name__ == "__main__":
    main()
