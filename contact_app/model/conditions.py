"""Held nodes and contact rows: conditions and contacts of a scene, written at the nodes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from contact_app.errors import ConfigurationError, ContactError, NoEquilibriumError
from contact_app.machine.ranks import agreed
from contact_app.model.averaged_rows import averaged_rows, has_averaged_rows
from contact_app.model.boundaries import boundary_nodes
from contact_app.model.geometry import Geometry
from contact_app.model.pairs import of_what_is_solved, owned_rows, sides_of
from contact_app.scene.conditions import BodyContact, Contact, DisplacementCondition
from meshes.arrays import Ints
from meshes.facing import SurfacesApartError
from meshes.mortar import mean_gaps
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, ContradictionError, NodeConditions


def node_conditions(
    geometry: Geometry, displacements: Sequence[DisplacementCondition]
) -> NodeConditions:
    """Held nodes and contact rows at the nodes of this rank's subdomains."""
    d = geometry.dimension
    held: list[tuple] = []
    touching: list[tuple] = []
    for s in geometry.partition.subdomains:
        body = geometry.bodies[s.body]
        for i, condition in enumerate(displacements):
            if condition.body != s.body:
                continue
            nodes = boundary_nodes(s, body, condition.boundary)
            if len(nodes) == 0:
                continue
            mask = np.array([v is not None for v in condition.values])
            values = np.array([v or 0.0 for v in condition.values])
            shape = (len(nodes), d)
            held.append(
                (
                    s.nodes[nodes], s.points()[nodes], np.broadcast_to(mask, shape),
                    np.broadcast_to(values, shape), np.full(len(nodes), i),
                )
            )  # fmt: skip
        for i, contact in enumerate(geometry.contacts):
            if contact.body != s.body or has_averaged_rows(body):
                continue
            nodes = boundary_nodes(s, body, contact.boundary)
            if len(nodes) == 0:
                continue
            points = s.points()[nodes]
            try:
                gap, normal = contact.gap_and_normal(points)
            except ConfigurationError as error:
                raise ConfigurationError(
                    f"{geometry.at(contact.source)}.obstacle: {error}"
                ) from None
            touching.append((s.nodes[nodes], points, -normal[:, :d], gap, np.full(len(nodes), i)))
    none = np.zeros(0, np.int64)
    held.append((none, np.zeros((0, 3)), np.zeros((0, d), bool), np.zeros((0, d)), none))
    touching.append((none, np.zeros((0, 3)), np.zeros((0, d)), np.zeros(0), none))
    joined = [[np.concatenate(c) for c in zip(*part, strict=True)] for part in (held, touching)]
    return NodeConditions(*joined[0], *joined[1])


def rows_in_the_mean(
    geometry: Geometry, exchange: NodeExchange, contact: Contact, number: int
) -> ContactRows:
    """Rows of a contact, given its number, that is enforced on averages about vertices."""
    partition, body = geometry.partition, geometry.bodies[contact.body]
    chosen = geometry.facets_of(contact.body, contact.boundary)
    if not partition.comm.allreduce(sum(map(len, chosen))):
        raise ConfigurationError(
            f"{geometry.at(contact.source)}.on: no whole facet of the surface of {body.name} lies "
            f"on {contact.boundary}; contact of tetrahedra of degree 2 needs facets all of whose "
            "nodes are on it"
        )
    with agreed(partition.comm):
        try:
            return averaged_rows(partition, exchange, chosen, contact, number)
        except ConfigurationError as error:
            raise ConfigurationError(f"{geometry.at(contact.source)}.obstacle: {error}") from None


def mortar_rows(
    geometry: Geometry, exchange: NodeExchange, pair: BodyContact, number: int
) -> ContactRows:
    """Mortar rows of a pair of bodies, given its number among all contacts."""
    on, against = (side.smooth() if pair.round else side for side in sides_of(geometry, pair))
    try:
        rows = mean_gaps(on, against, geometry.comm)
    except SurfacesApartError as error:
        raise ConfigurationError(f"{geometry.at(pair.source)}: {error}") from error
    rows = replace(rows, gaps=rows.gaps - pair.interference)
    if geometry.mirrors:
        rows = of_what_is_solved(geometry, rows)
    return owned_rows(exchange, rows, number)


def refuse_empty_boundaries(
    geometry: Geometry, displacements: Sequence[DisplacementCondition], conditions: NodeConditions
) -> None:
    """Refuse conditions and contacts whose boundary has no node (collective)."""
    groups: tuple[tuple[Sequence[DisplacementCondition | Contact], Ints], ...] = (
        (displacements, conditions.held_source),
        (geometry.contacts, conditions.contact_source),
    )
    for things, sources in groups:
        count = geometry.comm.allreduce(np.bincount(sources, minlength=len(things)))
        for thing, nodes in zip(things, count, strict=False):
            if nodes == 0 and not (
                isinstance(thing, Contact) and has_averaged_rows(geometry.bodies[thing.body])
            ):
                raise ConfigurationError(
                    f"{geometry.at(thing.source)}.on: no node of the surface of "
                    f"{geometry.bodies[thing.body].name} lies on {thing.boundary}; change the "
                    "boundary's `where` or the mesh"
                )


def contradiction(
    geometry: Geometry, displacements: Sequence[DisplacementCondition], error: ContradictionError
) -> ContactError:
    """The error that names the conditions that exclude each other."""
    if error.kind == "held twice":
        first, second = displacements[error.first], displacements[error.second]
        return ConfigurationError(
            f"{geometry.at(first.source)} and {second.source} hold one node of "
            f"{geometry.bodies[first.body].name} at displacements {abs(error.amount):.6g} apart"
        )
    contact = geometry.touching[error.first]
    if error.kind == "squeezed":
        other = geometry.touching[error.second].source
        return NoEquilibriumError(
            f"{geometry.source}: the obstacles of {contact.source} and {other} leave a node of "
            f"{geometry.bodies[contact.body].name} no room: they overlap by {error.amount:.6g} in "
            "the direction in which it can move, and no displacement satisfies both"
        )
    obstacle = "the obstacle" if isinstance(contact, Contact) else "the other body"
    return NoEquilibriumError(
        f"{geometry.source}: the displacement conditions on "
        f"{geometry.bodies[contact.body].name} push held nodes into {obstacle} of "
        f"{contact.source}, by up to {error.amount:.6g}: no displacement satisfies both"
    )
