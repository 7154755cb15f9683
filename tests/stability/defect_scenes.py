"""Random scenes of the kinds that were once answered wrongly, slowly or not at all.

Each kind is a function of a `Draw`: which cells, sizes, materials, loads and cuts it takes are
random. The kinds take turns, so that any run of seeds has all of them.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests import meshfiles
from tests.scenes import CELLS_2D, CELLS_3D, Config

Subdomains = int | list[int] | None
Vector = list[float | None]


@dataclass(frozen=True)
class Draw:
    """Choices of one kind of scene, and the properties shared by all its bodies.

    Attributes
    ----------
    plane
        What a scene in the plane assumes.
    """

    random: np.random.Generator
    dimension: int
    """2 or 3."""
    cell: str
    """Cell of all boxes."""
    plane: str
    young: float
    """A modulus that the others are multiples of."""
    bodies: list[Config] = field(default_factory=list)
    conditions: list[Config] = field(default_factory=list)
    contacts: list[Config] = field(default_factory=list)

    @property
    def up(self) -> str:
        """The axis that points up: the last one."""
        return "xyz"[self.dimension - 1]

    @property
    def solid(self) -> bool:
        return self.dimension == 3

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def power(self, low: float, high: float) -> float:
        """Ten to a power between these."""
        return float(10.0 ** self.random.uniform(low, high))

    def integer(self, low: int, high: int) -> int:
        """From low to high, both included."""
        return int(self.random.integers(low, high + 1))

    def choice(self, values: Any) -> Any:
        return values[int(self.random.integers(len(values)))]

    def vector(self, along: float, across: float | None = 0.0) -> Vector:
        """`along` upward, `across` otherwise."""
        return [across] * (self.dimension - 1) + [along]

    def box(
        self, name: str, lower: Any, upper: Any, cells: list[int], young: float, **more: Any
    ) -> None:
        """Add a body; one in eight is quadratic unless told otherwise."""
        corners = {"lower": _floats(lower), "upper": _floats(upper)}
        quadratic = self.chance(0.125) and "degree" not in more
        self.bodies.append(
            {
                "name": name,
                "mesh": {"box": {**corners, "cells": cells, "cell": self.cell}},
                "material": {"young": young, "poisson": float(self.random.uniform(0.0, 0.45))},
                **({"degree": 2} if quadratic else {}),
                **more,
            }
        )

    def hold(self, on: str, value: Vector) -> None:
        self.conditions.append({"on": on, "displacement": value})

    def touch(self, on: str, point: list[float], normal: list[float]) -> None:
        self.contacts.append({"on": on, "obstacle": {"plane": {"point": point, "normal": normal}}})

    def against_face(self, name: str, face: str, at: float) -> None:
        """An obstacle that faces a face of a body: the plane where that face's coordinate is at."""
        axis, sign = "xyz".index(face[0]), 1.0 if face[1] == "+" else -1.0
        point, normal = [0.0] * self.dimension, [0.0] * self.dimension
        point[axis], normal[axis] = float(at), -sign
        self.touch(f"{name}.{face}", point, normal)

    def scene(self, title: str, tolerance: float) -> Config:
        return {
            "title": title,
            "dimension": 3 if self.solid else self.plane,
            "bodies": self.bodies,
            "conditions": self.conditions,
            "contacts": self.contacts,
            "solver": {"tolerance": tolerance},
        }

    def cut(self, most: int = 8) -> Subdomains:
        """A random decomposition: `auto`, undecomposed or by the graph, and regular if all bodies
        are boxes."""
        boxes = [body["mesh"]["box"]["cells"] for body in self.bodies]
        kind = self.choice(("auto", "split", "graph", "whole"))
        if kind == "split":
            least = np.minimum(np.min(boxes, axis=0), 4)
            return [self.integer(1, int(n)) for n in least]
        if kind == "graph":
            return len(boxes) + self.integer(0, most)
        return None if kind == "auto" else 1


