"""A contact problem from plain arrays: stiffness matrices, loads, held nodes, obstacles.

Nodes have global numbers. Subdomains with the same node are glued there. The problem has the form
of Total FETI: every subdomain floats, and held components are rows of B (Dostál, Horák and Kučera,
2006).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import NodeConditions
from solver.problem.constraints.merge import merge_contact, merge_held
from solver.problem.constraints.shared_rows import SharedRows
from solver.tfeti.build import CongruentSubdomains, ConstraintRows, build_problem
from solver.tfeti.constraints.rows import write_rows
from solver.tfeti.constraints.supports import SupportRows
from solver.tfeti.derived import with_active
from solver.tfeti.dual import DualProblem
from solver.vectors import Array, Ints, Mask


@dataclass(frozen=True, eq=False)
class Subdomain:
    """One subdomain of this rank."""

    stiffness: Any  # (n, n)
    """K before any condition is imposed, as a PETSc matrix or anything that scipy converts to a
    sparse matrix; unknown ``node * dimension + component``, force per length. Subdomains with the
    same matrix object share one factor; their points may then differ by a translation only."""
    load: Array  # (n,)
    """f, forces."""
    nodes: Ints  # (nodes,)
    """Global numbers."""
    points: Array  # (nodes, dimension)
    """Coordinates."""
    kernel: Array | None = None  # (n, k) or None
    """Basis of the kernel of K; the rigid motions of the points unless given."""
    body: int = 0
    """Number of the subdomain's body. Certificates measure each body by its own sizes."""


@dataclass(frozen=True, eq=False)
class Held:
    """Held nodes; a rank may name nodes of its own subdomains."""

    nodes: Ints  # (k,)
    components: Mask  # (k, dimension)
    """Mask of held components."""
    values: Array  # (k, dimension)
    """Prescribed displacements, lengths."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Nodes in front of an obstacle: a · u ≤ gap."""

    nodes: Ints  # (k,)
    directions: Array  # (k, dimension)
    """Unit vectors a into the obstacle."""
    gaps: Array  # (k,)
    """Distances to the obstacle."""


@dataclass(frozen=True, eq=False)
class _Copies:
    """Copies of nodes on this rank, one subdomain after another."""

    nodes: Ints
    points: Array
    starts: Ints = field(default_factory=lambda: np.zeros(1, np.int64))

    def points_of(self, nodes: Ints) -> Array:
        """Coordinates (k, 3) of global nodes that have a copy on this rank."""
        order = np.argsort(self.nodes, kind="stable")
        at = np.minimum(np.searchsorted(self.nodes[order], nodes), len(order) - 1)
        if not np.array_equal(self.nodes[order][at], nodes):
            raise ValueError("a condition names a node that no subdomain of its rank has")
        return self.points[order][at]


def problem_from_arrays(
    comm: MPI.Intracomm, subdomains: Sequence[Subdomain], held: Held, obstacles: Sequence[Obstacle]
) -> DualProblem:
    """The dual problem of subdomains, held nodes and obstacles (collective).

    Parameters
    ----------
    subdomains
        Subdomains of this rank, at least one.
    held, obstacles
        Conditions at nodes of this rank; every rank gives the same number of obstacles.

    Raises
    ------
    ValueError
        A condition names an unknown node, or conditions exclude each other
        (`ContradictionError`).
    ArithmeticError
        A stiffness matrix resists its kernel or has a larger one.
    """
    d = held.components.shape[1]
    copies = _Copies(
        np.concatenate([s.nodes for s in subdomains]),
        np.concatenate([_in_space(s.points) for s in subdomains]),
        np.cumsum([0, *(len(s.nodes) for s in subdomains)]),
    )
    total = comm.allreduce(int(copies.nodes.max()), op=MPI.MAX) + 1
    exchange = NodeExchange(comm, copies.nodes, total)
    conditions = _conditions(copies, held, obstacles, d)
    length = comm.allreduce(float(np.ptp(copies.points, axis=0).max()), op=MPI.MAX)
    held_rows = merge_held(exchange, conditions)
    contact, _ = merge_contact(exchange, conditions, held_rows, length)
    first = comm.exscan(len(subdomains)) or 0
    numbers = np.repeat(first + np.arange(len(subdomains)), np.diff(copies.starts))
    floating = np.zeros(len(held_rows.nodes), bool)
    shared = SharedRows.of(contact)
    rows, shared = write_rows(exchange, numbers, held_rows, shared, floating)
    bodies = comm.allreduce(max(s.body for s in subdomains), op=MPI.MAX) + 1
    constraints = ConstraintRows(exchange, rows, shared, SupportRows(), False)
    problem = build_problem(_classes(subdomains, copies), constraints, np.arange(bodies))
    return _with_held_without_contact(problem)


def _conditions(
    copies: _Copies, held: Held, obstacles: Sequence[Obstacle], d: int
) -> NodeConditions:
    """All conditions at nodes."""
    nodes = np.concatenate([np.zeros(0, np.int64), *(o.nodes for o in obstacles)])
    return NodeConditions(
        held_nodes=held.nodes,
        held_points=copies.points_of(held.nodes),
        held=held.components,
        values=held.values,
        held_source=np.zeros(len(held.nodes), np.int64),
        contact_nodes=nodes,
        contact_points=copies.points_of(nodes),
        directions=np.concatenate([np.zeros((0, d)), *(o.directions for o in obstacles)]),
        gaps=np.concatenate([np.zeros(0), *(o.gaps for o in obstacles)]),
        contact_source=np.repeat(np.arange(len(obstacles)), [len(o.nodes) for o in obstacles]),
    )


def _classes(subdomains: Sequence[Subdomain], copies: _Copies) -> list[CongruentSubdomains]:
    """Classes of subdomains with the same matrix object."""
    groups: dict[tuple[int, int], list[int]] = {}
    for local, s in enumerate(subdomains):
        groups.setdefault((id(s.stiffness), id(s.kernel)), []).append(local)
    classes = []
    for members in groups.values():
        first = subdomains[members[0]]
        forces = np.asfortranarray(np.stack([subdomains[m].load for m in members], axis=1))
        nodes = np.arange(len(first.nodes))
        classes.append(
            CongruentSubdomains(
                stiffness=_sparse(first.stiffness),
                points=_in_space(first.points),
                nodes=nodes,
                copies=copies.starts[members][:, None] + nodes,
                forces=forces,
                lifting=np.zeros_like(forces),
                eliminated=None,
                bodies=np.array([subdomains[m].body for m in members], np.int64),
                kernel=first.kernel,
            )
        )
    return classes


def _with_held_without_contact(problem: DualProblem) -> DualProblem:
    """The problem with `held_without_contact` filled in (collective).

    Gluing and held rows alone stop every motion if the coarse problem without contact is regular.
    """
    probe = np.where(problem.inequality, 0.0, np.cos(np.arange(problem.size)))
    try:
        coarse = with_active(problem, np.zeros(problem.size, bool)).coarse
        held = coarse is None or coarse.is_regular(probe)
    except ArithmeticError:  # no rounding error hides that it is singular
        held = False
    return replace(problem, constraints=replace(problem.constraints, held_without_contact=held))


def _sparse(matrix: Any) -> sparse.csr_matrix:
    """A stiffness matrix as scipy's."""
    if isinstance(matrix, PETSc.Mat):
        pointers, columns, values = matrix.getValuesCSR()
        return sparse.csr_matrix((values, columns, pointers), shape=matrix.getSize())
    return sparse.csr_matrix(matrix)


def _in_space(points: Array) -> Array:
    """Coordinates (n, 3)."""
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
