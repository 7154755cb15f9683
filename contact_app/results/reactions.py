"""Reactions: the force and moment of each displacement condition on its body.

In equilibrium the residual K u - f of a node, summed over the subdomains that share it, is the
force of supports and contacts on it. Gluing forces cancel. In held components the residual is the
sum of the reaction and the forces of contact rows over several nodes. Where two conditions hold the
same component of a node, the first one in the file has the reaction. The moment is about the
centroid of the boundary, the mean of its nodes where it has no facet.

Rigid motions of a body that are held on request have a reaction of their own, after the conditions,
on the body as a whole.

If the scene was cut at planes of symmetry, a condition of the whole consists of mirror images of
solved conditions, as for contacts (`results.contacts`). The conditions at the cuts are not in the
file and are left out.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from contact_app.model.boundaries import boundary_facets, boundary_nodes
from contact_app.model.equilibrium import body_frame
from contact_app.model.model import Model
from contact_app.results.fields import NodeFields
from contact_app.results.mirror import full_mesh
from contact_app.results.resultants import Resultant, joined, summed
from contact_app.scene.bodies import MOTION_NAMES
from contact_app.scene.conditions import DisplacementCondition
from meshes.arrays import Array, Ints, Mask
from solver.contact.solution import Solution
from solver.exchange import NodeExchange
from solver.tfeti.dual import DualProblem


def reaction_records(model: Model, solution: Solution, nodes: NodeFields) -> list[dict[str, Any]]:
    """The list `reactions` of ``summary.json``, in the order of the file (collective)."""
    scene = model.scene
    of_solved_part = dict(zip(
        (c.source for c in scene.displacements), _reactions(model, solution, nodes), strict=True
    ))  # fmt: skip
    images, records = full_mesh(model.geometry, nodes).images, []
    for source, on in scene.condition_names:
        pieces = [
            of_solved_part[origin].image(image)
            for image in images
            if (origin := image.origin(source)) in of_solved_part
        ]
        records.append({"on": on, **joined(pieces, scene.dimension)})
    return records


def _reactions(model: Model, solution: Solution, nodes: NodeFields) -> list[Resultant]:
    """Reactions of the conditions of the solved part (collective)."""
    d, exchange = model.scene.dimension, model.node_exchange
    conditions = model.scene.displacements
    if not conditions:
        return []
    size, place = exchange.last - exchange.first, exchange.nodes - exchange.first
    held = [_held_copies(model, condition, place) for condition in conditions]
    of_supports = _residual(model, solution, held)
    arrived = exchange.to_owners(of_supports)
    force = np.zeros((size, 3))
    for i in range(d):
        force[:, i] = np.bincount(place, arrived[:, i], minlength=size)
    add_contact(model.problem, model.node_exchange, solution, force)
    assigned = np.zeros((size, 3), bool)
    reactions = []
    for condition, copies in zip(conditions, held, strict=True):
        holds = np.zeros((size, 3), bool)
        on = np.zeros(size, bool)
        on[place[exchange.to_owners(copies.on)]] = True
        holds[:, :d] = on[:, None] & [value is not None for value in condition.values]
        chosen = np.where(holds & ~assigned, force, 0.0)
        assigned |= holds
        shares = exchange.to_owners(copies.weight)
        weights = np.bincount(place, shares, minlength=size).astype(float)
        reactions.append(summed(model.comm, nodes.points, on, chosen, weights))
    return reactions


def add_contact(
    problem: DualProblem, exchange: NodeExchange, solution: Solution, force: Array
) -> None:
    """Add the forces of rows over several nodes on held components (collective).

    Parameters
    ----------
    force : (owned nodes, components)
        Changed in place.
    """
    for kind, rows in problem.shared.by_kind.items():
        of_rows, held = solution.multiplier[problem.kinds == kind] * rows.spread, rows.held
        query = exchange.among(held.node)
        at = query.to_owners(held.component), query.to_owners(of_rows[held.row] * held.value)
        np.add.at(force, (query.nodes - query.first, at[0]), at[1])


def hold_records(model: Model, solution: Solution) -> list[dict[str, Any]]:
    """Entries of `reactions` for bodies whose rigid motions are held on request (collective).

    Force on the body, and moment about its centre.
    """
    scene, rows = model.scene, model.problem.shared.means
    multiplier = solution.multiplier[model.problem.means] * rows.spread
    sums = np.zeros((len(scene.bodies), 6))
    force = multiplier[:, None] * np.column_stack([_in_space(rows.normals), rows.moments])
    np.add.at(sums, rows.sources, force)
    sums = model.comm.allreduce(sums)
    names, records = MOTION_NAMES[scene.dimension], []
    for body, total in zip(scene.bodies, sums, strict=True):
        if body.hold:
            whole_force = Resultant(total[:3], total[3:], body_frame(body)[0], 1.0)
            records.append({
                "on": body.name, "hold": [names[k] for k in body.hold],
                **joined([whole_force], scene.dimension),
            })  # fmt: skip
    return records


def _in_space(vectors: Array) -> Array:
    """Vectors (n, dimension) with three components, (n, 3)."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


@dataclass(frozen=True, eq=False)
class _Copies:
    """Copies of nodes that a condition holds, and their shares of its area, (copies,)."""

    on: Mask
    weight: Array


def _held_copies(model: Model, condition: DisplacementCondition, place: Ints) -> _Copies:
    """Copies of held nodes, in the order of the exchange of all nodes (collective).

    A subdomain may have a held node at an edge or a corner without any facet of the boundary; its
    copy counts, too.
    """
    body, one = model.scene.bodies[condition.body], np.eye(model.scene.dimension)[0]
    on, weight = [], []
    shares: dict[tuple[int, bytes], Array] = {}  # congruent subdomains have the same
    for s, (cls, _) in zip(model.partition.subdomains, model.place, strict=True):
        mask, share = np.zeros(len(s.nodes), bool), np.zeros(len(s.nodes))
        if s.body == condition.body:
            mask[boundary_nodes(s, body, condition.boundary)] = True
            rows = boundary_facets(s, body, condition.boundary)
            if len(rows):
                key = (cls, rows.tobytes())
                if key not in shares:
                    load = model.elements[cls].traction(rows, one)
                    shares[key] = load[:: model.scene.dimension]
                share = shares[key]
        on.append(mask)
        weight.append(share)
    exchange = model.node_exchange
    some = np.zeros(exchange.last - exchange.first, bool)
    some[place[exchange.to_owners(np.concatenate(on))]] = True
    return _Copies(exchange.from_owners(some[place]), np.concatenate(weight))


def _residual(model: Model, solution: Solution, held: list[_Copies]) -> Array:
    """K u - f at copies of held nodes, (copies, dimension), zero at others."""
    d = model.scene.dimension
    some = np.any([copies.on for copies in held], axis=0)
    result, start = np.zeros((len(some), d)), 0
    rows: dict[tuple[int, bytes], sparse.csr_matrix] = {}  # congruent subdomains have the same
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        local = np.flatnonzero(some[start : start + len(s.nodes)])
        if len(local):
            unknowns = (local[:, None] * d + np.arange(d)).ravel()
            key = (cls, local.tobytes())
            if key not in rows:
                rows[key] = model.problem.classes[cls].stiffness[unknowns]
            u = solution.displacements[cls][:, column]
            residual = rows[key] @ u - model.problem.forces[cls][unknowns, column]
            result[start + local] = residual.reshape(-1, d)
        start += len(s.nodes)
    return result
