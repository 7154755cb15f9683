"""The largest smoothed pressure of round bodies whose cells have straight edges, and what is right.

``python -m contact_app.studies.smoothed_peaks [BALL.msh …]`` solves scenes of ``configs`` with
degree 1 and `round: true`. One body is turned about its centre or axis by several angles, so that
its facets meet those of the other body in another way each time. It prints how many facets lie
across the narrow side of the contact, the largest nodal and the largest smoothed pressure, and how
far the smoothed one is off. Further meshes of the ball in its grooves are drawn by ``python
meshes/samples/make_parts.py ball_in_grooves --size 0.1 --to DIR``.

What is right: Hertz's peak for the ball on a plane, which is not turned. For the ball in its
grooves the peak of its finest mesh, since Hertz's surfaces are parabolas where these are circles.
For pin and hub the peak of degree 2 with curved cells.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from contact_app.accuracy.contact_limits import pressed_facets
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load

ANGLES = (0.0, 17.0, 40.0, 73.0, 111.0)


@dataclass(frozen=True)
class Round:
    """A scene of round bodies.

    Attributes
    ----------
    body, axis
        Number of the body that is turned, and the axis; None where none is.
    right
        Largest pressure.
    """

    name: str
    right: float
    body: int = 0
    axis: tuple[int, int, int] | None = None


SCENES = (
    Round("hertz_sphere", 5.266),
    Round("hub_on_shaft", 148.0, 1, (0, 0, 1)),
    Round("pin_in_lug", 194.0, 1, (0, 1, 0)),
    Round("ball_in_grooves", 2380.0, 0, (0, 0, 1)),
)


@dataclass(frozen=True)
class Peak:
    """The peak of one contact: facets across it, pressures, and how far the smoothed one is off."""

    across: float
    largest: float
    smoothed: float
    off: float


def peaks(case: Round, angle: float, configs: Path, mesh: Path | None = None) -> Iterator[Peak]:
    """The peaks of the contacts of a scene with a body turned by an angle in degrees."""
    path = configs / f"{case.name}.yaml"
    changes = [] if mesh is None else [f"bodies.{i}.mesh.file={mesh.resolve()}" for i in range(3)]
    if case.axis is not None:
        changes += [f"bodies.{case.body}.mesh.rotate={{axis: {list(case.axis)}, angle: {angle}}}"]
        changes += [f"bodies.{i}.degree=1" for i in range(len(load(path).bodies))]
        changes += [f"contacts.{i}.round=true" for i in range(len(load(path).contacts))]
    solved = solve_scene(build_scene(load(path, changes)))
    if not solved.solution.converged:
        raise RuntimeError(f"{path}: {solved.solution.reason}")
    facets = pressed_facets(solved.model, solved.nodes)
    comm = solved.model.comm
    for record, pressed in zip(solved.summary["contacts"], facets, strict=True):
        across = pressed.across_narrow_side(comm, solved.model.scene.dimension)
        smoothed = record["max_smoothed_pressure"]
        yield Peak(across, record["max_pressure"], smoothed, smoothed / case.right - 1.0)


def main(arguments: list[str]) -> None:
    """Print the table."""
    configs = Path("configs")
    cases: list[tuple[Round, Path | None]] = [(case, None) for case in SCENES]
    cases += [(SCENES[-1], Path(mesh)) for mesh in arguments]
    print(f"{'scene':38s} angle  facets across   largest  smoothed     off")
    for case, mesh in cases:
        name = case.name if mesh is None else f"{case.name} {mesh.parent.name}"
        for angle in ANGLES if case.axis else ANGLES[:1]:
            for found in peaks(case, angle, configs, mesh):
                print(_line(name, angle, found), flush=True)


def _line(name: str, angle: float, found: Any) -> str:
    return (
        f"{name:38s} {angle:5.0f}  {found.across:13.1f}  {found.largest:8.5g}  "
        f"{found.smoothed:8.5g}  {100.0 * found.off:+5.1f} %"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
