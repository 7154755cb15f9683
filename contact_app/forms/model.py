"""Construction of the dual problem of subdomains from forms, conditions and contacts."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.forms.bodies import (
    Bodies,
    Holding,
    Resisting,
    bodies_of,
    groups_of,
    holding,
    kernel_of,
)
from contact_app.forms.checks import check_matrices, together
from contact_app.forms.congruent import Congruent, congruent
from contact_app.forms.contacts import Contact
from contact_app.forms.fingerprints import all_equal, fingerprint_of_form, fingerprint_of_rows
from contact_app.forms.friction import friction_rows, jumps_of
from contact_app.forms.grid import ALIKE, Grid
from contact_app.forms.locking import Moduli
from contact_app.forms.parts import Parts, parts_of
from contact_app.forms.rows import rows_of
from contact_app.forms.sides import Sides, sides_of
from contact_app.forms.stress_loads import stress_loads
from contact_app.forms.subdomains import Subdomains, subdomains_of
from contact_app.forms.uniform import EqualCells, in_cylindrical_coordinates
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints, Mask
from meshes.contact_surface import Surface
from meshes.ties import MeanJumps
from solver.backend import SharedPlace
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactRows, HeldRows
from solver.problem.constraints.shared_rows import SharedRows
from solver.problem.parts import NodePlaces
from solver.rigid_motions import MOTIONS
from solver.tfeti.build import CongruentSubdomains, ConstraintRows, build_problem
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.tfeti.constraints.rows import write_rows
from solver.tfeti.constraints.supports import SupportRows
from solver.tfeti.dual import DualProblem
from solver.tfeti.subdomain.kernels import fixing_nodes


class NotCongruentError(ArithmeticError):
    """The parts of a grid differ, for example because the form varies from cell to cell."""


Measure = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True, eq=False)
class FormModel:
    """The discrete model of a problem of forms."""

    subdomains: Subdomains
    """With the copies of nodes that `exchange` brings to their owners."""
    bodies: Bodies
    """Groups of cells that hang together."""
    exchange: NodeExchange
    contacts: tuple[Contact, ...]
    sides: tuple[Sides, ...]
    jumps: tuple[MeanJumps | None, ...]
    """For each contact its facets and surfaces, and `jumps_of`."""
    problem: DualProblem
    merged: ContactRows
    """Rows that a tighter one of the same node makes redundant."""
    notes: tuple[str, ...]
    """Sentences for the certificate."""
    place: Ints  # (subdomains, 2)
    """Class and column of each subdomain of this rank in the problem."""
    moduli: Moduli | None
    """Moduli of the cells of a space of degree 1."""
    form: Any
    of_form: bytes
    of_rows: bytes
    """a, and fingerprints of its values, with the tags of contacts, and of the rows."""

    @property
    def parts(self) -> Parts:
        """The parts of the mesh on each rank."""
        return self.subdomains.parts

    def bodies_at(self, surface: Surface) -> set[int]:
        """Bodies that have the nodes of a surface (collective)."""
        first, last = self.exchange.first, self.exchange.last
        local = np.unique(surface.nodes)
        local = self.bodies.of_node[local[(first <= local) & (local < last)] - first]
        return set().union(*self.parts.comm.allgather(set(map(int, np.unique(local)))))

    def at_copies(self, values: Sequence[Array]) -> Array:
        """Values of the classes, (n, members) each, at the copies of the nodes, (copies, d)."""
        d = self.subdomains.dimension
        at_nodes = [values[cls][:, column].reshape(-1, d) for cls, column in self.place]
        return np.concatenate([np.zeros((0, d)), *at_nodes])


@dataclass(frozen=True, eq=False)
class _Loads:
    """f of each subdomain, (n,), and its part that acts on strains only; None without.

    As heat does, that part balances itself.
    """

    total: list[Array]
    thermal: list[Array] | None

    @classmethod
    def of(cls, subdomains: Subdomains, form: Any) -> "_Loads":
        """The loads of a linear form (collective)."""
        terms = stress_loads(form)
        thermal = None if terms is None else subdomains.loads(terms)
        return cls(subdomains.loads(form), thermal)


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
        Of the decomposition: whether subdomains are factored.
    grid
        The cut of a regular mesh; each rank's cells are one subdomain unless given.

    Raises
    ------
    ValueError, ConfigurationError
        A form or a contact is not admissible; the message says why.
    NoEquilibriumError
        A body leaves, or conditions exclude each other.
    """
    with measure("assembly"):
        parts = parts_of(space, grid)
        subdomains = subdomains_of(parts, grid)
        equal = EqualCells.of(parts, grid, forms[0])
        stiffness, acting = subdomains.stiffness(forms[0], equal), _Loads.of(subdomains, forms[1])
    classes = congruent(subdomains, stiffness, grid is not None)
    if grid is not None:
        kinds = parts.comm.allreduce(max((c.number + 1 for c in classes), default=0), op=MPI.MAX)
        if kinds * ALIKE > grid.count:
            raise NotCongruentError
    for cls in classes:
        for member in cls.members:
            stiffness[member] = cls.stiffness
    with together(parts.comm):
        check_matrices([cls.stiffness for cls in classes], acting.total)
    exchange = NodeExchange(parts.comm, subdomains.numbers, parts.nodes)
    sides = tuple(sides_of(parts, contact, i) for i, contact in enumerate(contacts))
    held, contact, merged = rows_of(parts, exchange, bcs, contacts, sides)
    jumps = jumps_of(exchange, contacts, sides, held)
    friction = friction_rows(parts, exchange, contacts, (sides, jumps), held, (contact, merged))
    of_rows = fingerprint_of_rows(held, contact)
    bodies = bodies_of(subdomains, exchange)
    groups = groups_of(bodies, exchange, contact)
    resisting = Resisting(held, contact, groups, friction, len(contacts))
    state = holding(subdomains, bodies, exchange, stiffness, acting.total, resisting)
    eliminated = state.held & (bodies.sizes == 1) & (not friction.acts)
    first = parts.comm.exscan(subdomains.count) or 0
    numbers = np.repeat(first + np.arange(subdomains.count), np.diff(subdomains.starts))
    of_held = eliminated[bodies.of_node[held.nodes - exchange.first]]
    shared = SharedRows.of(contact, friction)
    rows, shared = write_rows(exchange, numbers, held, shared, of_held)
    supports = _supports(subdomains, bodies, state, first)
    constraints = ConstraintRows(exchange, rows, shared, supports, state.without_contact)
    lifted = _lifted(exchange, held)
    with together(parts.comm):
        pieces = [
            _subdomain(subdomains, bodies, eliminated, acting, lifted, cls, not options.factored)
            for cls in classes
        ]
    problem = build_problem(
        pieces, constraints, groups, lambda: measure("factorization"), options, state.loose
    )
    problem = replace(problem, place=SharedPlace())
    linear = dolfinx_compat.lagrange_degree(space) == 1
    moduli = Moduli.of(parts, forms[0], equal) if linear else None
    return FormModel(
        subdomains, bodies, exchange, tuple(contacts), sides, jumps, problem, merged,
        _notes(bodies, state, (forms[0], contacts)), _places(classes, subdomains.count),
        moduli, forms[0],
        fingerprint_of_form(forms[0], space.mesh, contacts), of_rows,
    )  # fmt: skip


