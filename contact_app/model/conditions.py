"""Held nodes and contact rows: conditions and contacts of a scene, written at the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_app.errors import ConfigurationError, ContactError, NoEquilibriumError
from contact_app.machine.ranks import agreed
from contact_app.model.averaged_rows import averaged_rows, has_averaged_rows
from contact_app.model.boundaries import boundary_nodes, facets_of
from contact_app.model.pairs import of_what_is_solved, owned_rows, sides_of
from contact_app.scene.conditions import Contact, DisplacementCondition
from contact_app.scene.scene import Scene
from meshes import Partition
from meshes.facing import SurfacesApartError
from meshes.mortar import mean_gaps
from solver.tfeti.constraints.conditions import ContactRows, ContradictionError, NodeConditions
from solver.tfeti.constraints.exchange import NodeExchange


def node_conditions(scene: Scene, partition: Partition) -> NodeConditions:
    """Held nodes and contact rows at the nodes of this rank's subdomains."""
    d = scene.dimension
    held: list[tuple] = []
    touching: list[tuple] = []
    for s in partition.subdomains:
        body = scene.bodies[s.body]
        points = s.points()
        for i, condition in enumerate(scene.displacements):
            if condition.body != s.body:
                continue
            nodes = boundary_nodes(s, body, condition.boundary)
            mask = np.array([v is not None for v in condition.values])
            values = np.array([v or 0.0 for v in condition.values])
            shape = (len(nodes), d)
            held.append(
                (
                    s.nodes[nodes], points[nodes], np.broadcast_to(mask, shape),
                    np.broadcast_to(values, shape), np.full(len(nodes), i),
                )
            )  # fmt: skip
        for i, contact in enumerate(scene.contacts):
            if contact.body != s.body or has_averaged_rows(body):
                continue
            nodes = boundary_nodes(s, body, contact.boundary)
            if len(nodes) == 0:
                continue
            try:
                gap, normal = contact.gap_and_normal(points[nodes])
            except ConfigurationError as error:
                raise ConfigurationError(f"{scene.at(contact.source)}.obstacle: {error}") from None
            touching.append(
                (s.nodes[nodes], points[nodes], -normal[:, :d], gap, np.full(len(nodes), i))
            )
    none = np.zeros(0, np.int64)
    held.append((none, np.zeros((0, 3)), np.zeros((0, d), bool), np.zeros((0, d)), none))
    touching.append((none, np.zeros((0, 3)), np.zeros((0, d)), np.zeros(0), none))
    joined = [[np.concatenate(c) for c in zip(*part, strict=True)] for part in (held, touching)]
    return NodeConditions(*joined[0], *joined[1])


def rows_in_the_mean(
    scene: Scene, partition: Partition, exchange: NodeExchange, number: int
) -> ContactRows:
    """Rows of a contact that is enforced on averages about vertices."""
    contact = scene.contacts[number]
    body = scene.bodies[contact.body]
    chosen = facets_of(scene.bodies, partition, contact.body, contact.boundary)
    if not partition.comm.allreduce(sum(map(len, chosen))):
        raise ConfigurationError(
            f"{scene.at(contact.source)}.on: no whole facet of the surface of {body.name} lies on "
            f"{contact.boundary}; contact of tetrahedra of degree 2 needs facets all of whose "
            "nodes are on it"
        )
    with agreed(partition.comm):
        try:
            return averaged_rows(partition, exchange, chosen, contact, number)
        except ConfigurationError as error:
            raise ConfigurationError(f"{scene.at(contact.source)}.obstacle: {error}") from None


def mortar_rows(
    scene: Scene, partition: Partition, exchange: NodeExchange, number: int
) -> ContactRows:
    """Mortar rows of a pair of bodies; the message names a side that has no facet."""
    pair = scene.pairs[number]
    on, against = (
        side.smooth() if pair.round else side for side in sides_of(scene, partition, pair)
    )
    try:
        rows = mean_gaps(on, against, partition.comm)
    except SurfacesApartError as error:
        raise ConfigurationError(f"{scene.at(pair.source)}: {error}") from error
    rows = replace(rows, gaps=rows.gaps - pair.interference)
    if scene.mirrors:
        rows = of_what_is_solved(scene.bodies, scene.mirrors, partition.nodes, rows)
    return owned_rows(exchange, rows, len(scene.contacts) + number)


def refuse_empty_boundaries(scene: Scene, partition: Partition, conditions: NodeConditions) -> None:
    """Refuse conditions and contacts whose boundary has no node."""
    groups: tuple[tuple[Sequence[DisplacementCondition | Contact], NDArray[np.int64]], ...] = (
        (scene.displacements, conditions.held_source),
        (scene.contacts, conditions.contact_source),
    )
    for things, sources in groups:
        count = partition.comm.allreduce(np.bincount(sources, minlength=len(things)))
        for thing, nodes in zip(things, count, strict=False):
            if nodes == 0 and not (
                isinstance(thing, Contact) and has_averaged_rows(scene.bodies[thing.body])
            ):
                raise ConfigurationError(
                    f"{scene.at(thing.source)}.on: no node of the surface of "
                    f"{scene.bodies[thing.body].name} lies on {thing.boundary}; change the "
                    "boundary's `where` or the mesh"
                )


def contradiction(scene: Scene, error: ContradictionError) -> ContactError:
    """The error that names the conditions that exclude each other."""
    if error.kind == "held twice":
        first, second = scene.displacements[error.first], scene.displacements[error.second]
        return ConfigurationError(
            f"{scene.at(first.source)} and {second.source} hold one node of "
            f"{scene.bodies[first.body].name} at displacements {abs(error.amount):.6g} apart"
        )
    contact = scene.touching[error.first]
    if error.kind == "squeezed":
        other = scene.touching[error.second].source
        return NoEquilibriumError(
            f"{scene.source}: the obstacles of {contact.source} and {other} leave a node of "
            f"{scene.bodies[contact.body].name} no room: they overlap by {error.amount:.6g} in "
            "the direction in which it can move, and no displacement satisfies both"
        )
    obstacle = "the obstacle" if isinstance(contact, Contact) else "the other body"
    return NoEquilibriumError(
        f"{scene.source}: the displacement conditions on {scene.bodies[contact.body].name} push "
        f"held nodes into {obstacle} of {contact.source}, by up to {error.amount:.6g}: no "
        "displacement satisfies both"
    )
