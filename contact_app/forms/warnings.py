"""Warnings where the answer of forms violates assumptions of the model, as those of scenes.

The yield stress and an estimate of the error of the mesh of other cells than triangles and
tetrahedra of degree 1 are left to scenes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import combinations

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.contact_limits import (
    LIMITS,
    PressedFacets,
    between_nodes,
    carries_force,
    depth_between,
    entered_points,
)
from contact_app.accuracy.entered_pairs import (
    ENTERED,
    depth_in_each_other,
    entering_each_other,
    near_each_other,
    passing_through,
)
from contact_app.accuracy.faceted_curves import Distances, facets_match, largest_distances
from contact_app.accuracy.hertz import CoarsePressure, coarse_pressure
from contact_app.forms.bodies import contact_motions
from contact_app.forms.boundary import exterior_facets, gathered_surface
from contact_app.forms.contacts import Contact
from contact_app.forms.half_spaces import half_spaces
from contact_app.forms.locking import Fit, affine_fit, locking
from contact_app.forms.model import FormModel
from contact_app.forms.results import ContactAtNodes, OnSpace, Owners
from contact_app.forms.rows import in_the_mean
from contact_app.model.facets import moments
from contact_app.model.obstacle_hints import faces_away, facing_away
from contact_app.results.carried import carried
from contact_app.results.free_motions import sliding_bodies
from contact_app.results.friction import closing_points
from contact_app.results.overcome_friction import overcome_friction
from contact_app.results.repeated_sentences import without_repetitions
from contact_app.results.shared_forces import shared_force_warnings
from contact_app.results.sliding import largest_sliding, sliding_on_each_other
from contact_app.results.tilted_pairs import tilted
from contact_app.results.undetermined import Movable, play_warnings, undetermined
from contact_app.run import warning_texts as texts
from contact_app.scene.material import NEARLY_INCOMPRESSIBLE
from contact_app.scene.obstacles import Plane
from meshes import dolfinx_compat
from meshes.contact_surface import Surface, is_curved
from solver.contact.solution import Solution
from solver.problem.sizes import SIZES
from solver.vectors import Array, largest_magnitude


@dataclass(frozen=True, eq=False)
class FormAnswer:
    """An answer that is tested for the assumptions of its model."""

    model: FormModel
    solution: Solution
    owners: Owners
    """Owners of the copies in parts."""
    on_space: OnSpace
    """Map from owned nodes to the space of the forms."""
    displacement: Array  # (owned, dimension)
    contacts: Sequence[ContactAtNodes]
    """Each contact at nodes."""
    bcs: Sequence[object]
    """Dirichlet conditions."""
    in_halves: str | None = None
    """The warning of two half increments; None if they were not tried."""

    def bodies_on(self, number: int) -> list[int]:
        """Bodies of the first side of a contact."""
        return sorted(self.model.bodies_at(self.model.sides[number].surfaces[0]))

    @cached_property
    def coarse_pressures(self) -> list[CoarsePressure | None]:
        """The contacts with few facets across (collective)."""
        return [_coarse_pressure(self, number) for number in range(len(self.contacts))]


def form_warnings(answer: FormAnswer) -> list[str]:
    """Warnings for the certificate, one sentence each (collective)."""
    fit = affine_fit(answer.model.parts, answer.owners.copies(answer.displacement))
    warnings = [*_large_deformations(answer, fit[0]), *_of_bodies(answer), *_locking(answer, fit)]
    warnings += _without_contact(answer)
    for number, contact in enumerate(answer.model.contacts):
        sentences = [*_of_contact(answer, number, contact)]
        if _presses(answer, number):
            coarse = answer.coarse_pressures[number]
            sentences += ["" if coarse is None else coarse.warning]
        warnings += [f"contacts[{number}]: {text}" for text in sentences if text]
    problem = answer.model.problem
    before = problem.load_case.displacements_before
    changed = closing_points(problem, answer.solution, list(before) if before else None)
    since = "the last increment" if before else "the unloaded state"
    remedy = "loads in several increments, solve(increment=True), show how much this matters"
    closing = texts.closing_at_once(*changed, since, remedy)
    warnings.append(closing if answer.in_halves is None else answer.in_halves)
    numbers = [f"contacts[{number}]" for number in range(len(answer.model.contacts))]
    warnings += shared_force_warnings(answer.model.problem, answer.solution, numbers)
    bodies = answer.model.bodies
    warnings += overcome_friction(answer.model.problem, answer.solution, bodies.name)
    names = [bodies.name(b) for b in range(bodies.count)]
    return without_repetitions(list(filter(None, warnings)), names)


def _large_deformations(answer: FormAnswer, gradient: Array) -> list[str]:
    """Strains and rotations of cells, from the displacements of their vertices."""
    transposed = np.swapaxes(gradient, 1, 2)
    both = 0.5 * np.abs(np.stack([gradient + transposed, gradient - transposed]))
    comm = answer.model.parts.comm
    return texts.large_deformations(*(largest_magnitude(comm, part) for part in both))


def _of_bodies(answer: FormAnswer) -> Iterator[str]:
    """Bodies that slide along facets, move beyond their size, or can be moved at no energy."""
    model, solution = answer.model, answer.solution
    bodies, problem = model.bodies, model.problem
    fixes = "a Dirichlet condition, a spring or friction"
    for motion in sliding_bodies(problem, solution, bodies.size_of):
        yield motion.sentence(bodies.name(motion.body), f"{fixes} prevents the motion")
    for b, moved in enumerate(solution.measures.deformations[: bodies.count]):
        size = 2.0 * float(np.linalg.norm(bodies.halves[b]))
        yield texts.moved_beyond_size(bodies.name(b), float(moved), size)
    label = problem.bodies.groups
    groups = [np.flatnonzero(label == k) for k in np.unique(label)]
    names = [bodies.name(b) for b in range(bodies.count)]
    motions_of = partial(contact_motions, bodies, model.exchange, d=problem.dimension)
    movable = Movable(groups, names, bodies.size_of)
    yield from play_warnings(undetermined(problem, solution, motions_of, movable), fixes)
    if solution.converged:
        yield from carried(problem, solution, motions_of, movable)


def _without_contact(answer: FormAnswer) -> Iterator[str]:
    """Bodies that enter each other and that no contact joins (collective)."""
    model, measures = answer.model, answer.solution.measures
    parts, bodies = model.parts, model.bodies
    if not answer.solution.converged or bodies.count == 1:
        return
    outside = exterior_facets(parts)
    body = answer.owners.copies(bodies.of_node.astype(float))[outside.copies[:, 0]]
    surface_of = cache(lambda b: gathered_surface(parts, outside.chosen(body == b)))
    joined = [
        set[int]().union(*map(model.bodies_at, item.surfaces))
        for contact, item in zip(model.contacts, model.sides, strict=True)
        if contact.against is not None
    ]
    for a, b in combinations(range(bodies.count), 2):
        reach = float(measures.displacements[[a, b]].sum())
        distance = np.abs(bodies.centres[a] - bodies.centres[b])
        is_far = (distance > bodies.halves[a] + bodies.halves[b] + reach).any()
        if is_far or any({a, b} <= both for both in joined):
            continue
        sides = near_each_other(surface_of(a), surface_of(b), reach)
        if all(len(side.nodes) for side in sides):
            displaced = _displaced(answer, sides[0]), _displaced(answer, sides[1])
            depth = depth_in_each_other(parts.comm, sides, displaced, is_round=False)
            if depth > ENTERED * measures.deformations[[a, b]].max():
                yield passing_through(f"{bodies.name(a)} and {bodies.name(b)}", depth)


def _locking(answer: FormAnswer, fit: Fit) -> Iterator[str]:
    """Cells of degree 1 that are too stiff (collective)."""
    model, measures = answer.model, answer.solution.measures
    parts, bodies = model.parts, model.bodies
    if model.moduli is None:
        return
    body = answer.owners.copies(bodies.of_node.astype(float))[parts.cells[:, 0]].astype(np.int64)
    u = answer.on_space.values(answer.displacement), fit
    signs = locking(parts, model.moduli, u, (body, bodies.count))
    strained = (measures.strains > SIZES.strainless * measures.roundings)[: bodies.count]
    remedy = "a space of degree 2"
    for b in np.flatnonzero(strained):
        near = "energy", " or near ν = 0.5"
        signs_of_body = [texts.locking_in_bending(float(signs.varying[b]), *near, remedy)]
        if signs.poisson[b] >= NEARLY_INCOMPRESSIBLE:
            signs_of_body.append(texts.locking_in_volume(float(signs.poisson[b]), remedy))
        yield from (f"{bodies.name(int(b))}: {text}" for text in signs_of_body if text)
    if strained.any():
        yield texts.stiff_simplices(signs.error, "", remedy)


def _of_contact(answer: FormAnswer, number: int, contact: Contact) -> Iterator[str]:
    """Warnings on one contact (collective)."""
    model, solution, nodes = answer.model, answer.solution, answer.contacts[number]
    comm, d, sides = model.parts.comm, model.parts.dimension, model.sides[number]
    touching = [model.bodies_at(side) for side in sides.surfaces]
    every = sorted(set().union(*touching))
    moved = float(solution.measures.deformations[every].max())
    names = " and ".join(model.bodies.name(b) for b in every)
    rows = model.problem, model.exchange, answer.displacement, solution, number
    yield from _round_shapes(answer, number, contact, (names, moved))
    if contact.against is None:
        radius = getattr(contact.obstacle, "curvature_radius", None)
        yield texts.curving_away(largest_sliding(*rows), radius, moved)
        (on, *_), size = sides.surfaces, float(model.bodies.lengths.max())
        if faces_away(on.normals, contact.gap_and_normal(on.centres, d, size)[1]):
            yield facing_away(comm.allreduce(int(nodes.closed.sum())) > 0)
        if not _flat(contact) or in_the_mean(model.parts):
            yield from _entering(answer, number, contact, (names, moved))
    else:
        yield texts.sliding_far(*sliding_on_each_other(*rows))
        on, against = sides.surfaces
        displaced = _displaced(answer, on), _displaced(answer, against)
        depth = depth_in_each_other(comm, (on, against), displaced, contact.round)
        yield entering_each_other(names, depth, moved)
        both = [model.bodies.name(min(bodies)) for bodies in touching]
        yield tilted(model.problem, solution, number, against, (both[0], both[1]), moved)
    yield texts.rubbing_where_open(comm.allreduce(int((nodes.rubs & ~nodes.closed).sum())))
    pressed = comm.allreduce(int(nodes.closed.any()), op=MPI.MAX)
    yield texts.several_answers(contact.law.coefficient, bool(pressed))


def _presses(answer: FormAnswer, number: int) -> bool:
    """Whether a contact carries a force above the solver's error (collective)."""
    solution, nodes = answer.solution, answer.contacts[number]
    least = solution.tolerance * float(solution.measures.loads[answer.bodies_on(number)].max())
    return carries_force(answer.model.parts.comm, nodes.pressure, nodes.shares, least)


