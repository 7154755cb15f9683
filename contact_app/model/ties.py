"""Tied pairs of a scene: rows that join two surfaces of arbitrary meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.model.pairs import owned_rows, sides_of
from contact_app.scene.scene import Scene
from meshes import Partition
from meshes.facing import SurfacesApartError
from meshes.ties import Decided, mean_jumps
from solver.tfeti.constraints.conditions import (
    ContactEntries,
    ContactRows,
    ContradictionError,
    HeldRows,
)
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.merge import cut_held

FAR = 0.1
"""Distance of tied surfaces, relative to the size of a facet, from which on a warning is given."""


@dataclass(frozen=True, eq=False)
class TiedRows:
    """The tied rows of a scene.

    Attributes
    ----------
    rows
        Rows that this rank owns, without held components; `sources` counts `Scene.ties`.
    notes
        Sentences on sides that are apart.
    """

    rows: ContactRows
    notes: tuple[str, ...]


def tied_rows(
    scene: Scene, partition: Partition, exchange: NodeExchange, held: HeldRows, length: float
) -> TiedRows:
    """Write the rows of all tied pairs (collective).

    Parameters
    ----------
    length
        A length of the scene; jumps of held nodes below 1e-9 of it are round-off.

    Raises
    ------
    ConfigurationError
        A side has no facet, or the two never meet.
    NoEquilibriumError
        Displacement conditions hold the two sides apart.
    """
    d = scene.dimension
    if not scene.ties:
        return TiedRows(ContactRows.empty(d), ())
    decided = decided_by(exchange, held)
    parts, notes = [ContactRows.empty(d)], []
    for number, tie in enumerate(scene.ties):
        sides = sides_of(scene, partition, tie)
        try:
            found = mean_jumps(*sides, decided, partition.comm)
        except SurfacesApartError as error:
            raise ConfigurationError(f"{scene.at(tie.source)}: {error}") from error
        if found.gap > FAR * found.size:
            notes.append(
                f"{tie.source}: the tied surfaces are up to {found.gap:.3g} apart, where facets "
                f"are {found.size:.3g} large: they are joined across the gap, as by bars"
            )
        parts += [owned_rows(exchange, rows, number) for rows in found.rows]
        nodes = [decided.tied_before, *(rows.nodes for rows in found.rows)]
        decided = replace(decided, tied_before=np.unique(np.concatenate(nodes)))
    rows = ContactRows.join(parts)
    try:
        for sign in (-1.0, 1.0):
            cut = cut_held(exchange, _signed(rows, sign), held, length)
    except ContradictionError as error:
        tie = scene.ties[error.first]
        raise NoEquilibriumError(
            f"{scene.source}: the displacement conditions hold the two sides of {tie.source}, "
            f"which is tied, {error.amount:.6g} apart: no displacement satisfies both"
        ) from error
    return TiedRows(cut, tuple(notes))


def decided_by(exchange: NodeExchange, held: HeldRows) -> Decided:
    """Held nodes of all ranks, a small part of the surface; no row is taken yet (collective)."""
    nodes, masks = zip(*exchange.comm.allgather((held.nodes, held.held)), strict=True)
    every, mask = np.concatenate(nodes), np.concatenate(masks)
    order = np.argsort(every)
    return Decided(every[order], mask[order], np.zeros(0, np.int64))


def _signed(rows: ContactRows, sign: float) -> ContactRows:
    """Rows times one or minus one; of the first kind nothing is changed."""
    if sign > 0.0:
        return rows
    entries = rows.entries
    turned = ContactEntries(
        entries.row, entries.node, entries.points, entries.component, -entries.value
    )
    fields: Sequence[str] = [name for name in rows.__dict__ if name != "entries"]
    return ContactRows(**{name: getattr(rows, name) for name in fields}, entries=turned)