def weak_beside_strong(draw: Draw) -> Subdomains:
    """A weak body beside a strong one that nothing connects with it; contact on the weak one."""
    d, up, ratio = draw.dimension, draw.up, draw.power(-10.0, -2.0)
    strain = draw.power(-4.0, -2.0)
    most = 4 if draw.solid else 8
    draw.box("strong", [0.0] * d, [1.0] * d, [draw.integer(2, most)] * d, draw.young)
    draw.hold(f"strong.{up}-", draw.vector(0.0))
    pull = draw.choice((1.0, -1.0)) * draw.young * strain
    draw.conditions.append({"on": f"strong.{up}+", "traction": draw.vector(pull)})

    size = draw.random.uniform(0.5, 1.5, d)
    size[0] *= draw.random.uniform(1.0, 4.0)
    cells = [draw.integer(2, 10 if draw.solid else 20), *(draw.integer(2, most) for _ in size[1:])]
    lower = np.array([3.0, *[0.0] * (d - 1)])
    young = draw.young * (draw.power(-3.0, 3.0) if draw.chance(0.3) else 1.0)
    draw.box("weak", lower, lower + size, cells, young)
    move = strain * ratio * float(size[-1])
    kind = draw.choice(("load", "overlap", "displacement"))
    if kind == "displacement":
        draw.hold(f"weak.{up}+", draw.vector(-move))
        gap = draw.choice((0.0, 0.5)) * move
    else:
        draw.hold("weak.x-", draw.vector(0.0))
        gap = -move
    if kind == "load":
        stress = young * strain * ratio
        bends = 1.5 * stress / young * float(size[0] ** 4 / size[-1] ** 3)
        draw.conditions.append({"on": f"weak.{up}+", "traction": draw.vector(-stress)})
        gap = float(draw.choice((0.0, 0.1, 0.5))) * bends
    draw.against_face("weak", f"{up}-", -gap)
    return draw.cut()


def stiff_on_soft(draw: Draw) -> Subdomains:
    """A stiff block between frictionless walls, pressed onto a soft one."""
    d, up, contrast = draw.dimension, draw.up, draw.power(2.0, 5.0)
    strain = draw.power(-4.0, -2.0)
    size = draw.random.uniform(0.5, 2.0, d)
    beyond = draw.random.uniform(0.0, 1.0, d - 1)
    most = 5 if draw.solid else 10
    lower = np.append(-beyond, -draw.random.uniform(0.5, 1.0))
    upper = np.append(size[:-1] + draw.random.uniform(0.0, 1.0, d - 1), 0.0)
    cells = [draw.integer(2, most) for _ in range(d)]
    draw.box("soft", lower, upper, cells, draw.young)
    cells = [draw.integer(2, most) for _ in range(d)]
    draw.box("stiff", [0.0] * d, size, cells, draw.young * contrast)
    draw.hold(f"soft.{up}-", draw.vector(0.0))
    press = draw.random.normal(0.0, 0.2, d) * draw.chance(0.3)
    press[-1] = -1.0
    press *= strain * draw.young
    draw.conditions.append({"on": f"stiff.{up}+", "traction": _floats(press)})
    for axis in range(d - 1):
        for side, at in (("-", 0.0), ("+", float(size[axis]))):
            draw.against_face("stiff", f"{'xyz'[axis]}{side}", at)
    draw.contacts.append({"on": f"stiff.{up}-", "against": f"soft.{up}+"})
    return draw.cut(6)


