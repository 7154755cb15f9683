"""Tests whether the largest pressure of a contact is that of a sharp edge.

Where an edge of one body presses into the other, which goes on beyond the edge, the pressure of the
theory is infinite: as r^(-1/2) at the distance r from the edge of a rigid punch, as r^(-0.23) from
the right-angled edge of a body of the same material (J. Dundurs, M.-S. Lee, *Stress concentration
at a sharp edge in contact problems*, J. Elasticity 2, 1972). The largest pressure of a mesh then
grows without limit as the mesh is refined. There are three such edges:

* an edge of one of two bodies, where the other has none parallel to it. If both have one there,
  they end together, or a plane of symmetry cuts both, and the pressure need not be infinite. An
  edge of a body that is far softer than the other presses as against an obstacle;
* an edge of a body on an obstacle if the body's angle is larger than a right angle: the body and
  its mirror image are a body with a notch. At right angles without friction the pressure is finite;
* the end of a plane obstacle that acts on a part of a flat surface only: a punch.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress

import numpy as np
from mpi4py import MPI

from contact_app.model.boundaries import boundary_facets, surface_facets
from contact_app.model.model import Model
from contact_app.results.fields import NodeFields
from contact_app.scene.conditions import BodyContact, Contact
from meshes import Reference
from meshes.arrays import Array, Mask
from meshes.contact_surface import Surface

SHARP = np.radians(40.0)
"""Angle between the normals of two facets from which on their edge is sharp. Round surfaces with
nine facets around have smaller ones, chamfers of 45° larger ones."""

BLUNT = np.radians(80.0)
"""Angle between normals below which an edge on an obstacle has an infinite pressure. At a right
angle it is finite; the rest is for planes of symmetry through coarse facets."""

EXCHANGE = "the side of {} as `on` resolves it better"
"""Advice where the pressure is a field on a side that goes on beyond the edge."""

SOFTER = 0.1
"""Ratio of Young's moduli below which a body presses as on an obstacle."""

NEAR = 0.6
"""Distance of the node with the largest pressure from an edge of its own body, over its facets'
edges: the edge's own nodes. An edge of the other body may lie anywhere in its facets."""

ROUNDED = 1e-9
"""Coordinate over the largest one below which it is a rounding error and is written as zero."""

REACH = 4.0
"""Distance within which facets are gathered, over the size of a node's share of its boundary."""


@dataclass(frozen=True, eq=False)
class _Joints:
    """Edges between two facets of a surface, in the plane nodes."""

    turns: Array  # (joints,)
    """Angle between the normals, negative in re-entrant corners."""
    ends: Array  # (joints, d - 1, 3)
    pressed: Mask  # (joints, 2)
    """Mask of facets of the contact boundary."""

    @property
    def sharp(self) -> Mask:
        """Mask (joints,) of the sharp edges of the contact boundary."""
        return np.asarray((self.turns > SHARP) & self.pressed.any(axis=1))

    def distances(self, point: Array) -> Array:
        """Distances from a point, (joints,)."""
        start, along = self.ends[:, 0], self.ends[:, -1] - self.ends[:, 0]
        square = np.einsum("ij,ij->i", along, along)
        place = np.einsum("ij,ij->i", point - start, along) / np.where(square > 0.0, square, 1.0)
        nearest = start + np.clip(place, 0.0, 1.0)[:, None] * along
        return np.asarray(np.linalg.norm(point - nearest, axis=1))


@dataclass(frozen=True, eq=False)
class Skin:
    """The facets of one side of a contact near its largest pressure."""

    surface: Surface
    """Facets of the body, in and beside the contact boundary."""
    joints: _Joints
    """The edges between them."""
    name: str
    stiffness: float
    """Its Young's modulus, in a unit common to both sides."""

    @classmethod
    def of(cls, surface: Surface, pressed: Surface, name: str, stiffness: float) -> "Skin":
        """The facets of a body, of which some belong to the contact boundary."""
        pressed_facets = {tuple(row) for row in np.sort(pressed.nodes, axis=1)}
        on = np.array([tuple(row) in pressed_facets for row in np.sort(surface.nodes, axis=1)])
        return cls(surface, _joints(surface, on), name, stiffness)


def sharp_peaks(model: Model, nodes: NodeFields, pressed: Sequence[bool]) -> list[str]:
    """Warnings on contacts with a force whose largest pressure is at a sharp edge (collective)."""
    sentences = []
    for touching, at_nodes in compress(
        zip(model.scene.touching, nodes.contacts, strict=True), pressed
    ):
        places = nodes.points[at_nodes.nodes - nodes.first], at_nodes.shares
        pressures = at_nodes.pressure, at_nodes.smoothed
        edge_at = partial(_edge_at, model, touching)
        if text := sharp_peak(model.comm, model.scene.dimension, pressures, places, edge_at):
            sentences.append(f"{touching.source}: {text}")
    return sentences