def _coarse_pressure(answer: FormAnswer, number: int) -> CoarsePressure | None:
    """A pressure with a force that varies within single facets (collective)."""
    if not _presses(answer, number):
        return None
    parts, facets = answer.model.parts, answer.model.sides[number].facets
    d = parts.dimension
    corners = facets.points[:, : facets.vertices(d).shape[1]]
    areas = moments(facets.points, d).sum(axis=(1, 2)) if len(facets.copies) else np.zeros(0)
    pressure = answer.owners.copies(answer.contacts[number].pressure)[facets.copies]
    pressed = PressedFacets(corners, areas, pressure, answer.contacts[number].planes)
    nodes = answer.contacts[number]
    on, points = nodes.carriers | (nodes.shares > 0.0), answer.owners.at(parts.points)
    at = points[on], nodes.forces[on], nodes.smoothed[on]
    of_bodies = partial(half_spaces, answer.model, answer.owners, number)
    return coarse_pressure(answer.model.problem, number, at, pressed, of_bodies)


def _displaced(answer: FormAnswer, surface: Surface) -> Array:
    """Displacements of the nodes of facets, (facets, nodes per facet, 3) (collective)."""
    distinct, place = np.unique(surface.nodes, return_inverse=True)
    query = answer.model.exchange.among(distinct)
    u = np.zeros((len(distinct), 3))
    u[:, : surface.dimension] = query.from_owners(answer.displacement[query.nodes - query.first])
    return u[place.reshape(surface.nodes.shape)]


