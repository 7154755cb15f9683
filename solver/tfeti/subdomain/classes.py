"""Congruence classes: subdomains of one stiffness, solved together.

All members share K, its kernel R and its factor. On the interface, K⁺ acts either as one dense
block, which makes the class's share of the dual operator a single matrix product, or through
sparse solves with a column for each member. Classes of similar subdomains (`similar`) share a
factor and a block.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from solver.problem.subdomains import SubdomainClass
from solver.tfeti.subdomain.costs import block_pays
from solver.tfeti.subdomain.generalised_inverse import (
    Block,
    GeneralisedInverse,
    Inverse,
    SymmetricInverse,
)
from solver.tfeti.subdomain.kernels import (
    check_kernel,
    fixing_nodes,
    fixing_unknowns,
    orthonormal_kernel,
)
from solver.tfeti.subdomain.reflections import find_symmetry
from solver.tfeti.subdomain.rigid import ZeroInverse
from solver.tfeti.subdomain.similar import MovedInverse, ScaledBlock, Shape, Similarity
from solver.vectors import Array, Ints


@dataclass(frozen=True, eq=False)
class FactoredClass(SubdomainClass):
    """Subdomains of equal stiffness with its generalised inverse, where the class is factored."""

    inverse: Inverse | None = None
    """K⁺ on the free unknowns; None where the class is not factored."""
    block: Block | None = None  # (i, i) or None
    """K⁺ between interface unknowns; None where it does not pay."""

    @cached_property
    def preconditioning(self) -> Block | sparse.csr_matrix:
        """The stiffness on the interface in a preconditioner: relaxed inside where it can be."""
        return self.schur_complement or self.interface_stiffness

    @cached_property
    def schur_complement(self) -> Block | None:
        """Schur complement of K on the interface, (i, i); None without a block."""
        if self.block is None:
            return None
        try:
            return self.block.schur_complement
        except np.linalg.LinAlgError:  # a body so slender that its block has no correct digits
            return None

    def solve(self, loads: Array) -> Array:
        """K⁺ on full vectors, (n, s) to (n, s); held unknowns stay zero."""
        assert self.inverse is not None
        if len(self.free) == self.unknowns:
            return self.inverse.solve(loads)
        result = np.zeros(loads.shape, order="F")
        result[self.free] = self.inverse.solve(loads[self.free])
        return result

    def apply_interface(self, loads: Array, out: Array) -> None:
        """K⁺ on interface vectors, one row per member: (s, i) to (s, i)."""
        if self.block is not None:
            self.block.apply(loads, out)
            return
        assert self.inverse is not None
        full = np.zeros((len(self.free), len(loads)), order="F")
        full[self._place] = loads.T
        out[:] = self.inverse.solve(full)[self._place].T

    @cached_property
    def _place(self) -> Ints:
        """Places of the interface unknowns among the free unknowns."""
        return np.searchsorted(self.free, self.interface)


@dataclass(frozen=True, eq=False)
class ClassData:
    """Congruent subdomains, before anything is factored."""

    stiffness: sparse.csr_matrix  # (n, n)
    """K; unknown ``node * dimension + component``. Without entries for a rigid body, whose free
    unknowns are its kernel."""
    points: Array  # (nodes, 3)
    dimension: int
    touched: Ints
    """Unknowns with entries in B in some member."""
    members: int
    """Number of subdomains."""
    eliminated: Ints | None
    """Held unknowns that are eliminated; None where the members float."""
    kernel: Array | None = None  # (n, k)
    """Basis of the kernel of K; the rigid motions of the points if None."""

    @property
    def is_rigid(self) -> bool:
        """Whether the subdomains are rigid bodies."""
        return bool(self.stiffness.nnz == 0)

    @property
    def every(self) -> Ints:
        """All unknowns, (n,)."""
        return np.arange(self.stiffness.shape[0])

    @property
    def free(self) -> Ints:
        """The unknowns that are not eliminated, (m,)."""
        if self.eliminated is None:
            return self.every
        return np.setdiff1d(self.every, self.eliminated)

    def motions(self) -> Array:
        """Orthonormal basis of the kernel, (n, k).

        Raises
        ------
        ValueError
            The stiffness resists a rigid motion.
        """
        if self.kernel is None:
            basis = orthonormal_kernel(self.points, self.dimension)
        else:
            basis = np.linalg.qr(self.kernel)[0]
        check_kernel(self.stiffness, basis)
        return basis


def unfactored_class(data: ClassData) -> FactoredClass:
    """A class without factor and kernel, for methods that solve for the displacements.

    Raises
    ------
    ValueError
        The stiffness resists a rigid motion.
    """
    K, every, free, members = data.stiffness, data.every, data.free, data.members
    if data.is_rigid:
        unit = np.eye(len(every))
        return FactoredClass(K, unit[:, :0], unit, free, every, members)
    rigid, interface = data.motions(), np.unique(data.touched)
    return FactoredClass(K, rigid[:, :0], rigid, free, interface, members)


@dataclass(frozen=True, eq=False)
class _Inverse:
    """A generalised inverse and its class, with the field names of `FactoredClass`."""

    stiffness: sparse.csr_matrix
    kernel: Array
    free: Ints
    interface: Ints
    inverse: GeneralisedInverse | SymmetricInverse
    block_pays: bool
    """Whether K⁺ between interface unknowns pays."""


def subdomain_classes(data: Sequence[ClassData]) -> list[FactoredClass]:
    """The classes of subdomains; similar ones share a factor.

    Raises
    ------
    ValueError, ArithmeticError
        A stiffness resists a rigid motion, or has further zero-energy modes.
    """
    classes: dict[int, FactoredClass] = {}
    for first, others in _similar(data):
        touched = [data[first].touched]
        touched += [similarity.back(data[k].touched) for k, similarity in others.items()]
        members = sum(data[k].members for k in (first, *others))
        together = replace(data[first], touched=np.concatenate(touched), members=members)
        original = replace(subdomain_class(together), members=data[first].members)
        classes[first] = original
        for k, similarity in others.items():
            classes[k] = _moved(original, similarity, data[k].members)
    return [classes[k] for k in range(len(data))]


def _similar(data: Sequence[ClassData]) -> list[tuple[int, dict[int, Similarity]]]:
    """The first of each set of similar floating classes, and what makes the others of it."""
    result: list[tuple[int, dict[int, Similarity]]] = []
    of_size: dict[int, list[tuple[Shape, dict[int, Similarity]]]] = {}
    for k, one in enumerate(data):
        others: dict[int, Similarity] = {}
        result.append((k, others))
        if one.is_rigid or one.eliminated is not None or one.kernel is not None:
            continue
        shape = Shape(one.stiffness, one.points, one.dimension)
        equally_large = of_size.setdefault(len(one.points), [])
        for first, of_first in equally_large:
            similarity = first.similarity(shape)
            if similarity is not None:
                of_first[k] = similarity
                result.pop()
                break
        else:
            equally_large.append((shape, others))
    return result


def _moved(original: FactoredClass, similarity: Similarity, members: int) -> FactoredClass:
    """The class of subdomains that are similar to those of another class."""
    factor, block = similarity.factor, original.block
    assert original.inverse is not None
    return FactoredClass(
        similarity.stiffness(original.stiffness), similarity.moved(original.kernel),
        similarity.moved(original.motions), original.free, similarity.image[original.interface],
        members, MovedInverse(original.inverse, similarity),
        block if block is None or factor == 1.0 else ScaledBlock(block, 1.0 / factor),
    )  # fmt: skip


def subdomain_class(data: ClassData) -> FactoredClass:
    """Factor the stiffness of a congruence class and choose how K⁺ is applied.

    Raises
    ------
    ValueError, ArithmeticError
        The stiffness resists a rigid motion, or has further zero-energy modes.
    """
    if data.is_rigid:
        return _rigid_class(data)
    rigid = data.motions()
    inverted = _floating(data, rigid) if data.eliminated is None else _held(data)
    block: Block | None = None
    if inverted.block_pays:
        block = inverted.inverse.restricted(np.searchsorted(inverted.free, inverted.interface))
    return FactoredClass(
        inverted.stiffness, inverted.kernel, rigid, inverted.free, inverted.interface, data.members,
        inverted.inverse, block,
    )  # fmt: skip


def _held(data: ClassData) -> _Inverse:
    """The inverse on the unknowns that are not eliminated."""
    free, moves = data.free, np.zeros((data.stiffness.shape[0], 0))
    none = data.every[:0]
    inverse = GeneralisedInverse(data.stiffness[free][:, free], moves[free], none)
    pays = block_pays(len(free), len(data.touched), data.members, 1, data.dimension)
    return _Inverse(data.stiffness, moves, free, data.touched, inverse, pays)


def _floating(data: ClassData, rigid: Array) -> _Inverse:
    """The inverse of floating subdomains; mirror images of touched unknowns join the interface."""
    stiffness, points, d = data.stiffness, data.points, data.dimension
    symmetry = None
    if data.kernel is None:
        nodes = fixing_nodes(points, d)
        fixing = (nodes[:, None] * d + np.arange(d)).ravel()
        symmetry = find_symmetry(points, d, stiffness)
    else:
        fixing = fixing_unknowns(rigid)
    interface = np.unique(data.touched)
    if symmetry is not None:
        interface = symmetry.split(symmetry.closure(data.touched)).unknowns
    order = symmetry.order if symmetry else 1
    pays = block_pays(stiffness.shape[0], len(interface), data.members, order, d)
    inverse: GeneralisedInverse | SymmetricInverse
    if symmetry is None or not pays:
        inverse = GeneralisedInverse(stiffness, rigid, fixing)
    else:
        stiffness = symmetry.average(stiffness)
        inverse = SymmetricInverse(stiffness, rigid, fixing, symmetry)
    return _Inverse(stiffness, rigid, data.every, interface, inverse, pays)


def _rigid_class(data: ClassData) -> FactoredClass:
    """The class of rigid bodies: all unknowns are on the interface, and free ones are kernel."""
    every, free = data.every, data.free
    unit, inverse = np.eye(len(every)), ZeroInverse()
    return FactoredClass(
        data.stiffness, unit[:, free], unit, free, every, data.members, inverse,
        inverse.restricted(every),
    )  # fmt: skip
