"""The contact problem of a decomposition: stiffness, constraints, contact points and loads.

    min ½ uᵀ K u - fᵀ u  subject to  B u = c on gluing, held and tied rows, B u ≤ c on contact rows.

Each part is a record of its own. Factors belong to parts that are independent of the loads, so that
another load case needs no new factor (`DecomposedProblem.with_loads`).

Vectors are arrays, the local parts of distributed ones: dual vectors by owned row of B; interface
vectors by subdomain of this rank, class after class, member after member.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from solver.backend import SetState, SharedPlace
from solver.contact.bodies import Bodies, body_lengths
from solver.contact.friction_points import FrictionPoints
from solver.contact.row_kinds import RowKind
from solver.distributed import local_rows, petsc_rows
from solver.problem.constraints.conditions import ContactRows, HeldRows
from solver.problem.constraints.friction import friction_points
from solver.problem.constraints.matrix import ConstraintMatrix, without_columns
from solver.problem.constraints.shared_rows import SharedRows
from solver.problem.free_motions import FreeMotions
from solver.problem.parts import Constraints, Loads, NodePlaces, loads_on
from solver.problem.subdomains import SubdomainClass, interface_slices
from solver.problem.unfactored_loads import (
    given_motions,
    lengths_at_unknowns,
    loads_in_energy,
    pushes_of_rigid_bodies,
)
from solver.vectors import Array, Mask, largest_magnitude

GIVEN = 1e-3
"""Reference of the displacement of a body at rest, over the largest motion given in its group.

