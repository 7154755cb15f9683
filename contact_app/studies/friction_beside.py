"""Friction beside CalculiX and GetFEM.

    python -m contact_app.studies.friction_beside [NAME …] [--tuning] [-o DIR]

Two scenes (`rough_scenes`) are solved on series of meshes that all programs share. Each run is a
process on one thread and is measured as a whole. Errors are relative to this application's solution
on the finest mesh with degree 2:

* displacements at the nodes of the coarsest mesh, ‖u - u_ref‖ / ‖u_ref‖ in the root mean square;
* the resultant contact force, and its component along x. For the block this is friction; for the
  roller it also contains normal forces, whose directions are inclined;
* for the roller also the slip and the friction traction over 0 ≤ x ≤ `END`. The slip is the
  displacement of the roller's nodes relative to the block along the tangents of the roller.
  Tractions that CalculiX prints do not add up to its resultant and are left out.

``--tuning`` solves one mesh of each scene (`TUNED`) with other parameters instead: CalculiX with
penalties K and stick slopes λ over three decades, GetFEM with augmentations r over two.

A program that is not installed is left out with the reason. A run that does not converge, or takes
more than `LIMIT` seconds, has a row that says so. The study writes ``friction.csv`` and
``friction.png``, or ``tuning.csv``, and prints the tables.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contact_app.studies.calculix_deck import COMMAND, Deck, measured
from contact_app.studies.rough_models import Outcome, PlainScene
from contact_app.studies.rough_scenes import ROUGH, plain
from contact_app.studies.tables import write

Array = NDArray[np.float64]

OURS, CALCULIX, GETFEM = "contact-app", "CalculiX", "GetFEM"

LIMIT = 420
"""Time limit of a run in wall-clock seconds."""

END, RADIUS = 5.0, 50.0
"""Length over which profiles of the roller's contact are compared, and the roller's radius."""

TUNED = {"roller": (2.0, 1), "block": (8, 1)}
"""The level and degree on which parameters are changed."""

PENALTIES = (0.5, 5.0, 50.0, 500.0)
"""K over E / h, with a tenth of it as λ; CalculiX's manual recommends 5 to 50."""

STICKS = (0.05, 0.5, 50.0)
"""λ over E / h, with the penalty 50."""

AUGMENTATIONS = (0.03, 0.1, 0.3, 1.0, 3.0)
"""r over E / h."""

MESHES = {"program": "program", "degree": "degree", "level": "mesh", "unknowns": "unknowns",
          "cpu": "processor s", "clock": "clock s"}  # fmt: skip
PARAMETERS = {"program": "program", "penalty": "K", "stick": "λ", "augmentation": "r",
              "cpu": "processor s"}  # fmt: skip
ERRORS = {"displacement": "displacements", "force": "contact force", "along": "along x",
          "slip": "slip", "traction": "friction traction"}  # fmt: skip
"""Columns of the tables by the keys of a row."""

COLUMNS = ("scene", *dict.fromkeys([*MESHES, *PARAMETERS, *ERRORS]), "note")

Mesh = tuple[float, int]
"""Level and degree."""


def missing(program: str) -> str:
    """The reason why a program cannot run; empty if it can."""
    if program == CALCULIX and shutil.which(COMMAND) is None:
        return f"there is no {COMMAND} (Debian: calculix-ccx)"
    if program == GETFEM and importlib.util.find_spec("getfem") is None:
        return "there is no module getfem (Debian: python3-getfem)"
    return ""


def run(
    program: str, name: str, mesh: Mesh, directory: Path, tuning: Sequence[float] = ()
) -> tuple[Outcome, dict[str, Any]]:
    """Result of a program for a scene on a mesh of a level and degree, with its seconds.

    Parameters
    ----------
    tuning
        Of CalculiX the penalty and the stick slope, of GetFEM the augmentation parameter, all over
        E / h; the values of `calculix_deck` and `rough_getfem` unless given.

    Raises
    ------
    RuntimeError
        The program fails.
    """
    directory.mkdir(parents=True, exist_ok=True)
    file, scene_file = directory / "outcome.pickle", directory / "scene.pickle"
    python, note = [sys.executable, "-m"], ""
    if program == OURS:
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
        words += map(str, tuning)
        row = dict(measured(["timeout", str(LIMIT), *words], directory))
        note = (directory / "output.txt").read_text(encoding="utf-8").splitlines()[-1]
        return Outcome.load(file), {**row, "note": note.split(":")[0]}
    deck = Deck(scene, *tuning)
    (directory / "deck.inp").write_text("\n".join(deck.lines()) + "\n", encoding="utf-8")
    row = dict(measured(["timeout", str(LIMIT), COMMAND, "deck"], directory))
    printed = (directory / "output.txt").read_text(encoding="utf-8")
    note = f"{printed.count(' iteration ')} iterations"
    return deck.outcome(directory / "deck.dat"), {**row, "note": note}


class Judge:
    """Errors against the reference of a scene."""

    def __init__(self, name: str, known: Outcome) -> None:
        self.name, self.known = name, known
        self.scene: PlainScene = plain(name, ROUGH[name].levels[0], 1)

    def errors(self, found: Outcome) -> dict[str, float]:
        """Errors of one outcome, by the columns of the table."""
        moved = [np.concatenate(self._at_nodes(o)) for o in (self.known, found)]
        result = {
            "displacement": relative(*moved),
            "force": relative(self.known.force, found.force),
            "along": relative(self.known.force[:1], found.force[:1]),
        }
        if self.name != "roller":
            return result
        result["slip"] = relative(self._slip(self.known), self._slip(found))
        if len(found.places):
            result["traction"] = relative(traction(self.known), traction(found))
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


