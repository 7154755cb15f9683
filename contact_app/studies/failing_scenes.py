"""Scenes on which contact methods fail, each named after the failure it provokes.

docs/benchmarks/stability.md names the failure of each case without a guard, and the guard of this
application. If a milder variant of the scene is known, the growth of work from the variant to the
case is measured as well.
"""

import copy
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from contact_app.studies.perturbed import write_mesh
from meshes import BoxShape

Config = dict[str, Any]
Point = list[float]

REFUSED = "refused"
HOLDS = "holds"


@dataclass(frozen=True)
class Case:
    """A scene that provokes a failure."""

    name: str
    make: Callable[[], Config]
    """The scene as a configuration, without decomposition."""
    subdomains: Any = (2, 2)
    expected: str = HOLDS
    energy: float | None = None
    scale: float = 0.0
    """Scale of the comparison if the energy is zero."""
    mild: Callable[[], Config] | None = None
    """A variant without the difficulty, with about the same number of unknowns."""


def box_body(name: str, lower: Point, upper: Point, cells: list[int], **more: Any) -> Config:
    """A box of equal cells."""
    cell = more.pop("cell", "quadrilateral" if len(cells) == 2 else "hexahedron")
    material = {"young": more.pop("young", 1000.0), "poisson": more.pop("poisson", 0.3)}
    box = {"lower": lower, "upper": upper, "cells": cells, "cell": cell}
    return {"name": name, "mesh": {"box": box}, "material": material, **more}


def plane_contact(on: str, point: list[float], normal: list[float]) -> Config:
    """A boundary beside a plane."""
    return {"on": on, "obstacle": {"plane": {"point": point, "normal": normal}}}


def scene_of(bodies: list[Any], conditions: list[Config], contacts: list[Config]) -> Config:
    """The whole configuration without its decomposition."""
    return {
        "title": "",
        "dimension": len(bodies[0]["mesh"]["box"]["cells"]),
        "bodies": bodies,
        "conditions": conditions,
        "contacts": contacts,
        "solver": {"tolerance": 1e-8},
    }


FLOOR = plane_contact("block.y-", [0.0, 0.0], [0.0, 1.0])


def square(n: int, **more: Any) -> Config:
    """The unit square of n × n cells."""
    return box_body("block", [0.0, 0.0], [1.0, 1.0], [n, n], **more)


def moved(on: str, *values: float | None) -> Config:
    """A displacement condition."""
    return {"on": on, "displacement": list(values)}


def pulled(on: str, *values: float) -> Config:
    """A traction."""
    return {"on": on, "traction": list(values)}


def pressed(on: str, pressure: float) -> Config:
    """A pressure."""
    return {"on": on, "pressure": pressure}


def wall(n: int = 16, **more: Any) -> Config:
    """The paper's problem in the plane: foot clamped, top pressed, a wall at the right."""
    conditions = [moved("block.y-", 0.0, 0.0), pulled("block.y+", 0.0, -50.0)]
    beside = plane_contact("block.x+", [1.0, 0.0], [-1.0, 0.0])
    return scene_of([square(n, **more)], conditions, [beside])


def grazing() -> Config:
    """The top moves down by exactly the gap below the foot."""
    gap = 0.015625
    below = plane_contact("block.y-", [0.0, -gap], [0.0, 1.0])
    return scene_of([square(8, poisson=0.0)], [moved("block.y+", 0.0, -gap)], [below])


def weakly_active() -> Config:
    """A bar with EA = L = F = 1 that just reaches its wall: rows touch without force."""
    conditions = [moved("block.x-", 0.0, 0.0), pulled("block.x+", 1.0, 0.0)]
    beside = plane_contact("block.x+", [2.0, 0.0], [-1.0, 0.0])
    return scene_of([square(16, young=1.0, poisson=0.0)], conditions, [beside])


def quadratic_patch(degree: int = 2) -> Config:
    """A block on a floor under uniform pressure."""
    conditions = [moved("block.x-", 0.0, None), pressed("block.y+", 10.0)]
    return scene_of([square(4, degree=degree)], conditions, [FLOOR])


def eccentric(reach: float) -> Config:
    """A free block on a support over 0 ≤ x ≤ reach; the load acts at x = 0.75."""
    boundaries = {
        "support": {"where": f"y < 1e-9 and x < {reach} + 1e-9"},
        "right": {"where": "y > 1 - 1e-9 and x > 0.5 - 1e-9"},
    }
    body = box_body("block", [0.0, 0.0], [1.0, 1.0], [50, 8], boundaries=boundaries)
    below = plane_contact("block.support", [0.0, 0.0], [0.0, 1.0])
    return scene_of([body], [pulled("block.right", 0.0, -50.0)], [below])


def floating(*load: float) -> Config:
    """A free block on a frictionless floor."""
    return scene_of([square(8)], [pulled("block.y+", *load)], [FLOOR])


