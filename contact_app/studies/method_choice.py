"""Time of `solver.method: auto` compared with each of the methods that it chooses from.

    python meshes/samples/make_trials.py --to TRIALS
    python -m contact_app.studies.method_choice TRIALS/*.yaml [--degree 2] [--friction 0.3]
        [--limit SECONDS]

Each run is a process of its own on one rank (`contact_app.studies.part_run`), to a tolerance of
1e-8. The table holds CPU seconds from the mesh file to the solution and applications of the
operator. "over the better" is the ratio of `auto` to the faster of the other two. ``--friction``
gives all contacts Coulomb friction with this coefficient.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from contact_app.scene.yaml_reader import read
from contact_app.studies.parts import overrides_of
from contact_app.studies.processes import RunError, python

METHODS = ("auto", "primal", "active-set")
Row = dict[str, Any]
Run = Callable[[Path, str, int, float], Row]
"""Function of scene, method, degree and time limit that returns the measured values. It raises
`RunError`."""


def run_once(
    path: Path, method: str, degree: int, limit: float, friction: float | None = None
) -> Row:
    """One method on one scene, in a process of its own."""
    items = [*overrides_of(path, degree, None)]
    if friction is not None:
        contacts = range(len(read(path)[0]["contacts"]))
        items += [f"contacts.{i}.friction={{coulomb: {friction:g}}}" for i in contacts]
    more = [part for item in items for part in ("--set", item)]
    return python(
        "-m", "contact_app.studies.part_run", method, str(path), *more, "--once",
        limit=limit, threads=1,
    )  # fmt: skip


def row(path: Path, degree: int, limit: float, run: Run = run_once) -> str:
    """The line of one scene."""
    found: dict[str, Row | str] = {}
    for method in METHODS:
        try:
            found[method] = run(path, method, degree, limit)
        except RunError as error:
            found[method] = str(error)
    cells = [_cell(found[method]) for method in METHODS]
    auto, *others = (_seconds(found[method]) for method in METHODS)
    better = min((s for s in others if s is not None), default=None)
    ratio = f"{auto / better:.2f}" if auto is not None and better else ""
    done = [one for one in found.values() if not isinstance(one, str)]
    unknowns = f"{done[0]['unknowns']:,}" if done else ""
    used = found["auto"]
    winner = "" if isinstance(used, str) else used["used"]
    return f"| {path.stem} | {degree} | {unknowns} | {winner} | {' | '.join(cells)} | {ratio} |"


def _seconds(found: Row | str) -> float | None:
    """CPU seconds of a certified answer."""
    if isinstance(found, str) or not found["converged"]:
        return None
    return float(found["cpu"])


def _cell(found: Row | str) -> str:
    if isinstance(found, str):
        return found
    note = "" if found["converged"] else ", not certified"
    return f"{found['cpu']:.2f} ({found['iterations']:,}{note})"


def table(scenes: Sequence[Path], degree: int, limit: float, run: Run = run_once) -> Iterator[str]:
    """The lines of the table."""
    yield "| part | degree | unknowns | `auto` ends with | `auto` | `primal` | `active-set` " \
          "| over the better |"  # fmt: skip
    yield "|---|---:|---:|---|---:|---:|---:|---:|"
    for path in scenes:
        yield row(path, degree, limit, run)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Time of auto beside the methods it chooses from.")
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--degree", type=int, choices=(1, 2), default=1)
    parser.add_argument("--limit", type=float, default=120.0, help="time limit of a run in seconds")
    parser.add_argument("--friction", type=float, help="Coulomb's coefficient at all contacts")
    given = parser.parse_args()
    run = partial(run_once, friction=given.friction)
    for line in table(given.scenes, given.degree, given.limit, run):
        print(line, flush=True)


if __name__ == "__main__":
    main()
