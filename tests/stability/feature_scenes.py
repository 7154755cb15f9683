"""Random scenes with rigid bodies, tied boundaries, heat and interference, by themselves and mixed.

Any seed gives one scene, the same one every time. A block stands on a foundation, wholly or partly
held. On it may stand another one, tied or in contact, of another mesh, degree and material; beside
it may be an obstacle with an interference. Bodies may be warm. Rigid bodies, of one shape or two,
press on the top or from the side: moved, loaded by a force and a moment, held in some components
and free in others, or not held at all. Sides may be tied to a rigid body. Many of these scenes have
no equilibrium; that is part of the question.
"""

from typing import Any

import numpy as np

from tests.scenes import CELLS_2D, CELLS_3D, Config

Subdomains = int | list[int] | None

WITH_RIGID_TIES = 110_000
"""First seed of scenes with boundaries tied to rigid bodies; those of smaller seeds have none."""


def feature_scene(seed: int) -> tuple[Config, Subdomains]:
    """A configuration, and into what to split it."""
    return _Draw(seed).scene()


class _Draw:
    def __init__(self, seed: int) -> None:
        self.seed, self.random = seed, np.random.default_rng([24, seed])
        self.d = int(self.random.integers(2, 4))
        self.cell = self.choice(CELLS_3D if self.d == 3 else CELLS_2D)
        self.plane = self.choice(("plane_strain", "plane_stress"))
        self.unit = 10.0 ** self.random.uniform(-3.0, 3.0) if self.chance(0.3) else 1.0
        self.young = 10.0 ** self.random.uniform(0.0, 6.0)
        self.strain = 10.0 ** self.random.uniform(-4.0, -2.0)
        self.up = "xyz"[self.d - 1]
        self.made: Config = {
            "title": f"features {seed}", "dimension": 3 if self.d == 3 else self.plane,
            "bodies": [], "conditions": [], "contacts": [], "solver": {"tolerance": 1e-8},
        }  # fmt: skip

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def choice(self, values: Any) -> Any:
        return values[int(self.random.integers(len(values)))]

    def scene(self) -> tuple[Config, Subdomains]:
        self.block("b0", np.zeros(self.d), 4)
        self.hold_base()
        top = "b0"
        if self.chance(0.6):
            top = "b1"
            self.stacked()
        if self.chance(0.4):
            self.beside(top)
        rigid = self.chance(0.8)
        if rigid:
            self.press(top, "r0")
            if self.chance(0.25):
                self.press("b0", "r1", side=True)
        warm = [b["name"] for b in self.made["bodies"] if "mesh" in b and self.chance(0.4)]
        for name in warm:
            self.heat(name)
        if self.chance(0.3) or not (rigid or warm):
            pressure = self.softest(top) * self.strain
            self.made["conditions"].append({"on": f"{top}.{self.up}+", "pressure": pressure})
        if self.seed >= WITH_RIGID_TIES and self.chance(0.7):
            self.tie_to_rigid(top, rigid)
        if self.chance(0.15):
            self.made["solver"]["method"] = "smalbe"
        return self.made, self.subdomains()

    def subdomains(self) -> Subdomains:
        boxes = [b["mesh"]["box"]["cells"] for b in self.made["bodies"] if "mesh" in b]
        kind = self.choice(("auto", "split", "graph", "whole"))
        if kind == "split":
            return [int(self.random.integers(1, n + 1)) for n in np.min(boxes, axis=0)]
        if kind == "graph":
            most = sum(int(np.prod(cells)) for cells in boxes)
            return min(most, len(boxes) + int(self.random.integers(0, 4)))
        return None if kind == "auto" else 1

    def softest(self, name: str) -> float:
        body = next(b for b in self.made["bodies"] if b["name"] == name)
        return float(body["material"]["young"])

    def block(self, name: str, lower: np.ndarray, most: int) -> None:
        """A box of a few cells, quadratic one time in four."""
        size = self.random.uniform(0.6, 1.4, self.d)
        cell = self.choice(CELLS_3D if self.d == 3 else CELLS_2D)
        degree = 2 if self.chance(0.25) else 1
        most = most if self.d == 2 else max(2, most - 1 - degree)
        cells = [int(n) for n in self.random.integers(1, most + 1, self.d)]
        corners = {"lower": lower * self.unit, "upper": (lower + size) * self.unit}
        self.made["bodies"].append({
            "name": name,
            "mesh": {"box": {**{k: _floats(v) for k, v in corners.items()}, "cells": cells,
                             "cell": cell}},
            "material": {"young": self.young * 10.0 ** float(self.random.uniform(-1.0, 1.0)),
                         "poisson": float(self.random.uniform(0.0, 0.45))},
            "degree": degree,
        })  # fmt: skip

    def corners(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        box = next(b for b in self.made["bodies"] if b["name"] == name)["mesh"]["box"]
        return np.array(box["lower"]) / self.unit, np.array(box["upper"]) / self.unit

    def hold_base(self) -> None:
        value: list[float | None] = [0.0] * self.d
        if self.chance(0.2):  # free along the foundation
            value[0] = None
        self.made["conditions"].append({"on": f"b0.{self.up}-", "displacement": value})

    def stacked(self) -> None:
        """A block on the first one: tied, or in contact with or without interference."""
        lower, upper = self.corners("b0")
        at = lower + self.random.uniform(-0.2, 0.2, self.d)
        at[-1] = upper[-1]
        self.block("b1", at, 4)
        sides = [f"b1.{self.up}-", f"b0.{self.up}+"]
        first = int(self.random.integers(2))
        contact: Config = {"on": sides[first], "against": sides[1 - first]}
        if self.chance(0.6):
            contact["tied"] = True
        else:
            if self.chance(0.5):
                contact["interference"] = float(self.strain * self.unit * self.choice((1.0, -0.5)))
            for side in range(self.d - 1):
                value: list[float | None] = [None] * self.d
                value[side] = 0.0
                self.made["conditions"].append({"on": f"b1.{'xyz'[side]}-", "displacement": value})
        self.made["contacts"].append(contact)

    def beside(self, name: str) -> None:
        """A wall beside a block, with an interference or a clearance."""
        upper = self.corners(name)[1]
        point = np.zeros(self.d)
        point[0] = upper[0] * self.unit
        normal = [-1.0] + [0.0] * (self.d - 1)
        amount = float(self.strain * self.unit * self.choice((1.0, -1.0, 0.3)))
        self.made["contacts"].append({
            "on": f"{name}.x+", "obstacle": {"plane": {"point": _floats(point), "normal": normal}},
            "interference": amount,
        })  # fmt: skip

    def heat(self, name: str) -> None:
        body = next(b for b in self.made["bodies"] if b["name"] == name)
        body["material"]["expansion"] = 1e-5
        rise = float(self.random.normal()) * self.strain / 1e-5
        slope = float(self.random.normal()) * self.strain / 1e-5 / self.unit
        text = f"{rise!r} + {slope!r} * {self.choice('xy')}"
        value = text if self.chance(0.5) else rise
        self.made["conditions"].append({"in": name, "temperature": value})

    def press(self, name: str, rigid: str, side: bool = False) -> None:
        """A rigid body at the top of a block, or at its left side."""
        lower, upper = self.corners(name)
        axis = 0 if side else self.d - 1
        out = np.zeros(self.d)
        out[axis] = -1.0 if side else 1.0
        middle = 0.5 * (lower + upper) + 0.2 * self.random.uniform(-1, 1, self.d)
        middle[axis] = lower[axis] if side else upper[axis]
        size = float((upper - lower)[axis])
        gap = float(self.choice((0.0, 0.0, 1.0, -1.0))) * self.strain * size
        shapes = [self.shape(middle, out, axis, gap)]
        if self.chance(0.2):
            shapes.append(self.shape(middle, out, axis, gap))
        self.made["bodies"].append({"name": rigid, "rigid": shapes if len(shapes) > 1 else
                                    shapes[0]})  # fmt: skip
        face = "x-" if side else f"{self.up}+"
        self.made["contacts"].append({"on": f"{name}.{face}", "against": rigid})
        self.drive(name, rigid, out, axis, size)

    def drive(self, name: str, rigid: str, out: np.ndarray, axis: int, size: float) -> None:
        """Hold, move or load it."""
        turns = 3 if self.d == 3 else 1
        along = self.chance(0.1)  # free to slide off, too
        free = [along and self.chance(0.5) for _ in range(self.d)]
        free += [self.chance(0.4) for _ in range(turns)]
        moved = self.chance(0.3)
        free[axis] = not moved
        values: list[float | None] = [None if f else 0.0 for f in free]
        if moved:
            values[axis] = float(-out[axis] * 2.0 * self.strain * size * self.unit)
        turn: Any = values[self.d :]
        if any(v is not None for v in values):
            self.made["conditions"].append({
                "in": rigid, "displacement": values[: self.d],
                "rotation": turn if self.d == 3 else turn[0],
            })  # fmt: skip
        if moved and self.chance(0.7):
            return
        area = self.unit ** (self.d - 1)
        force = -out * self.softest(name) * self.strain * area * self.random.uniform(0.2, 1.0)
        load: Config = {"in": rigid, "total_force": _floats(force)}
        if self.chance(0.3):
            about = self.random.normal(size=turns) * 0.05 * np.abs(force).max() * self.unit
            load["total_moment"] = _floats(about) if self.d == 3 else float(about[0])
        self.made["conditions"].append(load)

    def tie_to_rigid(self, top: str, pressed: bool) -> None:
        """Sides of one block or of two tied to one rigid body, perhaps the one that presses."""
        name = top if self.chance(0.7) else "b0"
        faces = ["x-", "x+", *([f"{self.up}+"] if name == top else [])]
        face = self.choice(faces)
        sides = [f"{name}.{face}"]
        if self.chance(0.25):
            sides.append(f"{'b0' if name != 'b0' else top}.{self.choice(('x-', 'x+'))}")
        pressing = pressed and self.chance(0.25) and f"{top}.{self.up}+" not in sides
        rigid = "r0" if pressing else "t0"
        for side in dict.fromkeys(sides):
            self.made["contacts"].append({"on": side, "against": rigid, "tied": True})
        if rigid == "r0":
            return
        axis, out = "xyz".index(face[0]), np.zeros(self.d)
        out[axis] = 1.0 if face[1] == "+" else -1.0
        lower, upper = self.corners(name)
        middle = 0.5 * (lower + upper) + 0.2 * self.random.uniform(-1, 1, self.d)
        shape = self.shape(middle, out, axis, 0.0)
        self.made["bodies"].append({"name": rigid, "rigid": shape})
        if self.chance(0.6):
            self.drive(name, rigid, out, axis, float((upper - lower)[axis]))
            return
        size = self.softest(name) * self.strain * self.unit ** (self.d - 1)
        load: Config = {"in": rigid, "total_force": _floats(size * self.random.normal(size=self.d))}
        if self.chance(0.5):
            load["at"] = _floats(middle * self.unit)
        self.made["conditions"].append(load)

    def shape(self, middle: np.ndarray, out: np.ndarray, axis: int, gap: float) -> Config:
        kind = self.choice(("plane", "sphere", "cylinder"))
        if kind == "cylinder" and self.d == 2:
            kind = "sphere"
        if kind == "plane":
            normal = -out + (0.01 * self.random.normal(size=self.d) if self.chance(0.5) else 0.0)
            point = (middle + out * gap) * self.unit
            return {"plane": {"point": _floats(point), "normal": _floats(normal)}}
        radius = float(self.random.uniform(0.5, 3.0))
        center = _floats((middle + out * (radius + gap)) * self.unit)
        if kind == "sphere":
            return {"sphere": {"center": center, "radius": radius * self.unit}}
        along = np.roll(out, 1) + 0.1 * self.random.normal(size=3) * (out == 0.0)
        return {"cylinder": {"point": center, "axis": _floats(along),
                             "radius": radius * self.unit}}  # fmt: skip


def _floats(vector: np.ndarray) -> list[float]:
    return [float(v) for v in vector]
