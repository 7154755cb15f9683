"""Whether bodies can be in equilibrium, from their rigid motions alone.

Bodies that may touch each other are examined together, with the rigid motions of all of them; a
body that touches nothing but obstacles by itself. They are in equilibrium iff the load can be
balanced by reactions of held rows (any sign) and of contact rows (compression only):

    e = Dᵀ λ_D + Nᵀ λ_N,  λ_N ≥ 0,

with e the work of the load on the rigid motions (six numbers in space), D and N the held and
contact rows applied to the rigid motions. By Farkas' lemma there is no such λ iff there is a
rigid motion r with D r = 0, N r ≤ 0 and eᵀ r > 0: the body leaves in the direction r, and the
load drives it. The residual of the non-negative least-squares problem is this r.

With Coulomb friction the contact forces of a point lie in a cone, that of the rays N + μ t of all
unit tangents t, and with Tresca friction the friction forces of all points together in a convex
set. Among these forces the one that opposes a motion r most is the ray with t along T r: r is an
escape iff N r + μ |T r| ≤ 0 at each point and eᵀ r > Σ s |T r|.

The problem has six equations and as many unknowns as contact rows, spread over ranks. It is
solved by column generation: each round every rank offers the row, or the ray, that the residual
violates most, and the small problem of all rows offered so far is solved anew, by scipy's bounded
least squares (its `nnls` returned points that are not optimal in one release).
"""

from dataclasses import dataclass, field, replace

import numpy as np
from mpi4py import MPI
from scipy.linalg import eigh, qr

from solver.vectors import Array, Ints, Mask

ROUNDS = 200
"""Largest number of steps of a search.

Each step lowers the share, or adds a row or a friction force.
"""

SLIDING = 0.03
"""Sine of the angle between a motion and the surfaces, below which the motion counts as a slide.

Normals of a ball of 2.6 to 10 facets a radian are off by 0.002 to 0.015.
"""

HEAVY = 1e3
"""Weight of the equation that the shares of friction forces add up to one: the sum is off by the
residual over its square, which vanishes in equilibrium; 1e6 left residuals of rounding errors."""

SHARE_TOLERANCE = 1e-6
"""Relative accuracy of the share of a load that is in equilibrium."""

NO_SHARE = 1e-6
"""Share of a load below which its work counts as zero: motions carry rounding errors."""

LIFT = 1e-6
"""Lift over the largest lift, and length of a normalised motion, below which they count as zero."""


@dataclass(frozen=True, eq=False)
class BodyBalance:
    """The equilibrium of one body, or of several that may touch each other."""

    free_motions: Array  # (motions, k)
    """Orthonormal rigid motions on which all rows vanish: the body can slide along them."""
    escape: Array | None  # (motions,) or None
    """The normalised rigid motion in which the bodies leave; None in equilibrium."""
    held: bool
    """Whether the held rows alone stop every rigid motion."""
    steady: bool = False
    """Whether the held rows and the tied rows of its group together stop every rigid motion."""
    loose: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (motions, k)
    """The body's part of orthonormal motions of its group on which the contact rows, or all rows,
    are nearly zero."""
    allowed: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (motions, k)
    """The body's part of orthonormal motions of its group that the held and tied rows leave
    free."""