def relative(known: Array, found: Array) -> float:
    """‖found - known‖ over ‖known‖."""
    return float(np.linalg.norm(found - known) / np.linalg.norm(known))


def series(name: str) -> Iterator[tuple[str, Mesh, dict[str, float]]]:
    """Programs and meshes of a scene, coarse to fine."""
    levels = ROUGH[name].levels
    for program in (OURS, CALCULIX, GETFEM):
        for degree in (1, 2):
            for level in levels if degree == 1 else levels[:-1]:
                yield program, (level, degree), {}


def tunings(name: str) -> Iterator[tuple[str, Mesh, dict[str, float]]]:
    """Programs and parameters on one mesh of a scene."""
    yield OURS, TUNED[name], {}
    for penalty, stick in [*((k, 0.1 * k) for k in PENALTIES), *((50.0, x) for x in STICKS)]:
        yield CALCULIX, TUNED[name], {"penalty": penalty, "stick": stick}
    for augmentation in AUGMENTATIONS:
        yield GETFEM, TUNED[name], {"augmentation": augmentation}


def rows(names: Sequence[str], directory: Path, tuned: bool = False) -> Iterator[dict[str, Any]]:
    """All runs, one row each; the reference first. After a failure finer meshes are left out."""
    for name in names:
        finest, ended = ROUGH[name].finest, set()
        known, row = run(OURS, name, finest, directory / f"{name}_reference")
        judge = Judge(name, known)
        if not tuned:
            yield {**_named(name, "reference", finest), "unknowns": _unknowns(known), **row}
        for number, (program, mesh, tuning) in enumerate((tunings if tuned else series)(name)):
            reason = missing(program)
            one = (program,) if reason else (program, mesh[1], *tuning.values())
            if one in ended:
                continue
            named = {**_named(name, program, mesh), **tuning}
            if reason:
                ended.add(one)
                yield {**named, "note": f"left out: {reason}"}
                continue
            where = directory / f"{name}_{program}_{number}"
            try:
                found, row = run(program, name, mesh, where, list(tuning.values()))
            except (RuntimeError, subprocess.SubprocessError) as error:
                ended.add(one)
                note = f"no answer: {str(error).splitlines()[-1].split(';')[0]}"
                yield {**named, "note": note}
                continue
            yield {**named, "unknowns": _unknowns(found), **row, **judge.errors(found)}


def _named(name: str, program: str, mesh: Mesh) -> dict[str, Any]:
    return {"scene": name, "program": program, "level": mesh[0], "degree": mesh[1]}


def _unknowns(found: Outcome) -> int:
    return sum(points.size for points in found.points)


def table(found: Sequence[dict[str, Any]], name: str, tuned: bool = False) -> Iterator[str]:
    """The rows of one scene for the page in docs/benchmarks."""
    errors = [key for key in ERRORS if any(key in r for r in found if r["scene"] == name)]
    if tuned and "traction" in errors:
        errors.remove("traction")
    heads = {**(PARAMETERS if tuned else MESHES), **{key: ERRORS[key] for key in errors}}
    yield "| " + " | ".join([*heads.values(), ""]) + " |"
    yield "|---|" + "---:|" * (len(heads) - 1) + "---|"
    for row in found:
        if row["scene"] == name:
            words = [_word(key, row[key]) if key in row else "" for key in heads]
            yield "| " + " | ".join([*words, row.get("note", "")]) + " |"


def _word(key: str, value: Any) -> str:
    if key in ERRORS:
        return f"{100 * value:.2f} %"
    if key in ("cpu", "clock"):
        return f"{value:.1f}"
    return value if isinstance(value, str) else f"{value:,}" if key == "unknowns" else f"{value:g}"


def draw(found: Sequence[dict[str, Any]], name: str, path: Path) -> None:
    """The error of displacements over processor seconds."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    for k, program in enumerate((OURS, CALCULIX, GETFEM)):
        for degree in (1, 2):
            chosen = [r for r in found if (r["scene"], r["program"], r["degree"])
                    == (name, program, degree) and "displacement" in r]  # fmt: skip
            if chosen:
                axes.loglog(
                    [r["cpu"] for r in chosen], [100.0 * r["displacement"] for r in chosen],
                    color=plt.get_cmap("tab10")(k), linestyle="--" if degree == 2 else "-",
                    marker="o" if program == OURS else ".", linewidth=2.4 if k == 0 else 1.4,
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
    parser.add_argument("--tuning", action="store_true", help="other parameters on one mesh")
    parser.add_argument("-o", "--output", type=Path, default=Path("results/friction_beside"))
    given = parser.parse_args(arguments)
    unknown = sorted(set(given.names) - set(ROUGH))
    if unknown:
        parser.error(f"unknown scene {unknown[0]}; known: {', '.join(ROUGH)}")
    names, output = given.names or list(ROUGH), given.output.resolve()
    found = []
    for row in rows(names, output, given.tuning):
        found.append(row)
        print(row, file=sys.stderr, flush=True)
    write(found, COLUMNS, output / ("tuning.csv" if given.tuning else "friction.csv"))
    for name in names:
        print(f"\n{name}\n")
        print("\n".join(table(found, name, given.tuning)))
        if not given.tuning:
            draw(found, name, output / f"friction_{name}.png")


if __name__ == "__main__":
    main()
