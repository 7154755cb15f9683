"""Random scenes, as a user might type them: any seed gives one, the same one every time.

What is drawn: dimension, cells, bodies (also slender ones, slivers, far from the origin, in any
unit, one on another with meshes that do not match, of distorted cells from a mesh file), degree 1
and 2, mean dilatation, materials to a contrast of 1e6 (in one body, too) and nearly
incompressible, conditions that hold a body, hold it in part or not at all, loads, obstacles that
are near, touched, overlapped, tilted or curved, tolerances (`auto`, too), expansions, and
partitions. Many of these scenes have no equilibrium; that is part of the question. Every fourth
seed has a scene of `defect_scenes` instead.
"""

import itertools
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests import meshfiles
from tests.scenes import CELLS_2D, CELLS_3D, Config
from tests.stability.defect_scenes import Subdomains, defect_scene, kind_of

CONTRAST = 1e6
"""Largest quotient of two bodies' Young's moduli."""

SLENDER = 100.0
"""Largest quotient of two edges of a body."""

SLIVER = 100.0
"""Largest quotient of two edges of a cell (about)."""


def random_scene(seed: int) -> tuple[Config, Subdomains]:
    """A configuration, and into what to split it; every fourth is of `defect_scenes`."""
    return _Draw(seed).scene() if kind_of(seed) is None else defect_scene(seed)