@dataclass(frozen=True, eq=False)
class FrictionCones:
    """Tangential rows of this rank's contact points with friction."""

    slips: Array  # (k, motions)
    """Tangential rows applied to the rigid motions; the tangential rows of one point belong to one
    contact row."""
    normal: Ints  # (k,)
    """Contact row of each tangential row."""
    coefficients: Array
    limits: Array
    """Coefficient μ and given slip limit (force) of each row; one of the two is 0. Shapes (k,),
    (k,)."""
    acts: bool = True
    """Whether a contact of any rank has friction."""

    @classmethod
    def none(cls, motions: int) -> "FrictionCones":
        """No rows, of contacts without friction."""
        return cls(np.zeros((0, motions)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0), False)

    def along(self, motions: Array) -> "FrictionCones":
        """The same cones for motions that are combinations (motions, k) of the present motions."""
        return replace(self, slips=self.slips @ motions)

    def directions(self, motion: Array, rows: int) -> Array:
        """T r over its length at each point, zero where the point does not slide, (k,)."""
        slip = self.slips @ motion
        size = np.sqrt(np.bincount(self.normal, slip**2, rows))[self.normal]
        return np.divide(slip, size, out=np.zeros(len(slip)), where=size > 0.0)

    def opposing(self, rows: Array, motion: Array) -> Array:
        """Contact rows (rows, motions) plus the friction that opposes a motion most."""
        pull = (self.coefficients * self.directions(motion, len(rows)))[:, None] * self.slips
        result = rows.copy()
        np.add.at(result, self.normal, pull)
        return result

    def power_of_limits(self, motion: Array, rows: int) -> Array:
        """The power of friction with given limits against each motion, (motions,)."""
        return (self.limits * self.directions(motion, rows)) @ self.slips


def balance(
    comm: MPI.Intracomm,
    held: Array,
    contact: Array,
    load: Array,
    load_scale: float,
    friction: FrictionCones | None = None,
) -> BodyBalance:
    """Examine the equilibrium of one body, or of several together (collective).

    Parameters
    ----------
    held : (rows, motions)
        This rank's held rows applied to the rigid motions, body by body.
    contact : (rows, motions)
        This rank's contact rows applied to the rigid motions, directed into the obstacle.
    load : (motions,)
        Work of all loads on the rigid motions, summed over ranks.
    load_scale
        Sum of the magnitudes of the loads; smaller residuals than 1e-9 of it are round-off.
    friction
        Friction of some contact rows; none unless given.
    """
    friction = friction or FrictionCones.none(contact.shape[1])
    gram_held = comm.allreduce(held.T @ held)
    gram_contact = comm.allreduce(contact.T @ contact + friction.slips.T @ friction.slips)
    allowed = _null_space(gram_held)
    free = _null_space(gram_held + gram_contact)
    if allowed.shape[1] == 0:
        return BodyBalance(free, None, held=True)
    rows, cones = contact @ allowed, friction.along(allowed)
    residual = _residual(comm, rows, allowed.T @ load, 1e-9 * load_scale, cones)
    escape = None if residual is None else allowed @ (residual / np.linalg.norm(residual))
    return BodyBalance(free, escape, held=False)


def carried_share(
    comm: MPI.Intracomm, held: Array, contact: Array, load: Array, friction: FrictionCones
) -> float | None:
    """The largest t ≤ 1 for which t times a load is in equilibrium (collective).

    The loads that are in equilibrium form a convex set that contains zero. Without given slip
    limits it is a cone: for a load outside of it t is zero. With given limits t is the least Σ
    s |T r| / eᵀ r over motions r with D r = 0 and N r + μ |T r| ≤ 0 that the load drives. Each
    escape at one t is such a motion, and its quotient is the next t, until nothing escapes
    (Dinkelbach 1967).

    Parameters
    ----------
    held, contact, load, friction
        As in `balance`.

    Returns
    -------
    None where t is zero.
    """
    share = 1.0
    for _ in range(ROUNDS):
        part = share * load
        escape = balance(comm, held, contact, part, float(np.abs(part).sum()), friction).escape
        if escape is None:
            return share
        resisted = comm.allreduce(friction.power_of_limits(escape, len(contact)) @ escape)
        bound = float(resisted / (load @ escape))
        if bound < NO_SHARE:
            return None
        if bound > (1.0 - SHARE_TOLERANCE) * share:
            return bound
        share = bound
    return share


