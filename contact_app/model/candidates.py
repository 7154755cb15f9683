"""Candidates for contact: nodes that can come into contact get contact rows.

A node needs no row if its gap is larger than its displacement can be. The displacement of a held
body is estimated by those of a bar, a beam and a half space under the sum F of the magnitudes of
all loads on the body and on bodies that it touches. With Young's modulus E of its softest material,
length L, mean cross-section A, thickness t and cells of size h, the estimate is

    F L / (E A) (1 + 4 (L/t)²) + F / (E h)    (in the plane 4 F / E),

plus the largest prescribed displacement, the deepest overlap, and ε L (1 + L/t) for free thermal
strains up to ε (which includes the bending of a plate that is hot on one side). Twice this sum is
used. If rows at a node have directions less than 1e-2 apart, only the nearest remains: nearly
parallel rows make F nearly singular (an obstacle given twice, once slightly rotated, takes hundreds
of times as many steps).

No theorem guarantees either rule. So the answer is tested in the rows that were left out: if it
penetrates some, the scene is solved again with these rows (`run.solve_scene`). Bodies that only
contact holds have all rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from contact_app.scene.bodies import Body
from contact_app.scene.conditions import BodyContact, Tie
from contact_app.scene.scene import Scene
from solver.tfeti.constraints.conditions import ContactRows, pairs_at_nodes
from solver.tfeti.constraints.exchange import NodeExchange

SAFETY = 2.0
"""Safety factor on the estimate."""

NEARLY_PARALLEL = 1e-2
"""Distance of two unit directions at a node below which only the nearer row remains."""

Needed = Literal["all", "estimated"] | NDArray[np.bool_]
"""Choice of candidate rows: all, by an estimate, or a mask of this rank's candidates."""


def reaches(
    scene: Scene,
    groups: list[NDArray[np.int64]],
    pushing: tuple[NDArray[np.float64], NDArray[np.float64]],
    held: NDArray[np.bool_],
    overlaps: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Largest approach of the nodes of each contact, (contacts,); infinite if unbounded.

    Parameters
    ----------
    groups
        Bodies that may touch each other.
    pushing : (bodies,), (bodies,)
        Sum of the magnitudes of the nodal loads on each body, and its free thermal strain; elastic
        bodies first, then moving rigid ones, whose approach is unbounded.
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
        pushed += sum(strains[b] * _growth(scene.bodies[b]) for b in group if strains[b])
        force = float(forces[group].sum())
        for b in group:
            if held[group].all():
                together = _tied_to(scene.ties, int(b))
                softness = sum(_softness(scene.bodies[k], scene.dimension) for k in together)
                bound[b] = SAFETY * (pushed + force * softness)
    return np.array(
        [
            bound[c.body] + (bound[c.other] if isinstance(c, BodyContact) else 0.0)
            for c in scene.touching
        ]
    )


def _tied_to(ties: Sequence[Tie], number: int) -> set[int]:
    """A body and all bodies that are tied to it, directly or through others."""
    found, before = {number}, 0
    while len(found) > before:
        before = len(found)
        for tie in ties:
            if found & {tie.body, tie.other}:
                found |= {tie.body, tie.other}
    return found


def _growth(body: Body) -> float:
    """Displacement of a body by free thermal strains of up to one, estimated from its size."""
    sides = np.subtract(body.mesh.upper, body.mesh.lower)
    length = float(np.linalg.norm(sides))
    return length * (1.0 + length / float(sides.min()))


def _softness(body: Body, dimension: int) -> float:
    """Displacement of a body by a force of one, estimated from its size."""
    sides = np.subtract(body.mesh.upper, body.mesh.lower)
    length, thickness, volume = float(sides.max()), float(sides.min()), float(sides.prod())
    young = body.softest
    beam = length / (young * volume / length) * (1.0 + 4.0 * (length / thickness) ** 2)
    cell = (volume / body.mesh.total_cells) ** (1.0 / dimension) / body.degree
    return beam + (4.0 / young if dimension == 2 else 1.0 / (young * cell))


def estimated(rows: ContactRows, reach: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask (rows,) of candidate rows within reach that no nearer row nearly repeats."""
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
    """Mask (rows,) of the left-out rows that an answer penetrates.

    Parameters
    ----------
    slack : (rows,)
        Remaining gap of the answer along each row.
    sizes : (rows,)
        The largest displacement of the bodies of each row; rows that were out of reach join if they
        are as near as the others.
    """
    unreachable = left_out.gaps > reach[left_out.sources]
    return slack < np.where(unreachable, sizes, 0.0)


def slack_of(
    rows: ContactRows, exchange: NodeExchange, displacement: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Remaining gap along each row, (rows,) (collective).

    Parameters
    ----------
    exchange
        Exchange of all nodes with their owners.
    displacement : (nodes, dimension)
        Displacement at the nodes that this rank owns.
    """
    entries = rows.entries
    query = exchange.among(entries.node)
    u = query.from_owners(displacement[query.nodes - query.first])
    moved = entries.value * u[np.arange(len(entries.node)), entries.component]
    return rows.gaps - np.bincount(entries.row, moved, minlength=len(rows.nodes))
