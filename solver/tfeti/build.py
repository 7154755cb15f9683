"""From stiffness matrices and rows of constraints to a dual problem: factors, B, coarse problem."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from scipy import sparse

from solver.contact.row_kinds import RowKind
from solver.exchange import NodeExchange
from solver.problem.constraints.shared_rows import SharedRows
from solver.problem.free_motions import FreeMotions, LooseBodies
from solver.problem.parts import Constraints, NodePlaces, loads_on
from solver.tfeti.bodies import bodies_of
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.constraints.options import TotalFetiOptions
from solver.tfeti.constraints.rows import Rows
from solver.tfeti.constraints.supports import SupportRows
from solver.tfeti.dual import DualProblem
from solver.tfeti.row_order import order_rows
from solver.tfeti.subdomain.classes import (
    ClassData,
    FactoredClass,
    subdomain_classes,
    unfactored_class,
)
from solver.vectors import Array, Ints, Mask

Measure = Callable[[], AbstractContextManager[None]]
"""Context manager that measures the time of a stage, such as the factorisation."""


@dataclass(frozen=True, eq=False)
class CongruentSubdomains:
    """Subdomains of this rank that share one stiffness matrix."""

    stiffness: sparse.csr_matrix  # (n, n)
    """K before any condition is imposed; unknown ``node * dimension + component``."""
    points: Array  # (nodes, 3)
    """Coordinates of the nodes of one member; the others are moved copies of it."""
    nodes: Ints  # (k,)
    """Nodes that constraints may touch, ascending."""
    copies: Ints  # (members, k)
    """Numbers of these nodes among the copies of nodes on this rank."""
    forces: Array
    lifting: Array
    """Loads, and displacements of eliminated unknowns. Shape (n, members)."""
    eliminated: Ints | None  # (m,) or None
    """Held unknowns that are eliminated from K; None where the members float."""
    bodies: Ints  # (members,)
    """The body of each member."""
    kernel: Array | None = None  # (n, k) or None
    """Basis of the kernel of K; the rigid motions of the points unless given."""
    places: NodePlaces | None = None
    """Global nodes of the members, for methods that solve for the displacements."""
    thermal: Array | None = None  # (n, members) or None
    """The part of the forces that comes from heat, as `Loads.thermal`."""


@dataclass(frozen=True, eq=False)
class ConstraintRows:
    """The rows of B before their columns are numbered."""

    exchange: NodeExchange
    """Exchange between the copies of nodes."""
    rows: Rows
    """Gluing, held and contact rows."""
    shared: SharedRows
    """Geometry of the rows over nodes of several ranks, in row order."""
    supports: SupportRows
    """Rows for rigid motions that nothing else holds."""
    held_without_contact: bool
    """Whether all other rows alone stop every rigid motion."""


def build_problem(
    subdomains: Sequence[CongruentSubdomains],
    constraints: ConstraintRows,
    groups: Ints,
    measure: Measure = nullcontext,
    options: TotalFetiOptions | None = None,
    loose: LooseBodies | None = None,
) -> DualProblem:
    """Factor the stiffness matrices, number the interface, write B and the coarse problem.

    Collective: each rank gives its own subdomains and rows.

    Parameters
    ----------
    groups : (bodies,)
        Group of each body: bodies of a group may touch, directly or through others.
    loose
        Rigid motions that nothing resists, the same on all ranks.

    Raises
    ------
    ArithmeticError
        A stiffness matrix of some rank resists its kernel or has a larger one.
    """
    exchange, rows, shared = constraints.exchange, constraints.rows, constraints.shared
    comm, d = exchange.comm, shared.contact.normals.shape[1]
    touched = exchange.from_owners(rows.touched(len(exchange.nodes), d))
    for copies, values in zip(
        constraints.supports.copies, constraints.supports.values, strict=True
    ):
        touched[copies] |= values != 0.0
    factored = options is None or options.factored
    classes = _classes(comm, d, subdomains, touched, measure, factored)
    columns, size = _number_columns(comm, d, subdomains, classes, len(touched))
    kernels = [(cls.members, cls.kernel[cls.interface]) for cls in classes]
    ordered = order_rows(exchange, rows, constraints.supports, columns, size, kernels)
    in_contact = ordered.kinds == RowKind.CONTACT
    tangential = ordered.kinds == RowKind.TANGENT
    loads = loads_on(
        classes, [s.forces for s in subdomains], [s.lifting for s in subdomains], ordered.c
    )
    loads = replace(loads, thermal=tuple(s.thermal for s in subdomains))
    coarse = None
    if comm.allreduce(len(loads.e)):
        with measure():
            coarse = CoarseProblem(
                ordered.B, kernels, in_contact | tangential, ordered.weight, options
            )
    wide = np.zeros(len(ordered.kinds), bool)
    for kind in (RowKind.CONTACT, RowKind.TANGENT, RowKind.TIED):
        wide[ordered.kinds == kind] = shared.by_kind[kind].wide
    widths = [len(cls.interface) for cls in classes]
    bodies = bodies_of(comm, ordered.B, groups, [s.bodies for s in subdomains], widths,
                       [cls.rigid for cls in classes])  # fmt: skip
    return DualProblem(
        comm,
        d,
        tuple(classes),
        Constraints(
            ordered.B, ordered.kinds, wide, constraints.held_without_contact,
            ordered.held_unknowns,
        ),
        shared,
        loads,
        bodies,
        () if factored else tuple(s.places for s in subdomains if s.places is not None),
        exchange.total,
        _free_motions(exchange, d, subdomains, classes, groups, loose),
        coarse=coarse,
    )  # fmt: skip


def _free_motions(
    exchange: NodeExchange,
    d: int,
    subdomains: Sequence[CongruentSubdomains],
    classes: Sequence[FactoredClass],
    groups: Ints,
    loose: LooseBodies | None,
) -> FreeMotions | None:
    """Motions that nothing resists or contact alone, with the nodes of their subdomains.

    None where there are none (collective).
    """
    if loose is None or not loose.any:
        return None
    moved = [np.zeros((len(s.bodies), 3)) if s.places is None else s.places.translations
             for s in subdomains]  # fmt: skip
    points, bodies = [s.points for s in subdomains], [s.bodies for s in subdomains]
    place = exchange.nodes - exchange.first
    count = exchange.from_owners(np.bincount(place)[place])
    shares = [np.ones((len(s.bodies), len(s.points))) for s in subdomains]
    for share, s in zip(shares, subdomains, strict=True):
        share[:, s.nodes] /= count[s.copies]
    rigid = [cls.rigid for cls in classes]
    return FreeMotions(exchange.comm, d, groups, loose, points, moved, bodies, shares, rigid)


def _classes(
    comm: MPI.Intracomm,
    d: int,
    subdomains: Sequence[CongruentSubdomains],
    touched: Mask,
    measure: Measure,
    factored: bool,
) -> list[FactoredClass]:
    """The class of each set of congruent subdomains (collective).

    Parameters
    ----------
    touched : (copies, dimension)
        Components that some row of B touches.
    """
    data = []
    for group in subdomains:
        node, component = np.nonzero(touched[group.copies].any(axis=0))
        data.append(ClassData(
            group.stiffness, group.points, d, group.nodes[node] * d + component, len(group.bodies),
            group.eliminated, group.kernel,
        ))  # fmt: skip
    classes: list[FactoredClass] = []
    failed = ""
    with measure():
        try:
            classes = subdomain_classes(data) if factored else [unfactored_class(k) for k in data]
        except (ArithmeticError, ValueError) as error:  # the other ranks go on
            failed = f"{error}"
    for text in filter(None, comm.allgather(failed)):
        raise ArithmeticError(text)
    return classes


def _number_columns(
    comm: MPI.Intracomm,
    d: int,
    subdomains: Sequence[CongruentSubdomains],
    classes: Sequence[FactoredClass],
    copies: int,
) -> tuple[Ints, int]:
    """Interface column of each component of this rank's copies, and how many columns it has."""
    columns, size = np.full((copies, d), -1, np.int64), 0
    for group, cls in zip(subdomains, classes, strict=True):
        width = len(cls.interface)
        place_of = np.full(cls.unknowns, -1, np.int64)
        place_of[cls.interface] = np.arange(width)
        position = place_of[group.nodes[:, None] * d + np.arange(d)]
        starts = size + width * np.arange(cls.members)
        shifted = position + starts[:, None, None]
        columns[group.copies] = np.where(position >= 0, shifted, -1)
        size += width * cls.members
    first = comm.exscan(size) or 0
    return np.where(columns >= 0, columns + first, -1), size
