"""Records of a load history: one per increment, and the summary of all."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from contact_app.machine.atomic_file import atomic
from contact_app.results.repeated_sentences import without_numbers
from contact_app.run.increments import SolvedIncrement

OF_THE_RUN = ("scene", "mesh", "decomposition", "environment")
"""Parts of a summary that are equal in all increments and left out of their records."""

Record = dict[str, Any]


def record_of(increment: SolvedIncrement) -> Record:
    """The record of an increment in `steps` of ``summary.json``.

    The work of friction counts from the beginning; the work within the increment is a separate
    number.
    """
    place, summary = increment.place, increment.solved.summary
    of_increment = {key: value for key, value in summary.items() if key not in OF_THE_RUN}
    solution = dict(of_increment["solution"])
    if "dissipated_work" in solution:
        solution["dissipated_work_of_increment"] = solution["dissipated_work"]
        solution["dissipated_work"] = increment.dissipated
    return {
        "step": place.step,
        "factor": float(place.share),
        "increment": place.number,
        "time": place.time,
        "factors": dict(increment.factors),
        "halved": place.halved,
        **of_increment,
        "solution": solution,
        "timings": increment.solved.timings.as_dict(),
    }


def summary_of_steps(last: Mapping[str, Any], records: Sequence[Record]) -> Record:
    """``summary.json`` of a load history: the summary of the last increment, and all records.

    Timings are summed. Of warnings that differ only in their numbers the last one appears, with all
    increments that have one.

    Parameters
    ----------
    last
        The summary of the last increment.
    """
    final = records[-1]
    keys = dict.fromkeys(key for record in records for key in record["timings"])
    timings = {key: sum(record["timings"].get(key, 0.0) for record in records) for key in keys}
    return {
        **last,
        "solution": final["solution"],
        "certificate": {**final["certificate"], "warnings": _warnings(records)},
        "timings": timings,
        "steps": list(records),
    }


def _warnings(records: Sequence[Record]) -> list[str]:
    """Each warning once, with the increments that have it; those of the last increment first."""
    kinds: dict[str, dict[int, list[str]]] = {}
    for record in (records[-1], *records[:-1]):
        for sentence in record["certificate"]["warnings"]:
            of_kind = kinds.setdefault(without_numbers(sentence), {})
            of_kind.setdefault(record["increment"], []).append(sentence)
    return [text for of_kind in kinds.values() for text in _latest(of_kind, len(records))]


def _latest(of_kind: Mapping[int, list[str]], count: int) -> list[str]:
    """The sentences of a kind in the last increment that has it.

    Parameters
    ----------
    of_kind
        Sentences by the number of their increment.
    count
        Increments of the history.
    """
    numbers = sorted(of_kind)
    latest = of_kind[numbers[-1]]
    if count == 1:
        return latest
    where = f"all {count} increments" if len(numbers) == count else _ranges(numbers)
    if any(sentences != latest for sentences in of_kind.values()):
        where += f"; the numbers are those of increment {numbers[-1]}, `steps` has the others"
    return [f"{sentence} ({where})" for sentence in latest]


def _ranges(numbers: Sequence[int]) -> str:
    """Increasing numbers of increments in words.

    Examples
    --------
    >>> _ranges([3]), _ranges([1, 2, 4, 7, 8, 9])
    ('increment 3', 'increments 1 to 2, 4, 7 to 9')
    """
    starts = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    parts = [str(a) if a == b else f"{a} to {b}" for a, b in zip(starts, ends, strict=True)]
    return f"increment{'s' if len(numbers) > 1 else ''} {', '.join(parts)}"


def write_table(path: Path, records: Sequence[Record]) -> None:
    """Write ``increments.csv`` with one row per increment."""
    rows = [dict(_row(record)) for record in records]
    columns = list(dict.fromkeys(column for row in rows for column in row))
    with atomic(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def _row(record: Record) -> Iterable[tuple[str, Any]]:
    """Columns and values of a row."""
    for key in ("increment", "step", "factor", "time"):
        yield key, record[key]
    for name, factor in record["factors"].items():
        yield f"factor_{name}", factor
    yield "hessian_multiplications", record["solver"]["hessian_multiplications"]
    yield "certified", int(record["certificate"]["passed"])
    solution = record["solution"]
    for key in ("energy", "max_displacement", "max_contact_pressure", "dissipated_work"):
        if key in solution:
            yield key, solution[key]
    yield "estimated_error", record["accuracy"]["total"]
    for number, contact in enumerate(record["contacts"]):
        for axis, value in zip("xyz", contact["force"], strict=False):
            yield f"contacts[{number}]_force_{axis}", value
        for status, count in contact.get("nodes", {}).items():
            yield f"contacts[{number}]_{status}", count
    for name, probe in record.get("probes", {}).items():
        for axis, value in zip("xyz", probe["displacement"], strict=False):
            yield f"{name}_{axis}", value
