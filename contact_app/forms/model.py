"""From forms, conditions and contacts to the dual problem of the parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from contact_app.forms.bodies import Bodies, Holding, bodies_of, groups_of, holding, kernel_of
from contact_app.forms.boundary import Facets
from contact_app.forms.checks import check_matrices, together
from contact_app.forms.contacts import Contact
from contact_app.forms.grid import Grid
from contact_app.forms.kept import all_equal, fingerprint_of_form, fingerprint_of_rows
from contact_app.forms.parts import Parts, parts_of
from contact_app.forms.rows import rows_of, tagged_facets
from solver.tfeti.build import CongruentSubdomains, ConstraintRows, build_system
from solver.tfeti.constraints.conditions import ContactRows, HeldRows
from solver.tfeti.constraints.exchange import NodeExchange
from solver.tfeti.constraints.rows import write_rows
from solver.tfeti.constraints.supports import SupportRows
from solver.tfeti.dual import DualProblem
from solver.tfeti.options import TotalFetiOptions
from solver.tfeti.subdomain.kernels import MOTIONS, fixing_nodes
from solver.tfeti.system import NodePlaces

Array = NDArray[np.float64]

EQUAL = 1e-12
"""Difference of entries of two matrices, over the largest, that is round-off."""

ALIKE = 3
"""Sub-boxes of a grid that have to share a stiffness on the average; multigrid is cheaper than a
factor for nearly each of them."""


class NotCongruentError(ArithmeticError):
    """The parts of a grid differ, as where the form varies from cell to cell."""


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
    place : (parts, 2)
        Class and column of each part of this rank in the problem.
    form, of_form, of_rows
        a, and fingerprints of its values and of the rows.
    """

    parts: Parts
    bodies: Bodies
    exchange: NodeExchange
    contacts: tuple[Contact, ...]
    facets: tuple[Facets, ...]
    problem: DualProblem
    merged: ContactRows
    notes: tuple[str, ...]
    place: NDArray[np.int64]
    form: Any
    of_form: bytes
    of_rows: bytes

    def at_copies(self, values: Sequence[Array]) -> Array:
        """Values of the classes, (n, members) each, at the copies of the nodes, (copies, d)."""
        parts = [values[cls][:, column].reshape(-1, self.parts.dimension)
                 for cls, column in self.place]  # fmt: skip
        return np.concatenate([np.zeros((0, self.parts.dimension)), *parts])


