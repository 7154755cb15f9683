"""The errors and seconds of CalculiX and GetFEM with different parameters.

    python -m contact_app.studies.friction_tuning [NAME …] [-o DIR]

One mesh of each scene of `friction_beside` is solved with different parameters: by CalculiX with
penalties K and stick slopes λ over three decades, by GetFEM with augmentation parameters r over
two. The errors are those of `friction_beside`, relative to this application's solution on the
finest mesh. This application's answer on the same mesh, which has no parameter, stands beside them.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from contact_app.studies.friction_beside import (
    CALCULIX,
    GETFEM,
    OURS,
    Judge,
    missing,
    names_and_output,
    run,
    shown,
)
from contact_app.studies.rough_scenes import ROUGH
from contact_app.studies.tables import write

MESHES = {"roller": (2.0, 1), "block": (8, 1)}
"""The level and degree on which each scene is solved."""

PENALTIES = (0.5, 5.0, 50.0, 500.0)
"""K over E / h; CalculiX's manual recommends 5 to 50."""

STICKS = (0.05, 0.5, 5.0, 50.0)
"""λ over E / h, with the penalty 50."""

AUGMENTATIONS = (0.03, 0.1, 0.3, 1.0, 3.0)
"""r over E / h."""

COLUMNS = (
    "scene", "program", "penalty", "stick", "augmentation", "cpu", "displacement", "force", "along",
    "slip", "note",
)  # fmt: skip


def choices() -> Iterator[tuple[str, dict[str, float]]]:
    """Programs with their parameters."""
    yield OURS, {}
    for penalty in PENALTIES:
        yield CALCULIX, {"penalty": penalty, "stick": 0.1 * penalty}
    for stick in STICKS:
        if stick != 5.0:
            yield CALCULIX, {"penalty": 50.0, "stick": stick}
    for augmentation in AUGMENTATIONS:
        yield GETFEM, {"augmentation": augmentation}


def rows(names: Sequence[str], directory: Path) -> Iterator[dict[str, Any]]:
    """All runs, one row each."""
    for name in names:
        known, _ = run(OURS, name, ROUGH[name].finest, directory / f"{name}_reference")
        judge = Judge(name, known)
        for number, (program, tuning) in enumerate(choices()):
            row = {**dict.fromkeys(COLUMNS, ""), "scene": name, "program": program, **tuning}
            if missing(program):
                yield {**row, "note": f"left out: {missing(program)}"}
                continue
            where = directory / f"{name}_{number}"
            try:
                found, measured = run(program, name, MESHES[name], where, list(tuning.values()))
            except (RuntimeError, subprocess.SubprocessError):
                yield {**row, "note": "no answer"}
                continue
            kept = {key: measured[key] for key in ("cpu", "note")}
            yield {**row, **kept, **judge.errors(found)}


def table(found: Sequence[dict[str, Any]], name: str) -> Iterator[str]:
    """The rows of one scene for the page in docs/benchmarks."""
    errors = ["displacement", "force", "along", *(["slip"] if name == "roller" else [])]
    heads = ["displacements", "contact force", "along x", "slip"][: len(errors)]
    yield "| " + " | ".join(["program", "K", "λ", "r", "processor s", *heads, ""]) + " |"
    yield "|---|" + "---:|" * (4 + len(heads)) + "---|"
    for row in found:
        if row["scene"] != name:
            continue
        words = [f"{row[key]:g}" if row[key] != "" else "" for key in COLUMNS[2:5]]
        words.append(f"{row['cpu']:.1f}" if row["cpu"] != "" else "")
        words += [f"{100 * row[key]:.2f} %" if row[key] != "" else "" for key in errors]
        yield "| " + " | ".join([row["program"], *words, row["note"]]) + " |"


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    names, output = names_and_output(arguments, __doc__, list(MESHES), "results/friction_tuning")
    found = shown(rows(names, output))
    write(found, COLUMNS, output / "tuning.csv")
    for name in names:
        print(f"\n{name}\n")
        print("\n".join(table(found, name)))


if __name__ == "__main__":
    main()
