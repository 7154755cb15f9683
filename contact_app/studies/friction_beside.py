"""Friction beside CalculiX and GetFEM.

    python -m contact_app.studies.friction_beside [NAME …] [-o DIR]

Two scenes (`rough_scenes`) are solved on series of meshes that all programs share. Each run is a
process on one thread and is measured as a whole. Errors are relative to this application's solution
on the finest mesh with degree 2:

* displacements at the nodes of the coarsest mesh, ‖u - u_ref‖ / ‖u_ref‖ in the root mean square;
* the resultant contact force, and its component along x. For the block this is friction; for the
  roller it also contains normal forces, whose directions are inclined;
* for the roller also the slip and the friction traction over 0 ≤ x ≤ `END`. The slip is the
  displacement of the roller's nodes relative to the block along the tangents of the roller.
  Tractions that CalculiX prints do not add up to its resultant and are left out.

A program that is not installed is left out with the reason. A run that does not converge, or takes
more than `LIMIT` seconds, has a row that says so. The study writes ``friction.csv`` and
``friction_NAME.png``, and prints the tables.
"""

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from contact_app.studies.calculix_deck import COMMAND, Deck, measured
from contact_app.studies.rough_models import Outcome, PlainScene
from contact_app.studies.rough_scenes import ROUGH, plain
from contact_app.studies.tables import plotting, write
from meshes.arrays import Array

APPLICATION, CALCULIX, GETFEM = "contact-app", "CalculiX", "GetFEM"

LIMIT = 420
"""Time limit of a run in wall-clock seconds."""

END, RADIUS = 5.0, 50.0
"""Length over which profiles of the roller's contact are compared, and the roller's radius."""

RUNS = {"program": "program", "degree": "degree", "level": "mesh", "unknowns": "unknowns",
          "cpu": "processor s", "clock": "clock s"}  # fmt: skip
ERRORS = {"displacement": "displacements", "force": "contact force", "along": "along x",
          "slip": "slip", "traction": "friction traction"}  # fmt: skip
"""Columns of the tables by the keys of a row."""

COLUMNS = ("scene", *dict.fromkeys([*RUNS, *ERRORS]), "note")

Mesh = tuple[float, int]
"""Level and degree."""


def missing(program: str) -> str:
    """The reason why a program cannot run; empty if it can."""
    if program == CALCULIX and shutil.which(COMMAND) is None:
        return f"there is no {COMMAND} (Debian: calculix-ccx)"
    if program == GETFEM and importlib.util.find_spec("getfem") is None:
        return "there is no module getfem (Debian: python3-getfem)"
    return ""


def run(program: str, name: str, mesh: Mesh, directory: Path) -> tuple[Outcome, dict[str, Any]]:
    """Result of a program for a scene on a mesh of a level and degree, with its seconds.

    Raises
    ------
    RuntimeError
        The program fails.
    """
    directory.mkdir(parents=True, exist_ok=True)
    file, scene_file = directory / "outcome.pickle", directory / "scene.pickle"
    python, note = [sys.executable, "-m"], ""
    if program == APPLICATION:
        here = [*python, "contact_app.studies.rough_scenes", name, *map(str, mesh)]
        row: dict[str, Any] = dict(measured([*here, str(file)], directory))
        last = (directory / "output.txt").read_text(encoding="utf-8").splitlines()[-1]
        if not json.loads(last)["certificate"]["passed"]:
            note = "not certified"
        return Outcome.load(file), {**row, "note": note}
    scene = plain(name, *mesh)
    if program == GETFEM:
        scene.save(scene_file)
        words = [*python, "contact_app.studies.rough_getfem", str(scene_file), str(file)]
        row = dict(measured(["timeout", str(LIMIT), *words], directory))
        note = (directory / "output.txt").read_text(encoding="utf-8").splitlines()[-1]
        return Outcome.load(file), {**row, "note": note.split(":")[0]}
    deck = Deck(scene)
    (directory / "deck.inp").write_text("\n".join(deck.lines()) + "\n", encoding="utf-8")
    row = dict(measured(["timeout", str(LIMIT), COMMAND, "deck"], directory))
    printed = (directory / "output.txt").read_text(encoding="utf-8")
    note = f"{printed.count(' iteration ')} iterations"
    return deck.outcome(directory / "deck.dat"), {**row, "note": note}