def build_model(
    space: Any,
    forms: tuple[Any, Any],
    bcs: Sequence[Any],
    contacts: Sequence[Contact],
    measure: Measure,
    options: TotalFetiOptions,
    grid: Grid | None = None,
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
    grid
        The cut of a regular mesh; each rank's cells are one part unless given.

    Raises
    ------
    ValueError, ConfigurationError
        A form or a contact is of no use; the message says why.
    NoEquilibriumError
        A body leaves, or conditions exclude each other.
    """
    with measure("assembly"):
        parts = parts_of(space, grid)
        stiffness, loads = parts.stiffness(forms[0]), parts.loads(forms[1])
    classes = _congruent(stiffness, grid is not None)
    if grid is not None and len(classes) * ALIKE > parts.count:
        raise NotCongruentError
    with together(parts.comm):
        check_matrices([stiffness[members[0]] for members in classes])
    exchange = NodeExchange(parts.comm, parts.numbers, parts.nodes)
    facets = tuple(tagged_facets(parts, contact, i) for i, contact in enumerate(contacts))
    held, contact, merged = rows_of(parts, exchange, bcs, contacts, facets)
    of_rows = fingerprint_of_rows(held, contact)
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
        pieces = [
            _subdomain(parts, bodies, eliminated, (stiffness, loads), lifted, members)
            for members in classes
        ]
    place = np.empty((parts.count, 2), np.int64)
    for number, members in enumerate(classes):
        place[members, 0], place[members, 1] = number, np.arange(len(members))
    problem = DualProblem(
        build_system(
            pieces, constraints, groups, lambda: measure("factorization"), options, found.loose
        )
    )
    return FormModel(
        parts, bodies, exchange, tuple(contacts), facets, problem, merged, _notes(bodies, found),
        place, forms[0], fingerprint_of_form(forms[0], space.mesh), of_rows,
    )  # fmt: skip


def with_new_loads(
    model: FormModel,
    forms: tuple[Any, Any],
    bcs: Sequence[Any],
    contacts: Sequence[Contact],
    measure: Measure,
) -> FormModel | None:
    """The model under loads, held displacements and gaps as they are now (collective).

    It has the matrices and factors of the earlier one. None where a or the rows have changed.

    Raises
    ------
    ValueError, ConfigurationError, NoEquilibriumError
        As `build_model`.
    """
    parts, exchange, problem = model.parts, model.exchange, model.problem
    given = [id(contact) for contact in contacts] == [id(contact) for contact in model.contacts]
    now = fingerprint_of_form(forms[0], parts.space.mesh)
    if not (forms[0] is model.form and given and all_equal(parts.comm, now, model.of_form)):
        return None
    facets = tuple(tagged_facets(parts, own, i) for i, own in enumerate(model.contacts))
    held, contact, merged = rows_of(parts, exchange, bcs, model.contacts, facets)
    if not all_equal(parts.comm, fingerprint_of_rows(held, contact), model.of_rows):
        return None
    with measure("assembly"):
        loads = parts.loads(forms[1])
    stiffness = [problem.classes[cls].stiffness for cls, _ in model.place]
    groups = problem.bodies.groups
    holding(parts, model.bodies, exchange, stiffness, loads, (held, contact, groups))
    forces = [np.zeros_like(own) for own in problem.forces]
    lifting = [np.zeros_like(own) for own in problem.lifting]
    value = _lifted(exchange, held)[1].ravel()
    for number, (cls, column) in enumerate(model.place):
        forces[cls][:, column] = loads[number]
        lifting[cls][:, column] = value[parts.unknowns(number)]
    for lift, own in zip(lifting, problem.classes, strict=True):
        lift[own.free] = 0.0  # what is held there is held by rows
    c = np.zeros(problem.size)
    unknowns = problem.system.constraints.held_unknowns
    rows = np.flatnonzero(unknowns >= 0)
    at = np.searchsorted(held.nodes, unknowns[rows] // parts.dimension)
    c[rows] = held.values[at, unknowns[rows] % parts.dimension]
    c[problem.inequality] = contact.gaps * problem.contact.spread
    case = problem.with_loads(forces, lifting, c)
    return replace(model, problem=case, facets=facets, merged=merged)


def _lifted(exchange: NodeExchange, held: HeldRows) -> tuple[NDArray[np.bool_], Array]:
    """Which components of the copies are held, and to which value, (copies, d) (collective)."""
    count, d = exchange.last - exchange.first, held.held.shape[1]
    mask, value = np.zeros((count, d), bool), np.zeros((count, d))
    mask[held.nodes - exchange.first] = held.held
    value[held.nodes - exchange.first] = held.values
    at = exchange.nodes - exchange.first
    return exchange.from_owners(mask[at]), exchange.from_owners(value[at])


def _congruent(stiffness: list[sparse.csr_matrix], grid: bool) -> list[list[int]]:
    """Parts whose matrices are equal but for rounding; each by itself where there is no grid."""
    classes: list[list[int]] = []
    for number, K in enumerate(stiffness):
        for members in classes if grid else ():
            first = stiffness[members[0]]
            if (
                first.shape == K.shape
                and first.nnz == K.nnz
                and np.array_equal(first.indices, K.indices)
                and np.abs(first.data - K.data).max() <= EQUAL * np.abs(first.data).max()
            ):
                members.append(number)
                break
        else:
            classes.append([number])
    return classes


def _subdomain(
    parts: Parts,
    bodies: Bodies,
    eliminated: NDArray[np.bool_],
    assembled: tuple[list[sparse.csr_matrix], list[Array]],
    lifted: tuple[NDArray[np.bool_], Array],
    members: list[int],
) -> CongruentSubdomains:
    """Parts of one stiffness."""
    stiffness, loads = assembled
    K, of_members = stiffness[members[0]], [parts.copies(number) for number in members]
    part, body = of_members[0], bodies.of_part[members[0]]
    points, nodes = parts.points[part], np.arange(part.stop - part.start)
    kernel = kernel_of(K, points, parts.dimension)
    lift, fixed = np.zeros((K.shape[0], len(members)), order="F"), None
    if eliminated[body]:
        mask, value = (v[part].ravel() for v in lifted)
        fixed = np.flatnonzero(mask)
        lift[fixed, 0] = value[fixed]
    elif kernel.shape[1] == 0:
        fixed = np.zeros(0, np.int64)
    starts = np.array([own.start for own in of_members], np.int64)
    return CongruentSubdomains(
        stiffness=K,
        points=points,
        nodes=nodes,
        copies=starts[:, None] + nodes[None],
        forces=np.asfortranarray(np.stack([loads[number] for number in members], axis=1)),
        lifting=lift,
        eliminated=fixed,
        bodies=bodies.of_part[members],
        kernel=None if kernel.shape[1] == MOTIONS[parts.dimension] else kernel,  # as it knows
        places=NodePlaces(
            np.stack([parts.numbers[own] for own in of_members]),
            parts.points[starts] - points[0],
            points,
        ),
    )


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