def slide(
    comm: MPI.Intracomm, held: Array, contact: Array, escape: Array, friction: FrictionCones
) -> Array:
    """The normalised part of an escape along surfaces that stay in contact (collective).

    An escape is normal to the friction cones: where a point slides by |T r| it also lifts by
    μ |T r|. Coulomb's law has no such lift. The part of the escape without lift is the slide. If
    nothing remains, as in a wedge, or if other points would be pressed in, the escape itself is
    returned.

    Parameters
    ----------
    held, contact, friction
        As in `balance`.
    escape : (motions,)
    """
    rise = contact @ escape
    largest = comm.allreduce(np.abs(rise).max(initial=0.0), op=MPI.MAX)
    slides = friction.opposing(contact, escape) @ escape >= -LIFT * largest
    stays = np.concatenate([held, contact[slides]])
    left = _null_space(comm.allreduce(stays.T @ stays))
    result = left @ (left.T @ escape)
    size = np.linalg.norm(result)
    pressed = comm.allreduce((contact @ result).max(initial=0.0), op=MPI.MAX)
    if size < LIFT or pressed > LIFT * largest:
        return escape
    return np.asarray(result / size)


def held_motions(comm: MPI.Intracomm, held: Array) -> Array:
    """Orthonormal rigid motions (motions, k) that no held row (rows, motions) stops."""
    return _null_space(comm.allreduce(held.T @ held))


def holds(comm: MPI.Intracomm, held: Array) -> bool:
    """Whether held rows (rows, motions) of all ranks alone stop every rigid motion."""
    return held_motions(comm, held).shape[1] == 0


def loose_motions(comm: MPI.Intracomm, held: Array, contact: Array, moved: Array) -> Array:
    """Orthonormal motions of a group that held rows leave free and contact rows hardly resist.

    Along such a motion v the surfaces slide: Σ (nᵀ v)² ≤ `SLIDING`² Σ |v|² over contact rows, as
    where a ball turns between races and the facets of its mesh alone resist (collective).

    Parameters
    ----------
    held, contact
        As in `balance`.
    moved : (rows · dimension, motions)
        How the two sides of each contact row move relative to each other.
    """
    allowed = _null_space(comm.allreduce(held.T @ held))
    resisted, motion = (
        allowed.T @ comm.allreduce(rows.T @ rows) @ allowed for rows in (contact, moved)
    )
    if allowed.shape[1] == 0 or not motion.any():
        return allowed[:, :0]
    motion += 1e-9 * np.trace(motion) * np.eye(len(motion))
    values, vectors = eigh(resisted, motion)
    return np.linalg.qr(allowed @ vectors[:, values <= SLIDING**2])[0]


def undetermined_motions(
    comm: MPI.Intracomm, allowed: Array, contact: Array, presses: Mask, loose: Array
) -> Array:
    """Orthonormal motions of a group that move open contact rows and no row with a force.

    No load works on them, since the rows with a force balance all loads, and none strains a body:
    an answer may be moved along them until a row closes that is open (collective).

    Parameters
    ----------
    allowed, loose : (motions, k), (motions, l)
        As in `BodyBalance`; the part along `loose` is left out.
    contact, presses : (rows, motions), (rows,)
        This rank's contact rows, and tangential ones, applied to the rigid motions; which of them
        have a force or a slip limit.
    """
    if allowed.shape[1] == 0:
        return allowed
    rows = contact @ allowed
    free, open_motions = (
        allowed @ _null_space(comm.allreduce(some.T @ some)) for some in (rows, rows[presses])
    )
    components = np.hstack([free, loose]).T @ open_motions
    if not components.any():
        return open_motions
    return np.asarray(open_motions @ _null_space(components.T @ components))


def spanned(motions: Array) -> Array:
    """Orthonormal basis of the span of motions (n, k), without nearly dependent ones."""
    basis, size, _ = np.linalg.svd(motions, full_matrices=False)
    return np.asarray(basis[:, size > 1e-6])


