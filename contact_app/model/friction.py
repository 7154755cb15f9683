"""Contacts of a scene with friction: their boundaries, laws and tangential rows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.model.boundaries import facets_of
from contact_app.model.facets import moments
from contact_app.model.pairs import sides_of
from contact_app.model.rigid import RigidUnknowns, with_slips
from contact_app.model.tangential_rows import (
    RoughContact,
    slips_at_obstacle,
    slips_between,
    summed_at,
    tangential_rows,
)
from contact_app.model.ties import decided_by
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import BodyContact, Contact
from contact_app.scene.scene import Scene
from meshes import Partition
from meshes.ties import MeanJumps, mean_jumps
from solver.tfeti.constraints.conditions import ContactRows, HeldRows
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.friction import FrictionRows

Array = NDArray[np.float64]


def friction_rows(
    scene: Scene,
    partition: Partition,
    exchange: NodeExchange,
    contact: ContactRows,
    held: HeldRows,
    tied: ContactRows,
    merged: ContactRows,
) -> FrictionRows | None:
    """The tangential rows of all contacts with friction (collective); None where there are none.

    Parameters
    ----------
    contact, held, tied, merged
        As `tangential_rows` takes them.
    """
    if not scene.has_friction:
        return None
    rough = [
        _rough(scene, partition, exchange, held, number)
        for number, touching in enumerate(scene.touching)
        if touching.friction is not None
    ]
    return tangential_rows(exchange, rough, contact, merged, held, tied)


def always_rough(
    touching: Sequence[Contact | BodyContact], contact: ContactRows
) -> NDArray[np.bool_]:
    """Mask of contact rows whose friction acts also while they are open, (rows,)."""
    has_limit = [c.friction is not None and c.friction.tresca is not None for c in touching]
    return np.array([*has_limit, False])[contact.sources]


def without_area(
    touching: Sequence[Contact | BodyContact], friction: FrictionRows | None, comm: MPI.Intracomm
) -> list[str]:
    """Sentences on contact points where Tresca friction has no area to act on (collective)."""
    sentences = []
    for number, contact in enumerate(touching):
        if contact.friction is None or not contact.friction.tresca or friction is None:
            continue
        rows = friction.rows
        lost = rows.nodes[(rows.sources == number) & (friction.limits == 0.0)]
        count = comm.allreduce(len(np.unique(lost)))
        if count:
            sentences.append(
                f"{contact.source}: {count} nodes lie on no whole facet of {contact.boundary}: "
                "they have no area, so Tresca friction does not act on them"
            )
    return sentences


def _rough(
    scene: Scene, partition: Partition, exchange: NodeExchange, held: HeldRows, number: int
) -> RoughContact:
    """One contact with friction."""
    touching = scene.touching[number]
    assert touching.friction is not None

    def slips(contact: ContactRows) -> tuple[ContactRows, NDArray[np.bool_]]:
        if isinstance(touching, BodyContact):
            jumps = _jumps(scene, partition, exchange, touching, held)
            return slips_between(exchange, contact, jumps, number)
        rows, is_free = slips_at_obstacle(contact, None if touching.rigid in scene.moving else held)
        if touching.rigid is not None:
            rows = with_slips(rows, RigidUnknowns.of(scene, partition), touching.rigid)
        return rows, is_free

    def shares(nodes: NDArray[np.int64]) -> Array:
        return _shares(scene.bodies, partition, exchange, touching, nodes)

    return RoughContact(number, touching.friction, shares, slips)


def _jumps(
    scene: Scene, partition: Partition, exchange: NodeExchange, pair: BodyContact, held: HeldRows
) -> MeanJumps:
    """Mean jumps of the displacements of a pair, of all ranks (collective)."""
    sides, decided = sides_of(scene, partition, pair), decided_by(exchange, held)
    return mean_jumps(*sides, decided, partition.comm, gives=False)


def _shares(
    bodies: Sequence[Body],
    partition: Partition,
    exchange: NodeExchange,
    touching: Contact | BodyContact,
    nodes: NDArray[np.int64],
) -> Array:
    """∫ φ_k over the boundary of a contact at some nodes this rank owns, (n,) (collective)."""
    every, values = [np.zeros(0, np.int64)], [np.zeros(0)]
    chosen = facets_of(bodies, partition, touching.body, touching.boundary)
    for s, rows in zip(partition.subdomains, chosen, strict=True):
        if len(rows):
            facets = s.reference.facets[rows]
            share = moments(s.points()[facets], partition.dimension).sum(axis=1)
            every.append(s.nodes[facets].ravel())
            values.append(share.ravel())
    return summed_at(exchange, np.concatenate(every), np.concatenate(values), nodes)