def lifted(draw: Draw) -> Subdomains:
    """A long strip or a thin plate on a floor, one end or side lifted against its weight."""
    d, up, slender = draw.dimension, draw.up, draw.power(np.log10(20.0), np.log10(200.0))
    length = np.full(d, slender)
    length[-1] = 1.0
    if draw.solid:
        length[1] *= draw.choice((1.0, 0.5))
        n = draw.integer(8, 20)
        cells = [n, max(2, round(n * length[1] / length[0])), draw.integer(1, 2 if n < 16 else 1)]
    else:
        high = draw.integer(1, 4)
        cells = [draw.integer(40, 1400 // (high + 1)), high]
    draw.box("strip", [0.0] * d, length, cells, draw.young, degree=1)
    rise, lifts = draw.power(-2.0, 0.0), slender * draw.random.uniform(0.1, 0.7)
    weight = 2.0 * draw.young * rise / lifts**4  # q = 24 E I w / a⁴
    draw.conditions.append({"in": "strip", "force": draw.vector(-weight)})
    side = draw.choice(("x-", "x+", "y+") if draw.solid else ("x-", "x+"))
    draw.hold(f"strip.{side}", draw.vector(rise, 0.0 if draw.chance(0.6) else None))
    draw.against_face("strip", f"{up}-", 0.0)
    return draw.choice((None, 1, draw.integer(2, 24), [draw.integer(2, 8), *[1] * (d - 1)]))


def load_on_touching_face(draw: Draw) -> Subdomains:
    """A load on the face that touches; most often nothing moves."""
    d, up = draw.dimension, draw.up
    size = draw.random.uniform(0.5, 3.0, d)
    most = 4 if draw.solid else 8
    draw.box("block", [0.0] * d, size, [draw.integer(1, most) for _ in size], draw.young)
    held = draw.choice(("x+", f"{up}+", "x-"))
    draw.hold(f"block.{held}", draw.vector(0.0, 0.0 if draw.chance(0.7) else None))
    stress = draw.young * draw.power(-8.0, -2.0)
    if draw.chance(0.5):
        load: Config = {"traction": draw.vector(-stress)}
    else:  # away from the floor: nothing presses then
        load = {"pressure": stress * draw.choice((-1.0, -1.0, 1.0))}
    draw.conditions.append({"on": f"block.{up}-", **load})
    if draw.chance(0.2):  # next to nothing elsewhere
        faint = stress * draw.power(-8.0, 0.0)
        draw.conditions.append({"on": f"block.{up}+", "pressure": faint})
    draw.against_face("block", f"{up}-", 0.0)
    return draw.cut()


def moved_far(draw: Draw) -> Subdomains:
    """A body that is moved far by its displacement condition and squeezed a little."""
    d, up = draw.dimension, draw.up
    size = draw.random.uniform(0.5, 2.0, d)
    most = 4 if draw.solid else 8
    draw.box("block", [0.0] * d, size, [draw.integer(1, most) for _ in size], draw.young)
    motion = draw.random.normal(size=d) * draw.power(-1.0, 2.0)
    if draw.chance(0.5):
        motion[-1] *= draw.choice((0.0, 1e-3))
    squeeze = float(np.abs(motion).max()) * draw.power(-9.0, -3.0)
    draw.hold(f"block.{up}-", list(_floats(motion)))
    draw.against_face("block", f"{up}+", size[-1] + motion[-1] - squeeze)
    if draw.chance(0.3):
        stress = draw.young * squeeze / float(size[-1])
        draw.conditions.append(
            {"in": "block", "force": _floats(draw.random.normal(size=d) * stress)}
        )
    return draw.cut()


def several_contacts(draw: Draw) -> Subdomains:
    """Several contacts at one node: in a corner, on boundaries that overlap, in oblique planes."""
    return draw.choice((_corner, _overlapping_boundaries, _wedge))(draw)


def _corner(draw: Draw) -> Subdomains:
    """Pressed down between a floor and walls."""
    d, up, strain = draw.dimension, draw.up, draw.power(-4.0, -1.5)
    size = draw.random.uniform(0.5, 2.0, d)
    most = 4 if draw.solid else 8
    draw.box("block", [0.0] * d, size, [draw.integer(1, most) for _ in size], draw.young)
    draw.conditions.append({"on": f"block.{up}+", "pressure": draw.young * strain})
    sides = [(axis, "-") for axis in range(d)]
    sides += [(axis, "+") for axis in range(d - 1) if draw.chance(0.8)]
    for axis, side in sides:
        gap = float(draw.choice((0.0, 0.0, 0.2, -0.2)) * strain * size[axis])
        at = size[axis] + gap if side == "+" else -gap
        draw.against_face("block", f"{'xyz'[axis]}{side}", at)
    return draw.cut()


def _overlapping_boundaries(draw: Draw) -> Subdomains:
    """Two boundaries of one face that share nodes, on the same floor."""
    d, up, strain = draw.dimension, draw.up, draw.power(-4.0, -1.5)
    most = 4 if draw.solid else 8
    cells = [2 * draw.integer(1, most // 2) for _ in range(d)]
    ends = (0.5, 0.5) if draw.chance(0.5) else (0.5 - 1.0 / cells[0], 0.5 + 1.0 / cells[0])
    draw.box(
        "block", [0.0] * d, [1.0] * d, cells, draw.young,
        boundaries={
            "left": {"where": f"{up} < 1e-9 and x < {ends[1]} + 1e-9"},
            "right": {"where": f"{up} < 1e-9 and x > {ends[0]} - 1e-9"},
        },
    )  # fmt: skip
    draw.hold("block.x-", [0.0] + [None] * (d - 1))
    draw.conditions.append({"on": f"block.{up}+", "pressure": draw.young * strain})
    gap = float(draw.choice((0.0, 0.5))) * strain
    for name, further in (("left", 0.0), ("right", float(draw.choice((0.0, gap))))):
        draw.touch(f"block.{name}", draw.vector(-gap - further), draw.vector(1.0))
    return draw.cut()


def _wedge(draw: Draw) -> Subdomains:
    """An edge that lies in two oblique planes."""
    d, up, strain = draw.dimension, draw.up, draw.power(-4.0, -1.5)
    most = 4 if draw.solid else 8
    draw.box("block", [0.0] * d, [1.0] * d, [draw.integer(1, most) for _ in range(d)], draw.young)
    if draw.chance(0.7):
        draw.hold(f"block.{up}+", draw.vector(0.0))
    push = -draw.young * strain * draw.random.uniform(0.2, 1.0, d)
    if draw.solid:
        push[1] = 0.0
    draw.conditions.append({"in": "block", "force": _floats(push)})
    for axis, face in ((0, "x-"), (d - 1, f"{up}-")):
        normal = [0.0] * d
        normal[0], normal[-1] = draw.random.uniform(0.0, 0.4, 2)
        normal[axis] = 1.0
        draw.touch(f"block.{face}", [0.0] * d, _floats(normal))
    return draw.cut()


def cantilever(draw: Draw) -> Subdomains:
    """A clamped slender cantilever in many subdomains, without contact."""
    d, slender = draw.dimension, draw.power(1.0, 2.0)
    if draw.solid:
        size, cells = [slender, 1.0, 1.0], [draw.integer(10, 60), 2, 2]
    else:
        size, high = [slender, 1.0], draw.integer(2, 24)
        cells = [draw.integer(10, 1400 // (high + 1)), high]
    draw.box("beam", [0.0] * d, size, cells, draw.young, degree=1)
    draw.hold(f"beam.{draw.choice(('x-', 'x+'))}", draw.vector(0.0))
    load = draw.young * draw.power(-3.0, -1.0) / slender**3
    draw.conditions.append({"on": f"beam.{draw.up}+", "pressure": load})
    split = [draw.integer(4, min(16, cells[0])), *(draw.integer(1, n) for n in cells[1:])]
    split[1] = min(split[1], 4)
    return draw.choice((draw.integer(6, 40), split))


def overlapping_cells(draw: Draw) -> Subdomains:
    """A mesh file whose cells overlap."""
    path = _mesh_file(draw.cell, int(draw.random.integers(1000)))
    everywhere = {"where": "x < 1e30"}
    draw.bodies.append(
        {
            "name": "block",
            "mesh": {"file": path},
            "material": {"young": draw.young, "poisson": 0.3},
            "boundaries": {"some": {"where": "x < 0"} if draw.chance(0.5) else everywhere},
        }
    )
    draw.hold("block.some", draw.vector(0.0))
    draw.conditions.append({"in": "block", "force": draw.vector(-draw.young)})
    return draw.choice((None, 1, 3))


KINDS: tuple[Callable[[Draw], Subdomains], ...] = (
    weak_beside_strong,
    stiff_on_soft,
    lifted,
    load_on_touching_face,
    moved_far,
    several_contacts,
    cantilever,
    overlapping_cells,
)

EVERY = 4
"""One in so many seeds has a scene of these kinds: the last one of them."""


def kind_of(seed: int) -> Callable[[Draw], Subdomains] | None:
    """The kind of a seed's scene; None of other seeds."""
    return KINDS[seed // EVERY % len(KINDS)] if seed % EVERY == EVERY - 1 else None


def defect_scene(seed: int) -> tuple[Config, Subdomains]:
    """The scene of a seed that has a kind, and into what to split it."""
    kind = kind_of(seed)
    assert kind is not None
    random = np.random.default_rng([20_201_122, seed])
    dimension = int(random.integers(2, 4))
    cells = CELLS_3D if dimension == 3 else CELLS_2D
    plane = ("plane_strain", "plane_stress")[int(random.integers(2))]
    young = float(10.0 ** random.uniform(0.0, 6.0))
    draw = Draw(random, dimension, cells[int(random.integers(2))], plane, young)
    subdomains = kind(draw)
    tolerance = draw.choice((1e-8, 1e-8, 1e-8, 1e-6, 1e-7))
    if kind is cantilever:
        tolerance = draw.power(-12.0, -10.0)
    elif tolerance == 1e-7:
        tolerance = "auto"
    return draw.scene(f"{kind.__name__.replace('_', ' ')} {seed}", tolerance), subdomains


@cache
def _mesh_file(cell: str, seed: int) -> str:
    """A mesh file whose cells overlap, kept while Python runs."""
    path = Path(_directory().name) / f"{cell}-{seed}.vtu"
    return str(meshfiles.write(meshfiles.overlapping(cell, seed), path, None))


@cache
def _directory() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="overlapping-cells-")


def _floats(vector: Any) -> list[float]:
    return [float(v) for v in vector]
