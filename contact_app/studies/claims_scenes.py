"""Random scenes on which `contact_app.studies.claims` compares claims of accuracy with errors.

Any seed gives one scene, always the same. A scene is one box, plane or spatial, of any cell type,
that begins with 1 to 8 cells along an edge (3 in space), often unequal ones. One body in three is
slender (up to 1:30 in the plane, 1:10 in space); one in three is nearly incompressible (Poisson's
ratio of 0.49 to 0.4999). It is held on a whole side, on a part of a side, or by two or three
frictionless sides; it carries tractions and pressures on whole sides and on parts of sides, and
body forces; most bodies have obstacles: planes, tilted planes, discs, spheres and cylinders. In two
scenes of three the file names no degree. Every support is at least a facet of the mesh, so that
all energies are finite, and no scene can move as a rigid body.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from meshes.arrays import Array

Config = dict[str, Any]

YOUNG = 1000.0
STRAIN = 1e-3
"""Approximate strain under the loads: small, so that bodies stay linear; slender bodies bend
more."""


@dataclass(frozen=True)
class ClaimScene:
    """A scene of the study."""

    seed: int
    config: Config
    """The scene as a user would write it, without `accuracy`."""
    breaks: tuple[tuple[float, ...], ...]
    """Coordinates by axis where a load, a support or a contact begins or ends inside a side."""

    @property
    def box(self) -> Config:
        """Corners and cells of the body."""
        box: Config = self.config["bodies"][0]["mesh"]["box"]
        return box

    @property
    def words(self) -> str:
        """A short description of the scene."""
        box, body = self.box, self.config["bodies"][0]
        size = np.subtract(box["upper"], box["lower"])
        cells = "x".join(str(n) for n in box["cells"])
        degree = f"degree {body['degree']}" if "degree" in body else "free degree"
        kinds = [
            "tilted" if contact.get("tilted") else next(iter(contact["obstacle"]))
            for contact in self.config.get("contacts", [])
        ]
        return (
            f"{cells} {box['cell']}, {degree}, 1:{size.max() / size.min():.2g}, "
            f"ν {body['material']['poisson']:.4g}, {', '.join(kinds) or 'no obstacle'}"
            + (", parts" if any(self.breaks) else "")
        )


def claim_scene(seed: int, dimension: int) -> ClaimScene:
    """The scene of a seed in the plane or in space."""
    return _Draw(seed, dimension).scene()


@dataclass
class _Draw:
    """Draws one scene."""

    seed: int
    dimension: int
    breaks: list[list[float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng([20_261_122, self.dimension, self.seed])
        self.breaks = [[] for _ in range(self.dimension)]

    def chance(self, share: float) -> bool:
        return bool(self.random.random() < share)

    def choice(self, values: Any, p: list[float] | None = None) -> Any:
        return values[int(self.random.choice(len(values), p=p))]

    def scene(self) -> ClaimScene:
        d = self.dimension
        self.draw_shape()
        cell = self.choice(
            ("quadrilateral", "triangle") if d == 2 else ("hexahedron", "tetrahedron")
        )
        box = {"lower": [0.0] * d, "upper": _floats(self.size), "cells": self.cells, "cell": cell}
        self.body: Config = {
            "name": "b", "mesh": {"box": box}, "boundaries": {},
            "material": {"young": YOUNG, "poisson": self.poisson()},
        }  # fmt: skip
        if self.chance(1 / 3):
            self.body["degree"] = int(self.choice((1, 2)))
        plane = self.choice(("plane_strain", "plane_stress"))
        config: Config = {
            "title": f"claim {d}D {self.seed}", "dimension": 3 if d == 3 else plane,
            "bodies": [self.body], "conditions": [], "contacts": [],
        }  # fmt: skip
        free = self.hold(config["conditions"])
        self.load(config["conditions"], free)
        self.touch(config["contacts"], free)
        if not self.body["boundaries"]:
            del self.body["boundaries"]
        return ClaimScene(self.seed, config, tuple(tuple(sorted(set(b))) for b in self.breaks))

    def draw_shape(self) -> None:
        """Edges and cells."""
        d = self.dimension
        self.size = np.round(self.random.uniform(0.6, 1.6, d), 3)
        most = 8 if d == 2 else 3
        self.cells = [int(n) for n in self.random.integers(1, most + 1, d)]
        if self.chance(0.35):
            axis = int(self.random.integers(d))
            ratio = 10.0 ** self.random.uniform(0.6, np.log10(30.0 if d == 2 else 10.0))
            self.size[axis] = np.round(self.size.min() * ratio, 3)
            across = self.random.integers(1, 4 if d == 2 else 3, d)
            along = int(self.random.integers(2, most + 1))
            self.cells = [along if a == axis else int(across[a]) for a in range(d)]

    def poisson(self) -> float:
        if self.chance(0.33):
            return float(self.choice((0.49, 0.499, 0.4999)))
        return float(np.round(self.random.uniform(0.0, 0.45), 3))

    def side(self, name: str, share: float) -> str:
        """The whole side, or with probability `share` a part made of facets."""
        axis = "xyz".index(name[0])
        along = [a for a in range(self.dimension) if a != axis and self.cells[a] > 1]
        if not along or not self.chance(share):
            return f"b.{name}"
        a = self.choice(along)
        number = int(self.random.integers(1, self.cells[a]))
        end = float(self.size[a] * number / self.cells[a])
        self.breaks[a].append(end)
        low = 0.0 if name[1] == "-" else float(self.size[axis])
        part = f"part{len(self.body['boundaries'])}"
        self.body["boundaries"][part] = {
            "where": f"abs({name[0]} - {low!r}) < 1e-9 and {'xyz'[a]} < {end!r} + 1e-9"
        }
        return f"b.{part}"

    def hold(self, conditions: list[Config]) -> list[str]:
        """Hold the body so that it cannot move; return the sides that stay free."""
        d = self.dimension
        faces = [f"{axis}{side}" for axis in "xyz"[:d] for side in "-+"]
        if self.chance(0.7):
            first = self.choice(faces)
            conditions.append({"on": self.side(first, 0.15), "displacement": [0.0] * d})
            return [face for face in faces if face != first]
        held = [f"{axis}{self.choice('-+')}" for axis in "xyz"[:d]]
        for axis, face in enumerate(held):
            value = [0.0 if a == axis else None for a in range(d)]
            conditions.append({"on": f"b.{face}", "displacement": value})
        return [face for face in faces if face not in held]

    def load(self, conditions: list[Config], free: list[str]) -> None:
        """One or two loads."""
        d, stress = self.dimension, YOUNG * STRAIN
        for _ in range(int(self.random.integers(1, 3))):
            kind = self.choice(("traction", "pressure", "force"), [0.4, 0.4, 0.2])
            if kind == "force":
                force = self.random.normal(size=d) * stress / self.size.max()
                conditions.append({"in": "b", "force": _floats(np.round(force, 6))})
                continue
            on = self.side(self.choice(free), 0.5)
            value = self.random.normal(size=d) * stress
            loaded: Any = _floats(np.round(value, 6))
            if kind == "pressure":
                loaded = float(np.round(abs(value[0]) * self.choice((1.0, 1.0, -1.0)), 6))
            conditions.append({"on": on, kind: loaded})

    def touch(self, contacts: list[Config], free: list[str]) -> None:
        """Add no, one or two obstacles."""
        count = int(self.choice((0, 1, 2), [0.25, 0.5, 0.25]))
        sides = [free[i] for i in self.random.permutation(len(free))][:count]
        for face in sides:
            contacts.append({"on": self.side(face, 0.15), "obstacle": self.obstacle(face)})

    def obstacle(self, face: str) -> Config:
        """An obstacle that the side touches, nearly touches or overlaps slightly."""
        d, axis = self.dimension, "xyz".index(face[0])
        outward = np.zeros(d)
        outward[axis] = 1.0 if face[1] == "+" else -1.0
        centre = 0.5 * self.size
        centre[axis] = self.size[axis] if face[1] == "+" else 0.0
        gap = float(self.choice((0.0, 1.0, -0.5), [0.6, 0.25, 0.15]) * STRAIN * self.size[axis])
        kind = self.choice(("plane", "tilted", "sphere", "cylinder"), [0.5, 0.1, 0.2, 0.2])
        if kind in ("sphere", "cylinder"):
            extent = max(self.size[a] for a in range(d) if a != axis)
            radius = float(np.round(self.random.uniform(1.0, 4.0) * extent, 3))
            middle = centre + outward * (radius + gap)
            if kind == "sphere" or d == 2:
                return {"sphere": {"center": _floats(middle), "radius": radius}}
            along = np.zeros(3)
            along[(axis + 1) % 3] = 1.0
            return {
                "cylinder": {"point": _floats(middle), "axis": _floats(along), "radius": radius}
            }
        if kind == "tilted":
            outward = outward + 1e-3 * self.random.normal(size=d)
            outward /= np.linalg.norm(outward)
        corners = np.stack(np.meshgrid(*([0.0, x] for x in self.size)), axis=-1).reshape(-1, d)
        reach = float((corners @ outward).max())
        point = outward * (reach + gap)
        return {"plane": {"point": _floats(point), "normal": _floats(-outward)}}


def _floats(vector: Array) -> list[float]:
    return [float(v) for v in vector]
