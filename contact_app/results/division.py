"""Division of the force at a node among its contacts.

A contact row belongs to one contact, and its force is a force of that contact. An exception are
equal rows of several contacts at a node: two level floors side by side, a boundary given twice, two
coplanar surfaces of another body. Then one row represents all of them (`merge_contact`,
`candidates.estimated`), or only the sum of their multipliers is determined. This sum is the force
of the node. It is divided like a uniform pressure, by the area of each contact about the node. So
the pressure is continuous across the seam of two boundaries, and the sum over all contacts does not
change. Rows of neighbouring pairs on averages over facets differ, but their multipliers may still
be undetermined; `seams` chooses them before.

Rows count as equal if they are less than `NEARLY_PARALLEL` apart, as unit vectors and in their
normals, and if their gaps differ by less than `TIED`: a deeper obstacle takes no force. For two
rows with separate multipliers the limit is `EQUAL`. A facet on the boundaries of several obstacles
counts for the first of them; otherwise its pressure would be halved.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.model.averaged_rows import has_averaged_rows
from contact_app.model.candidates import NEARLY_PARALLEL
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.results.seams import smooth_forces
from contact_app.results.surface_nodes import SurfaceNodes
from meshes.arrays import Array, Ints, Mask
from meshes.connected import connected
from solver.contact.solution import Solution
from solver.problem.constraints.conditions import ContactRows, pairs_at_nodes, unit_rows
from solver.tfeti.dual import DualProblem

TIED = 1e-9
"""Difference of gaps, over the size of the scene, that counts as zero: as in `merge_contact`."""


EQUAL = 1e-6
"""Distance of two unit rows below which only the sum of their multipliers is determined."""


@dataclass(frozen=True, eq=False)
class ContactLoads:
    """Forces of contacts at the nodes that this rank owns, each contact at most once per node."""

    sources: Ints
    nodes: Ints
    """Contact, as `Scene.touching` counts them, and number of the node. Shape (loads,)."""
    force: Array  # (loads,)
    """Magnitude of the normal force, zero or more."""
    vectors: Array
    moments: Array
    """Force on the body of `on`, and its moment about the node. Shape (loads, 3)."""
    areas: Array  # (loads,)
    """Area on which it acts; NaN where it is the node's share of the boundary."""
    friction: Array  # (loads, 3)
    """The part of `vectors` that is along the surface."""
    slips: Array  # (loads, 3)
    """Slip along the other side."""
    sticks: Mask  # (loads,)
    """Whether the node sticks."""
    rubs: Mask  # (loads,)
    """Whether it has a friction force with a given limit, independent of a contact force."""
    rows: ContactRows
    """The contact row of each."""


def contact_loads(model: Model, solution: Solution, surface: SurfaceNodes) -> ContactLoads:
    """Divide the forces of the contact rows among the contacts (collective)."""
    problem, contact = model.problem, model.problem.contact
    parts = [contact, model.left_out, model.merged]
    forces = solution.multiplier[problem.inequality] * contact.spread
    if model.scene.pairs:
        jumps = problem.jumps(solution.displacements)[problem.inequality]
        least = solution.tolerance * solution.measures.displacement
        closed = (forces > 0.0) | (-jumps / contact.spread <= least)
        forces = smooth_forces(model.comm, contact, forces, closed)
    order = np.lexsort(
        [np.concatenate([getattr(p, n) for p in parts]) for n in ("sources", "nodes")]
    )
    rows = ContactRows.join(parts)  # in this order
    touches = order < len(contact.nodes)
    loads = loads_of_rows(problem, solution, forces)

    def padded(values: NDArray[Any]) -> NDArray[Any]:
        result = np.zeros((len(order), *values.shape[1:]), values.dtype)
        result[touches] = values[order[touches]]
        return result

    loads = ContactLoads(
        rows.sources, rows.nodes, padded(loads.force), padded(loads.vectors),
        padded(loads.moments), rows.areas, padded(loads.friction), padded(loads.slips),
        padded(loads.sticks), padded(loads.rubs), rows,
    )  # fmt: skip
    tied = TIED * model.geometry.length
    label = _together(rows, touches, loads.force, tied, _rigid_bodies(model.geometry, rows))
    if model.comm.allreduce(int((label >= 0).sum())):
        loads = _divided(model.geometry, surface, loads, label)
    members = touches | (loads.force > 0.0)
    fields = {name: values[members] for name, values in loads.__dict__.items() if name != "rows"}
    return ContactLoads(**fields, rows=rows.of(members))


