"""Tied pairs of a scene: rows that join two surfaces of arbitrary meshes."""

from dataclasses import dataclass, replace

import numpy as np

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.model.geometry import Geometry
from contact_app.model.pairs import owned_rows, sides_of
from contact_app.model.rigid import tightest_on_motions
from contact_app.model.rigid_ties import (
    ContactsAndTies,
    of_rigid_bodies,
    on_motions,
    refuse_pushed,
    rigidly_tied_rows,
    without_repeated,
)
from contact_app.scene.conditions import RigidTie
from meshes.arrays import Mask
from meshes.facing import SurfacesApartError
from meshes.ties import Decided, mean_jumps
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, ContradictionError, HeldRows
from solver.problem.constraints.merge import cut_held
from solver.problem.constraints.ties import undecided

FAR = 0.1
"""Distance of tied surfaces, relative to the size of a facet, from which on a warning is given."""


@dataclass(frozen=True, eq=False)
class TiedRows:
    """The tied rows of a scene."""

    rows: ContactRows
    """Rows that this rank owns, without held components; `sources` counts the ties."""
    notes: tuple[str, ...]
    """Sentences on sides that are apart."""


def tied_rows(geometry: Geometry, exchange: NodeExchange, held: HeldRows) -> TiedRows:
    """Write the rows of all ties (collective).

    Jumps of held nodes below 1e-9 of the length of the scene are round-off.

    Raises
    ------
    ConfigurationError
        A side has no facet, or the two never meet.
    NoEquilibriumError
        Displacement conditions hold the two sides apart.
    """
    ties = geometry.ties
    if not ties:
        return TiedRows(ContactRows.empty(geometry.dimension), ())
    of_rigid, moving = rigidly_tied_rows(geometry, exchange)
    decided = replace(decided_by(exchange, held), tied_before=moving)
    parts, notes = [ContactRows.empty(geometry.dimension), *of_rigid], []
    for number, tie in enumerate(ties):
        if isinstance(tie, RigidTie):
            continue
        sides = sides_of(geometry, tie)
        try:
            jumps = mean_jumps(*sides, decided, geometry.comm)
        except SurfacesApartError as error:
            raise ConfigurationError(f"{geometry.at(tie.source)}: {error}") from error
        if jumps.gap > FAR * jumps.size:
            notes.append(
                f"{tie.source}: the tied surfaces are up to {jumps.gap:.3g} apart, where facets "
                f"are {jumps.size:.3g} large: they are joined across the gap, as by bars"
            )
        parts += [owned_rows(exchange, rows, number) for rows in jumps.rows]
        nodes = [decided.tied_before, *(rows.nodes for rows in jumps.rows)]
        decided = replace(decided, tied_before=np.unique(np.concatenate(nodes)))
    rows = ContactRows.join(parts)
    try:
        cut = cut_held(exchange, rows, held, geometry.length, sides=2)
    except ContradictionError as error:
        raise NoEquilibriumError(
            f"{geometry.source}: the displacement conditions hold the two sides of "
            f"{ties[error.first].source}, which is tied, {error.amount:.6g} "
            "apart: no displacement satisfies both"
        ) from error
    if of_rigid:
        cut = without_repeated(geometry, exchange, cut)
    return TiedRows(cut, tuple(notes))


def without_determined(constraints: ContactsAndTies) -> tuple[ContactRows, ContactRows]:
    """Contact rows that tied rows leave open, and those that they determine (collective).

    Contact rows of nodes that are tied to moving rigid bodies are rows on the motions of these.
    """
    geometry, tied = constraints.geometry, constraints.tied
    moved = bool(of_rigid_bodies(geometry.ties) and geometry.rigid.moving)
    if moved:
        constraints = replace(constraints, contact=on_motions(constraints))
    some = _undetermined(constraints)
    contact, determined = constraints.contact.of(some), constraints.contact.of(~some)
    if moved:
        some = tightest_on_motions(geometry, contact, tied)
        contact, determined = contact.of(some), ContactRows.join([determined, contact.of(~some)])
    return contact, determined


def _undetermined(constraints: ContactsAndTies) -> Mask:
    """Mask (contact rows,) of rows that tied rows do not determine (collective).

    Contact with a rigid body is determined at nodes that are tied to it.
    """
    contact, tied, geometry = constraints.contact, constraints.tied, constraints.geometry
    some = undecided(geometry.comm, contact, tied) | contact.on_rigid
    if not of_rigid_bodies(geometry.ties):
        return some
    inside = np.zeros(len(some), bool)
    of_contacts = np.array([getattr(item, "rigid", None) for item in geometry.touching])
    for number, tie in of_rigid_bodies(geometry.ties):
        both = np.flatnonzero(of_contacts == tie.rigid)
        of_tie = tied.nodes[tied.sources == number]
        inside |= np.isin(contact.sources, both) & np.isin(contact.nodes, of_tie)
    refuse_pushed(constraints.of(~some & ~inside))
    return some & ~inside


def decided_by(exchange: NodeExchange, held: HeldRows) -> Decided:
    """Held nodes of all ranks, a small part of the surface; no row is taken yet (collective)."""
    nodes, masks = zip(*exchange.comm.allgather((held.nodes, held.held)), strict=True)
    every, mask = np.concatenate(nodes), np.concatenate(masks)
    order = np.argsort(every)
    return Decided(every[order], mask[order], np.zeros(0, np.int64))
