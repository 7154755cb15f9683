"""The largest pressure by Hertz's theory, for contacts whose facets are too coarse to show it.

The gap of the undeformed bodies about the middle of the contact forces is fitted by a quadratic,

    g ≈ c + b·x + A s² + B t²,     A ≤ B,

with s and t along the surface. For a force F and 1/E* = Σ (1 - ν²)/E, the half axes a ≥ b of the
ellipse, k = b/a and the elliptic integrals K and E of m = 1 - k² satisfy

    A/B = (K - E)/(E/k² - K),     B = p0 b (E/k² - K)/(E* m a²),     F = 2π a b p0/3,

and a line contact with the force q per length p0 = √(2 q E* B/π) (K. L. Johnson, *Contact
Mechanics*, 1985, sections 4.1 and 4.2). The force and the curvatures are right on coarse meshes,
too, where the pressure is not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from contact_app.accuracy.contact_limits import PressedFacets
from contact_app.model.model import Model
from contact_app.results.fields import NodeFields
from contact_app.scene.conditions import BodyContact
from meshes.arrays import Array

REACH = 3.0
"""Radius about the middle of the contact within which gaps are fitted, over a facet's longest edge.
It has some 25 nodes of quadrilaterals for the six coefficients."""

SLENDER, ROUND = 0.03, 1e-6
"""Ratio of the axes of an ellipse up to which the contact is taken for that of a roller, and its
difference from one up to which it is taken for that of a ball."""

LARGER = 1.5
"""Half length of the contact, less a facet, over Hertz's, or the other way round, from which on it
is no contact of his kind: an edge or a flat face has no curvature, and his would be larger."""

MISFIT = 0.02
"""Largest root of the mean squared misfit over the range of the gaps. Flat facets of round surfaces
have a larger one, and their curvature is not that of the surface."""


def hertz_peak(model: Model, nodes: NodeFields, facets: PressedFacets, number: int) -> float | None:
    """Hertz's largest pressure of a contact of a scene with a force (collective).

    None where the contact is not of his kind: of other size than the theory says, with a gap that
    is no quadratic, or at bodies of several materials.
    """
    comm, d, modulus = model.comm, model.scene.dimension, _modulus(model, number)
    strongest = float(np.abs(nodes.contacts[number].forces).max(initial=0.0))
    if comm.allreduce(strongest, op=MPI.MAX) ** 2 == 0.0:  # as are the squares of such forces
        return None
    loaded = facets.corners[(facets.pressure > 0.0).any(axis=1)]
    edges = np.linalg.norm(loaded - np.roll(loaded, 1, axis=1), axis=2)
    size = comm.allreduce(float(edges.max(initial=0.0)), op=MPI.MAX)
    contact, rows = nodes.contacts[number], model.problem.contact
    planes = facets.planes_at_end(comm)
    places = nodes.points[contact.nodes - nodes.first]
    force, middle, moment = _moments(comm, places, contact.forces, planes)
    near = np.linalg.norm(rows.points - middle, axis=1) < REACH * size
    near &= rows.sources == number
    parts = comm.allgather((rows.points[near] - middle, rows.gaps[near], rows.normals[near]))
    points, gaps, normals = (np.concatenate(part) for part in zip(*parts, strict=True))
    for axis, _ in planes:
        points, gaps = np.concatenate([points, points * _mirror(axis)]), np.tile(gaps, 2)
        normals[:, axis] = 0.0
    if modulus is None or not normals.any():
        return None
    along = np.linalg.svd(normals.sum(axis=0)[None])[2][1:]  # (d - 1, d)
    bends = _curvatures(points[:, :d] @ along.T / (REACH * size), gaps)
    if bends is None or bends[-1] <= 0.0:
        return None
    lengths = np.sqrt(np.maximum(np.linalg.eigvalsh(along @ moment[:d, :d] @ along.T), 0.0))
    return peak_of(force, modulus, bends / (REACH * size) ** 2, lengths, size)


def _mirror(axis: int) -> Array:
    return np.where(np.arange(3) == axis, -1.0, 1.0)


def _modulus(model: Model, number: int) -> float | None:
    """E* of the bodies of a contact; None if one has several materials."""
    scene, touching = model.scene, model.scene.touching[number]
    bodies = [touching.body, *([touching.other] if isinstance(touching, BodyContact) else [])]
    materials = [set(scene.bodies[b].materials) for b in bodies]
    if any(len(of_body) > 1 for of_body in materials):
        return None
    across = 0.0 if scene.plane == "stress" else 1.0
    return 1.0 / sum((1.0 - across * m.poisson**2) / m.young for (m,) in materials)


def _moments(
    comm: MPI.Intracomm, places: Array, forces: Array, planes: Sequence[tuple[int, float]]
) -> tuple[float, Array, Array]:
    """Force of a contact with its images, its middle (3,), and its second moments (3, 3)."""
    amount = np.linalg.norm(forces, axis=1)
    sums = comm.allreduce(np.concatenate([amount @ places, forces.sum(axis=0), [amount.sum()]]))
    middle, resultant, total = sums[:3] / sums[6], sums[3:6], sums[6]
    for axis, place in planes:
        middle[axis], resultant[axis] = place, 0.0
    away = places - middle
    moment = comm.allreduce(np.einsum("n,ni,nj->ij", amount, away, away)) / total
    for axis, _ in planes:  # products with other axes cancel those of the image
        moment *= np.equal.outer(*2 * [np.arange(3) == axis])
    return float(np.linalg.norm(resultant)) * 2 ** len(planes), middle, moment


def _curvatures(points: Array, gaps: Array) -> Array | None:
    """Coefficients of s² and t², ascending, of the gaps at points (n, d - 1) in the unit disc.

    None where the gap is no quadratic, or has too few points.
    """
    columns = points.T
    squares = [a * b for i, a in enumerate(columns) for b in columns[i:]]
    terms = np.stack([np.ones(len(gaps)), *columns, *squares], axis=1)
    weight = 1.0 - (points**2).sum(axis=1)
    fitted, _, rank, _ = np.linalg.lstsq(terms * weight[:, None], gaps * weight, rcond=None)
    off = (terms @ fitted - gaps) * weight
    if rank < terms.shape[1] or off @ off > len(off) * (MISFIT * np.ptp(gaps)) ** 2:
        return None
    if points.shape[1] == 1:
        return np.asarray(fitted[-1:])
    aa, ab, bb = fitted[-3:]
    return np.asarray(np.linalg.eigvalsh([[aa, ab / 2.0], [ab / 2.0, bb]]))


def peak_of(
    force: float, modulus: float, bends: Array, lengths: Array, size: float
) -> float | None:
    """Hertz's pressure by coefficients of the gap, (d - 1,); None for a contact of other size.

    Parameters
    ----------
    lengths : (d - 1,)
        Roots of the second moments of the pressure over its force, ascending: half lengths over √5
        of an ellipsoid, over 2 of a half ellipse on a line, over √3 of a constant.
    size
        Of the facets, which is the error of lengths.
    """
    low, high = bends[0] / bends[-1], bends[-1]
    if len(bends) == 2 and low > _quotient(SLENDER):
        k = 1.0 - ROUND
        if low < _quotient(k):
            k = brentq(lambda k: np.log(_quotient(k) / low), SLENDER, k)
        a = (1.5 * force * _integrals(k)[1] / (np.pi * modulus * high * (1.0 - k * k))) ** (1 / 3)
        peak, half, factor = 1.5 * force / (np.pi * k * a**2), a * np.array([k, 1.0]), 5.0**0.5
    else:
        length = np.sqrt(12.0) * lengths[-1] if len(bends) == 2 else 1.0
        if low < -_quotient(SLENDER) or (len(bends) == 2 and length < 2.0 * size):
            return None
        peak = np.sqrt(2.0 * force / length * modulus * high / np.pi)
        half, factor = np.array([peak / (modulus * high), np.inf][: len(bends)]), 2.0
    observed, finite = factor * lengths, np.isfinite(half)
    close = observed < LARGER * half + size
    close[finite] &= half[finite] < LARGER * observed[finite] + size
    return float(peak) if close.all() else None


def _quotient(k: float) -> float:
    """A/B of an ellipse with the half axes a and k a."""
    upper, lower = _integrals(k)
    return upper / lower


def _integrals(k: float) -> tuple[float, float]:
    """K - E and E/k² - K."""
    first, second = ellipk(1.0 - k * k), ellipe(1.0 - k * k)
    return float(first - second), float(second / k**2 - first)