def _places(classes: Sequence[Congruent], count: int) -> Ints:
    """Class and column of each subdomain, (subdomains, 2)."""
    place = np.empty((count, 2), np.int64)
    for number, cls in enumerate(classes):
        place[cls.members, 0], place[cls.members, 1] = number, np.arange(len(cls.members))
    return place


def with_new_loads(
    model: FormModel,
    forms: tuple[Any, Any],
    bcs: Sequence[Any],
    contacts: Sequence[Contact],
    measure: Measure,
) -> FormModel | None:
    """The model with the present loads, held displacements and gaps (collective).

    It shares the matrices and factors of the earlier one, and the surfaces of contacts. None if a
    or the rows have changed.

    Raises
    ------
    ValueError, ConfigurationError, NoEquilibriumError
        As `build_model`.
    """
    parts, exchange, problem = model.parts, model.exchange, model.problem
    is_same = [id(contact) for contact in contacts] == [id(contact) for contact in model.contacts]
    now = fingerprint_of_form(forms[0], parts.space.mesh, contacts)
    if not (forms[0] is model.form and is_same and all_equal(parts.comm, now, model.of_form)):
        return None
    held, contact, merged = rows_of(parts, exchange, bcs, model.contacts, model.sides)
    if not all_equal(parts.comm, fingerprint_of_rows(held, contact), model.of_rows):
        return None
    with measure("assembly"):
        acting = _Loads.of(model.subdomains, forms[1])
    with together(parts.comm):
        check_matrices([], acting.total)
    stiffness = [problem.classes[cls].stiffness for cls, _ in model.place]
    groups = problem.bodies.groups
    sides = model.sides, model.jumps
    friction = friction_rows(parts, exchange, model.contacts, sides, held, (contact, merged))
    resisting = Resisting(held, contact, groups, friction, len(contacts))
    holding(model.subdomains, model.bodies, exchange, stiffness, acting.total, resisting)
    forces, heat = ([np.zeros_like(values) for values in problem.forces] for _ in range(2))
    lifting = [np.zeros_like(values) for values in problem.lifting]
    value = _lifted(exchange, held)[1].ravel()
    for number, (cls, column) in enumerate(model.place):
        forces[cls][:, column] = acting.total[number]
        heat[cls][:, column] = 0.0 if acting.thermal is None else acting.thermal[number]
        lifting[cls][:, column] = value[model.subdomains.unknowns(number)]
    for lift, values in zip(lifting, problem.classes, strict=True):
        lift[values.free] = 0.0  # rows hold these unknowns
    c = problem.right_hand_side(held, SharedRows.of(contact, friction))
    case = problem.with_loads(forces, lifting, c, [h if h.any() else None for h in heat])
    return replace(model, problem=case, merged=merged)