def _flat(contact: Contact) -> bool:
    """Whether the obstacle of a contact is a plane, which may end with the tagged facets."""
    return isinstance(contact.obstacle, Plane)


def _round_shapes(
    answer: FormAnswer, number: int, contact: Contact, body: tuple[str, float]
) -> Iterator[str]:
    """Round surfaces with flat facets or straight edges that are coarse beside the gap."""
    model, nodes = answer.model, answer.contacts[number]
    comm, surfaces = model.parts.comm, model.sides[number].surfaces
    degree = dolfinx_compat.lagrange_degree(model.parts.space) or 1
    points = answer.owners.at(model.parts.points)
    has_gap = np.isfinite(nodes.gap)
    pieces = comm.allgather((points[has_gap], nodes.gap[has_gap]))
    watched, gaps = (np.concatenate(piece) for piece in zip(*pieces, strict=True))
    distances = Distances()
    for side in surfaces if contact.against is not None or degree == 2 else ():
        v = side.vertices.shape[1]
        if not is_curved(side.points, v):
            of_side = largest_distances(side, (watched, gaps), contact.round)
            distances = distances.or_larger(of_side)
    if distances.facets == 0.0:
        return
    if contact.against is not None:
        on, against = surfaces
        if facets_match(on, against, watched[gaps <= distances.facets]):
            return
    rows = [(part.sources, np.abs(part.gaps)) for part in (model.problem.contact, model.merged)]
    pieces = sum(comm.allgather(rows), [])
    sources, gaps = (np.concatenate(piece) for piece in zip(*pieces, strict=True))
    gap = float(np.median(gaps[sources == number])) if (sources == number).any() else np.inf
    name, moved = body
    if contact.against is None:
        yield texts.straight_edges(name, distances.facets, moved, gap, degree)
    else:
        text = texts.flat_facets(name, distances, moved, gap, contact.round)
        yield text.replace("round: true", "round=True")