def held_and_touching() -> Config:
    """Nodes held in one component and in contact in the other, on an oblique plane."""
    conditions = [moved("block.x-", 0.0, None), pressed("block.y+", 40.0)]
    slope = plane_contact("block.y-", [0.0, 0.0], [0.3, 1.0])
    return scene_of([square(12)], conditions, [slope])


def two_planes() -> Config:
    """A clamped block pressed into a corner: one node touches both planes."""
    below = plane_contact("block.y-", [0.0, -0.002], [0.0, 1.0])
    beside = plane_contact("block.x+", [1.004, 0.0], [-1.0, 0.0])
    conditions = [moved("block.x-", 0.0, 0.0), pulled("block.y+", 30.0, -80.0)]
    return scene_of([square(12)], conditions, [below, beside])


def same_plane_thrice() -> Config:
    """One plane three times, the last time turned by a thousandth."""
    made = wall()
    made["contacts"] += [
        copy.deepcopy(made["contacts"][0]),
        plane_contact("block.x+", [1.0, 0.0], [-1.0, 0.001]),
    ]
    return made


def held_inside() -> Config:
    """A held face that is moved into an obstacle."""
    made = grazing()
    made["contacts"] = [plane_contact("block.y+", [0.0, 0.99], [0.0, 1.0])]
    return made


def squeezed() -> Config:
    """A foot on rollers, one node of which two oblique planes push both ways."""
    middle = {"middle": {"where": "y < 1e-9 and abs(x - 0.5) < 0.01"}}
    conditions = [moved("block.y-", None, 0.0), pulled("block.y+", 5.0, -5.0)]
    contacts = [
        plane_contact("block.middle", [0.505, 0.0], [1.0, 0.5]),
        plane_contact("block.middle", [0.495, 0.0], [-1.0, 0.5]),
    ]
    return scene_of([square(8, boundaries=middle)], conditions, contacts)


def slender(ratio: float, cells: list[int]) -> Config:
    """A cantilever that bends down onto a plane at a distance below it."""
    beam = box_body("beam", [0.0, 0.0], [1.0, 1.0 / ratio], cells)
    conditions = [moved("beam.x-", 0.0, 0.0), pressed("beam.y+", 2000.0 / ratio**3)]
    return scene_of([beam], conditions, [plane_contact("beam.y-", [0.0, -0.02], [0.0, 1.0])])


def slivers(cells: list[int]) -> Config:
    """The wall with cells a hundred times longer than wide."""
    made = wall()
    made["bodies"][0]["mesh"]["box"]["cells"] = cells
    return made


def contrast(ratio: float) -> Config:
    """A block pressed onto another one that is stiffer, with meshes that do not match."""
    lower = box_body("lower", [0.0, 0.0], [1.0, 1.0], [6, 6], young=1000.0 * ratio)
    upper = box_body("upper", [0.2, 1.0], [0.8, 1.5], [5, 5])
    holds = [moved("lower.y-", 0.0, 0.0), moved("upper.x-", 0.0, None)]
    contacts = [{"on": "upper.y-", "against": "lower.y+"}]
    return scene_of([lower, upper], [*holds, pressed("upper.y+", 10.0)], contacts)


def weak_beside_strong(ratio: float) -> Config:
    """A cantilever bent down onto a plane, and a pulled block that is independent of it.

    Loads and gap of the cantilever are proportional to a ratio; those of the block are not.
    """
    strong = box_body("strong", [0.0, 0.0], [1.0, 1.0], [8, 8])
    weak = box_body("weak", [3.0, 0.0], [7.0, 1.0], [24, 6])
    conditions = [
        moved("strong.y-", 0.0, 0.0),
        pulled("strong.y+", 0.0, 10.0),
        moved("weak.x-", 0.0, 0.0),
        pulled("weak.y+", 0.0, -10.0 * ratio),
    ]
    below = plane_contact("weak.y-", [0.0, -0.1 * ratio], [0.0, 1.0])
    return scene_of([strong, weak], conditions, [below])


def between_walls(contrast: float) -> Config:
    """A block between frictionless walls, pressed onto a softer, broader one."""
    rubber = box_body("rubber", [-1.0, -1.0], [3.0, 0.0], [12, 4], young=1.0, poisson=0.4)
    steel = box_body("steel", [0.0, 0.0], [2.0, 2.0], [10, 10], young=contrast)
    contacts = [
        plane_contact("steel.x-", [0.0, 0.0], [1.0, 0.0]),
        plane_contact("steel.x+", [2.0, 0.0], [-1.0, 0.0]),
        {"on": "steel.y-", "against": "rubber.y+"},
    ]
    conditions = [moved("rubber.y-", 0.0, 0.0), pulled("steel.y+", 0.0, -0.01)]
    return scene_of([rubber, steel], conditions, contacts)


