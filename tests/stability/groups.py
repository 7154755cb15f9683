"""The undecomposed solution of each group of bodies, and how far an answer is from it in each body.

Bodies that pairs connect form a group. Each group is solved for itself, in its own units, about the
rigid motion that its displacement conditions come nearest to: a soft body's accuracy does not
suffer from a stiff neighbour, nor the strains of a body from how far it is moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tests import reference
from tests.stability.polish import polish

REFERENCE = 1e-7
"""Relative residual of the optimality conditions that the reference may leave here."""

IDLE = 1e-3
"""Load of a body over that of its group below which its strains need fewer digits: the answer's
error is then measured as if the body carried so much, as the certificate has it."""

STILL = 1e-18
"""Squared strains over those that loads make at their nodes alone, that are rounding errors."""

CANCELLING = 1e-9
"""Energies over the works that cancel in them, below which differences are rounding errors."""

EPSILON = float(np.finfo(float).eps)

FORCE_DIGITS = 1e-7
"""Forces that rounding of displacements makes over the load, beyond which a certificate may miss:
the program does not pass forces of fewer than six digits."""


@dataclass(frozen=True, eq=False)
class Solved:
    """Data of one body.

    Attributes
    ----------
    scale : float
        What squared errors in energy norm are relative to; 0 where nothing strains the body.
    blur : float
        What rounding makes of coordinates, and so of gaps.
    """

    dofs: np.ndarray  # (n,)
    """Its unknowns among those of the system."""
    stiffness: sp.csr_matrix  # (n, n)
    motions: np.ndarray  # (n, 3 or 6)
    """Orthonormal rigid motions."""
    u: np.ndarray
    load: np.ndarray
    """Displacements and loads. Shape (n,)."""
    strain: float
    """a(u, u)."""
    scale: float
    force: float
    """Sum of the magnitudes of loads, or of reactions and contact forces."""
    blur: float

    def error(self, u: np.ndarray) -> float:
        """Squared energy norm of a difference from displacements (dofs,) over the scale."""
        error = strain_of(self.stiffness, self.motions, u[self.dofs] - self.u) ** 0.5
        blurred = float(self.stiffness.diagonal().sum()) ** 0.5 * self.blur
        square = max(0.0, error - blurred) ** 2
        if self.scale > 0.0:
            return square / self.scale
        return float(square > 1e4 * self.rounding)

    @property
    def rounding(self) -> float:
        """Squared energy norm of what rounding makes of the displacements."""
        largest = float(np.abs(self.u).max(initial=0.0))
        return float(self.stiffness.diagonal().sum()) * (EPSILON * largest) ** 2

    def has_digits(self, tolerance: float) -> bool:
        """Whether displacements in double precision can show the strains to a tolerance."""
        largest = float(np.abs(self.u).max(initial=0.0))
        sums = np.asarray(abs(self.stiffness).sum(axis=1)).ravel()
        forces = EPSILON * largest * float(np.linalg.norm(sums))  # of products K u
        enough = forces <= FORCE_DIGITS * self.force
        return enough and 10.0 * self.rounding <= tolerance * self.scale


@dataclass(frozen=True, eq=False)
class Known:
    """The undecomposed solution."""

    energy: float
    floor: float
    """Size of energies whose differences may be rounding errors of works that cancel."""
    bodies: tuple[Solved, ...]
    """One for each body."""

    @property
    def blur(self) -> float:
        """Energy that rounding of coordinates may make: the works of forces on gaps."""
        return sum(body.force * body.blur for body in self.bodies)

    def worst(self, u: np.ndarray) -> tuple[float, int]:
        """Largest error of a body in displacements (dofs,), and the body."""
        errors = [body.error(u) for body in self.bodies]
        return max(errors), int(np.argmax(errors))


def groups_of(scene: Any) -> list[np.ndarray]:
    """Bodies of each group that pairs connect."""
    count = len(scene.bodies)
    ends = [(pair.body, pair.other) for pair in scene.pairs]
    rows, columns = np.array(ends, int).reshape(-1, 2).T
    graph = sp.coo_matrix((np.ones(len(ends)), (rows, columns)), (count, count))
    groups, group = connected_components(graph, directed=False)
    return [np.flatnonzero(group == g) for g in range(groups)]


def in_order(system: reference.System, points: np.ndarray, u: np.ndarray) -> np.ndarray | None:
    """Displacements in the order of the reference's unknowns; None where points do not match.

    Both have the nodes of one body after those of the other.
    """
    if len(points) != len(system.points):
        return None
    result = np.empty_like(u)
    for body in np.unique(system.body):
        here = np.flatnonzero(system.body == body)
        theirs = system.points[here]
        distance, order = cKDTree(points[here]).query(theirs)
        if distance.max() > 1e-9 * np.ptp(theirs, axis=0).max() or np.unique(order).size < len(
            here
        ):
            return None
        result[here] = u[here][order]
    return np.asarray(result.ravel())


def solve(
    system: reference.System, groups: Sequence[np.ndarray], near: np.ndarray | None = None
) -> Known:
    """Solve group by group.

    Groups on which the reference fails are solved with residuals in extended precision (`polish`),
    beginning with what is closed in `near`.

    Raises
    ------
    ReferenceError
        One has no solution that the reference can vouch for.
    """
    found = [_solve_group(system, group, near) for group in groups]
    bodies = sorted((body for _, _, some in found for body in some), key=lambda b: b.dofs[0])
    return Known(sum(f[0] for f in found), sum(f[1] for f in found), tuple(bodies))


def _solve_group(
    system: reference.System, group: np.ndarray, near: np.ndarray | None
) -> tuple[float, float, list[Solved]]:
    """Energy, the floor of its differences, and the bodies of one group."""
    parts = [_dofs(system, body) for body in group]
    dofs = np.concatenate(parts)
    rows = np.isin(system.contact_node, np.flatnonzero(np.isin(system.body, group)))
    motions = [rigid_motions(system, body) for body in group]
    moved = np.concatenate(
        [_rigid_part(system, part, R) for part, R in zip(parts, motions, strict=True)]
    )
    K, load = system.stiffness[dofs][:, dofs], system.load[dofs]
    B = sp.csr_matrix(system.contact)[rows][:, dofs]
    held = system.held[dofs]
    v = np.where(held, system.prescribed[dofs] - moved, 0.0)
    gap = system.gap[rows] - B @ moved
    programme = K[~held][:, ~held], (load - K @ v)[~held], B[:, ~held], gap - B @ v
    extent = float(np.ptp(system.points[np.isin(system.body, group)], axis=0).max())
    try:
        found, multiplier = reference.minimise(*programme, extent, tolerance=REFERENCE)[:2]
        polished = polish(*programme, multiplier)
        v[~held] = found if polished is None else polished
    except reference.ReferenceError:
        if near is None:
            raise
        start = (near[dofs] - moved)[~held]
        exact = polish(*programme, _pressing(programme, start))
        if exact is None:
            raise
        v[~held] = exact
    bodies, start = [], 0
    for part, R in zip(parts, motions, strict=True):
        at = slice(start, start + len(part))
        bodies.append(_body(system, part, R, moved[at], v[at]))
        start += len(part)
    work, strain = float(load @ v + load @ moved), 0.5 * sum(body.strain for body in bodies)
    scaled = _scaled(bodies)
    still = sum(body.scale for body in scaled if body.scale > 2.0 * strain)
    return strain - work, CANCELLING * (strain + abs(work)) + still, scaled


def _pressing(programme: tuple[Any, ...], u: np.ndarray) -> np.ndarray:
    """One for rows that displacements close, (rows,)."""
    slack = programme[3] - programme[2] @ u
    return np.asarray(slack <= 1e-7 * np.abs(u).max(initial=0.0), float)


def _body(
    system: reference.System, dofs: np.ndarray, R: np.ndarray, moved: np.ndarray, v: np.ndarray
) -> Solved:
    """Data of one body before its scale is known."""
    K, load = system.stiffness[dofs][:, dofs], system.load[dofs]
    reactions = float(np.abs(K @ v - load).sum())
    force = max(float(np.abs(load).sum()), reactions)
    blur = (
        2.0
        * EPSILON
        * float(np.abs(system.points[dofs[:: system.dimension] // system.dimension]).max())
    )
    return Solved(dofs, K, R, moved + v, load, strain_of(K, R, v), 0.0, force, blur)


def _scaled(bodies: list[Solved]) -> list[Solved]:
    """The bodies of a group with what their errors are relative to."""
    strain = sum(body.strain for body in bodies)
    alone = sum(float((b.load**2 / b.stiffness.diagonal()).sum()) for b in bodies)
    force = sum(body.force for body in bodies)
    result = []
    for b in bodies:
        share = max(1.0, IDLE * force / b.force) if b.force > 0.0 else np.inf
        scale = min(b.strain * share**2, strain) if b.strain > 0.0 else strain
        if strain <= max(STILL * alone, 1e4 * sum(other.rounding for other in bodies)):
            scale = alone
        result.append(replace(b, scale=scale))
    return result


def strain_of(K: sp.csr_matrix, R: np.ndarray, u: np.ndarray) -> float:
    """a(u, u); rigid motions R leave no rounding errors in it."""
    for _ in range(2):
        u = u - R @ (R.T @ u)
    return max(0.0, float(u @ (K @ u)))


def _dofs(system: reference.System, body: int) -> np.ndarray:
    """Unknowns of a body."""
    nodes = np.flatnonzero(system.body == body)
    return np.asarray((nodes[:, None] * system.dimension + np.arange(system.dimension)).ravel())


def _rigid_part(system: reference.System, dofs: np.ndarray, R: np.ndarray) -> np.ndarray:
    """The rigid motion nearest to the prescribed displacements of a body."""
    held = system.held[dofs]
    if not held.any():
        return np.zeros(len(dofs))
    return np.asarray(R @ np.linalg.lstsq(R[held], system.prescribed[dofs][held], rcond=1e-10)[0])


def rigid_motions(system: reference.System, body: int) -> np.ndarray:
    """Orthonormal translations and infinitesimal rotations of a body, (n, 3 or 6)."""
    points = system.points[system.body == body]
    points = points - points.mean(axis=0)
    points = points / np.abs(points).max()
    return np.asarray(np.linalg.qr(motions_at(points, system.dimension))[0])


def motions_at(points: np.ndarray, dimension: int) -> np.ndarray:
    """Translations and infinitesimal rotations at the points, shape (n·dimension, 3 or 6)."""
    columns = [np.tile(np.eye(dimension)[i], len(points)) for i in range(dimension)]
    for a, b in ((0, 1), (1, 2), (0, 2))[: 1 if dimension == 2 else 3]:
        turn = np.zeros((len(points), dimension))
        turn[:, a], turn[:, b] = -points[:, b], points[:, a]
        columns.append(turn.ravel())
    return np.array(columns).T
