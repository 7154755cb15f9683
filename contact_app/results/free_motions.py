"""How far bodies slide where nothing but the facets of their meshes resists.

A ball between races may turn: round surfaces slide along themselves. On a mesh its facets resist a
little, and how far the ball turns says nothing of the problem. The motion is the part of the rigid
motion of each body (the one nearest to its displacement in the mean square) along the loose motions
of its group (`solver.contact.equilibrium.loose_motions`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.equilibrium import (
    body_frame,
    directions_in_words,
    groups_in_contact,
    upward,
)
from contact_app.model.model import Model
from contact_app.results.fields import NodeFields
from solver.tfeti.subdomain.kernels import MOTIONS, rigid_motions

LARGE = 0.5
"""Largest displacement without the motion over that with it, below which the motion is told."""


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """The slide of one body.

    Attributes
    ----------
    body
        Its number.
    along
        The motion in words.
    names
        Numbers of the rigid motions whose `hold` stops it.
    largest, without
        Largest displacement of the body, and without the motion.
    """

    body: int
    along: str
    names: tuple[int, ...]
    largest: float
    without: float

    def record(self, name: str) -> dict[str, Any]:
        """As `summary.json` holds it."""
        return {
            "body": name, "along": self.along, "max_displacement": self.largest,
            "without_it": self.without,
        }  # fmt: skip


def free_motions(model: Model, nodes: NodeFields) -> list[FreeMotion]:
    """Slides that make up most of the displacement of their body (collective)."""
    if not any(loose.shape[1] for loose in model.loose):
        return []
    found = []
    for group in groups_in_contact(model.scene):
        loose = np.concatenate([model.loose[b] for b in group])
        if loose.shape[1]:
            moved = np.concatenate([_rigid_motion(model, nodes, b) for b in group])
            slide = (loose @ (loose.T @ moved)).reshape(len(group), -1)
            found += list(_large(model, nodes, group, slide))
    return found


def _large(
    model: Model, nodes: NodeFields, group: NDArray[np.int64], slide: NDArray[np.float64]
) -> Iterator[FreeMotion]:
    """Slides (bodies of the group, motions) that make up most of a displacement (collective)."""
    for b, motion in zip(group, slide, strict=True):
        points, u = _of_body(model, nodes, b)
        body = model.scene.bodies[b]
        left = u - rigid_motions(points, model.scene.dimension, *body_frame(body)) @ motion
        sizes = np.array([np.linalg.norm(v, axis=1).max(initial=0.0) for v in (u, left)])
        model.comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
        largest, without = (float(size) for size in sizes)
        if without < LARGE * largest:
            share = np.abs(motion) > 0.05 * np.abs(motion).max()
            along = directions_in_words(upward(np.where(share, motion, 0.0)[:, None]))
            names = tuple(int(k) for k in np.flatnonzero(share))
            yield FreeMotion(int(b), along, names, largest, without)


def _rigid_motion(model: Model, nodes: NodeFields, b: int) -> NDArray[np.float64]:
    """The rigid motion nearest to the displacement of a body, (motions,) (collective)."""
    d = model.scene.dimension
    points, u = _of_body(model, nodes, b)
    motions = rigid_motions(points, d, *body_frame(model.scene.bodies[b])).reshape(-1, MOTIONS[d])
    sums = model.comm.allreduce(np.column_stack([motions.T @ motions, motions.T @ u.ravel()]))
    gram, seen = sums[:, :-1], sums[:, -1]
    return np.asarray(np.linalg.solve(gram, seen))


def _of_body(
    model: Model, nodes: NodeFields, b: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and displacements of the nodes of a body that this rank owns."""
    first = np.clip(model.partition.first_node[b : b + 2] - nodes.first, 0, len(nodes.points))
    mine = slice(int(first[0]), int(first[1]))
    return nodes.points[mine], nodes.displacement[mine]