def overlapping_cells() -> Config:
    """The wall from a mesh file in which one node was pulled through its neighbours."""
    made, faces = wall(), {"y-": "y < 1e-9", "y+": "y > 1 - 1e-9", "x+": "x > 1 - 1e-9"}
    made["bodies"][0] |= {
        "mesh": {"file": str(_tangled())},
        "boundaries": {name: {"where": where} for name, where in faces.items()},
    }
    return made


@cache
def _tangled() -> Path:
    """A temporary mesh file of the unit square with one node far from its place."""
    shape = BoxShape((0.0, 0.0), (1.0, 1.0), (8, 8), "triangle").cell_mesh()
    points = shape.points.copy()
    points[np.abs(points - 0.5).max(axis=1).argmin()] = [0.8, 0.6]
    return write_mesh(Path(_directory().name) / "tangled.vtu", replace(shape, points=points))


@cache
def _directory() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="failing-scenes-")


def units(length: float, force: float) -> Config:
    """The wall in other units."""
    made = wall()
    box = made["bodies"][0]["mesh"]["box"]
    box["upper"] = [length, length]
    made["bodies"][0]["material"]["young"] *= force / length**2
    made["conditions"][1]["traction"] = [0.0, -50.0 * force / length**2]
    made["contacts"][0]["obstacle"]["plane"]["point"] = [length, 0.0]
    return made


def far_away(distance: float) -> Config:
    """The wall a million lengths from the origin."""
    made = wall()
    box = made["bodies"][0]["mesh"]["box"]
    box["lower"], box["upper"] = [distance, distance], [distance + 1.0, distance + 1.0]
    made["contacts"][0]["obstacle"]["plane"]["point"] = [distance + 1.0, distance]
    return made


def overlap() -> Config:
    """A body without loads whose obstacle starts inside it."""
    inside = plane_contact("block.x+", [0.99, 0.0], [-1.0, 0.05])
    return scene_of([square(12)], [moved("block.x-", 0.0, 0.0)], [inside])


_PATCH_ENERGY = -0.5 * 10.0 * 10.0 * (1.0 - 0.3**2) / 1000.0

CASES = (
    Case("grazing", grazing, energy=0.0, scale=1000.0 * 0.015625**2),
    Case("weakly active rows", weakly_active, energy=-0.5),
    Case("quadratic elements, uniform pressure", quadratic_patch, energy=_PATCH_ENERGY),
    Case("eccentric load inside the support", lambda: eccentric(1.0)),
    Case("load at the edge of the support", lambda: eccentric(0.76), mild=lambda: eccentric(1.0)),
    Case("load outside the support", lambda: eccentric(0.74), expected=REFUSED),
    Case("pulled off", lambda: floating(0.0, 10.0), expected=REFUSED),
    Case("pushed along a frictionless floor", lambda: floating(1.0, -50.0), expected=REFUSED),
    Case(
        "free to slide",
        lambda: floating(0.0, -50.0),
        energy=-0.5 * 50.0 * 50.0 * (1.0 - 0.3**2) / 1000.0,
    ),
    Case("held and touching at one node", held_and_touching),
    Case("a node in two planes", two_planes),
    Case("the same plane thrice", same_plane_thrice, mild=wall),
    Case("held nodes inside an obstacle", held_inside, expected=REFUSED),
    Case("squeezed between two obstacles", squeezed, expected=REFUSED),
    Case(
        "parts of a few cells",
        lambda: wall(8, cell="triangle"),
        subdomains=24,
        mild=lambda: wall(8),
    ),
    Case("nearly incompressible, ν = 0.4999", lambda: wall(poisson=0.4999), mild=wall),
    Case("stiffness contrast 1e6", lambda: contrast(1e6), subdomains=8, mild=lambda: contrast(1.0)),
    Case(
        "weak body beside a strong one",
        lambda: weak_beside_strong(1e-8),
        subdomains=(4, 2),
        mild=lambda: weak_beside_strong(1.0),
    ),
    Case(
        "soft beside stiff: steel between walls on rubber",
        lambda: between_walls(2e5),
        subdomains=(2, 2),
        mild=lambda: between_walls(1.0),
    ),
    Case("overlapping cells", overlapping_cells, expected=REFUSED),
    Case(
        "slender body 1:100",
        lambda: slender(100.0, [200, 2]),
        subdomains=(10, 1),
        mild=lambda: slender(5.0, [45, 9]),
    ),
    Case("sliver cells 1:100", lambda: slivers([200, 2]), subdomains=(10, 1), mild=wall),
    Case("micrometres and giganewtons", lambda: units(1e-6, 1e9), mild=wall),
    Case("a million lengths from the origin", lambda: far_away(1e6), mild=wall),
    Case("overlap alone", overlap),
)