def _lifted(exchange: NodeExchange, held: HeldRows) -> tuple[Mask, Array]:
    """Mask of the held components of the copies, and their values, (copies, d) (collective)."""
    count, d = exchange.last - exchange.first, held.held.shape[1]
    mask, value = np.zeros((count, d), bool), np.zeros((count, d))
    mask[held.nodes - exchange.first] = held.held
    value[held.nodes - exchange.first] = held.values
    at = exchange.nodes - exchange.first
    return exchange.from_owners(mask[at]), exchange.from_owners(value[at])


def _subdomain(
    subdomains: Subdomains,
    bodies: Bodies,
    eliminated: Mask,
    acting: _Loads,
    lifted: tuple[Mask, Array],
    alike: Congruent,
    levels: bool,
) -> CongruentSubdomains:
    """Subdomains of one stiffness.

    Parameters
    ----------
    levels
        Whether levels of a multigrid ask for the vertices of cells of degree 2.
    """
    K, members, points = alike.stiffness, alike.members, alike.points
    of_members = [subdomains.copies(number) for number in members]
    body, nodes = bodies.of_subdomain[members[0]], np.arange(len(points))
    kernel = kernel_of(K, points, subdomains.dimension)
    lift, fixed = np.zeros((K.shape[0], len(members)), order="F"), None
    if eliminated[body]:
        mask, value = (v[of_members[0]].ravel() for v in lifted)
        fixed = np.flatnonzero(mask)
        lift[fixed, 0] = value[fixed]
    elif kernel.shape[1] == 0:
        fixed = np.zeros(0, np.int64)
    starts = np.array([member.start for member in of_members], np.int64)
    heat = None
    if acting.thermal is not None:
        heat = np.asfortranarray(np.stack([acting.thermal[k] for k in members], axis=1))
    return CongruentSubdomains(
        stiffness=K,
        points=points,
        nodes=nodes,
        copies=starts[:, None] + nodes[None],
        forces=np.asfortranarray(np.stack([acting.total[k] for k in members], axis=1)),
        thermal=heat if heat is not None and heat.any() else None,
        lifting=lift,
        eliminated=fixed,
        bodies=bodies.of_subdomain[members],
        kernel=None if kernel.shape[1] == MOTIONS[subdomains.dimension] else kernel,  # as it knows
        places=NodePlaces(
            np.stack([subdomains.numbers[member] for member in of_members]),
            subdomains.points[starts] - points[0],
            points,
            subdomains.parts.vertex_weights(int(members[0])) if levels else None,
        ),
    )


def _supports(subdomains: Subdomains, bodies: Bodies, state: Holding, first: int) -> SupportRows:
    """Rows that hold free motions at a few nodes of each body's first subdomain."""
    supports = SupportRows()
    for number, body in enumerate(bodies.of_subdomain):
        motions = state.free_motions[body]
        if first + number != bodies.first[body] or motions.shape[1] == 0:
            continue
        copies = subdomains.copies(number)
        points = subdomains.points[copies]
        chosen = fixing_nodes(points, subdomains.dimension)
        seen = bodies.motions(int(body), points[chosen], subdomains.dimension) @ motions
        for row in np.linalg.qr(seen.reshape(-1, motions.shape[1]))[0].T:
            supports.copies.append(copies.start + chosen)
            supports.values.append(row.reshape(len(chosen), -1))
    return supports


def _notes(
    bodies: Bodies, state: Holding, touching: tuple[Any, Sequence[Contact]]
) -> tuple[str, ...]:
    """Sentences for the certificate.

    Parameters
    ----------
    touching
        The bilinear form, and the contacts.
    """
    form, contacts = touching
    sentences = [
        f"{bodies.name(b)} can move freely and no load does work in that motion: it is held in its "
        "place"
        for b, motions in enumerate(state.free_motions)
        if motions.shape[1]
    ]
    if any(contact.weight is None for contact in contacts) and in_cylindrical_coordinates(form):
        sentences.append(
            "a has both coordinates and displacements that are not differentiated, as in "
            "cylindrical coordinates: if its integrals have the factor r, so have forces (per "
            "radian), pressures are those of the body times r, and slip limits (Tresca) must be "
            "given times r, unless the contact has `weight`, as lambda x: x[:, 0]"
        )
    return tuple(sentences)
