"""Held nodes and contact rows of Dirichlet conditions and contacts of forms."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.errors import NoEquilibriumError
from contact_app.forms.boundary import Facets
from contact_app.forms.checks import check_holding, together
from contact_app.forms.contacts import Contact
from contact_app.forms.parts import Parts
from contact_app.forms.sides import Sides
from contact_app.model.averaged_rows import rows_about_vertices
from contact_app.model.pairs import owned_rows
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import (
    ContactRows,
    ContradictionError,
    HeldRows,
    NodeConditions,
)
from solver.problem.constraints.merge import merge_contact, merge_held


def rows_of(
    parts: Parts,
    exchange: NodeExchange,
    bcs: Sequence[Any],
    contacts: Sequence[Contact],
    sides: Sequence[Sides],
) -> tuple[HeldRows, ContactRows, ContactRows]:
    """Held nodes, contact rows, and rows that are redundant beside these (collective).

    Raises
    ------
    ValueError, ConfigurationError
        A contact is of no use, or a condition holds no node.
    NoEquilibriumError
        Conditions exclude each other.
    """
    check_holding(parts.comm, bcs)
    size = _size(parts)
    at_nodes, means = [_no_contact(parts.dimension)], []
    for i, (contact, side) in enumerate(zip(contacts, sides, strict=True)):
        if side.gaps is not None:
            gaps_of_pair = replace(side.gaps, gaps=side.gaps.gaps - contact.interference)
            means.append(owned_rows(exchange, gaps_of_pair, i))
        elif in_the_mean(parts):
            means.append(_mean_rows(parts, exchange, (contact, side.facets), i, size))
        else:
            at_nodes.append(_node_rows(parts, contact, side.facets, i, size))
    joined = [np.concatenate(values) for values in zip(*at_nodes, strict=True)]
    conditions = NodeConditions(*_held(parts, bcs), *joined)
    try:
        held = merge_held(exchange, conditions)
        rows, merged = merge_contact(exchange, conditions, held, size, means)
    except ContradictionError as error:
        raise _contradiction(contacts, error) from error
    return held, rows, merged


def _size(parts: Parts) -> float:
    """Longest side of the box about the mesh (collective)."""
    lower = parts.points.min(axis=0, initial=np.inf)
    upper = parts.points.max(axis=0, initial=-np.inf)
    sides = np.max(parts.comm.allgather(upper), axis=0) - np.min(
        parts.comm.allgather(lower), axis=0
    )
    return float(sides.max())


_AtNodes = tuple[Ints, Array, Array, Array, Ints]
"""Fields of `NodeConditions` on contacts."""


def _no_contact(d: int) -> _AtNodes:
    none = np.zeros(0, np.int64)
    return none, np.zeros((0, 3)), np.zeros((0, d)), np.zeros(0), none


def _node_rows(
    parts: Parts, contact: Contact, tagged: Facets, number: int, size: float
) -> _AtNodes:
    """A row at each node of a contact with an obstacle (collective)."""
    copies, first = np.unique(tagged.copies, return_index=True)
    points = tagged.points.reshape(-1, 3)[first]
    with together(parts.comm):
        gap, normal = contact.gap_and_normal(points, parts.dimension, size)
    source = np.full(len(copies), number)
    return parts.numbers[copies], points, -normal[:, : parts.dimension], gap, source


def _mean_rows(
    parts: Parts, exchange: NodeExchange, contact: tuple[Contact, Facets], number: int, size: float
) -> ContactRows:
    """Rows about the vertices of a contact with an obstacle (collective)."""
    touching, side = contact
    pieces = [(side.numbers, side.points)] if len(side.copies) else []

    def gap_and_normal(points: Array) -> tuple[Array, Array]:
        return touching.gap_and_normal(points, parts.dimension, size)

    with together(parts.comm):
        return rows_about_vertices(exchange, parts.dimension, pieces, gap_and_normal, number)


def in_the_mean(parts: Parts) -> bool:
    """Whether contact with obstacles is enforced on averages about vertices, not at nodes."""
    tetrahedra = parts.space.mesh.topology.cell_name() == "tetrahedron"
    return tetrahedra and dolfinx_compat.lagrange_degree(parts.space) == 2


def _held(parts: Parts, bcs: Sequence[Any]) -> tuple[NDArray, Array, NDArray, Array, NDArray]:
    """Held nodes in the form of `NodeConditions`; the last of several values, as in dolfinx."""
    mask, value = held_values(parts, bcs)
    with together(parts.comm):
        if not np.isfinite(value[mask]).all():
            raise ValueError("bcs: a value of a Dirichlet condition is not finite")
    some = np.flatnonzero(mask.any(axis=1))
    return (
        parts.numbers[some], parts.points[some], mask[some],
        np.where(mask[some], value[some], 0.0), np.zeros(len(some), np.int64),
    )  # fmt: skip


def held_values(parts: Parts, bcs: Sequence[Any]) -> tuple[Mask, Array]:
    """Mask and values (copies, d) of the components held by Dirichlet conditions."""
    d, dofmap = parts.dimension, parts.space.dofmap
    value = np.zeros(d * (dofmap.index_map.size_local + dofmap.index_map.num_ghosts))
    dolfinx_compat.set_values(bcs, value)
    return held_components(parts, bcs), value.reshape(-1, d)[parts.blocks]


def held_components(parts: Parts, bcs: Sequence[Any]) -> Mask:
    """Mask (copies, d) of the components held by Dirichlet conditions."""
    d, dofmap = parts.dimension, parts.space.dofmap
    mask = np.zeros(d * (dofmap.index_map.size_local + dofmap.index_map.num_ghosts), bool)
    for condition in bcs:
        mask[np.asarray(condition.dof_indices()[0])] = True
    return mask.reshape(-1, d)[parts.blocks]


def _contradiction(contacts: Sequence[Contact], error: ContradictionError) -> Exception:
    """The error that names the conditions that exclude each other."""
    if error.kind == "held twice":
        return ValueError(
            f"ranks hold one node at displacements {abs(error.amount):.6g} apart; the value of a "
            "Dirichlet condition must be the same on all of them (scatter_forward)"
        )
    first = contacts[error.first].on
    if error.kind == "squeezed":
        return NoEquilibriumError(
            f"the contacts of {first} and {contacts[error.second].on} leave a node no room: they "
            f"overlap by {error.amount:.6g} in the direction in which it can move"
        )
    return NoEquilibriumError(
        f"the Dirichlet conditions push held nodes of {first} into the other side, by up to "
        f"{error.amount:.6g}: no displacement satisfies both"
    )
