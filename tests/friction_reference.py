"""An independent solution of a scene with friction: Gauss-Seidel over contact points.

The undecomposed system of `tests.reference` is condensed to the slips and penetrations of its
contact points, a dense matrix W = C K⁻¹ Cᵀ, and each point in turn is given the force that its law
asks for while the others stay (M. Jean, *The non-smooth contact dynamics method*, 1999): a normal
force that leaves no penetration, a friction force that is the projection of λ_t + ρ w on the disc
of its present limit. No statuses, no frozen limits, no decomposition. Only bodies that conditions
hold.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.spatial import cKDTree

from contact_app.scene.conditions import Traction
from tests.reference import ReferenceError, System, assemble

SWEEPS = 20_000
CHANGE = 1e-13
"""Largest change in a sweep at which the sweeps end: of a force over the largest force, or of a
motion over the largest motion. Where a node is in several contacts W is singular, and rounding
errors move forces that leave all points in place by about 1e-12 a sweep without end."""

SETTLED = 1e-9
"""Residual of the conditions up to which forces that leave all points in place are the answer. Such
forces may also change by the same amount in each sweep until one of them reaches its limit."""


@dataclass(frozen=True)
class FrictionReference:
    """The reference solution of a scene with friction."""

    system: System
    u: np.ndarray  # ndarray, shape (n, dim)
    normal: np.ndarray  # ndarray, shape (points,)
    """λ_n."""
    tangential: np.ndarray
    slip: np.ndarray
    """λ_t, the force of the body on what it touches, and w. Shape ndarray, shape (points, dim)."""
    limit: np.ndarray  # ndarray, shape (points,)
    energy: float
    """½ a(u, u) - l(u)."""
    force: np.ndarray  # ndarray, shape (dim·points,)
    """λ in the rows of `Condensed`."""

    @property
    def points(self) -> np.ndarray:
        """Nodes, shape (n, 3)."""
        return self.system.points


@dataclass(frozen=True)
class Condensed:
    """A scene condensed to its contact points: penetrations and slips are q - W λ."""

    system: System
    own: np.ndarray  # ndarray, shape (n·dim,)
    """Displacements without contact forces."""
    soft: np.ndarray  # ndarray, shape (free, dim·points)
    """Displacements of the free components by unit forces."""
    free: np.ndarray  # ndarray of int, shape (free,)
    W: np.ndarray
    q: np.ndarray
    """Shapes ndarray, shapes (dim·points, dim·points), (dim·points,)."""
    rows: np.ndarray  # ndarray of int, shape (points, dim)
    """Rows of each point, that along its normal first."""
    coefficient: np.ndarray
    given: np.ndarray
    """Shape ndarray, shape (points,)."""
    C: sp.csr_matrix  # csr_matrix, shape (dim·points, n·dim)
    frames: np.ndarray  # ndarray, shape (points, dim - 1, dim)
    """Tangents."""

    @property
    def scale(self) -> float:
        """A force that moves the points as far as the loads do."""
        return float(np.abs(self.q).max() / np.abs(np.diag(self.W)).max())

    def answer(self, force: np.ndarray) -> FrictionReference:
        """Displacements and friction of contact forces (dim·points,)."""
        system, u = self.system, self.own.copy()
        u[self.free] -= self.soft @ force
        along, residual = force[self.rows], (self.q - self.W @ force)[self.rows]
        flat = u @ (system.stiffness @ u) / 2 - system.load @ u
        tangential, slip = (
            np.einsum("pk,pki->pi", x[:, 1:], self.frames) for x in (along, residual)
        )
        limit = self.coefficient * along[:, 0] + self.given
        return FrictionReference(
            system, u.reshape(-1, system.dimension), along[:, 0], tangential, slip, limit,
            float(flat), force,
        )  # fmt: skip

    def rows_of(
        self, nodes: np.ndarray, sources: np.ndarray, normal: np.ndarray, tangential: np.ndarray
    ) -> np.ndarray:
        """Forces (points,), (points, dim) at nodes (points, 3) of contacts as λ (dim·points,)."""
        result, system = np.zeros(len(self.q)), self.system
        size = np.ptp(system.points, axis=0).max()
        for at, source, along, force in zip(nodes, sources, normal, tangential, strict=True):
            away = np.linalg.norm(system.points[system.contact_node] - at, axis=1)
            mine = np.flatnonzero((away < 1e-9 * size) & (system.contact_source == source))
            if len(mine) != 1:
                raise ReferenceError("a contact point of the answer is not one of the reference")
            p = mine[0]
            result[self.rows[p]] = along, *(self.frames[p] @ force)
        return result

    def residual(self, force: np.ndarray) -> float:
        """Residual of the conditions of contact and friction, as forces relative to the largest
        one.

        λ_n - max(0, λ_n + r w_n) and λ_t minus the projection of λ_t + r w_t on the disc of μ λ_n
        or s, with r the inverse of the largest compliance of the point.
        """
        moved = (self.q - self.W @ force)[self.rows]
        own, worst = force[self.rows], 0.0
        for p, at in enumerate(self.rows):
            stiff = np.diag(self.W)[at].max()
            if stiff <= 0.0:
                continue
            normal = own[p, 0] - max(own[p, 0] + moved[p, 0] / stiff, 0.0)
            wanted = own[p, 1:] + moved[p, 1:] / stiff
            limit = self.coefficient[p] * max(own[p, 0], 0.0) + self.given[p]
            size = float(np.linalg.norm(wanted))
            wanted = wanted * min(1.0, limit / size) if size > 0.0 else wanted
            worst = max(worst, abs(normal), float(np.abs(own[p, 1:] - wanted).max()))
        return worst / max(float(np.abs(force).max()), 1e-3 * self.scale)


def condense(scene: Any) -> Condensed:
    """Assemble a scene and eliminate all but its contact points."""
    system = assemble(scene)
    frames, tangents, coefficient, given = _rows(scene, system)
    C = sp.vstack([system.contact, *tangents], format="csr")
    free = np.flatnonzero(~system.held)
    prescribed = np.where(system.held, system.prescribed, 0.0)
    factor = spla.splu(system.stiffness[free][:, free].tocsc())
    own = prescribed.copy()
    own[free] = factor.solve((system.load - system.stiffness @ prescribed)[free])
    soft = factor.solve(C[:, free].T.toarray())
    W = C[:, free] @ soft
    q = C @ own
    count, d = len(frames), system.dimension
    q[:count] -= system.gap
    rows = np.arange(d)[None] * count + np.arange(count)[:, None]  # normal first
    return Condensed(system, own, soft, free, W, q, rows, coefficient, given, C, frames)


def solve(scene: Any, backwards: bool = False) -> FrictionReference:
    """Sweep until nothing changes.

    Parameters
    ----------
    backwards
        Whether points are taken in the opposite order, from large forces on.
    """
    condensed = condense(scene)
    start = np.full(len(condensed.q), condensed.scale if backwards else 0.0)
    return condensed.answer(sweep(condensed, start, backwards))


def sweep(
    condensed: Condensed, start: np.ndarray, backwards: bool = False, most: int = SWEEPS
) -> np.ndarray:
    """Contact forces from first ones on, (dim·points,).

    Raises
    ------
    ReferenceError
        The sweeps do not settle.
    """
    W, q, rows, scale = condensed.W, condensed.q, condensed.rows, condensed.scale
    coefficient, given = condensed.coefficient, condensed.given
    force = start.copy()
    order = np.arange(len(rows))
    if backwards:
        order = order[::-1]
    for _ in range(most):
        change, before = 0.0, force.copy()
        for p in order:
            own = rows[p]
            block = W[np.ix_(own, own)]
            rest = q[own] - W[own] @ force + block @ force[own]
            local = force[own].copy()
            step = 1.0 / np.linalg.norm(block[1:, 1:], 2) if block[1:, 1:].any() else 0.0
            for _ in range(20):
                if block[0, 0] > 0.0:
                    local[0] = max((rest[0] - block[0, 1:] @ local[1:]) / block[0, 0], 0.0)
                slip = rest[1:] - block[1:] @ local
                local[1:] += step * slip
                limit, size = coefficient[p] * local[0] + given[p], np.linalg.norm(local[1:])
                if size > limit:
                    local[1:] *= limit / size
            change = max(change, np.abs(local - force[own]).max())
            force[own] = local
        if change <= CHANGE * max(np.abs(force).max(), 1e-3 * scale):
            return force
        still = np.abs(W @ (force - before)).max() <= CHANGE * np.abs(q).max()
        if still and condensed.residual(force) <= SETTLED:
            return force
    raise ReferenceError("the sweeps did not settle")


def _rows(
    scene: Any, system: System
) -> tuple[np.ndarray, list[sp.csr_matrix], np.ndarray, np.ndarray]:
    """Tangents (points, d - 1, d), rows of the slips along each, μ and given limits (points,)."""
    d, count = system.dimension, system.contact.shape[0]
    contact = system.contact
    normals = np.zeros((count, d))
    weights = sp.lil_matrix((count, len(system.points)))
    for p in range(count):
        entries = contact[p].toarray().reshape(-1, d)
        largest = entries[np.argmax(np.linalg.norm(entries, axis=1))]
        # a row between two bodies has entries of both signs: out of the body of its point
        out = np.sign(largest @ entries[system.body == system.body[system.contact_node[p]]].sum(0))
        normals[p] = out * largest / np.linalg.norm(largest)
        weights[p] = entries @ normals[p]
        flat = np.abs(entries - np.outer(entries @ normals[p], normals[p])).max()
        if flat > 1e-9:
            raise ReferenceError("a row along normals that differ from node to node")
    weights = weights.tocsr()
    if d == 2:
        frames = [np.stack([-normals[:, 1], normals[:, 0]], axis=1)]
    else:
        other = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
        first = np.cross(normals, other)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        frames = [first, np.cross(normals, first)]
    tangents = []
    for frame in frames:
        parts = [sp.diags(frame[:, i]) @ weights for i in range(d)]
        stacked = sp.hstack(parts).tocsc()
        order = (np.arange(len(system.points))[:, None] + np.arange(d) * len(system.points)).ravel()
        tangents.append(stacked[:, order].tocsr())
    coefficient, given = [], []
    for touching in scene.touching:
        part = replace(scene, contacts=(), pairs=())
        field = "pairs" if hasattr(touching, "other") else "contacts"
        rows = assemble(replace(part, **{field: (touching,)})).contact_node
        limit = touching.law.limit
        coefficient.append(np.full(len(rows), touching.law.coefficient))
        given.append(limit * _areas(scene, touching)[rows] if limit else np.zeros(len(rows)))
    limits = np.concatenate(coefficient), np.concatenate(given)
    return np.stack(frames, axis=1), tangents, *limits


def _areas(scene: Any, touching: Any) -> np.ndarray:
    """∫ φ_k over the boundary of a contact: what a traction of one does to each node.

    Where rows are means about vertices φ_k are their hat functions.
    """
    d = scene.dimension
    one = Traction(touching.body, touching.boundary, (1.0,) + (0.0,) * (d - 1), "area")
    bare = replace(
        scene, tractions=(one,), pressures=(), forces=(), temperatures=(), contacts=(), pairs=()
    )
    nodes = assemble(bare)
    body = scene.bodies[touching.body]
    if body.degree == 1 or not (hasattr(touching, "other") or body.mesh.cell == "tetrahedron"):
        return nodes.load[::d]
    linear = replace(bare, bodies=tuple(replace(b, degree=1) for b in scene.bodies))
    vertices = assemble(linear)
    result = np.zeros(len(nodes.points))
    for body_number in range(len(scene.bodies)):
        here = np.flatnonzero(nodes.body == body_number)
        there = np.flatnonzero(vertices.body == body_number)
        _, at = cKDTree(nodes.points[here]).query(vertices.points[there])
        result[here[at]] = vertices.load[::d][there]
    return result