class Judge:
    """Errors against the reference of a scene."""

    def __init__(self, name: str, reference: Outcome) -> None:
        self.name, self.reference = name, reference
        self.scene: PlainScene = plain(name, ROUGH[name].levels[0], 1)

    def errors(self, outcome: Outcome) -> dict[str, float]:
        """Errors of one outcome, by the columns of the table."""
        moved = [np.concatenate(self._at_nodes(o)) for o in (self.reference, outcome)]
        result = {
            "displacement": relative(*moved),
            "force": relative(self.reference.force, outcome.force),
            "along": relative(self.reference.force[:1], outcome.force[:1]),
        }
        if self.name != "roller":
            return result
        result["slip"] = relative(self._slip(self.reference), self._slip(outcome))
        if len(outcome.places):
            result["traction"] = relative(traction(self.reference), traction(outcome))
        return result

    def _at_nodes(self, outcome: Outcome) -> list[Array]:
        """Displacements at the nodes of the coarsest mesh."""
        result = []
        for body, points, moved in zip(
            self.scene.bodies, outcome.points, outcome.displacement, strict=True
        ):
            away, at = cKDTree(points).query(body.points)
            if away.max() > 1e-6:
                raise RuntimeError("a mesh without the nodes of the coarsest one")
            result.append(moved[at].ravel())
        return result

    @staticmethod
    def _slip(outcome: Outcome) -> Array:
        """Slip of the nodes of the roller along the block, along the roller's tangents."""
        (roller, block), (u, v) = outcome.points, outcome.displacement
        on = np.abs(np.hypot(roller[:, 0], roller[:, 1] - RADIUS) - RADIUS) < 1e-6 * RADIUS
        on &= (roller[:, 0] < 2.0 * END) & (roller[:, 1] < RADIUS)
        x, y = roller[on].T
        top = np.flatnonzero(np.abs(block[:, 1]) < 1e-9)
        top = top[np.argsort(block[top, 0])]
        meets = x * RADIUS / (RADIUS - y)
        jump = [u[on, i] - np.interp(meets, block[top, 0], v[top, i]) for i in (0, 1)]
        slip = (jump[0] * (RADIUS - y) + jump[1] * x) / RADIUS
        order = np.argsort(x)
        return np.asarray(np.interp(_grid(), x[order], slip[order]))


def traction(outcome: Outcome) -> Array:
    """Friction force per area along the contact of the roller, away from its middle."""
    order = np.argsort(outcome.places[:, 0])
    x = outcome.places[order, 0]
    along = np.abs(outcome.traction[order]).max(axis=1)  # one component, or nearly
    return np.asarray(np.interp(_grid(), x, along))


def _grid() -> Array:
    return np.linspace(0.0, END, 201)


def relative(exact: Array, values: Array) -> float:
    """‖values - exact‖ over ‖exact‖."""
    return float(np.linalg.norm(values - exact) / np.linalg.norm(exact))


def series(name: str) -> Iterator[tuple[str, Mesh]]:
    """Programs and meshes of a scene, coarse to fine."""
    levels = ROUGH[name].levels
    for program in (APPLICATION, CALCULIX, GETFEM):
        for degree in (1, 2):
            for level in levels if degree == 1 else levels[:-1]:
                yield program, (level, degree)


