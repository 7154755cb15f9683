"""The equilibrium of a rough block before the solve, against an independent linear program.

A block lies on planes, in a vee, in a bowl or in a trough. Its weight acts in full; a force and a
moment in random directions grow until contact forces in friction cones no longer balance them.
"""

from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import linprog

from contact_app.errors import NoEquilibriumError
from contact_app.model.model import build_model
from solver.vectors import Array
from tests import scenes

SIDES = 96
"""Number of sides of the pyramid in each cone; its friction is up to 0.05 % smaller."""

CELLS = 3


def wrench(point: Array, force: Array) -> Array:
    return np.concatenate([force, np.cross(point, force)])


@dataclass
class RestingBlock:
    """A block with the nodes that touch its obstacles, and what friction can do there."""

    size: Array
    law: dict[str, float]
    contacts: list[scenes.Config] = field(default_factory=list)
    rays: list[Array] = field(default_factory=list)
    limited: list[tuple[Array, float]] = field(default_factory=list)

    @property
    def nodes(self) -> Array:
        return np.array(list(product(*(np.linspace(0, s, CELLS + 1) for s in self.size))))

    def touches(self, axis: int, obstacle: scenes.Config, normal_at: Any) -> None:
        """Put a side of the block against an obstacle, with its normal on the block."""
        on = "xyz"[axis]
        self.contacts.append({"on": f"block.{on}-", "obstacle": obstacle, "friction": self.law})
        for x in self.nodes[self.nodes[:, axis] == 0.0]:
            normal = normal_at(x)
            across = np.linalg.svd(normal[None])[2][1:]
            angles = 2 * np.pi * np.arange(SIDES) / SIDES
            circle = np.cos(angles)[:, None] * across[0] + np.sin(angles)[:, None] * across[1]
            mu = self.law.get("coulomb", 0.0)
            self.rays += [wrench(x, normal + mu * t) for t in (circle if mu else circle[:1])]
            if "tresca" in self.law:
                others = [k for k in range(3) if k != axis]
                ends = [0.5 if x[k] in (0.0, self.size[k]) else 1.0 for k in others]
                area = float(np.prod(ends) * np.prod(self.size[others]) / CELLS**2)
                friction = np.array([wrench(x, t) for t in circle])
                self.limited.append((friction, self.law["tresca"] * area))

    def share(self, dead: Array, live: Array) -> float:
        """The largest factor of the live wrench in equilibrium; NaN if the dead one has none."""
        columns = np.array(self.rays + [f for forces, _ in self.limited for f in forces]).T
        upper = np.zeros((len(self.limited), columns.shape[1] + 1))
        for row in range(len(self.limited)):
            begin = len(self.rays) + row * SIDES
            upper[row, begin : begin + SIDES] = 1.0
        most = np.array([limit for _, limit in self.limited])
        cost = np.zeros(columns.shape[1] + 1)
        cost[-1] = -1.0
        found = linprog(
            cost, A_ub=upper if len(most) else None, b_ub=most if len(most) else None,
            A_eq=np.c_[columns, live], b_eq=-dead,
        )  # fmt: skip
        return float(found.x[-1]) if found.status == 0 else np.inf if found.status == 3 else np.nan


def unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)


def resting(kind: str, rng: np.random.Generator) -> RestingBlock:
    size = rng.uniform(0.6, 1.5, 3)
    law = {"coulomb": float(rng.uniform(0.1, 0.8))}
    if rng.random() < 0.3 and kind in ("plane", "corner"):
        law = {"tresca": float(rng.uniform(0.05, 0.3))}
    block = RestingBlock(size, law)
    if kind in ("plane", "corner"):
        for axis in (2, 0) if kind == "corner" else (2,):
            normal = np.eye(3)[axis]
            block.touches(
                axis, scenes.plane("hexahedron", (0, 0, 0), normal), lambda x, n=normal: n
            )
    if kind == "vee":
        for side, at in ((1.0, 0.0), (-1.0, size[0])):
            angle = rng.uniform(0.3, 1.0)
            normal = np.array([side * np.sin(angle), 0.0, np.cos(angle)])
            plane = {"plane": {"point": [float(at), 0.0, 0.0], "normal": normal.tolist()}}
            block.touches(2, plane, lambda x, n=normal: n)
    if kind in ("bowl", "trough"):
        along = np.array([1.0, 0.0 if kind == "trough" else 1.0, 1.0])
        half = 0.5 * float(np.linalg.norm((size * along)[:2]))
        radius = half * float(rng.uniform(1.3, 3.0))
        center = np.array([size[0] / 2, size[1] / 2, np.sqrt(radius**2 - half**2)])
        round_one: scenes.Config = {"radius": radius, "hollow": True}
        if kind == "bowl":
            obstacle = {"sphere": {"center": center.tolist(), **round_one}}
        else:
            bore = {"point": center.tolist(), "axis": [0, 1, 0], **round_one}
            obstacle = {"cylinder": bore}
        block.touches(2, obstacle, lambda x: unit((center - x) * along))
    return block


@pytest.mark.parametrize("kind", ["plane", "corner", "vee", "bowl", "trough"])
@pytest.mark.parametrize("seed", range(6))
def test_a_block_leaves_where_no_forces_in_friction_cones_balance_it(kind: str, seed: int) -> None:
    rng = np.random.default_rng([seed, len(kind)])
    block = resting(kind, rng)
    weight = np.array([0.0, 0.0, -1.0]) + 0.05 * rng.normal(size=3)
    force, at = rng.normal(size=3), block.size * rng.uniform(0, 1, 3)
    moment = 0.5 * rng.normal(size=3) * (seed % 2)
    live = wrench(at, force) + np.r_[np.zeros(3), moment]
    share = block.share(wrench(block.size / 2, weight), live)

    def model(factor: float) -> None:
        config = scenes.config(
            "hexahedron",
            [scenes.box("block", block.size.tolist(), [CELLS] * 3)],
            [
                {"in": "block", "force": (weight / np.prod(block.size)).tolist()},
                {
                    "on": "block.z+", "at": at.tolist(), "total_force": (factor * force).tolist(),
                    "total_moment": (factor * moment).tolist(),
                },
            ],
            block.contacts,
        )  # fmt: skip
        build_model(scenes.build(config, 1), MPI.COMM_SELF)

    if np.isnan(share):
        with pytest.raises(NoEquilibriumError):
            model(0.0)
        return
    model(0.99 * share if np.isfinite(share) else 100.0)
    if np.isfinite(share):
        with pytest.raises(NoEquilibriumError, match="leaving"):
            model(1.01 * share)
