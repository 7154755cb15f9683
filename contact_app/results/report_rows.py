"""Lines of forces and displacements by name for the table at the end of a run."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from contact_app.scene.obstacles import SHAPES

MOST = 12
"""Largest number of lines of one kind in the table; ``summary.json`` has all."""

ROUND_OFF = 1e-9
"""Component of a vector over its largest, or of a reaction over the largest force, that is shown as
0."""

Row = tuple[str, str]


def number(value: float | None) -> str:
    """A value in four digits."""
    return "unknown" if value is None else f"{value:.4g}"


def named_rows(summary: Mapping[str, Any]) -> Iterator[Row]:
    """Contacts, supports, sections and probes."""
    solution, contacts = summary["solution"], summary.get("contacts", [])
    if summary["decomposition"]["contact"]:
        if len(contacts) < 2 or any(contact["with"] in SHAPES for contact in contacts):
            yield "contact force", contact_force(summary)
        yield "largest contact pressure", number(solution["max_contact_pressure"])
        loads = [f"{force_of(c)}, {number(c['max_pressure'])}" for c in contacts]
        names = [f"{c['on']} on {c['with']}" for c in contacts]
        each = [*zip(names, loads, strict=True)] if len(contacts) > 1 else []
        yield from _several("of each contact: force, largest pressure", each)
    reactions = summary.get("reactions", [])
    forces = [force for record in (*contacts, *reactions) for force in record["force"]]
    most = max(map(abs, forces), default=0.0)
    supports = [(record["on"], vector(record["force"], most)) for record in reactions]
    yield from _several("reactions", supports)
    sections = summary.get("sections", {}).items()
    yield from _several(
        "sections: force, moment",
        [(name, f"{vector(s['force'])}, {vector(s['moment'])}") for name, s in sections],
    )
    probes = summary.get("probes", {}).items()
    yield from _several(
        "displacements at probes", [(name, vector(p["displacement"])) for name, p in probes]
    )


def contact_force(record: Mapping[str, Any]) -> str:
    """The force of the contact of a record; with several contacts, that of all obstacles."""
    contacts = record.get("contacts", [])
    force = contacts[0]["force"] if len(contacts) == 1 else record["solution"]["contact_force"]
    return vector(force, sum(map(_size, contacts)))


def force_of(contact: Mapping[str, Any]) -> str:
    """The force of one contact; rounding errors beside its pressure, as on a ring, are 0."""
    return vector(contact["force"], _size(contact))


def _size(contact: Mapping[str, Any]) -> float:
    """Largest pressure times area."""
    return float((contact.get("max_pressure") or 0.0) * (contact.get("area") or 0.0))


def _several(head: str, rows: Sequence[Row]) -> Iterator[Row]:
    """A heading and lines below it; nothing without lines."""
    if rows:
        yield head, ""
    for name, value in rows[:MOST]:
        yield f"  {name}", value
    more = len(rows) - MOST
    if more > 0:
        yield f"  and {more} more", "in summary.json"


def vector(values: Sequence[float] | float, size: float = 0.0) -> str:
    """Components in brackets, round-off beside the largest as 0; a single number as it is.

    Parameters
    ----------
    size
        A larger number, of which rounding errors may be.
    """
    if not isinstance(values, Sequence):
        return number(values)
    none = ROUND_OFF * max([size, *map(abs, values)])
    return f"({', '.join(number(v if abs(v) > none else 0.0) for v in values)})"