def loads_of_rows(problem: DualProblem, solution: Solution, force: Array) -> ContactLoads:
    """The forces of the contact rows of this rank, with their friction.

    The friction force on the body of `on` is -Σ λ_k t_k over the tangents t_k of a point, its slip
    Σ w_k t_k is its displacement along the other side. A point with friction sticks whose force is
    below its limit, or nearly at it without a slip.

    Parameters
    ----------
    force : (rows,)
        Normal forces.
    """
    rows, d = problem.contact, problem.dimension
    vectors, friction, slips = np.zeros((3, len(force), 3))
    sticks, rubs = np.zeros((2, len(force)), bool)
    points, tangents = problem.friction, problem.shared.friction
    place, normals = tangents.places(rows), tangents.rows.normals
    along = points.forces(solution.multiplier)
    slip = points.slips(problem.jumps(solution.displacements))
    moments = force[:, None] * rows.moments
    np.add.at(friction[:, :d], place, along[:, None] * normals)
    np.add.at(moments, place, along[:, None] * tangents.rows.moments)
    np.add.at(slips[:, :d], place, -slip[:, None] * normals)
    still = solution.tolerance * solution.measures.displacement
    rests = ~points.sliding(solution.multiplier)[points.rows[points.first]]
    sticks[place] = (rests | (points.sizes(slip) <= still))[points.point]
    rubs[place] = ((points.limits > 0.0) & (points.sizes(along) > 0.0))[points.point]
    vectors[:, :d] = force[:, None] * rows.normals
    return ContactLoads(
        rows.sources, rows.nodes, force, vectors + friction, moments, rows.areas, friction, slips,
        sticks, rubs, rows,
    )  # fmt: skip


def _rigid_bodies(geometry: Geometry, rows: ContactRows) -> Ints:
    """The moving rigid body of each row, -1 for none, (rows,)."""
    of_contact = [getattr(item, "rigid", None) for item in geometry.touching]
    moving = geometry.rigid.moving
    number = np.array([-1 if k not in moving else int(k) for k in of_contact], np.int64)
    return number[rows.sources]


def _together(rows: ContactRows, touches: Mask, force: Array, tied: float, rigid: Ints) -> Ints:
    """Number of the group of equal rows with a force that each row is in, (rows,); -1 for none.

    Parameters
    ----------
    touches, force : (rows,)
        Mask of rows with a multiplier, and their forces.
    tied
        Difference of gaps that counts as zero.
    rigid : (rows,)
        The moving rigid body of a row; rows of different rigid bodies are never equal.
    """
    label = np.full(len(rows.nodes), -1, np.int64)
    first = np.flatnonzero(rows.nodes[1:] == rows.nodes[:-1])
    several = np.zeros(len(label), bool)
    several[first], several[first + 1] = True, True
    several &= np.bincount(rows.entries.row, minlength=len(label)) > 0
    some = rows.of(several)
    if not several.any():
        return label
    matrix, length = unit_rows(some)
    gap, solved, of_body = some.gaps / length, touches[several], rigid[several]
    links = [np.zeros((0, 2), np.int64)]
    for i, j in pairs_at_nodes(some.nodes):
        cosine = np.asarray(matrix[i].multiply(matrix[j]).sum(axis=1)).ravel()
        distance = np.maximum(
            np.sqrt(np.maximum(2.0 - 2.0 * cosine, 0.0)),
            np.linalg.norm(some.normals[i] - some.normals[j], axis=1),
        )
        same = distance < np.where(solved[i] & solved[j], EQUAL, NEARLY_PARALLEL)
        same &= (np.abs(gap[i] - gap[j]) <= tied) & (of_body[i] == of_body[j])
        links.append(np.stack([i[same], j[same]], axis=1))
    ends = np.concatenate(links)
    group = connected(ends.T, len(gap))
    loaded = np.bincount(group, force[several]) > 0.0
    loaded &= np.bincount(group) > 1
    number = np.where(loaded, np.cumsum(loaded) - 1, -1)
    label[several] = number[group]
    return label


