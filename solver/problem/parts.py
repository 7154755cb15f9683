"""The parts of a contact problem: constraints, nodes and loads, each an immutable record."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from solver.problem.constraints.matrix import ConstraintMatrix
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


def loads_on(
    classes: Sequence[SubdomainClass], forces: Sequence[Array], lifting: Sequence[Array], c: Array
) -> Loads:
    """The load case with these forces, and their work on the kernels of the classes."""
    works = [(cls.kernel.T @ f).T.ravel() for cls, f in zip(classes, forces, strict=True)]
    return Loads(tuple(forces), tuple(lifting), c, np.concatenate([np.zeros(0), *works]))