class _Draw:
    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.random = np.random.default_rng([20_201_121, seed])
        self.dimension = int(self.random.integers(2, 4))
        self.unit = 10.0 ** self.random.uniform(-3.0, 3.0) if self.chance(0.3) else 1.0
        self.young = 10.0 ** self.random.uniform(0.0, 6.0)
        self.strain = 10.0 ** self.random.uniform(-4.0, -1.5)

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def choice(self, values: Any, p: list[float] | None = None) -> Any:
        return values[int(self.random.choice(len(values), p=p))]

    def scene(self) -> tuple[Config, Subdomains]:
        cell = self.choice(CELLS_3D if self.dimension == 3 else CELLS_2D)
        self.plane = self.choice(("plane_strain", "plane_stress"))
        made: Config = {
            "title": f"random scene {self.seed}",
            "dimension": 3 if self.dimension == 3 else self.plane,
            "bodies": [],
            "conditions": [],
            "contacts": [],
            "solver": {"tolerance": 1e-8},
        }
        if self.chance(0.25):
            self.stack(made, cell)
        else:
            for number in range(self.choice((1, 1, 2, 3))):
                self.body(made, number, cell)
            if self.chance(0.1):
                made["contacts"] += [dict(c) for c in made["contacts"]]  # every obstacle twice
        self.solver(made)
        return made, self.subdomains(made)

    def solver(self, made: Config) -> None:
        """Mostly the defaults."""
        if self.chance(0.15):
            made["solver"]["tolerance"] = "auto"
        if self.chance(0.15):
            made["solver"]["expansion"] = self.choice(("projcg", "fixed", "gfgr-opt"))

    def stack(self, made: Config, cell: str) -> None:
        """A block pressed onto another one: meshes that do not match, any contrast."""
        d, axis = self.dimension, "xyz"[self.dimension - 1]
        size = self.random.uniform(0.5, 1.5, (2, d))
        gap = float(self.choice((0.0, 0.0, 1.0, -0.3)) * self.strain * size[0, -1])
        lower = np.zeros((2, d))
        lower[1, :-1] = self.random.uniform(-0.3, 0.3, d - 1)
        lower[1, -1] = size[0, -1] + gap
        most = 6 if d == 2 else 3
        for number in range(2):
            stiff = self.young * CONTRAST ** self.random.uniform(-0.5, 0.5)
            cells = [int(n) for n in self.random.integers(1, most + 1, d)]
            low, high = lower[number] * self.unit, (lower[number] + size[number]) * self.unit
            made["bodies"].append(self.meshed(f"b{number}", low, high, cells, cell, stiff))
        softest = min(min(moduli(b)) for b in made["bodies"])
        made["conditions"] += [
            {"on": f"b0.{axis}-", "displacement": [0.0] * d},
            {"on": f"b1.{axis}+", "pressure": float(softest * self.strain)},
        ]
        for side in range(d - 1) if self.chance(0.7) else ():  # else free to slide, or to tip over
            value: list[float | None] = [None] * d
            value[side] = 0.0
            made["conditions"].append({"on": f"b1.{'xyz'[side]}-", "displacement": value})
        sides = [f"b1.{axis}-", f"b0.{axis}+"]
        first = int(self.random.integers(2))
        made["contacts"].append({"on": sides[first], "against": sides[1 - first]})

    def material(self, stiff: float) -> dict[str, float]:
        """A material with the given modulus; one in ten is nearly incompressible."""
        poisson = 0.4999 if self.chance(0.1) else float(self.random.uniform(0.0, 0.49))
        return {"young": float(stiff), "poisson": poisson}

    def meshed(
        self, name: str, lower: np.ndarray, upper: np.ndarray, cells: list[int], cell: str,
        stiff: float,
    ) -> Config:  # fmt: skip
        """A body between two corners: a box, or the same of distorted cells from a file.

        One in eight is quadratic, one in four of the others has mean dilatation where it may.
        """
        body: Config = {"name": name}
        if self.chance(0.2):
            n = int(self.choice((2, 4) if self.dimension == 2 else (2,)))
            seed = int(self.random.integers(3))
            body["mesh"] = {"file": _mesh_file(cell, n, seed, tuple(lower), tuple(upper))}
            body["material"] = self.material(stiff)
            if self.chance(0.5):
                other = stiff * CONTRAST ** self.random.uniform(-0.5, 0.5)
                body["material"] = {"soft": body["material"], "hard": self.material(other)}
        else:
            corners = {"lower": _floats(lower), "upper": _floats(upper)}
            body["mesh"] = {"box": {**corners, "cells": cells, "cell": cell}}
            body["material"] = self.material(stiff)
        may = cell == "hexahedron" or (cell == "quadrilateral" and self.plane == "plane_strain")
        if self.chance(0.125):
            body["degree"] = 2
        elif self.chance(0.25) and may:
            body["mean_dilatation"] = True
        return body

    def body(self, made: Config, number: int, cell: str) -> None:
        d, name = self.dimension, f"b{number}"
        size = self.random.uniform(0.3, 2.0, d)
        limit = 6 if d == 2 else 4
        cells = self.random.integers(1, limit + 1, d)
        if self.chance(0.15):  # slender
            axis, ratio = int(self.random.integers(d)), 10.0 ** self.random.uniform(1.0, 2.0)
            size[:] = self.random.uniform(0.5, 1.0, d) * min(ratio, SLENDER) ** -1.0
            size[axis], cells[:] = 1.0, np.minimum(cells, 2)
            cells[axis] = int(self.random.integers(5, 40 if d == 2 else 20))
        elif self.chance(0.1):  # slivers
            axis = int(self.random.integers(d))
            size[axis] = size.max() * SLIVER * 10.0 ** self.random.uniform(-1.0, 0.0)
        lower = np.zeros(d)
        lower[0] = 3.0 * number
        if self.chance(0.1):
            lower += 1e3 * self.random.uniform(-1.0, 1.0, d)
        lower, size = lower * self.unit, size * self.unit
        upper = lower + size
        stiff = self.young * CONTRAST ** self.random.uniform(-0.5, 0.5)
        made["bodies"].append(self.meshed(name, lower, upper, [int(n) for n in cells], cell, stiff))
        stiff = min(moduli(made["bodies"][-1]))
        faces = [f"{axis}{side}" for axis in "xyz"[:d] for side in "-+"]
        faces = [faces[i] for i in self.random.permutation(len(faces))]
        held = self.choice(("all", "some", "none"), [0.6, 0.25, 0.15])
        # rarely the face that is held: its nodes are in the obstacle's way, or not at all
        touching = [self.choice(faces if self.chance(0.1) else faces[1:]) for _ in range(3)]
        touching = touching[: int(self.random.integers(0, 4))]
        seated = held != "all" and self.chance(0.7)
        if seated:  # in a corner, pressed into it
            touching = [f"{axis}{self.choice('-+')}" for axis in "xyz"[:d]]
        self.hold(made, name, faces, held, size)
        self.load(made, name, faces, size, stiff, touching if seated else None)
        for face in touching:
            made["contacts"].append(
                {"on": f"{name}.{face}", "obstacle": self.obstacle(face, lower, upper)}
            )

    def hold(self, made: Config, name: str, faces: list[str], held: str, size: np.ndarray) -> None:
        d = self.dimension
        value: list[float | None]
        if held == "all":
            moved = self.random.normal(size=d) * self.strain * size * self.chance(0.3)
            made["conditions"].append({"on": f"{name}.{faces[0]}", "displacement": _floats(moved)})
        elif held == "some":
            value = [0.0 if self.chance(0.5) else None for _ in range(d)]
            if all(v is None for v in value):
                value[0] = 0.0
            made["conditions"].append({"on": f"{name}.{faces[0]}", "displacement": value})
            if self.chance(0.3):  # a second roller, perhaps over the same nodes
                value = [None] * d
                value[int(self.random.integers(d))] = 0.0
                made["conditions"].append({"on": f"{name}.{faces[1]}", "displacement": value})

    def load(
        self,
        made: Config,
        name: str,
        faces: list[str],
        size: np.ndarray,
        stiff: float,
        seats: list[str] | None,
    ) -> None:
        d, stress = self.dimension, stiff * self.strain
        force = self.random.normal(size=d) * stress / size.max()
        if seats is not None:
            towards = np.array([1.0 if face[1] == "+" else -1.0 for face in seats])
            force = towards * self.random.uniform(0.2, 1.0, d) * stress / size
            made["conditions"].append({"in": name, "force": _floats(force)})
            return
        traction = self.random.normal(size=d) * stress
        made["conditions"].append({"on": f"{name}.{faces[1]}", "traction": _floats(traction)})
        if self.chance(0.3):
            made["conditions"].append({"in": name, "force": _floats(force)})
        if self.chance(0.2):
            pressure = float(self.random.normal() * stress)
            made["conditions"].append({"on": f"{name}.{faces[2]}", "pressure": pressure})

    def obstacle(self, face: str, lower: np.ndarray, upper: np.ndarray) -> Config:
        """One that the face touches, nearly touches, overlaps or may never reach."""
        d, axis = self.dimension, "xyz".index(face[0])
        outward = np.zeros(d)
        outward[axis] = 1.0 if face[1] == "+" else -1.0
        center = 0.5 * (lower + upper)
        center[axis] = upper[axis] if face[1] == "+" else lower[axis]
        corners = np.array(list(itertools.product(*zip(lower, upper, strict=True))))
        extent = float(np.max(upper - lower))
        share = self.choice((0.0, 1.0, -0.3), [0.45, 0.4, 0.15])
        gap = float(share * self.strain * (upper - lower)[axis])
        kind = self.choice(("plane", "tilted", "sphere", "hollow", "cylinder"))
        if kind == "cylinder" and d == 2:
            kind = "plane"
        if kind in ("plane", "tilted"):
            if kind == "tilted":
                tilt = self.choice((0.3, 1e-3)) * self.random.normal(size=d)
                outward = outward + tilt
                outward /= np.linalg.norm(outward)
            reach = float((corners @ outward).max())
            point = outward * (reach + gap)
            return {"plane": {"point": _floats(point), "normal": _floats(-outward)}}
        radius = float(self.random.uniform(1.0, 4.0)) * extent
        if kind == "sphere":
            middle = center + outward * (radius + gap)
            return {"sphere": {"center": _floats(middle), "radius": radius}}
        if kind == "cylinder":
            along = np.zeros(3)
            along[(axis + 1) % 3] = 1.0
            along += 0.1 * self.random.normal(size=3) * (along == 0.0)
            point = center + outward * (radius + gap)
            return {"cylinder": {"point": _floats(point), "axis": _floats(along), "radius": radius}}
        middle = center - outward * radius
        around = float(np.linalg.norm(corners - middle, axis=1).max())
        return {"sphere": {"center": _floats(middle), "radius": around + gap, "hollow": True}}

    def subdomains(self, made: Config) -> Subdomains:
        boxes = [b["mesh"]["box"]["cells"] for b in made["bodies"] if "box" in b["mesh"]]
        least = np.min([*boxes, np.full(self.dimension, 100 if boxes else 2)], axis=0)
        if len(boxes) < len(made["bodies"]):
            least = np.minimum(least, 2)
        kind = self.choice(("auto", "split", "graph", "whole"))
        if kind == "split":
            return [int(self.random.integers(1, n + 1)) for n in least]
        if kind == "graph":
            return len(made["bodies"]) + int(self.random.integers(0, 4))
        return None if kind == "auto" else 1


@cache
def _mesh_file(
    cell: str, n: int, seed: int, lower: tuple[float, ...], upper: tuple[float, ...]
) -> str:
    """A mesh file of a block of distorted cells between two corners, kept while Python runs."""
    mesh = meshfiles.block(cell, n, seed=seed)
    d = len(lower)
    mesh.points[:, :d] = np.array(lower) + mesh.points[:, :d] * np.subtract(upper, lower)
    path = Path(_directory().name) / f"{_mesh_file.cache_info().misses}.msh"
    return str(meshfiles.write(mesh, path))


@cache
def _directory() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="random-scenes-")


def moduli(body: Config) -> list[float]:
    """Young's moduli of a body."""
    material = body["material"]
    return [m["young"] for m in ([material] if "young" in material else material.values())]


def _floats(vector: np.ndarray) -> list[float]:
    return [float(v) for v in vector]