def _edge_at(model: Model, touching: Contact | BodyContact, point: Array, reach: float) -> str:
    """Phrase on the sharp edge of a contact at a point, from the facets within a distance."""
    sides, end = [skin_near(model, touching.body, touching.boundary, point, reach)], ""
    if isinstance(touching, BodyContact):
        sides.append(skin_near(model, touching.other, touching.other_boundary, point, reach))
    elif touching.obstacle.curvature_radius is None:
        end = touching.boundary
    return sharp_edge(point, sides, end)


def sharp_peak(
    comm: MPI.Intracomm,
    d: int,
    pressures: tuple[Array, Array],
    places: tuple[Array, Array],
    edge_at: Callable[[Array, float], str],
) -> str:
    """Sentence on a largest pressure at a sharp edge, or if there is none, on a smoothed one there.

    Empty if neither is at a sharp edge (collective).

    Parameters
    ----------
    pressures : (n,), (n,)
        The pressure and the smoothed pressure at the nodes of a contact on this rank.
    places : (n, 3), (n,)
        Points of the nodes, and integrals of their shape functions.
    edge_at
        Phrase on the sharp edge at a point, from the facets within a distance.
    """
    for name, values in zip(("pressure", "smoothed pressure"), pressures, strict=True):
        largest, point, size = peak(comm, values, *places, d)
        edge = edge_at(point, REACH * size) if largest > 0.0 else ""
        if edge:
            return sentence(name, largest, point[:d], edge)
    return ""


def peak(
    comm: MPI.Intracomm, pressure: Array, points: Array, shares: Array, d: int
) -> tuple[float, Array, float]:
    """Largest pressure of a contact, its place, and the size of the node's share (collective).

    Parameters
    ----------
    pressure, points, shares : (n,), (n, 3), (n,)
        At nodes of this rank, with the integrals of their shape functions.
    """
    largest: tuple[float, tuple[float, ...], float] = (0.0, (0.0, 0.0, 0.0), 0.0)
    if len(pressure):
        k = int(np.argmax(pressure))
        share = float(shares[k]) ** (1.0 / (d - 1))
        largest = float(pressure[k]), tuple(map(float, points[k])), share
    most, point, size = max(comm.allgather(largest))
    return most, np.array(point), size


def sharp_edge(point: Array, sides: Sequence[Skin | None], end: str) -> str:
    """Phrase that names the sharp edge at a point; empty if there is none.

    Parameters
    ----------
    sides
        That of the pressure, and the other body's unless the contact is with an obstacle.
    end
        Name of the contact boundary if a plane obstacle may end with it: a punch.
    """
    on = sides[0]
    if on is None:
        return ""
    facet = _facet_edge(on.surface, point)
    away = on.joints.distances(point)
    near = away <= NEAR * facet
    sharp = near & on.joints.sharp
    if len(sides) == 1:
        if (sharp & (on.joints.turns < BLUNT)).any():
            return f"at a sharp edge of {on.name}"
        flat = near & (on.joints.turns < SHARP) & (on.joints.pressed.sum(axis=1) == 1)
        return f"at the end of {end}" if flat.any() and end else ""
    other = sides[1]
    if other is None:
        return ""
    across = other.joints
    opposite = across.sharp & (across.distances(point) <= 1.01 * facet)
    close = on.joints.sharp & (away <= 1.01 * facet)
    reach = NEAR * facet
    of_own = ~_together(on.joints.ends[sharp], across.ends[opposite], reach).any(axis=1)
    of_other = ~_together(on.joints.ends[close], across.ends[opposite], reach).any(axis=0)
    alone = of_own.any(), of_other.any()  # an edge along which the other body does not end
    if not any(alone):
        return ""
    pressing, pressed = (on, other) if alone[0] else (other, on)  # the node is on its own edge
    if pressing.stiffness < SOFTER * pressed.stiffness:
        return ""
    hint = "" if pressing is on else f" ({EXCHANGE.format(pressing.name)})"
    return f"at a sharp edge of {pressing.name}{hint}"


def _together(one: Array, two: Array, reach: float) -> Mask:
    """Mask (n, m) of pairs of edges with ends (n, d - 1, 3) and (m, d - 1, 3) that go together.

    They are parallel, which points in the plane are, and their lines lie within a distance.
    """
    along = [ends[:, -1] - ends[:, 0] for ends in (one, two)]
    lengths = [np.linalg.norm(direction, axis=1) for direction in along]
    parallel = np.abs(along[0] @ along[1].T) >= np.cos(SHARP) * np.outer(*lengths)
    unit = along[0] / np.where(lengths[0] > 0.0, lengths[0], 1.0)[:, None]
    offset = two.mean(axis=1)[None] - one.mean(axis=1)[:, None]
    offset -= np.einsum("nmi,ni->nm", offset, unit)[..., None] * unit[:, None]
    return np.asarray(parallel & (np.linalg.norm(offset, axis=2) <= reach))


