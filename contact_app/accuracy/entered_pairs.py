"""Bodies that enter each other at vertices, though the mean gaps of their contact are not negative.

Mortar rows keep mean gaps from being negative. If contact is narrower than a facet, as at an edge
or a corner that presses into a face, the mean gap around it is positive: the edge enters the other
body by a share of the facet's size, and no force resists it. Therefore the vertices of each side
are tested against the facets of the other one, along the normals of these facets. Only vertices
outside of the other body before the deformation count, and those that slide by less than a facet.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.contact_limits import entered_beside
from contact_app.model.boundaries import surface_facets
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.model.pairs import sides_of
from contact_app.results.fields import NodeFields
from contact_app.results.percent import percent
from contact_app.scene.conditions import BodyContact, Tie
from meshes import Reference
from meshes.arrays import Array, Ints, Mask
from meshes.contact_surface import Surface, is_curved
from meshes.facet_overlaps import on_facets
from meshes.facet_search import points_along_normals
from meshes.facing import FACING
from meshes.shares import share
from solver.contact.solution import Solution

ENTERED = 0.2
"""Depth over the largest displacement from which on a warning says that a vertex enters."""

NOT_JOINED = "no entry of `contacts` joins them"

OUTSIDE = 1e-6
"""Depth of a vertex, over the radius of a facet, up to which it counts as outside."""


def entered_pairs(model: Model, solution: Solution, nodes: NodeFields) -> list[str]:
    """Sentences on pairs of bodies that enter each other (collective)."""
    scene, moved, sentences = model.scene, solution.measures.deformations, []
    for pair in scene.pairs:
        names = f"{scene.bodies[pair.body].name} and {scene.bodies[pair.other].name}"
        largest = float(max(moved[pair.body], moved[pair.other]))
        if text := entering_each_other(names, entered(model, nodes, pair), largest):
            sentences.append(f"{pair.source}: {text}")
    return sentences


def entered_without_contact(model: Model, solution: Solution, nodes: NodeFields) -> list[str]:
    """Sentences on bodies that enter each other where no contact joins them (collective)."""
    scene, measures, sentences = model.scene, solution.measures, []
    entries: list[BodyContact | Tie] = [*scene.pairs, *scene.ties]
    if not solution.converged:
        return []
    for a, b in combinations(range(len(scene.bodies)), 2):
        bodies = scene.bodies[a], scene.bodies[b]
        reach = float(measures.displacements[a] + measures.displacements[b])
        lower, upper = (
            np.array([getattr(body.mesh, side) for body in bodies]) for side in ("lower", "upper")
        )
        if (lower.max(axis=0) > upper.min(axis=0) + reach).any():
            continue
        joined = [entry for entry in entries if {entry.body, entry.other} == {a, b}]
        parts = _part_near(model.geometry, a, b, reach), _part_near(model.geometry, b, a, reach)
        depth = 0.0
        if parts[0] is not None and parts[1] is not None:
            surfaces = near_each_other(parts[0], parts[1], reach)
            depth = _outside_of_contacts(model, nodes, surfaces, joined)
        if depth > ENTERED * max(measures.deformations[a], measures.deformations[b]):
            where = "the boundaries of their contacts end; name larger boundaries"
            names = f"{bodies[0].name} and {bodies[1].name}"
            sentences.append(passing_through(names, depth, where if joined else NOT_JOINED))
    return sentences


def entered_by_rigid_bodies(model: Model, solution: Solution) -> list[str]:
    """Sentences on rigid bodies that enter bodies which no contact joins to them (collective)."""
    scene, sentences = model.scene, dict[tuple[int, int], str]()
    joined = {(item.rigid, item.body) for item in scene.contacts}
    joined |= {(tie.rigid, tie.body) for tie in scene.rigid_ties}
    for i, contact in enumerate(scene.contacts if solution.converged else ()):
        for body in range(len(scene.bodies)):
            rigid = contact.rigid
            if rigid is None or (rigid, body) in joined or (rigid, body) in sentences:
                continue
            if depth := entered_beside(model, solution, i, body)[1]:
                names = f"{scene.rigid.bodies[rigid].name} and {scene.bodies[body].name}"
                sentences[rigid, body] = passing_through(names, depth)
    return list(sentences.values())


def passing_through(names: str, depth: float, where: str = NOT_JOINED) -> str:
    """Two bodies that enter each other away from their contacts."""
    return (
        f"{names} enter each other by up to {depth:.2g}: bodies pass through each other where "
        f"{where}"
    )


def _outside_of_contacts(
    model: Model,
    nodes: NodeFields,
    surfaces: tuple[Surface, Surface],
    joined: Sequence[BodyContact | Tie],
) -> float:
    """Largest depth of a vertex of one body in the other one away from their contacts (collective).

    Facets with a node on a boundary of a contact do not count: there the contact decides.

    Parameters
    ----------
    surfaces
        The facets of the two bodies that may meet.
    """
    named = [side.nodes.ravel() for item in joined for side in sides_of(model.geometry, item)]
    in_contact = np.unique(np.concatenate([np.zeros(0, np.int64), *named]))
    displaced, depth = [_displaced(model, nodes, side) for side in surfaces], 0.0
    for k in range(2):
        away = ~np.isin(surfaces[k].nodes, in_contact).any(axis=1)
        sides, u = list(surfaces), displaced.copy()
        sides[k], u[k] = _some(surfaces[k], away), displaced[k][away]
        if all(len(side.nodes) for side in sides):
            depth = max(depth, depth_in_each_other(model.comm, sides, u, False))
    return depth


def near_each_other(one: Surface, two: Surface, reach: float) -> tuple[Surface, Surface]:
    """The facets of two surfaces near the box about both.

    Parameters
    ----------
    reach
        Largest component of the displacements of both, added up. A vertex enters a facet along its
        normal, from a distance of the root of three times that at most.
    """
    lower = np.max([side.points.min(axis=(0, 1)) for side in (one, two)], axis=0)
    upper = np.min([side.points.max(axis=(0, 1)) for side in (one, two)], axis=0)

    def near(side: Surface) -> Surface:
        away = np.maximum(lower - side.points.max(axis=1), side.points.min(axis=1) - upper)
        return _some(side, away.max(axis=1) <= np.sqrt(3.0) * reach + side.radii)

    return near(one), near(two)


def _some(surface: Surface, facets: Mask) -> Surface:
    """Some facets of a surface."""
    parts = (surface.nodes[facets], surface.points[facets], surface.normals[facets])
    return Surface(surface.dimension, *parts)


def _part_near(geometry: Geometry, body: int, other: int, reach: float) -> Surface | None:
    """Outer facets of a body in its subdomains near the box about another one, on all ranks.

    Collective. All outer facets in a scene with planes of symmetry; parameters of
    `near_each_other`.
    """
    chosen, sizes = [], dict[Reference, tuple[Array, Array, float]]()
    box, every = geometry.bodies[other].mesh, bool(geometry.mirrors)
    for s in geometry.partition.subdomains:
        rows = np.zeros(0, np.int32)
        if s.body == body:
            if s.reference not in sizes:
                points = s.reference.points[:, : geometry.dimension]
                edges = np.ptp(points[s.reference.facets], axis=1)
                largest = float(np.linalg.norm(edges, axis=1).max(initial=0.0))
                sizes[s.reference] = points.min(axis=0), points.max(axis=0), largest
            lower, upper, size = sizes[s.reference]
            offset = s.translation[: len(lower)]
            away = np.maximum(lower + offset - box.upper, box.lower - upper - offset)
            if every or (away <= np.sqrt(3.0) * reach + size).all():
                rows = surface_facets(s, geometry.bodies[body])
        chosen.append(rows)
    return geometry.surface_of(chosen)


def entering_each_other(names: str, depth: float, moved: float) -> str:
    """Bodies that enter each other at vertices; an empty text where they hardly do.

    Parameters
    ----------
    depth
        Largest depth of a vertex in the other body.
    moved
        Largest displacement of the bodies.
    """
    if depth <= ENTERED * moved:
        return ""
    size = f"{percent(depth / moved)} of the largest displacement" if moved else "and do not deform"
    return (
        f"{names} enter each other by up to {depth:.2g} at vertices, {size}: contact is narrower "
        "than a facet, and the gap is tested in the mean over facets; use cells much smaller than "
        "the contact there"
    )


def entered(model: Model, nodes: NodeFields, pair: BodyContact) -> float:
    """Largest depth of a vertex of one side in the other one, a length (collective)."""
    on, against = sides_of(model.geometry, pair)
    displaced = _displaced(model, nodes, on), _displaced(model, nodes, against)
    return depth_in_each_other(model.comm, (on, against), displaced, pair.round)


def depth_in_each_other(
    comm: MPI.Intracomm, sides: Sequence[Surface], displaced: Sequence[Array], is_round: bool
) -> float:
    """Largest depth of a vertex of one side in the other one, a length (collective).

    Parameters
    ----------
    sides
        The facets of both sides, on all ranks.
    displaced
        Displacements of their nodes, (facets, nodes per facet, 3).
    is_round
        Whether the gap is that of smooth surfaces through the nodes.
    """
    on, against = (side.smooth() if is_round else side for side in sides)
    u_on, u_against = displaced
    depth = max(
        _depth(comm, on, against, u_on, u_against), _depth(comm, against, on, u_against, u_on)
    )
    return float(comm.allreduce(depth, op=MPI.MAX))


def _displaced(model: Model, nodes: NodeFields, surface: Surface) -> Array:
    """Displacements of the nodes of facets, (facets, nodes per facet, 3) (collective)."""
    distinct, place = np.unique(surface.nodes, return_inverse=True)
    image, node = np.divmod(distinct, model.partition.nodes)
    query = model.node_exchange.among(node)
    u = np.zeros((len(node), 3))
    u[:, : surface.dimension] = query.from_owners(nodes.displacement[query.nodes - nodes.first])
    for k, mirror in enumerate(model.scene.mirrors):
        u[(image >> k) % 2 == 1, mirror.axis] *= -1.0
    return u[place.reshape(surface.nodes.shape)]


def _depth(comm: MPI.Intracomm, on: Surface, of: Surface, u_on: Array, u_of: Array) -> float:
    """Largest depth of a vertex of one surface behind facets `on` this rank has a share in."""
    v, w = on.vertices.shape[1], of.vertices.shape[1]
    corner, vertex = np.unique(of.nodes[:, :w], return_index=True, return_inverse=True)[1:]
    points, moved = (values[corner // w, corner % w] for values in (of.points, u_of))
    reach = _reach(on, u_on, moved)
    away = np.maximum(points.min(axis=0) - on.points.max(axis=1),
                      on.points.min(axis=1) - points.max(axis=0))  # fmt: skip
    near = np.flatnonzero(away.max(axis=1) <= reach + OUTSIDE * on.radii)
    chosen = near[share(comm, len(near))]
    i, k = points_along_normals(on, points, chosen, reach[chosen])
    if len(i) == 0:
        return 0.0
    axes = on.frames[i].transpose(0, 2, 1)
    here = (on.points[i] - on.centres[i][:, None]) @ axes
    x = ((points[k] - on.centres[i])[:, None] @ axes)[:, 0]
    flat = here[:, :v, :-1]
    within = ((x[:, :-1] >= flat.min(axis=1)) & (x[:, :-1] <= flat.max(axis=1))).all(axis=1)
    i, k, here, x = i[within], k[within], here[within], x[within]
    if len(i) == 0:
        return 0.0
    hats, shapes, _ = on_facets(here[..., :-1], x[:, :-1], is_curved(here, v))
    gap = x[:, -1] - np.einsum("qn,qn->q", shapes, here[..., -1]) - on.height(i, hats)
    jump = moved[k] - np.einsum("qn,qni->qi", shapes, u_on[i])
    closing = np.einsum("qi,qi->q", on.normals[i], jump)
    sliding = np.linalg.norm(jump - closing[:, None] * on.normals[i], axis=1)
    counted = (hats >= -OUTSIDE).all(axis=1) & (gap >= -OUTSIDE * on.radii[i])
    counted &= (sliding <= on.radii[i]) & (gap + closing < 0.0)
    i, k, entered = i[counted], k[counted], -(gap + closing)[counted]
    pair, facet = _pairs_with_facets(k, vertex.ravel(), w)
    facing = -np.einsum("ij,ij->i", on.normals[i[pair]], of.normals[facet]) >= FACING
    return float(entered[pair[facing]].max(initial=0.0))


def _reach(on: Surface, u_on: Array, u_of: Array) -> Array:
    """Distance of facets from the farthest vertex that can enter, (facets,).

    It is the largest approach along the normal plus twice the height of nodes over the facet's
    plane and a margin.
    """
    away = on.points - on.centres[:, None]
    height = np.abs(np.einsum("fnk,fk->fn", away, on.normals)).max(axis=1)
    if on.bulge is not None:
        height += np.abs(on.bulge).sum(axis=(1, 2))
    lower, upper = u_of.min(axis=0), u_of.max(axis=0)
    inwards = 0.5 * (np.abs(on.normals) @ (upper - lower) - on.normals @ (upper + lower))
    outwards = np.einsum("fni,fi->fn", u_on, on.normals).max(axis=1)
    return np.maximum(inwards + outwards, 0.0) + 2.0 * height + OUTSIDE * on.radii


def _pairs_with_facets(chosen: Ints, vertex: Ints, corners: int) -> tuple[Ints, Ints]:
    """Places in a list of vertices, each with every facet that has the vertex there.

    Parameters
    ----------
    vertex : (facets * corners,)
        The vertices of all facets.
    """
    order, counts = np.argsort(vertex, kind="stable"), np.bincount(vertex)
    last, times = np.cumsum(counts)[chosen], counts[chosen]
    place = np.repeat(np.arange(len(chosen)), times)
    ahead = np.repeat(np.cumsum(times), times) - np.arange(len(place))
    return place, order[last[place] - ahead] // corners
