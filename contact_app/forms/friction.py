"""Contacts of forms with friction: their boundaries, laws and tangential rows."""

from collections.abc import Sequence

from contact_app.forms.boundary import Facets
from contact_app.forms.contacts import Contact
from contact_app.forms.parts import Parts
from contact_app.forms.sides import Sides
from contact_app.model.tangential_rows import (
    RoughContact,
    slips_at_obstacle,
    slips_between,
    summed_at,
    tangential_rows,
)
from contact_app.model.ties import decided_by
from meshes.arrays import Array, Ints, Mask
from meshes.ties import MeanJumps, mean_jumps
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, HeldRows
from solver.problem.constraints.friction import FrictionRows


def jumps_of(
    exchange: NodeExchange, contacts: Sequence[Contact], sides: Sequence[Sides], held: HeldRows
) -> tuple[MeanJumps | None, ...]:
    """Mortar means of the motions along each other, of pairs with friction (collective)."""
    jumps: list[MeanJumps | None] = []
    for contact, side in zip(contacts, sides, strict=True):
        if not contact.law.acts or contact.against is None:
            jumps.append(None)
        else:
            on, against = side.surfaces
            decided = decided_by(exchange, held)
            jumps.append(mean_jumps(on, against, decided, exchange.comm, gives=False))
    return tuple(jumps)


def friction_rows(
    parts: Parts,
    exchange: NodeExchange,
    contacts: Sequence[Contact],
    sides: tuple[Sequence[Sides], Sequence[MeanJumps | None]],
    held: HeldRows,
    rows: tuple[ContactRows, ContactRows],
) -> FrictionRows:
    """The tangential rows of all contacts with friction (collective).

    Parameters
    ----------
    sides
        Of each contact, and its `jumps_of`.
    rows
        Contact rows this rank owns, and those that are redundant beside them.
    """
    rough = [
        _rough(parts, exchange, held, (contact, side.facets, jumps), number)
        for number, (contact, side, jumps) in enumerate(zip(contacts, *sides, strict=True))
        if contact.law.acts
    ]
    contact, merged = rows
    return tangential_rows(exchange, rough, contact, merged, held, contact.none())


def _rough(
    parts: Parts,
    exchange: NodeExchange,
    held: HeldRows,
    touching: tuple[Contact, Facets, MeanJumps | None],
    number: int,
) -> RoughContact:
    """One contact with friction."""
    contact, facets, jumps = touching

    def slips(contact_rows: ContactRows) -> tuple[ContactRows, Mask]:
        if jumps is None:
            return slips_at_obstacle(contact_rows, held)
        return slips_between(exchange, contact_rows, jumps, number)

    def shares(nodes: Ints) -> Array:
        values = contact.shares(facets.points, parts.dimension)
        return summed_at(exchange, facets.numbers.ravel(), values.ravel(), nodes)

    return RoughContact(number, contact.law, shares, slips)