def _entering(
    answer: FormAnswer, number: int, contact: Contact, body: tuple[str, float]
) -> Iterator[str]:
    """An obstacle that enters the body between the nodes, a round one also beside the contact."""
    model, (name, moved), depth = answer.model, body, 0.0
    parts, tagged = model.parts, model.sides[number].facets

    def gap_and_normal(points: Array) -> tuple[Array, Array]:
        return contact.gap_and_normal(points, parts.dimension, float(model.bodies.lengths.max()))

    u = answer.owners.copies(answer.displacement)
    if len(tagged.copies):
        depth = depth_between(tagged.points, u[tagged.copies], gap_and_normal)
    depth = largest_magnitude(parts.comm, np.array([depth]))
    yield (
        between_nodes(depth, moved, name, in_the_mean(parts))
        if depth > LIMITS.between * moved
        else ""
    )
    if _flat(contact):
        return
    outside = exterior_facets(parts)
    of_node = answer.owners.copies(model.bodies.of_node.astype(float))
    of_bodies = np.isin(of_node, answer.bodies_on(number))
    free = np.zeros(len(u), bool)
    free[outside.copies] = True
    on = answer.owners.copies(answer.owners.on(tagged.copies, len(u)).astype(float)) > 0.0
    beside = np.flatnonzero(free & of_bodies & ~on)
    gaps, least = (gap_and_normal, gap_and_normal), LIMITS.entered * moved
    entered, deep = entered_points(parts.points[beside], u[beside], gaps, least)
    count, deep = parts.comm.allreduce(entered), largest_magnitude(parts.comm, np.array([deep]))
    yield texts.beside_boundary(name, contact.on, count, deep)
