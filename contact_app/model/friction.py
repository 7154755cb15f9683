"""Contacts of a scene with friction: their boundaries, laws and tangential rows."""

from collections.abc import Sequence

import numpy as np

from contact_app.model.facets import moments
from contact_app.model.geometry import Geometry
from contact_app.model.pairs import sides_of
from contact_app.model.rigid import RigidUnknowns, with_body
from contact_app.model.tangential_rows import (
    RoughContact,
    slips_at_obstacle,
    slips_between,
    summed_at,
)
from contact_app.model.ties import decided_by
from contact_app.scene.conditions import BodyContact, Contact
from meshes.arrays import Array, Ints, Mask
from meshes.ties import MeanJumps, mean_jumps
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, HeldRows
from solver.problem.constraints.friction import FrictionRows


def rough_contacts(
    geometry: Geometry, exchange: NodeExchange, held: HeldRows
) -> list[RoughContact]:
    """The contacts with friction among all contacts, in the order of their numbers."""
    return [
        _rough(geometry, exchange, held, item, number)
        for number, item in enumerate(geometry.touching)
        if item.law.acts
    ]


def always_rough(touching: Sequence[Contact | BodyContact], contact: ContactRows) -> Mask:
    """Mask of contact rows whose friction acts also while they are open, (rows,)."""
    return np.array([*(c.law.limit > 0.0 for c in touching), False])[contact.sources]


def without_area(geometry: Geometry, friction: FrictionRows) -> list[str]:
    """Sentences on contact points where Tresca friction has no area to act on (collective)."""
    sentences = []
    for number, contact in enumerate(geometry.touching):
        if contact.law.limit == 0.0:
            continue
        rows = friction.rows
        lost = rows.nodes[(rows.sources == number) & (friction.limits == 0.0)]
        count = geometry.comm.allreduce(len(np.unique(lost)))
        if count:
            sentences.append(
                f"{contact.source}: {count} nodes lie on no whole facet of {contact.boundary}: "
                "they have no area, so Tresca friction does not act on them"
            )
    return sentences


def _rough(
    geometry: Geometry,
    exchange: NodeExchange,
    held: HeldRows,
    touching: Contact | BodyContact,
    number: int,
) -> RoughContact:
    """One contact with friction."""

    def slips(contact: ContactRows) -> tuple[ContactRows, Mask]:
        if isinstance(touching, BodyContact):
            jumps = _jumps(geometry, exchange, touching, held)
            return slips_between(exchange, contact, jumps, number)
        moves = touching.rigid in geometry.rigid.moving
        rows, is_free = slips_at_obstacle(contact, None if moves else held)
        if touching.rigid is not None:
            unknowns, rigid = RigidUnknowns.of(geometry), touching.rigid
            rows = with_body(rows, unknowns, rigid, unknowns.placed_center(rigid))
        return rows, is_free

    def shares(nodes: Ints) -> Array:
        return _shares(geometry, exchange, touching, nodes)

    return RoughContact(number, touching.law, shares, slips)


def _jumps(
    geometry: Geometry, exchange: NodeExchange, pair: BodyContact, held: HeldRows
) -> MeanJumps:
    """Mean jumps of the displacements of a pair, of all ranks (collective)."""
    sides, decided = sides_of(geometry, pair), decided_by(exchange, held)
    return mean_jumps(*sides, decided, geometry.comm, gives=False)


def _shares(
    geometry: Geometry, exchange: NodeExchange, touching: Contact | BodyContact, nodes: Ints
) -> Array:
    """∫ φ_k over the boundary of a contact at some nodes this rank owns, (n,) (collective)."""
    every, values = [np.zeros(0, np.int64)], [np.zeros(0)]
    chosen = geometry.facets_of(touching.body, touching.boundary)
    for s, rows in zip(geometry.partition.subdomains, chosen, strict=True):
        if len(rows):
            facets = s.reference.facets[rows]
            share = moments(s.points()[facets], geometry.dimension).sum(axis=1)
            every.append(s.nodes[facets].ravel())
            values.append(share.ravel())
    return summed_at(exchange, np.concatenate(every), np.concatenate(values), nodes)
