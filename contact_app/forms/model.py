"""From forms, conditions and contacts to the dual problem of the parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.forms.bodies import Bodies, Holding, bodies_of, groups_of, holding, kernel_of
from contact_app.forms.boundary import Facets
from contact_app.forms.checks import check_matrices, together
from contact_app.forms.contacts import Contact
from contact_app.forms.parts import Parts, parts_of
from contact_app.forms.rows import rows_of, tagged_facets
from solver.tfeti.build import CongruentSubdomains, ConstraintRows, build_system
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.rows import ContactRows, HeldRows, write_rows
from solver.tfeti.constraints.supports import SupportRows
from solver.tfeti.dual import DualProblem
from solver.tfeti.options import TotalFetiOptions
from solver.tfeti.subdomain.kernels import fixing_nodes
from solver.tfeti.system import NodePlaces

Array = NDArray[np.float64]

Measure = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True, eq=False)
class FormModel:
    """A problem of forms made ready to solve.

    Attributes
    ----------
    parts
        The mesh in parts, with the copies of nodes that `exchange` brings to their owners.
    bodies
        What hangs together.
    facets
        Facets of each contact on the side of `tag`.
    merged
        Rows that a tighter one of the same node makes redundant.
    notes
        Sentences for the certificate.
    """

    parts: Parts
    bodies: Bodies
    exchange: NodeExchange
    contacts: tuple[Contact, ...]
    facets: tuple[Facets, ...]
    problem: DualProblem
    merged: ContactRows
    notes: tuple[str, ...]


def build_model(
    space: Any,
    forms: tuple[Any, Any],
    bcs: Sequence[Any],
    contacts: Sequence[Contact],
    measure: Measure,
    options: TotalFetiOptions,
) -> FormModel:
    """Assemble, write the constraints, factor (collective).

    Parameters
    ----------
    forms
        a and L.
    measure
        Measures the time of a stage.
    options
        Of the decomposition: whether parts are factored.

    Raises
    ------
    ValueError, ConfigurationError
        A form or a contact is of no use; the message says why.
    NoEquilibriumError
        A body leaves, or conditions exclude each other.
    """
    with measure("assembly"):
        parts = parts_of(space)
        stiffness, loads = parts.stiffness(forms[0]), parts.loads(forms[1])
        with together(parts.comm):
            check_matrices(stiffness)
    exchange = NodeExchange(parts.comm, parts.numbers, parts.nodes)
    facets = tuple(tagged_facets(parts, contact, i) for i, contact in enumerate(contacts))
    held, contact, merged = rows_of(parts, exchange, bcs, contacts, facets)
    bodies = bodies_of(parts, exchange)
    groups = groups_of(bodies, exchange, contact)
    found = holding(parts, bodies, exchange, stiffness, loads, (held, contact, groups))
    eliminated = found.held & (bodies.sizes == 1)
    first = parts.comm.exscan(parts.count) or 0
    numbers = np.repeat(first + np.arange(parts.count), np.diff(parts.starts))
    of_held = eliminated[bodies.of_node[held.nodes - exchange.first]]
    rows, contact, _, tied = write_rows(exchange, numbers, held, contact, of_held)
    constraints = ConstraintRows(
        exchange, rows, contact, _supports(parts, bodies, found, first), found.without_contact, tied
    )
    lifted = _lifted(exchange, held)
    with together(parts.comm):
        pieces = _subdomains(parts, bodies, eliminated, (stiffness, loads), lifted)
    problem = DualProblem(
        build_system(
            pieces, constraints, groups, lambda: measure("factorization"), options, found.loose
        )
    )
    return FormModel(
        parts, bodies, exchange, tuple(contacts), facets, problem, merged, _notes(bodies, found)
    )


def _lifted(exchange: NodeExchange, held: HeldRows) -> tuple[NDArray[np.bool_], Array]:
    """Which components of the copies are held, and to which value, (copies, d) (collective)."""
    count, d = exchange.last - exchange.first, held.held.shape[1]
    mask, value = np.zeros((count, d), bool), np.zeros((count, d))
    mask[held.nodes - exchange.first] = held.held
    value[held.nodes - exchange.first] = held.values
    at = exchange.nodes - exchange.first
    return exchange.from_owners(mask[at]), exchange.from_owners(value[at])


def _subdomains(
    parts: Parts,
    bodies: Bodies,
    eliminated: NDArray[np.bool_],
    assembled: tuple[list[sparse.csr_matrix], list[Array]],
    lifted: tuple[NDArray[np.bool_], Array],
) -> list[CongruentSubdomains]:
    """Each part as a class of its own."""
    result = []
    for number, (K, f) in enumerate(zip(*assembled, strict=True)):
        part, body = parts.copies(number), bodies.of_part[number]
        points, nodes = parts.points[part], np.arange(part.stop - part.start)
        kernel = kernel_of(K, points, parts.dimension)
        lift, fixed = np.zeros((len(f), 1), order="F"), None
        if eliminated[body]:
            mask, value = (v[part].ravel() for v in lifted)
            fixed = np.flatnonzero(mask)
            lift[fixed, 0] = value[fixed]
        elif kernel.shape[1] == 0:
            fixed = np.zeros(0, np.int64)
        result.append(
            CongruentSubdomains(
                stiffness=K,
                points=points,
                nodes=nodes,
                copies=part.start + nodes[None],
                forces=np.asfortranarray(f[:, None]),
                lifting=lift,
                eliminated=fixed,
                bodies=np.array([body]),
                kernel=kernel,
                places=NodePlaces(parts.numbers[None, part], np.zeros((1, 3)), points),
            )
        )
    return result


def _supports(parts: Parts, bodies: Bodies, found: Holding, first: int) -> SupportRows:
    """Rows that hold free motions at a few nodes of each body's first part."""
    supports = SupportRows()
    for number, body in enumerate(bodies.of_part):
        motions = found.free_motions[body]
        if first + number != bodies.first[body] or motions.shape[1] == 0:
            continue
        part = parts.copies(number)
        points = parts.points[part]
        chosen = fixing_nodes(points, parts.dimension)
        seen = bodies.motions(int(body), points[chosen], parts.dimension) @ motions
        for row in np.linalg.qr(seen.reshape(-1, motions.shape[1]))[0].T:
            supports.copies.append(part.start + chosen)
            supports.values.append(row.reshape(len(chosen), -1))
    return supports


def _notes(bodies: Bodies, found: Holding) -> tuple[str, ...]:
    loose = [b for b, motions in enumerate(found.free_motions) if motions.shape[1]]
    return tuple(
        f"the body about ({', '.join(f'{v:.3g}' for v in bodies.centres[b])}) can move freely and "
        "no load works on that motion: it is held where it is"
        for b in loose
    )


def largest(comm: MPI.Intracomm, values: Array) -> float:
    """Largest of values over all ranks, zero or more (collective)."""
    return float(comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX))