def skin_near(model: Model, body: int, boundary: str, point: Array, reach: float) -> Skin | None:
    """Facets of a body near a point and the edges between them (collective).

    Facets that are held along one axis only are left out: they lie on planes of symmetry.
    """
    scene, partition = model.scene, model.partition
    every, of_contact = [], []
    references = {id(s.reference): s.reference for s in partition.subdomains}
    extents = {key: _extent(reference) for key, reference in references.items()}
    for s in partition.subdomains:
        rows = contact = np.zeros(0, np.int32)
        lower, upper, facet = extents[id(s.reference)]
        at = point - s.translation
        near = np.linalg.norm(at - np.clip(at, lower, upper)) <= reach + facet
        if s.body == body and near:
            rows = surface_facets(s, scene.bodies[body])
            rows = rows[within(s.points()[s.reference.facets[rows]], point, reach)]
        if len(rows):
            held = [
                boundary_facets(s, scene.bodies[body], condition.boundary)
                for condition in scene.displacements
                if condition.body == body and sum(v is not None for v in condition.values) == 1
            ]
            rows = np.setdiff1d(rows, np.concatenate([*held, rows[:0]]))
            contact = np.intersect1d(rows, boundary_facets(s, scene.bodies[body], boundary))
        every.append(rows)
        of_contact.append(contact)
    surface, pressed = (model.geometry.surface_of(rows) for rows in (every, of_contact))
    if surface is None or pressed is None:
        return None
    return Skin.of(surface, pressed, scene.bodies[body].name, scene.bodies[body].softest)


def _extent(reference: Reference) -> tuple[Array, Array, float]:
    """Corners of the box about a mesh, (3,) each, and the size of its largest facet."""
    points, facets = reference.points, reference.points[reference.facets]
    sizes = np.linalg.norm(np.ptp(facets, axis=1), axis=1)
    return points.min(axis=0), points.max(axis=0), float(sizes.max(initial=0.0))


def within(facets: Array, point: Array, reach: float) -> Mask:
    """Mask of the facets (n, nodes, 3) with a part within some distance of a point."""
    away = np.linalg.norm(facets - point, axis=2).min(axis=1, initial=np.inf)
    return np.asarray(away <= reach + np.linalg.norm(np.ptp(facets, axis=1), axis=1))


def _joints(surface: Surface, pressed: Mask) -> _Joints:
    """The edges that two facets of a surface share, with the angle between the facets."""
    v, d = surface.vertices.shape[1], surface.dimension
    ends = surface.nodes[:, :v, None]
    points = surface.vertices[:, :, None]
    if d == 3:
        ends = np.stack([ends[:, :, 0], np.roll(ends[:, :, 0], -1, axis=1)], axis=2)
        points = np.stack([surface.vertices, np.roll(surface.vertices, -1, axis=1)], axis=2)
    ends = np.sort(ends.reshape(-1, d - 1), axis=1)
    order = np.lexsort(ends.T)
    same = np.flatnonzero((ends[order][1:] == ends[order][:-1]).all(axis=1))
    places = points.reshape(-1, d - 1, 3)[order[same]]
    one, two = order[same] // v, order[same + 1] // v
    normals, centres = surface.normals, surface.centres
    cosine = np.einsum("ij,ij->i", normals[one], normals[two])
    turns = np.arccos(np.clip(cosine, -1.0, 1.0))
    bent = np.einsum("ij,ij->i", centres[two] - centres[one], normals[one])
    return _Joints(
        np.where(bent < 0.0, turns, -turns), places, np.stack([pressed[one], pressed[two]], axis=1)
    )


def _facet_edge(surface: Surface, point: Array) -> float:
    """Longest edge of the facets that contain a node."""
    nearest = np.linalg.norm(surface.points - point, axis=2).min(axis=1)
    touching = nearest <= nearest.min() + 1e-9 * float(surface.radii.max())
    edges = surface.vertices - np.roll(surface.vertices, 1, axis=1)
    return float(np.linalg.norm(edges[touching], axis=2).max())


def sentence(name: str, pressure: float, point: Array, edge: str) -> str:
    """Warning on a largest pressure at a sharp edge, without the name of its contact."""
    point = np.where(np.abs(point) > ROUNDED * np.abs(point).max(), point, 0.0)
    return (
        f"the largest {name}, {pressure:.3g} at ({', '.join(f'{v:.4g}' for v in point)}), is "
        f"{edge}: it grows without limit as the mesh is refined, unless the edge is drawn with its "
        "radius; forces and pressures away from the edge converge"
    )