def rows(names: Sequence[str], directory: Path) -> Iterator[dict[str, Any]]:
    """All runs, one row each; the reference first. After a failure finer meshes are left out."""
    for name in names:
        finest, failed = ROUGH[name].finest, set()
        reference, row = run(APPLICATION, name, finest, directory / f"{name}_reference")
        judge = Judge(name, reference)
        yield {**_named(name, "reference", finest), "unknowns": _unknowns(reference), **row}
        for number, (program, mesh) in enumerate(series(name)):
            reason = missing(program)
            one = (program, 0 if reason else mesh[1])
            if one in failed:
                continue
            named = _named(name, program, mesh)
            if reason:
                failed.add(one)
                yield {**named, "note": f"left out: {reason}"}
                continue
            began = time.monotonic()
            try:
                outcome, row = run(program, name, mesh, directory / f"{name}_{program}_{number}")
            except (RuntimeError, subprocess.SubprocessError) as error:
                failed.add(one)
                note = f": {str(error).splitlines()[-1].split(';')[0]}"
                if time.monotonic() - began >= LIMIT:
                    note = f" within {LIMIT} s"
                yield {**named, "note": f"no answer{note}"}
                continue
            yield {**named, "unknowns": _unknowns(outcome), **row, **judge.errors(outcome)}


def _named(name: str, program: str, mesh: Mesh) -> dict[str, Any]:
    return {"scene": name, "program": program, "level": mesh[0], "degree": mesh[1]}


def _unknowns(outcome: Outcome) -> int:
    return sum(points.size for points in outcome.points)


def table(results: Sequence[dict[str, Any]], name: str) -> Iterator[str]:
    """The rows of one scene for the page in docs/benchmarks."""
    errors = [key for key in ERRORS if any(key in r for r in results if r["scene"] == name)]
    heads = {**RUNS, **{key: ERRORS[key] for key in errors}}
    yield "| " + " | ".join([*heads.values(), ""]) + " |"
    yield "|---|" + "---:|" * (len(heads) - 1) + "---|"
    for row in results:
        if row["scene"] == name:
            words = [_word(key, row[key]) if key in row else "" for key in heads]
            yield "| " + " | ".join([*words, row.get("note", "")]) + " |"


def _word(key: str, value: Any) -> str:
    if key in ERRORS:
        return f"{100 * value:.2f} %"
    if key in ("cpu", "clock"):
        return f"{value:.1f}"
    return value if isinstance(value, str) else f"{value:,}" if key == "unknowns" else f"{value:g}"


def draw(results: Sequence[dict[str, Any]], name: str, path: Path) -> None:
    """The error of displacements over processor seconds."""
    plt = plotting()
    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    for k, program in enumerate((APPLICATION, CALCULIX, GETFEM)):
        for degree in (1, 2):
            chosen = [r for r in results if (r["scene"], r["program"], r["degree"])
                    == (name, program, degree) and "displacement" in r]  # fmt: skip
            if chosen:
                axes.loglog(
                    [r["cpu"] for r in chosen], [100.0 * r["displacement"] for r in chosen],
                    color=plt.get_cmap("tab10")(k), linestyle="--" if degree == 2 else "-",
                    marker="o" if program == APPLICATION else ".", linewidth=2.4 if k == 0 else 1.4,
                    label=f"{program}, degree {degree}",
                )  # fmt: skip
    axes.set_xlabel("processor seconds of the whole run")
    axes.set_ylabel("error of displacements, %")
    axes.set_title(f"{name}, pressed with friction")
    axes.grid(visible=True, which="both", alpha=0.25)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(ROUGH)}; all unless given")
    parser.add_argument("-o", "--output", type=Path, default=Path("results/friction_beside"))
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(ROUGH))
    if unknown:
        parser.error(f"unknown scene {unknown[0]}; known: {', '.join(ROUGH)}")
    names, output = options.names or list(ROUGH), options.output.resolve()
    results = []
    for row in rows(names, output):
        results.append(row)
        print(row, file=sys.stderr, flush=True)
    write(results, COLUMNS, output / "friction.csv")
    for name in names:
        print(f"\n{name}\n")
        print("\n".join(table(results, name)))
        draw(results, name, output / f"friction_{name}.png")


if __name__ == "__main__":
    main()
