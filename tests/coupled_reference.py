"""The undecomposed reference of scenes with rigid bodies and tied boundaries.

`tests.reference` knows neither. What it assembles is extended here, from the description of the
scene alone:

rigid bodies
    Two nodes more for each, at its reference point, one for its displacement and one for its
    rotation. A contact row Σ v_k · u_k ≤ g of the boundary's nodes x_k becomes
    Σ v_k · (u_k - t - θ × (x_k - c)) ≤ g, which has on the rigid motions what the row itself would
    make of them, with the other sign. g is the gap where the body is placed; the row is written
    for the whole motion.
tied boundaries
    On flat interfaces without a gap: the mean of the jump over each multiplier, of the slow mortar
    integrals of `tests.mortar_reference`, is neither positive nor negative: two rows a component.
boundaries tied to rigid bodies
    u_k - t - θ × (x_k - c) is neither positive nor negative, with c as the file has it. A tied
    interface has no multipliers at these nodes: their functions are distributed. Rows of contact
    with the same body are left out there.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from tests import mortar_reference, reference

NODES = 2


@dataclass(frozen=True)
class Coupled:
    """The extended problem."""

    system: reference.System
    """With nodes of rigid bodies after all others."""
    meshed: int
    """Nodes of elastic bodies."""


def assemble(scene: Any) -> Coupled:
    """The problem of a scene, rigid bodies where its placements have them."""
    system = reference.assemble(replace(scene, ties=()))
    meshed = len(system.points)
    bodies = [reference.AssembledBody(b, scene.dimension, scene.plane) for b in scene.bodies]
    first = np.concatenate([[0], np.cumsum([len(b.points) for b in bodies])])
    of_rigid = [
        np.unique([n for f in bodies[t.body].facets_on(t.boundary, first[t.body]) for n in f.nodes])
        for t in scene.rigid_ties
    ]
    for tie in scene.ties:
        sides = [
            bodies[b].facets_on(boundary, first[b])
            for b, boundary in ((tie.body, tie.boundary), (tie.other, tie.other_boundary))
        ]
        system = _tied(system, sides, set(np.concatenate([[], *of_rigid]).tolist()))
    for nth, number in enumerate(scene.moving):
        system = _with_rigid(system, scene, number, len(scene.bodies) + nth, meshed)
    for tie, nodes in zip(scene.rigid_ties, of_rigid, strict=True):
        system = _rigidly_tied(system, scene, tie.rigid, nodes, meshed)
        about = [i for i, c in enumerate(scene.contacts) if c.rigid == tie.rigid]
        system = _without(system, np.isin(system.contact_source, about), nodes)
    return Coupled(system, meshed)


def _motions(points: np.ndarray, center: np.ndarray, d: int) -> np.ndarray:
    """Displacements (n · d, 2 d) of points by a translation and a rotation vector."""
    away = np.zeros((len(points), 3))
    away[:, : points.shape[1]] = points
    away -= center
    result = np.zeros((len(points), d, NODES * d))
    result[:, :, :d] = np.eye(d)
    axes = [np.array([0.0, 0.0, 1.0])] if d == 2 else list(np.eye(3))
    for k, axis in enumerate(axes):
        result[:, :, d + k] = np.cross(axis, away)[:, :d]
    return result.reshape(len(points) * d, NODES * d)


def _with_rigid(
    system: reference.System, scene: Any, number: int, body: int, meshed: int
) -> reference.System:
    """The same with one rigid body more."""
    d, rigid, place = system.dimension, scene.rigid.bodies[number], scene.rigid.placements[number]
    center = np.array(rigid.center) + np.array(place.displacement)
    held, values = np.zeros(NODES * d, bool), np.zeros(NODES * d)
    held[d + (1 if d == 2 else 3) :] = True
    for motion in scene.rigid.motions:
        if motion.body == number:
            for k, value in enumerate((*motion.displacement, *motion.rotation)):
                if value is not None:
                    held[k], values[k] = True, value
    load = np.zeros(NODES * d)
    for item in scene.rigid.loads:
        if item.body == number:
            load[:d] += np.array(item.force)[:d]
            load[d : d + (1 if d == 2 else 3)] += item.moment[2:] if d == 2 else item.moment
    placed = np.zeros(NODES * d)
    placed[:d] = place.displacement[:d]
    placed[d : d + (1 if d == 2 else 3)] = place.rotation[2:] if d == 2 else place.rotation
    about = [i for i, c in enumerate(scene.contacts) if c.rigid == number]
    mine = sp.diags(np.isin(system.contact_source, about).astype(float))
    contact, dofs = sp.csr_matrix(system.contact), meshed * d
    turned = -(mine @ contact[:, :dofs]) @ _motions(system.points[:meshed], center, d)
    added = np.tile(center[: system.points.shape[1]], (NODES, 1))
    return replace(
        system,
        points=np.concatenate([system.points, added]),
        body=np.concatenate([system.body, np.full(NODES, body)]),
        stiffness=sp.block_diag(
            [system.stiffness, sp.csr_matrix((NODES * d, NODES * d))], format="csr"
        ),
        load=np.concatenate([system.load, load]),
        held=np.concatenate([system.held, held]),
        prescribed=np.concatenate([system.prescribed, values]),
        contact=sp.hstack([contact, sp.csr_matrix(turned)], format="csr"),
        gap=system.gap + turned @ placed,
    )


def _tied(system: reference.System, sides: list[Any], moved: set[int]) -> reference.System:
    """The same with two rows for each component of the mean jumps of tied boundaries."""
    d, dofs = system.dimension, len(system.load)
    found, _, _ = mortar_reference.mortar_rows(*sides, moved, tied=True)
    normal = sides[0][0].normal
    matrix = sp.lil_matrix((d * len(found), dofs))
    for row, node in enumerate(found):
        for there, vector in found[node].items():
            for i in range(d):
                matrix[row * d + i, there * d + i] = float(vector @ normal)
    return _with_equalities(system, matrix, np.zeros(matrix.shape[0]), np.repeat(list(found), d))


def _rigidly_tied(
    system: reference.System, scene: Any, number: int, nodes: np.ndarray, meshed: int
) -> reference.System:
    """The same with nodes that move with a rigid body, moving or held."""
    d, dofs = system.dimension, len(system.load)
    own = (nodes[:, None] * d + np.arange(d)).ravel()
    motions = _motions(system.points[nodes], np.array(scene.rigid.bodies[number].center), d)
    matrix = sp.csr_matrix((np.ones(len(own)), (np.arange(len(own)), own)), (len(own), dofs))
    if number in scene.moving:
        start = (meshed + NODES * scene.moving.index(number)) * d
        blocks = [sp.csr_matrix((len(own), n)) for n in (start, dofs - start - NODES * d)]
        matrix = matrix - sp.hstack([blocks[0], sp.csr_matrix(motions), blocks[1]])
        return _with_equalities(system, matrix, np.zeros(len(own)), np.repeat(nodes, d))
    values = np.zeros(NODES * d)
    for motion in scene.rigid.motions:
        if motion.body == number:
            for k, value in enumerate((*motion.displacement, *motion.rotation)):
                values[k] = values[k] if value is None else value
    return _with_equalities(system, matrix, motions @ values, np.repeat(nodes, d))


def _without(system: reference.System, rows: np.ndarray, nodes: np.ndarray) -> reference.System:
    """The same without those of some contact rows (mask) that are at some nodes."""
    keep = ~(rows & np.isin(system.contact_node, nodes))
    return replace(
        system,
        contact=sp.csr_matrix(system.contact)[keep],
        gap=system.gap[keep],
        contact_node=system.contact_node[keep],
        contact_source=system.contact_source[keep],
    )


def _with_equalities(
    system: reference.System, matrix: Any, right: np.ndarray, nodes: np.ndarray
) -> reference.System:
    """The same with two rows for each equality, one of each sign."""
    count = 2 * len(right)
    return replace(
        system,
        contact=sp.vstack([system.contact, matrix, -matrix], format="csr"),
        gap=np.concatenate([system.gap, right, -right]),
        contact_node=np.concatenate([system.contact_node, nodes, nodes]),
        contact_source=np.concatenate([system.contact_source, np.full(count, -1)]),
    )


def solve(coupled: Coupled, tolerance: float = 1e-9) -> np.ndarray:
    """Displacements, (nodes, d), those of rigid bodies last.

    Raises
    ------
    ReferenceError
        The reference has no answer.
    """
    system = coupled.system
    free, K, u = ~system.held, system.stiffness, system.prescribed.copy()
    u[free] = reference.minimise(
        K[free][:, free],
        (system.load - K @ u)[free],
        system.contact[:, free],
        system.gap - system.contact @ u,
        float(np.ptp(system.points, axis=0).max()),
        tolerance,
    )[0]
    return u.reshape(-1, system.dimension)


def escape_work(coupled: Coupled) -> float:
    """Largest work of the loads on rigid motions of all bodies that nothing stops, relative.

    By linear programming; zero where the bodies can be in equilibrium.
    """
    system, d = coupled.system, coupled.system.dimension
    length = float(np.ptp(system.points[: coupled.meshed], axis=0).max())
    columns = []
    for body in np.unique(system.body):
        nodes = np.flatnonzero(system.body == body)
        dofs = (nodes[:, None] * d + np.arange(d)).ravel()
        points = system.points[nodes]
        if nodes[0] >= coupled.meshed:
            R = np.diag([1.0] * d + [1.0 / length] * d)
        else:
            center = np.zeros(3)
            center[: points.shape[1]] = points.mean(axis=0)
            R = _motions(points, center, d)[:, : 3 * (d - 1)]
            R[:, d:] /= np.ptp(points, axis=0).max()
        block = np.zeros((len(system.load), R.shape[1]))
        block[dofs] = R
        columns.append(block)
    R = np.concatenate(columns, axis=1)
    load, scale = system.load, float(np.abs(system.load).sum())
    if scale == 0.0:
        return 0.0
    rows = np.asarray(system.contact @ R)
    found = linprog(
        -(load @ R) / scale, A_ub=np.vstack([rows, np.zeros((1, R.shape[1]))]),
        b_ub=np.zeros(len(rows) + 1), A_eq=np.vstack([R[system.held], np.zeros((1, R.shape[1]))]),
        b_eq=np.zeros(int(system.held.sum()) + 1), bounds=(-1.0, 1.0), method="highs",
    )  # fmt: skip
    return -float(found.fun) if found.status == 0 else 0.0
