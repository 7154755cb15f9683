"""Which nodes may touch: contact rows only where the displacement may ask for them.

A node farther from what it may touch than it can move needs no row. How far a body that its
conditions hold can move is bounded as a bar, a beam and a half space would be under the sum F of
the magnitudes of all loads on it and on what it touches, with Young's modulus E of its softest
material, length L, mean cross-section A, thickness t and cells of size h:

    F L / (E A) (1 + 4 (L/t)²) + F / (E h)    (in the plane 4 F / E),

on top of the largest displacement that is prescribed, the deepest overlap and what free thermal
strains of up to ε add up to, ε L (1 + L/t), the bow of a plate that is hot on one side among them;
twice that is taken.
Of rows at a node whose directions are less than 1e-2 apart only the nearest is kept: the others
say nearly the same, which makes F singular but for the square of that angle (an obstacle given
twice, once a little turned, takes hundreds of times as many steps).

No theorem makes either sure, so the answer is held against the rows that were left out: if it
crosses one of them, the scene is solved again with those it crosses (`run.solve_scene`). Bodies
that only contact keeps may move as far as the gaps let them, and keep all rows.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.conditions import BodyContact
from contact_app.scene.scene import Scene
from solver.tfeti.constraints.conditions import ContactRows, pairs_at_nodes
from solver.tfeti.constraints.exchange import NodeExchange

SAFETY = 2.0
"""Factor of the bound."""

NEARLY_PARALLEL = 1e-2
"""Distance of two unit directions at a node of which the nearer one alone is kept."""

Needed = Literal["all", "estimated"] | NDArray[np.bool_]
"""Candidate rows that get one: all, those an estimate finds, or some of this rank's."""


def reaches(
    scene: Scene,
    groups: list[NDArray[np.int64]],
    pushing: tuple[NDArray[np.float64], NDArray[np.float64]],
    held: NDArray[np.bool_],
    overlaps: NDArray[np.float64],
) -> NDArray[np.float64]:
    """How far each contact's nodes may come nearer, (contacts,), infinite where nothing bounds it.

    Parameters
    ----------
    groups
        Bodies that may touch each other.
    pushing : (bodies,), (bodies,)
        Sum of the magnitudes of the nodal loads on each body, and its free thermal strain; elastic
        bodies first, then moving rigid ones, whose contacts nothing bounds.
    held : (bodies,)
        Whether the conditions stop every rigid motion of a body.
    overlaps : (contacts,)
        Deepest initial overlap of each contact, zero or more.
    """
    forces, strains = pushing
    bound = np.full(len(scene.body_names), np.inf)
    for group in groups:
        moved = [
            float(np.linalg.norm([v or 0.0 for v in condition.values]))
            for condition in scene.displacements
            if condition.body in group
        ]
        depth = [overlaps[i] for i, c in enumerate(scene.touching) if c.body in group]
        pushed = max(moved, default=0.0) + max(depth, default=0.0)
        pushed += sum(strains[b] * _growth(scene, int(b)) for b in group if strains[b])
        force = float(forces[group].sum())
        for b in group:
            if held[group].all():
                softness = sum(_softness(scene, k) for k in _tied_to(scene, int(b)))
                bound[b] = SAFETY * (pushed + force * softness)
    return np.array(
        [
            bound[c.body] + (bound[c.other] if isinstance(c, BodyContact) else 0.0)
            for c in scene.touching
        ]
    )


def _tied_to(scene: Scene, number: int) -> set[int]:
    """A body and those that are tied to it, directly or through others."""
    found, before = {number}, 0
    while len(found) > before:
        before = len(found)
        for tie in scene.ties:
            if found & {tie.body, tie.other}:
                found |= {tie.body, tie.other}
    return found


def _growth(scene: Scene, number: int) -> float:
    """Displacement of a body by free thermal strains of up to one, estimated from its size."""
    mesh = scene.bodies[number].mesh
    sides = np.subtract(mesh.upper, mesh.lower)
    length = float(np.linalg.norm(sides))
    return length * (1.0 + length / float(sides.min()))


def _softness(scene: Scene, number: int) -> float:
    """Displacement of a body by a force of one, estimated from its size."""
    body, d = scene.bodies[number], scene.dimension
    sides = np.subtract(body.mesh.upper, body.mesh.lower)
    length, thickness, volume = float(sides.max()), float(sides.min()), float(sides.prod())
    young = body.softest
    beam = length / (young * volume / length) * (1.0 + 4.0 * (length / thickness) ** 2)
    cell = (volume / body.mesh.total_cells) ** (1.0 / d) / body.degree
    return beam + (4.0 / young if d == 2 else 1.0 / (young * cell))


def estimated(rows: ContactRows, reach: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which candidate rows are within reach and not nearly repeated by nearer ones, (rows,)."""
    needed = rows.gaps <= reach[rows.sources]
    single = ~rows.wide & np.isfinite(reach[rows.sources])
    direction, entries = np.zeros_like(rows.normals), rows.entries
    mine = single[entries.row]
    direction[entries.row[mine], entries.component[mine]] = entries.value[mine]
    norm = np.linalg.norm(direction, axis=1)
    norm[norm == 0.0] = 1.0
    direction, gap = direction / norm[:, None], rows.gaps / norm
    for i, j in pairs_at_nodes(rows.nodes):
        same = np.linalg.norm(direction[i] - direction[j], axis=1) < NEARLY_PARALLEL
        same &= single[i] & single[j] & needed[i] & needed[j]
        needed[np.where(gap[i] <= gap[j], j, i)[same]] = False
    return needed


def more_needed(
    left_out: ContactRows,
    reach: NDArray[np.float64],
    slack: NDArray[np.float64],
    sizes: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Of the rows that were left out those an answer asks for, (rows,).

    Parameters
    ----------
    slack : (rows,)
        What the answer leaves along them.
    sizes : (rows,)
        The largest displacement of their bodies; rows that were out of reach are taken if they are
        as near.
    """
    far = left_out.gaps > reach[left_out.sources]
    return slack < np.where(far, sizes, 0.0)


def slack_of(
    rows: ContactRows, exchange: NodeExchange, displacement: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance left along each row, (rows,) (collective).

    Parameters
    ----------
    exchange
        Of all nodes with their owners.
    displacement : (nodes, dimension)
        At the nodes this rank owns.
    """
    entries = rows.entries
    query = exchange.among(entries.node)
    u = query.from_owners(displacement[query.nodes - query.first])
    moved = entries.value * u[np.arange(len(entries.node)), entries.component]
    return rows.gaps - np.bincount(entries.row, moved, minlength=len(rows.nodes))