A body counts as at rest below `MOTIONLESS` times this share (`solver.contact.bodies`): its
displacement is a rounding error of gaps from which the given motion is subtracted.
"""


@dataclass(frozen=True, eq=False)
class DecomposedProblem:
    """The contact problem as methods use it, whether they solve for forces or displacements."""

    comm: MPI.Intracomm
    """Communicator of all ranks."""
    dimension: int
    """Components of a node."""
    classes: tuple[SubdomainClass, ...]
    """Congruence classes of subdomains on this rank."""
    constraints: Constraints
    shared: SharedRows
    """Geometry of the contact, tangential, tied and mean rows, each in row order."""
    load_case: Loads
    bodies: Bodies
    """The body of each subdomain and row."""
    places: tuple[NodePlaces, ...] = ()
    """Nodes of each class if the subdomains are not factored; otherwise empty."""
    nodes: int = 0
    """Number of nodes on all ranks."""
    free_motions: FreeMotions | None = None
    """Rigid motions that nothing resists; None without such motions."""
    place: SharedPlace | None = None
    """For the matrices of methods without factors; problems at one place share them."""

    def with_loads(
        self,
        forces: Sequence[Array],
        lifting: Sequence[Array] | None = None,
        c: Array | None = None,
        thermal: Sequence[Array | None] = (),
    ) -> Self:
        """The problem with other loads; parameters as in `Loads`.

        Displacements and gaps stay unchanged unless given.
        """
        shared = self.shared
        lifting = self.lifting if lifting is None else lifting
        if c is None:
            c = self.c
        else:
            gaps = c[self.inequality] / shared.contact.spread
            shared = replace(shared, contact=replace(shared.contact, gaps=gaps))
        loads = replace(loads_on(self.classes, forces, lifting, c), thermal=tuple(thermal))
        return self._under(loads, shared)

    def _under(self, load_case: Loads, shared: SharedRows) -> Self:
        """The problem of another load case."""
        return replace(self, load_case=load_case, shared=shared)

    @property
    def B(self) -> ConstraintMatrix:
        """Constraint matrix on interface unknowns, (dual, interface)."""
        return self.constraints.B

    @property
    def kinds(self) -> NDArray[np.int8]:
        """`RowKind` of each row, (dual,)."""
        return self.constraints.kinds

    @property
    def held_without_contact(self) -> bool:
        """Whether every body is held with all contact rows open."""
        return self.constraints.held_without_contact

    @property
    def contact(self) -> ContactRows:
        """Geometry of the contact rows, in row order."""
        return self.shared.contact

    @property
    def forces(self) -> tuple[Array, ...]:
        """Loads f, one (n, members) array per class."""
        return self.load_case.forces

    @property
    def lifting(self) -> tuple[Array, ...]:
        """Displacements of eliminated held unknowns, one (n, members) array per class."""
        return self.load_case.lifting

    @property
    def c(self) -> Array:
        """Right-hand side of the constraints, (dual,)."""
        return self.load_case.c

    @property
    def e(self) -> Array:
        """Work of the loads on the kernels, (kernels,)."""
        return self.load_case.e

    @property
    def factored(self) -> bool:
        """Whether subdomains are factored; otherwise only methods for displacements apply."""
        return not self.places

    @cached_property
    def slices(self) -> list[slice]:
        """Slice of each class in an interface vector."""
        return interface_slices(self.classes)

    @property
    def size(self) -> int:
        """Local rows of B."""
        return len(self.c)

    @cached_property
    def loads(self) -> tuple[Array, ...]:
        """Loads with the lifting of eliminated conditions subtracted, f - K u_held."""
        return tuple(
            force - cls.stiffness @ lift if lift.any() else force
            for cls, force, lift in zip(self.classes, self.forces, self.lifting, strict=True)
        )

    @cached_property
    def inequality(self) -> Mask:
        """Mask (dual,) of the local contact rows."""
        return self.kinds == RowKind.CONTACT

    @cached_property
    def tangential(self) -> Mask:
        """Mask (dual,) of the local tangential rows."""
        return self.kinds == RowKind.TANGENT

    @cached_property
    def conditional(self) -> Mask:
        """Mask (dual,) of the local rows that may be active or not: contact and tangential rows."""
        return self.inequality | self.tangential

    @cached_property
    def friction(self) -> FrictionPoints:
        """Contact points with friction."""
        rows = self.shared.friction
        return friction_points(rows, self.contact, self.tangential, self.inequality)

    @cached_property
    def tied(self) -> Mask:
        """Mask (dual,) of the local tied rows."""
        return self.kinds == RowKind.TIED

    @cached_property
    def means(self) -> Mask:
        """Mask (dual,) of the local rows that hold a rigid motion in the mean."""
        return self.kinds == RowKind.MEAN

    @cached_property
    def one_sided(self) -> bool:
        """Whether any rank has a contact row (collective at the first call)."""
        return bool(self.comm.allreduce(int(self.inequality.sum())))

    @cached_property
    def spread(self) -> Array:
        """One over the length of unscaled contact, tangential, tied, mean rows; 1 for others.

        Force = multiplier · spread, and distance = residual / spread.
        """
        result = np.ones(self.size)
        for kind, rows in self.shared.by_kind.items():
            result[self.kinds == kind] = rows.spread
        return result

    def right_hand_side(self, held: HeldRows, shared: SharedRows) -> Array:
        """c (dual,) for other held displacements and gaps of the same rows."""
        c, unknowns = np.zeros(self.size), self.constraints.held_unknowns
        rows = np.flatnonzero(unknowns >= 0)
        node, component = np.divmod(unknowns[rows], self.dimension)
        c[rows] = held.values[np.searchsorted(held.nodes, node), component]
        for kind, of_kind in shared.by_kind.items():
            chosen = self.kinds == kind
            c[chosen] = of_kind.gaps * self.spread[chosen]
        return c

    @cached_property
    def deforming(self) -> ConstraintMatrix:
        """B without the columns of rigid bodies; B itself where no body is rigid.

        Corrections of rows, overlaps and preconditioners use it (collective at the first call).
        """
        rigid = [np.full(c.members * len(c.interface), c.rigid) for c in self.classes]
        return without_columns(self.B, np.concatenate([np.zeros(0, bool), *rigid]))

    @cached_property
    def overlapping(self) -> Mask:
        """Mask (dual,) of the contact, tangential, tied and mean rows; the others are orthonormal.

        These rows are orthogonal to the others, but not to each other.
        """
        return self.conditional | self.tied | self.means

    @cached_property
    def products(self) -> PETSc.Mat:
        """B Bᵀ of the overlapping rows (collective at the first call)."""
        rows = petsc_rows(self.comm, self.deforming.local[self.overlapping], self.B.columns)
        transpose = rows.transpose(PETSc.Mat())
        result = rows.matMult(transpose)
        for matrix in (rows, transpose):
            matrix.destroy()
        return result

    @cached_property
    def overlap(self) -> Array:
        """Row sums of |B Bᵀ| over the overlapping rows, 1 for other rows (collective at first).

        They bound the sum of the corrections of rows that are not orthogonal.
        """
        result = np.ones(self.size)
        sums = np.asarray(abs(local_rows(self.products)).sum(axis=1)).ravel()
        result[self.overlapping] = np.maximum(sums, 1.0)
        return result

    def count(self, kind: RowKind) -> int:
        """Rows of one kind on all ranks."""
        return int(self.comm.allreduce(int((self.kinds == kind).sum())))

    def strains_at_unknowns(self) -> Array:
        """a(u, u) if each free unknown gave way to its load alone, Σ f_i² / K_ii (collective).

        Of each body, (bodies,). Forces on rigid bodies count as if they pushed one unknown.
        """
        sums = []
        for cls, force in zip(self.classes, self.forces, strict=True):
            flexible = 1.0 / cls.resistance[cls.free]
            sums.append(np.einsum("im,im,i->m", force[cls.free], force[cls.free], flexible))
        elastic = np.asarray(self.comm.allreduce(self.bodies.sum_members(sums)))
        return elastic + self.pushes[1]

    @cached_property
    def pushes(self) -> tuple[Array, Array]:
        """Displacement and a(u, u) of each body by the forces on rigid bodies, (bodies,) each.

        As `pushes_of_rigid_bodies` estimates them (collective at the first call).
        """
        return pushes_of_rigid_bodies(self.bodies, self.classes, self.forces, self.comm)

    @cached_property
    def resting_lengths(self) -> Array:
        """The least references of lengths of bodies at rest, (bodies,) (collective at first).

        A body that comes back to its unloaded state is at rest but for rounding errors of the
        displacements from which slip is measured.
        """
        motions = given_motions(self.bodies, self.lifting, self.comm)
        resting = np.maximum(self.pushes[0], GIVEN * motions)
        before = self.load_case.lengths_before
        return resting if before is None else np.maximum(resting, before)

    @cached_property
    def mechanical_loads(self) -> Array:
        """Σ |f| of each body without its thermal loads, (bodies,) (collective at first)."""
        acting = [f if heat is None else f - heat for f, heat in self._forces_with_heat]
        return self._magnitudes(acting)

    @cached_property
    def heated(self) -> Mask:
        """Bodies of groups with thermal loads, (bodies,) (collective at first)."""
        heat = [np.zeros((1, f.shape[1])) if heat is None else heat
                for f, heat in self._forces_with_heat]  # fmt: skip
        return self.bodies.by_group(self._magnitudes(heat))[self.bodies.groups] > 0.0

    @property
    def _forces_with_heat(self) -> list[tuple[Array, Array | None]]:
        """Forces and their thermal part, or None, of each class."""
        thermal = self.load_case.thermal or [None] * len(self.forces)
        return list(zip(self.forces, thermal, strict=True))

    def _magnitudes(self, forces: Sequence[Array]) -> Array:
        """Σ |f| of each body, (bodies,), of forces (n, members) of each class (collective)."""
        sums = self.bodies.sum_members([np.abs(f).sum(axis=0) for f in forces])
        return np.asarray(self.comm.allreduce(sums))

    @cached_property
    def free_lengths(self) -> Array:
        """Largest f_i / K_ii of each body, (bodies,) (collective at the first call).

        The largest displacement without constraint forces, if each unknown gave way to its load
        alone.
        """
        elastic = lengths_at_unknowns(self.bodies, self.classes, self.loads, self.comm)
        return np.maximum(elastic, self.resting_lengths)

    @cached_property
    def free_strains(self) -> Array:
        """a(u, u) without constraint forces, (bodies,), as `strains_at_unknowns` estimates it."""
        return self.strains_at_unknowns()

    @property
    def effect_of_loads(self) -> Array:
        """A vector (any,) that tells load cases apart, `loads_in_energy` (collective)."""
        return loads_in_energy(self.comm, self.classes, self.loads, self.c[~self.conditional])

    @property
    def description(self) -> dict[str, float]:
        """Numbers that identify the problem, equal on any number of ranks (collective)."""
        c, d, e = self.c, self.effect_of_loads, self.e
        squares = self.comm.allreduce(np.array([self.size, c @ c, d @ d, e @ e]))
        kinds = {kind.name.lower(): float(self.count(kind)) for kind in RowKind}
        return {**kinds, **dict(zip(("rows", "c", "d", "e"), map(float, squares), strict=True))}

    def lengths(self, interface: Array) -> Array:
        """The reference length of each body, (bodies,), for displacements (interface,)."""
        moved = self.bodies.largest_on_interface(self.comm, interface)
        return body_lengths(self.bodies, moved, self.free_lengths)

    def on_interface(self, displacements: list[Array]) -> Array:
        """The interface vector of displacements, which are (n, members) for each class."""
        result = np.empty(self.B.columns)
        for cls, part, u in zip(self.classes, self.slices, displacements, strict=True):
            result[part].reshape(cls.members, -1)[:] = u[cls.interface].T
        return result

    def residual(self, interface: Array) -> Array:
        """B u - c for displacements on the interface: jumps, and penetration on contact rows."""
        result = np.empty(self.size)
        self.B.apply(interface, result)
        return np.subtract(result, self.c, out=result)

    def jumps(self, displacements: list[Array]) -> Array:
        """B u - c (rows of B,) for displacements, which are (n, members) for each class."""
        return self.residual(self.on_interface(displacements))

    def largest_distance(self, state: SetState) -> float:
        """Largest jump or penetration of a state, over the displacement of its body (collective).

        Open contact rows count where they are penetrated, tangential ones where they stick.
        """
        distance, active = state.distance, state.active
        distance = np.where(self.tangential & ~active, 0.0, distance)
        distance = np.where(self.inequality & ~active, np.maximum(distance, 0.0), distance)
        return largest_magnitude(self.comm, distance)

    def constraint_forces(self, multiplier: Array) -> Array:
        """Bᵀ λ, an interface vector."""
        result = np.empty(self.B.columns)
        self.B.apply_transpose(multiplier, result)
        return result

    def row_stiffness(self, rows: Mask) -> Array:
        """The stiffness against each of some rows alone, diag(B diag(K) Bᵀ) (collective)."""
        parts = [np.tile(c.stiffness.diagonal()[c.interface], c.members) for c in self.classes]
        diagonal = np.concatenate([np.empty(0), *parts])
        squares = self.B.local[rows].power(2)
        result = np.empty(squares.shape[0])
        ConstraintMatrix(self.comm, squares, self.B.columns).apply(diagonal, result)
        return result