def _divided(
    geometry: Geometry, surface: SurfaceNodes, loads: ContactLoads, label: Ints
) -> ContactLoads:
    """Divide the sum of each group of rows by their areas (collective)."""
    grouped = np.flatnonzero(label >= 0)
    group = label[grouped]
    weight = _weights(geometry, surface, loads, grouped, group)
    total = np.bincount(group, weight)
    has_weight = total[group] > 0.0
    grouped, group = grouped[has_weight], group[has_weight]
    part = weight[has_weight] / total[group]

    def divided(values: Array) -> Array:
        values = values.copy()
        sums = np.zeros((len(total), *values.shape[1:]))
        np.add.at(sums, group, values[grouped])
        values[grouped] = part.reshape(-1, *(1,) * (values.ndim - 1)) * sums[group]
        return values

    return replace(
        loads, force=divided(loads.force), vectors=divided(loads.vectors),
        moments=divided(loads.moments), friction=divided(loads.friction),
    )  # fmt: skip


def _weights(
    geometry: Geometry, surface: SurfaceNodes, loads: ContactLoads, grouped: Ints, group: Ints
) -> Array:
    """Area of the contact of each grouped row about its node, (grouped,) (collective)."""
    weight, sources = loads.areas[grouped].copy(), loads.sources[grouped]
    shared = np.flatnonzero(sources < len(geometry.contacts))
    weight[shared] = 0.0
    at = np.searchsorted(surface.owned, loads.nodes[grouped])
    members, which = _members(sources[shared], group[shared])
    every = sorted({m for rank in geometry.comm.allgather(members) for m in rank})
    for these in every:
        of_set = shared[which == members.index(these)] if these in members else shared[:0]
        for source, shares in _shares_in_turn(geometry, surface, these):
            of_source = of_set[sources[of_set] == source]
            weight[of_source] = shares[at[of_source]]
    return weight


def _members(sources: Ints, group: Ints) -> tuple[list[tuple[int, ...]], Ints]:
    """Sets of contacts of the groups: all different sets, and the number of the set of each row."""
    if len(group) == 0:
        return [], group
    order = np.lexsort((sources, group))
    _, start, row, count = np.unique(
        group[order], return_index=True, return_inverse=True, return_counts=True
    )
    row = row.reshape(-1)
    table = np.full((len(start), int(count.max())), -1, np.int64)
    table[row, np.arange(len(order)) - start[row]] = sources[order]
    rows, place = np.unique(table, axis=0, return_inverse=True)
    which = np.empty(len(order), np.int64)
    which[order] = place.reshape(-1)[row]
    return [tuple(int(s) for s in line if s >= 0) for line in rows], which


def _shares_in_turn(
    geometry: Geometry, surface: SurfaceNodes, sources: tuple[int, ...]
) -> Iterator[tuple[int, Array]]:
    """∫ φ_k over the facets of each contact with an obstacle that no earlier contact has, (owned,).

    For rows on averages about vertices, the integrals of linear shape functions. Collective.
    """
    chosen_before = [np.zeros(0, np.int32) for _ in geometry.partition.subdomains]
    for source in sources:
        touching = geometry.touching[source]
        chosen = geometry.facets_of(touching.body, touching.boundary)
        left = [np.setdiff1d(group, t) for group, t in zip(chosen, chosen_before, strict=True)]
        means = has_averaged_rows(geometry.bodies[touching.body])
        yield source, surface.shares(geometry.partition, left, hats=means)
        chosen_before = [
            np.union1d(group, t) for group, t in zip(chosen, chosen_before, strict=True)
        ]
