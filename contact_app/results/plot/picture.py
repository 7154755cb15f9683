"""Pictures of a result: the deformed shape, coloured by fields, the contact pressure, and friction.

Reads only the files of a run (``solution.xdmf``, ``summary.json``). matplotlib draws all pictures
and needs no screen.
"""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.errors import ContactError
from contact_app.machine.atomic_file import atomic
from contact_app.results.plot.contact_picture import STATUS, NothingPressedError, draw_contact
from contact_app.results.plot.friction_picture import draw_friction
from contact_app.results.plot.plane_picture import draw_plane
from contact_app.results.plot.space_picture import draw_space
from contact_app.results.plot.stored import SMOOTHED, Stored, read

#: Largest displacement in the picture, as a share of the size of the bodies.
VISIBLE = 0.08
#: Largest change of an edge of a cell's side in the picture, as a share of its length.
BENT = 0.5


class PictureError(ContactError):
    """No picture can be made: the result or its fields are missing."""


def plot(
    directory: Path | str,
    *,
    output: Path | str | None = None,
    fields: tuple[str, ...] = ("von_mises", "contact_pressure"),
    exaggeration: float | None = None,
    camera: tuple[float, float, float] | None = None,
    time: float | None = None,
) -> tuple[list[Path], list[str]]:
    """Draw the bodies (``bodies.png``) and the contact pressure (``contact_pressure.png``).

    With ``contact_status`` also the sticking and slipping parts (``contact_status.png``). Of load
    cases each one is drawn, and the largest values over all of them (``envelope.png``).

    Parameters
    ----------
    directory
        Directory of the results of a run.
    output
        Directory of the pictures; by default that of the results. Load cases have one each below.
    fields
        One panel for each field; fields that are not in the result are left out. With
        ``smoothed_contact_pressure`` among them and without ``contact_pressure`` the picture of the
        contact shows the smoothed one.
    exaggeration
        Factor on the displacements; by default a round number that makes them visible.
    camera
        In space the direction to the camera; by default one from which contact is visible.
    time
        Of the increment of a load history, in completed steps; by default the last.

    Returns
    -------
    pictures, remarks
        Paths of the pictures, and sentences on those that were not drawn.

    Raises
    ------
    ContactError
        There is no result, or it holds none of the fields.
    """
    directory = Path(directory)
    target = Path(output) if output is not None else directory
    summary = _summary(directory)
    if cases := summary.get("cases"):
        draw = partial(plot, fields=fields, exaggeration=exaggeration, camera=camera, time=time)
        drawn = [(case, *draw(directory / case, output=target / case)) for case in cases]
        pictures = [path for _, made, _ in drawn for path in made]
        remarks = [f"{case}: {remark}" for case, _, remarks in drawn for remark in remarks]
        return [*pictures, *_of_envelope(directory, target, summary, camera)], remarks
    stored = read(directory, time)
    names = {*stored.point_data, *stored.cell_data}
    unknown = [name for name in fields if name not in names]
    if len(unknown) == len(fields):
        raise PictureError(
            f"the result holds none of {', '.join(unknown)}; it holds {_listed(names)}"
        )
    remarks = [
        f"left out: {name}: the result does not hold it, only {_listed(names)}" for name in unknown
    ]
    shown = tuple(name for name in fields if name in names and acts(stored, name))
    shown = shown or tuple(name for name in fields if name in names)
    target.mkdir(parents=True, exist_ok=True)
    factor = exaggeration if exaggeration is not None else round_exaggeration(stored)
    title, bodies = str(summary.get("scene", {}).get("title", "")), target / "bodies.png"
    title += "" if time is None else f", time {time:g}"
    caption = f"{title}\ndisplacements × {factor:g}".strip()
    remarks += _draw_bodies(stored, shown, factor, bodies, caption, camera, _has_pairs(summary))
    return [bodies, *_of_contacts(stored, shown, target, title, remarks)], remarks


def _draw_bodies(
    stored: Stored,
    shown: tuple[str, ...],
    factor: float,
    target: Path,
    caption: str,
    camera: tuple[float, float, float] | None,
    between: bool,
) -> list[str]:
    """Draw the bodies; return remarks."""
    with atomic(target) as part:
        if not stored.plane:
            return draw_space(stored, shown, factor, part, caption, camera, between)
        draw_plane(stored, shown, factor, part, caption)
        return []


def _has_pairs(summary: dict[str, Any]) -> bool:
    return bool(summary.get("solution", {}).get("pair_forces"))


def _of_envelope(
    directory: Path,
    target: Path,
    summary: dict[str, Any],
    camera: tuple[float, float, float] | None,
) -> list[Path]:
    """Draw the largest stress and pressure over all load cases, if they were written."""
    if not (directory / "envelope.xdmf").is_file():
        return []
    stored = read(directory, name="envelope")
    largest = {name: stored.field(f"largest_{name}") for name in ("von_mises", "contact_pressure")}
    pressure = {"contact_pressure": largest["contact_pressure"]}
    stored = replace(stored, point_data=pressure, cell_data={"von_mises": largest["von_mises"]})
    shown = tuple(name for name in largest if acts(stored, name))
    between = any(map(_has_pairs, summary["cases"].values()))
    caption = f"{summary.get('scene', {}).get('title', '')}\nlargest values over all cases".strip()
    _draw_bodies(stored, shown, 0.0, target / "envelope.png", caption, camera, between)
    return [target / "envelope.png"]


def _of_contacts(
    stored: Stored, shown: tuple[str, ...], target: Path, title: str, remarks: list[str]
) -> list[Path]:
    """Draw the pictures of the contact boundaries; adds a remark on each that is left out."""
    smoothed = SMOOTHED in shown and "contact_pressure" not in shown
    name = SMOOTHED if smoothed else "contact_pressure"
    of_contacts: dict[str, Callable[..., Path]] = {
        "contact_pressure.png": partial(draw_contact, name=name)
    }
    if STATUS in stored.point_data:
        of_contacts["contact_status.png"] = draw_friction
    pictures = []
    for name, draw in of_contacts.items():
        try:
            with atomic(target / name) as part:
                draw(stored, part, title)
            pictures.append(target / name)
        except NothingPressedError as error:
            remarks.append(f"left out: {name}: {error}")
    return pictures


def _listed(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none, as output.fields of the scene chose"


def acts(stored: Stored, name: str) -> bool:
    """Whether a field is something else than a contact pressure that is zero everywhere."""
    return not name.endswith("contact_pressure") or bool((stored.point_data[name] > 0.0).any())


def round_exaggeration(stored: Stored) -> float:
    """A factor 1, 2 or 5 times a power of ten that makes the displacements visible.

    The factor is small enough not to invert cells, for example at a small dent in a large body.
    """
    if "displacement" not in stored.point_data:
        return 1.0
    moves = stored.point_data["displacement"]
    largest = float(np.linalg.norm(moves, axis=1).max(initial=0.0))
    if not largest > 0.0:
        return 1.0
    wanted = VISIBLE * float(np.linalg.norm(np.ptp(stored.points, axis=0))) / largest
    for sides in stored.boundary():
        change, length = (
            np.linalg.norm(of[sides] - of[np.roll(sides, -1, axis=1)], axis=2)
            for of in (moves, stored.points)
        )
        wanted = min(wanted, BENT / max(float((change / length).max()), BENT / wanted))
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted) * power)


def _summary(directory: Path) -> dict[str, Any]:
    """The content of `summary.json`; empty if it is missing or incomplete."""
    try:
        summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return summary if isinstance(summary, dict) else {}