def by_body(free: Array, motions: int) -> list[Array]:
    """Distribute joint motions among bodies: holding all parts holds all motions.

    Parameters
    ----------
    free : (bodies · motions, k)
        Joint motions of all bodies.

    Returns
    -------
    For each body orthonormal motions (motions, k_b), Σ k_b = k.
    """
    shares = []
    left = free
    for start in range(0, len(free), motions):
        part = left[start : start + motions]
        if left.shape[1] == 0:
            shares.append(part)
            continue
        u, size, vt = np.linalg.svd(part)
        rank = int((size > 1e-6).sum())
        onto = u[:, :rank] @ u[:, :rank].T  # pivoting prefers motions along axes
        shares.append(qr(onto, pivoting=True)[0][:, :rank])
        left = left @ vt[rank:].T
    return shares


def _residual(
    comm: MPI.Intracomm, rows: Array, load: Array, tolerance: float, friction: FrictionCones
) -> Array | None:
    """Residual of min ‖load - rowsᵀ λ - friction‖ over λ ≥ 0, or None if it vanishes."""
    chosen, bounded = np.zeros((0, len(load))), np.zeros((0, len(load)))
    residual = load
    for _ in range(ROUNDS):
        if np.linalg.norm(residual) <= tolerance:
            return None
        rays = friction.opposing(rows, residual)
        violation = rays @ residual
        best = int(np.argmax(violation)) if len(violation) else -1
        threshold = 1e-10 * np.linalg.norm(residual)
        offer = rays[best] if best >= 0 and violation[best] > threshold else None
        offers = [row for row in comm.allgather(offer) if row is not None]
        fresh = [row for row in offers if not (np.abs(chosen - row).max(axis=1) < 1e-14).any()]
        pull = friction.power_of_limits(residual, len(rows))
        pull = _new_friction_sum(comm, pull, bounded, residual)
        if not fresh and not len(pull):
            return residual
        chosen, bounded = np.vstack([chosen, *fresh]), np.vstack([bounded, pull])
        residual = load - _nearest(chosen, bounded, load)
    return None if friction.acts else residual


def _new_friction_sum(comm: MPI.Intracomm, pull: Array, bounded: Array, residual: Array) -> Array:
    """The sum of friction forces with given limits that oppose a motion, if new, (0 or 1, n)."""
    pull = comm.allreduce(pull)
    largest = max((bounded @ residual).max(initial=0.0), 0.0)
    if pull @ residual <= largest + 1e-10 * np.linalg.norm(residual) * np.linalg.norm(pull):
        return np.zeros((0, len(pull)))
    return pull[None]


def _nearest(chosen: Array, bounded: Array, load: Array) -> Array:
    """The nearest point to the load of  chosenᵀ λ + boundedᵀ w,  λ, w ≥ 0, Σ w ≤ 1."""
    columns, target = chosen.T, load
    if len(bounded):  # with a slack variable the sum is one; its equation weighs most
        heavy = HEAVY * max(np.abs(bounded).max(), np.abs(load).max())
        sums = np.concatenate([np.zeros(len(chosen)), np.full(len(bounded) + 1, heavy)])
        columns = np.hstack([columns, bounded.T, np.zeros((len(load), 1))])
        columns, target = np.vstack([columns, sums]), np.append(load, heavy)
    weights = np.linalg.lstsq(columns, target, rcond=None)[0]
    if (weights < 0.0).any():
        from scipy.optimize import lsq_linear  # slow to import, rarely needed

        weights = lsq_linear(
            columns, target, bounds=(0.0, np.inf), method="bvls", tol=1e-14, max_iter=1000
        ).x
    return np.asarray((columns @ weights)[: len(load)])


def _null_space(gram: Array) -> Array:
    """Orthonormal null space of a small Gram matrix."""
    values, vectors = np.linalg.eigh(gram)
    return vectors[:, values <= 1e-12 * values.max(initial=np.finfo(float).tiny)]
