"""The discrete contact problem of a decomposition: stiffness, constraints, contact points, loads.

    min ½ uᵀ K u - fᵀ u  subject to  B u = c on gluing, held and tied rows, B u ≤ c on contact rows.

Each part is an immutable record of its own. The factors of the stiffness and of the coarse problem
belong to parts that are independent of the loads, so that another load case needs no new factor
(`ContactSystem.with_loads`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from solver.contact.bodies import Bodies
from solver.contact.row_kinds import RowKind
from solver.problem.constraints.matrix import ConstraintMatrix
from solver.problem.constraints.shared_rows import SharedRows
from solver.problem.free_motions import FreeMotions
from solver.problem.subdomains import SubdomainClass
from solver.vectors import Array, Ints, Mask


@dataclass(frozen=True, eq=False)
class Constraints:
    """The left-hand side of all constraints."""

    B: ConstraintMatrix  # (dual, interface)
    """Constraint matrix on interface unknowns."""
    kinds: NDArray[np.int8]  # (dual,)
    """`RowKind` of each row."""
    wide: Mask  # (dual,)
    """Contact, tangential and tied rows over several nodes, which overlap others."""
    held_without_contact: bool
    """Whether the rows that always hold with equality stop every rigid motion."""
    held_unknowns: Ints  # (dual,)
    """Unknown that a held row holds, node · dimension + component; -1 on other rows."""


@dataclass(frozen=True, eq=False)
class NodePlaces:
    """Nodes of the subdomains of one class."""

    numbers: Ints  # (members, nodes)
    """Global number of each node."""
    translations: Array  # (members, 3)
    """Translation of each member from the points of the class."""
    points: Array  # (nodes, 3)
    """Coordinates of the class."""
    vertex_weights: sparse.csr_matrix | None = None  # (nodes, nodes) or None
    """Degree 2: the functions of degree 1 of the vertices at each node; None for degree 1."""


@dataclass(frozen=True, eq=False)
class Loads:
    """A load case."""

    forces: tuple[Array, ...]  # one (n, members) array per class
    """Loads f, forces."""
    lifting: tuple[Array, ...]  # one (n, members) array per class
    """Displacements of eliminated held unknowns, zero elsewhere."""
    c: Array  # (dual,)
    """Right-hand side of the constraints: displacements of held rows, gaps of contact rows."""
    e: Array  # (kernels,)
    """Work of the forces on the kernels, Rᵀ f."""
    thermal: tuple[Array | None, ...] = ()
    """The part of the forces that comes from heat, or that acts on strains alone as heat does, so
    that it balances itself; empty without heat. Shape one (n, members) array per class, or None for
    a class without heat."""
    lengths_before: Array | None = None  # (bodies,) or None
    """Largest displacements of each body at the end of the last increment; None in the first
    one."""
    displacements_before: tuple[Array, ...] = ()  # one (n, members) array per class
    """Displacements from which undetermined motions are least; empty for those of zero."""


@dataclass(frozen=True, eq=False)
class ContactSystem:
    """The discrete contact problem; local parts throughout."""

    comm: MPI.Intracomm
    dimension: int
    """Components of a node."""
    classes: tuple[SubdomainClass, ...]
    """Congruence classes of subdomains on this rank."""
    constraints: Constraints
    shared: SharedRows
    """Geometry of the contact, tangential, tied and mean rows, each in row order."""
    loads: Loads
    bodies: Bodies
    """The body of each subdomain and row."""
    places: tuple[NodePlaces, ...] = ()
    """Nodes of each class if the subdomains are not factored; otherwise empty."""
    nodes: int = 0
    """Number of nodes on all ranks."""
    free_motions: FreeMotions | None = None
    """Rigid motions that nothing resists; None without such motions."""

    def with_loads(
        self,
        forces: Sequence[Array],
        lifting: Sequence[Array] | None = None,
        c: Array | None = None,
        thermal: Sequence[Array | None] = (),
    ) -> Self:
        """The system with other loads; parameters as in `Loads`.

        Displacements and gaps stay unchanged unless given.
        """
        loads, shared = self.loads, self.shared
        lifting = loads.lifting if lifting is None else lifting
        if c is None:
            c = loads.c
        else:
            of_contact = self.constraints.kinds == RowKind.CONTACT
            gaps = c[of_contact] / shared.contact.spread
            shared = replace(shared, contact=replace(shared.contact, gaps=gaps))
        loads = loads_on(self.classes, forces, lifting, c)
        return replace(self, loads=replace(loads, thermal=tuple(thermal)), shared=shared)


def loads_on(
    classes: Sequence[SubdomainClass], forces: Sequence[Array], lifting: Sequence[Array], c: Array
) -> Loads:
    """The load case with these forces, and their work on the kernels of the classes."""
    works = [(cls.kernel.T @ f).T.ravel() for cls, f in zip(classes, forces, strict=True)]
    return Loads(tuple(forces), tuple(lifting), c, np.concatenate([np.zeros(0), *works]))
