"""Fields at the nodes of the mesh, resultants and summary of an answer."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_app.forms.model import FormModel
from contact_app.forms.parts import Parts
from contact_app.forms.rows import held_components, in_the_mean
from contact_app.machine.environment import environment
from contact_app.machine.timings import Timings
from contact_app.model.normal_forces import NormalForces
from contact_app.results.contact_side import ContactSide
from contact_app.results.division import ContactLoads
from contact_app.results.friction import dissipated_work, of_most_pressed
from contact_app.results.pressure import NodesInContact, nodes_of_side
from contact_app.results.reactions import add_contact
from contact_app.results.resultants import joined, summed
from contact_app.results.smoothed_pressure import AT_PLANE, smoothed_on
from contact_app.results.summary import decomposition_record, solver_record
from meshes.quadratic import FACETS
from solver.contact.solution import Solution
from solver.exchange import NodeExchange
from solver.vectors import Array, Ints, Mask, largest_magnitude


class Owners:
    """Values at copies of nodes and at their owners; all methods are collective."""

    def __init__(self, exchange: NodeExchange) -> None:
        self._exchange = exchange
        self.count = exchange.last - exchange.first
        self._at = exchange.nodes - exchange.first

    @classmethod
    def of_subdomains(cls, model: FormModel) -> "Owners":
        """Owners of the copies in subdomains."""
        return cls(model.exchange)

    @classmethod
    def of_parts(cls, model: FormModel) -> "Owners":
        """Owners of the copies in parts, which are on the ranks of their cells."""
        if model.subdomains.moved is None:
            return cls(model.exchange)
        return cls(model.exchange.among(model.parts.numbers))

    def sums(self, copies: Array) -> Array:
        """Values (copies, …) summed over the copies of a node, (owned, …)."""
        arrived = self._exchange.to_owners(copies)
        columns = arrived.reshape(len(arrived), -1).T
        sums = [np.bincount(self._at, column, minlength=self.count) for column in columns]
        return np.stack(sums, axis=1).reshape(self.count, *copies.shape[1:]).astype(float)

    def copies(self, owned: Array) -> Array:
        """Values (owned, …) at the copies."""
        return self._exchange.from_owners(owned[self._at])

    def mean(self, copies: Array) -> Array:
        """Mean over the copies of a node; zero where there is none."""
        count = np.maximum(self.sums(np.ones(len(copies))), 1.0)
        return self.sums(copies) / count.reshape(-1, *(1,) * (copies.ndim - 1))

    def on(self, some: Ints, count: int) -> Mask:
        """Mask (owned,) of the nodes that have some of the copies, of all that there are."""
        marks = np.zeros(count)
        marks[some.ravel()] = 1.0
        return self.sums(marks) > 0.0

    def at(self, copies: Array) -> Array:
        """Values (copies, …) that are equal at all copies of a node, (owned, …)."""
        result = np.zeros((self.count, *copies.shape[1:]), copies.dtype)
        result[self._at] = self._exchange.to_owners(copies)
        return result


class OnSpace:
    """Map from owned nodes to the space of the forms (collective)."""

    def __init__(self, parts: Parts, exchange: NodeExchange) -> None:
        dofmap = parts.space.dofmap
        here = dofmap.index_map.size_local + dofmap.index_map.num_ghosts
        numbers = dofmap.index_map.local_to_global(np.arange(here, dtype=np.int32))
        self._space = exchange.among(numbers.astype(np.int64))

    def values(self, owned: Array) -> Array:
        """Values (owned, …) at the nodes of the space on this rank, including ghosts."""
        return self._space.from_owners(owned[self._space.nodes - self._space.first])


@dataclass(frozen=True, eq=False)
class ContactAtNodes(NodesInContact):
    """One contact at the nodes that this rank owns; zero away from it."""

    gap: Array  # (owned,)
    """NaN where there is no row."""
    planes: Sequence[tuple[int, float]]
    """Axis and place of the planes of symmetry at which the contact goes on."""


def contact_at_nodes(
    model: FormModel,
    solution: Solution,
    owners: Owners,
    loads: ContactLoads,
    number: int,
    planes: Sequence[tuple[int, float]],
) -> ContactAtNodes:
    """Pressure, gap and forces of one contact (collective).

    Parameters
    ----------
    loads
        Forces of all contact rows.
    planes
        Axis and place of planes of symmetry at which the contact goes on.
    """
    problem, rows = model.problem, model.problem.contact
    side, of_contact = _side_of(model, owners, number), rows.sources == number
    between = model.contacts[number].against is not None
    at_nodes = not between and not in_the_mean(model.parts)
    carriers = (side.shares if at_nodes else side.areas) > 0.0
    nodes, covered, _ = nodes_of_side(side, loads, number, (at_nodes, between, None), carriers)
    jump = problem.jumps(solution.displacements)[problem.inequality]
    gap = np.full(owners.count, np.nan)
    at = rows.nodes[of_contact] - model.exchange.first
    np.fmin.at(gap, at, (-jump / rows.spread)[of_contact])
    if side.degree == 2 and not at_nodes:
        gap = side.at_all_nodes(gap)
    smoothed = _smoothed(model, side, number, (nodes.pressure, covered), at_nodes, planes)
    return ContactAtNodes(**{**vars(nodes), "smoothed": smoothed}, gap=gap, planes=planes)


def _side_of(model: FormModel, owners: Owners, number: int) -> ContactSide:
    """The tagged facets of a contact."""
    parts, facets = model.parts, model.sides[number].facets
    d, nodes = parts.dimension, facets.copies.shape[1]
    shares = model.contacts[number].shares(facets.points, d) if len(facets.copies) else None
    return ContactSide(
        1 if nodes == FACETS[d, nodes].vertices else 2, d,
        [] if shares is None else [(facets.copies, shares)], parts.points,
        model.exchange.first + np.arange(owners.count), model.exchange, owners.sums, owners.copies,
    )  # fmt: skip


def _smoothed(
    model: FormModel,
    side: ContactSide,
    number: int,
    pressures: tuple[Array, Array],
    at_nodes: bool,
    planes: Sequence[tuple[int, float]],
) -> Array:
    """The pressure of a contact without what facets make of it, (owned,) (collective).

    Parameters
    ----------
    pressures : (owned,), (owned,)
        The pressure, and covered shares.
    """
    on, parts = np.flatnonzero(side.facets_of_node), model.parts
    pressure, covered = (values[on] for values in pressures)
    at_on = side.owned[on], pressure, side.shares[on], covered
    result = np.zeros(len(side.owned))
    surfaces = model.sides[number].surfaces
    stiff = parts.space.mesh.topology.cell_name() == "triangle" and side.degree == 1
    weighted = [(*plane, AT_PLANE if stiff else 1.0) for plane in planes]
    result[on] = smoothed_on(parts.comm, surfaces, at_on, parts.nodes, at_nodes, weighted)
    return result


def contact_records(
    model: FormModel,
    owners: Owners,
    contacts: list[ContactAtNodes],
    peaks: Sequence[float | None],
) -> list[dict[str, Any]]:
    """The list `contacts` of the summary (collective).

    Parameters
    ----------
    peaks
        The largest smoothed pressures where they are not those at nodes.
    """
    records, points = [], owners.at(model.parts.points)
    for contact, nodes, peak in zip(model.contacts, contacts, peaks, strict=True):
        comm, carriers = model.parts.comm, nodes.carriers
        resultant = summed(comm, points, carriers, nodes.forces, nodes.shares, nodes.moments)
        counts = np.bincount(nodes.status[carriers], minlength=3)
        area, *counts = comm.allreduce(np.array([nodes.areas.sum(), *counts]))
        records.append({
            "on": contact.on, "with": contact.other,
            **joined([resultant], model.parts.dimension), "area": float(area),
            "max_pressure": largest_magnitude(comm, nodes.pressure),
            "max_smoothed_pressure": largest_magnitude(comm, nodes.smoothed)
            if peak is None else peak,
            "nodes": dict(zip(("open", "stick", "slip"), map(int, counts), strict=True)),
        })  # fmt: skip
    return records


def reaction_records(
    model: FormModel, solution: Solution, owners: Owners, bcs: Sequence[Any]
) -> list[dict[str, Any]]:
    """The list `reactions` of the summary: force and moment of each condition (collective).

    Where several conditions hold a component of a node, the first has the reaction.
    """
    d, comm = model.parts.dimension, model.parts.comm
    force = np.zeros((owners.count, 3))
    force[:, :d] = _force_of_conditions(model, solution)
    taken, records = np.zeros((owners.count, 3), bool), []
    points = owners.at(model.parts.points)
    for number, condition in enumerate(bcs):
        holds = np.zeros((owners.count, 3), bool)
        held = held_components(model.parts, [condition]).astype(float)
        holds[:, :d] = owners.sums(held) > 0.0
        reaction = np.where(holds & ~taken, force, 0.0)
        taken |= holds
        on = holds.any(axis=1)
        resultant = summed(comm, points, on, reaction, np.zeros(owners.count))
        records.append({"on": f"bcs[{number}]", **joined([resultant], d)})
    return records


def _force_of_conditions(model: FormModel, solution: Solution) -> Array:
    """Force of conditions and contacts on each node, (owned, d) (collective).

    It is the residual K u - f. In held components the forces of contact rows are subtracted.
    """
    problem = model.problem
    residual = [
        cls.stiffness @ u - f
        for cls, u, f in zip(problem.classes, solution.displacements, problem.forces, strict=True)
    ]
    force = Owners.of_subdomains(model).sums(model.at_copies(residual))
    add_contact(problem, model.exchange, solution, force)
    return force


def summary_of(
    model: FormModel,
    solution: Solution,
    displacement: Array,
    records: tuple[list[dict[str, Any]], list[dict[str, Any]]],
    timings: Timings,
    before: NormalForces | None,
) -> dict[str, Any]:
    """The summary with the keys of `summary.json` that exist for forms (collective).

    Parameters
    ----------
    displacement : (owned, dimension)
    records
        `contacts` and `reactions`.
    before
        Normal forces at the begin of an increment; None of a load applied at once.
    """
    contacts, reactions = records
    comm, parts = model.parts.comm, model.parts
    magnitude = np.linalg.norm(displacement, axis=1)
    mesh, count = parts.space.mesh, comm.allreduce(model.subdomains.count)
    multiplier = solution.multiplier[model.problem.inequality]
    certificate = solution.certificate.as_dict()
    rough = model.problem.friction.acts
    work = {"dissipated_work": dissipated_work(model.problem, solution, before)} if rough else {}
    forces = [c["force"] for c, contact in zip(contacts, model.contacts, strict=True)
              if contact.against is None]  # fmt: skip
    return {
        "mesh": {
            "cells": int(mesh.topology.index_map(mesh.topology.dim).size_global),
            "nodes": parts.nodes,
            "dofs": parts.nodes * parts.dimension,
        },
        "decomposition": decomposition_record(model.problem, count),
        "solver": solver_record(solution),
        "solution": {
            "energy": solution.measures.energy,
            "max_displacement": largest_magnitude(comm, magnitude),
            "mean_displacement": comm.allreduce(float(magnitude.sum())) / parts.nodes,
            "active_contacts": comm.allreduce(int((multiplier > 0.0).sum())),
            "contact_force": np.sum([np.zeros(3), *forces], axis=0).tolist(),
            "max_contact_pressure": max((c["max_pressure"] for c in contacts), default=0.0),
            **work,
        },
        "contacts": contacts,
        "reactions": reactions,
        "certificate": certificate,
        "timings": timings.as_dict(),
        "environment": environment(comm),
    }


def friction_fields(
    contacts: list[ContactAtNodes], count: int, d: int
) -> tuple[Array, Array, Ints]:
    """Friction traction and slip, (owned, d), and status, (owned,), of all contacts."""
    pieces = []
    for nodes in contacts:
        on = np.flatnonzero(nodes.carriers | (nodes.shares > 0.0))
        pieces.append(
            (on, nodes.pressure[on], nodes.traction[on], nodes.slips[on], nodes.status[on])
        )
    return of_most_pressed(pieces, count, d)


def nearest_gap(contacts: list[ContactAtNodes], count: int) -> Array:
    """The smallest gap over the contacts of a node, (owned,); NaN where there is none."""
    gap = np.full(count, np.nan)
    for nodes in contacts:
        gap = np.fmin(gap, nodes.gap)
    return gap
