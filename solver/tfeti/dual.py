"""The dual problem: min ½ λᵀ F λ - λᵀ d  subject to  λ_I ≥ 0 and G λ = e.

    F = B K⁺ Bᵀ,  d = B K⁺ f - c,  G = Rᵀ Bᵀ,  e = Rᵀ f

(paper, section 4.1). The multipliers are homogenised by λ = x + λ̃ with λ̃ = Gᵀ (G Gᵀ)⁻¹ e, and
F is projected, which leaves

    min ½ xᵀ P F P x - xᵀ P (d - F λ̃)  subject to  x_I ≥ -λ̃_I and Q x = 0.

Vectors are arrays, the local parts of distributed ones: dual vectors by owned row of B; interface
vectors by subdomain of this rank, class after class, member after member.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from solver.contact.bodies import FAINT, Bodies, body_lengths
from solver.contact.friction_points import FrictionPoints
from solver.contact.row_kinds import RowKind
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.constraints.conditions import ContactRows
from solver.tfeti.constraints.friction import friction_points
from solver.tfeti.constraints.matrix import (
    ConstraintMatrix,
    local_rows,
    petsc_rows,
    without_columns,
)
from solver.tfeti.directions import Directions
from solver.tfeti.dual_operator import DualOperator, interface_slices
from solver.tfeti.free_solution import FreeSolution, solve_free
from solver.tfeti.projected import ProjectedOperator
from solver.tfeti.subdomain.classes import SubdomainClass
from solver.tfeti.system import ContactSystem
from solver.tfeti.unfactored_loads import lengths_at_unknowns, loads_in_energy
from solver.vectors import largest_magnitude


@dataclass(frozen=True, eq=False)
class Known:
    """Known results of another problem of the same system; None where they have to be computed.

    Attributes
    ----------
    operator
        F.
    free
        The displacements under the loads without constraints.
    d : (dual,)
        B K⁺ f - c.
    offset, displacements : (dual,), (interface,)
        λ̃ if it is not the smallest one, and K⁺ (f - Bᵀ λ̃).
    directions
        Search directions that problems under other loads share; each solve adds to them.
    """

    operator: DualOperator | None = None
    free: FreeSolution | None = None
    d: NDArray[np.float64] | None = None
    offset: NDArray[np.float64] | None = None
    displacements: NDArray[np.float64] | None = None
    directions: Directions | None = None


@dataclass(frozen=True, eq=False)
class DualProblem:
    """The dual problem with all data of the solve, the recovery and the certificate; local parts.

    Attributes
    ----------
    system
        Stiffness, constraints, contact points and loads.
    known
        Results that other problems of the same system have computed already.
    """

    system: ContactSystem
    known: Known = Known()

    def with_loads(
        self,
        forces: Sequence[NDArray[np.float64]],
        lifting: Sequence[NDArray[np.float64]] | None = None,
        c: NDArray[np.float64] | None = None,
    ) -> DualProblem:
        """The problem of another load case; constraints and factors are shared.

        Parameters are those of `ContactSystem.with_loads`.
        """
        known = Known(operator=self.F) if self.factored else Known()
        known = replace(known, directions=self.known.directions)
        return DualProblem(self.system.with_loads(forces, lifting, c), known)

    def without_factors(self) -> DualProblem:
        """The problem without factors, for the evaluation of its answer alone."""
        classes = tuple(replace(cls, inverse=None, block=None) for cls in self.classes)
        return DualProblem(replace(self.system, classes=classes))

    def recycling(self, directions: Directions | None) -> DualProblem:
        """The problem with search directions that solves under other loads share.

        Parameters
        ----------
        directions
            Initial directions, used if they belong to the same constraints; none if None.
        """
        if directions is None or directions.B is not self.B:
            directions = Directions(self.B, self.conditional)
        known = replace(self.known, operator=self.F, directions=directions)
        return DualProblem(self.system, known)

    def with_slip_from(self, displacements: list[NDArray[np.float64]]) -> DualProblem:
        """The problem with slip measured from given displacements, not from the unstrained state.

        The slip of these displacements is the right-hand side of the tangential rows.

        Parameters
        ----------
        displacements : one (n, members) array per class
            Displacements of a problem with the same subdomains.
        """
        if [u.shape for u in displacements] != [f.shape for f in self.forces]:
            raise ValueError("slip is measured from displacements of other subdomains")
        moved = np.empty(self.size)
        self.B.apply(self.on_interface(displacements), moved)
        loads = replace(self.system.loads, c=np.where(self.tangential, moved, self.c))
        return DualProblem(replace(self.system, loads=loads), replace(self.known, d=None))

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of all ranks."""
        return self.system.comm

    @property
    def dimension(self) -> int:
        """Components of a node."""
        return self.system.dimension

    @property
    def classes(self) -> tuple[SubdomainClass, ...]:
        """Congruence classes of this rank."""
        return self.system.classes

    @property
    def B(self) -> ConstraintMatrix:
        """Constraint matrix on interface unknowns, (dual, interface)."""
        return self.system.constraints.B

    @property
    def kinds(self) -> NDArray[np.int8]:
        """`RowKind` of each row, (dual,)."""
        return self.system.constraints.kinds

    @property
    def wide(self) -> NDArray[np.bool_]:
        """Mask (dual,) of contact, tangential and tied rows over several nodes, which overlap."""
        return self.system.constraints.wide

    @property
    def coarse(self) -> CoarseProblem | None:
        """The coarse problem; None where no subdomain floats."""
        return self.system.constraints.coarse

    @property
    def held_without_contact(self) -> bool:
        """Whether gluing and held rows alone stop every rigid motion."""
        return self.system.constraints.held_without_contact

    @property
    def contact(self) -> ContactRows:
        """Geometry of the contact rows, in row order."""
        return self.system.contact

    @property
    def bodies(self) -> Bodies:
        """The body of each subdomain and row."""
        return self.system.bodies

    @property
    def forces(self) -> tuple[NDArray[np.float64], ...]:
        """Loads f, one (n, members) array per class."""
        return self.system.loads.forces

    @property
    def lifting(self) -> tuple[NDArray[np.float64], ...]:
        """Displacements of eliminated held unknowns, one (n, members) array per class."""
        return self.system.loads.lifting

    @property
    def c(self) -> NDArray[np.float64]:
        """Right-hand side of the constraints, (dual,)."""
        return self.system.loads.c

    @property
    def e(self) -> NDArray[np.float64]:
        """Work of the loads on the kernels, (kernels,)."""
        return self.system.loads.e

    @property
    def factored(self) -> bool:
        """Whether subdomains are factored; otherwise only methods for displacements apply."""
        return not self.system.places

    @cached_property
    def F(self) -> DualOperator:
        """The dual operator."""
        if self.known.operator is not None:
            return self.known.operator
        return DualOperator(self.B, self.classes)

    @property
    def size(self) -> int:
        """Local rows of B."""
        return len(self.c)

    @cached_property
    def loads(self) -> tuple[NDArray[np.float64], ...]:
        """Loads with the lifting of eliminated conditions subtracted, f - K u_held."""
        return tuple(
            force - cls.stiffness @ lift if lift.any() else force
            for cls, force, lift in zip(self.classes, self.forces, self.lifting, strict=True)
        )

    @cached_property
    def inequality(self) -> NDArray[np.bool_]:
        """Mask (dual,) of the local contact rows."""
        return self.kinds == RowKind.CONTACT

    @cached_property
    def tangential(self) -> NDArray[np.bool_]:
        """Mask (dual,) of the local tangential rows."""
        return self.kinds == RowKind.TANGENT

    @cached_property
    def conditional(self) -> NDArray[np.bool_]:
        """Mask (dual,) of the local rows that may be active or not: contact and tangential rows."""
        return self.inequality | self.tangential

    @cached_property
    def friction(self) -> FrictionPoints | None:
        """Contact points with friction; None where no rank has any."""
        rows = self.system.friction
        if rows is None:
            return None
        return friction_points(rows, self.contact, self.tangential, self.inequality)

    @cached_property
    def tied(self) -> NDArray[np.bool_]:
        """Mask (dual,) of the local tied rows."""
        return self.kinds == RowKind.TIED

    @cached_property
    def means(self) -> NDArray[np.bool_]:
        """Mask (dual,) of the local rows that hold a rigid motion in the mean."""
        return self.kinds == RowKind.MEAN

    @cached_property
    def one_sided(self) -> bool:
        """Whether any rank has a contact row (collective at the first call)."""
        return bool(self.comm.allreduce(int(self.inequality.sum())))

    @cached_property
    def spread(self) -> NDArray[np.float64]:
        """One over the length of unscaled contact, tangential, tied, mean rows; 1 for others.

        Force = multiplier · spread, and distance = residual / spread.
        """
        result = np.ones(self.size)
        result[self.inequality] = self.contact.spread
        result[self.tied] = self.system.tied.spread
        result[self.means] = self.system.means.spread
        if self.system.friction is not None:
            result[self.tangential] = self.system.friction.rows.spread
        return result

    @cached_property
    def deforming(self) -> ConstraintMatrix:
        """B without the columns of rigid bodies; B itself where no body is rigid.

        Corrections of rows, overlaps and preconditioners use it (collective at the first call).
        """
        own = [np.full(c.members * len(c.interface), c.rigid) for c in self.classes]
        return without_columns(self.B, np.concatenate([np.zeros(0, bool), *own]))

    @cached_property
    def overlap(self) -> NDArray[np.float64]:
        """Row sums of |B Bᵀ| over contact, tangential, tied and mean rows, 1 for other rows.

        They bound the sum of the corrections of rows that are not orthogonal.
        """
        result = np.ones(self.size)
        overlapping = self.conditional | self.tied | self.means
        contact = self.deforming.local[overlapping]
        if self.comm.allreduce(int(self.wide.any() or self.means.any())):
            matrix = petsc_rows(self.comm, contact, self.B.columns)
            product = local_rows(matrix.matMult(matrix.transpose(PETSc.Mat())))
        else:  # rows of one node overlap only with rows of the same node, which are on this rank
            product = contact @ contact.T
        sums = np.asarray(abs(product).sum(axis=1)).ravel()
        result[overlapping] = np.maximum(sums, 1.0)
        return result

    def count(self, kind: RowKind) -> int:
        """Rows of one kind on all ranks."""
        return int(self.comm.allreduce(int((self.kinds == kind).sum())))

    @cached_property
    def free(self) -> FreeSolution:
        """The displacements under the loads without constraints."""
        if self.known.free is not None:
            return self.known.free
        return solve_free(self.classes, self.loads)

    @property
    def free_displacements(self) -> NDArray[np.float64]:
        """K⁺ f on the interface."""
        return self.free[0]

    @cached_property
    def free_lengths(self) -> NDArray[np.float64]:
        """Largest K⁺ f on the interface of each body, (bodies,) (collective at the first call).

        Without factors, the largest f_i / K_ii: the value if each unknown gave way to its load
        alone.
        """
        if not self.factored:
            return lengths_at_unknowns(self.bodies, self.classes, self.loads, self.comm)
        moved = largest_magnitude(self.comm, *self.lifting)
        free = self.bodies.largest_on_interface(self.comm, self.free_displacements)
        return np.maximum(free, FAINT * moved)  # rounding errors of given motions

    @cached_property
    def free_strains(self) -> NDArray[np.float64]:
        """fᵀ K⁺ f of each body, (bodies,), held unknowns at rest (collective at the first call).

        Without factors, Σ f_i² / K_ii: the value if each unknown gave way to its load alone.
        """
        if not self.factored:
            return self.strains_at_unknowns()
        works = list(self.free[1])
        for number, (cls, load, lift) in enumerate(
            zip(self.classes, self.forces, self.lifting, strict=True)
        ):
            if lift.any():
                works[number] = np.einsum("ij,ij->j", load, cls.solve(load.copy(order="F")))
        return np.asarray(self.comm.allreduce(self.bodies.sum_members(works)))

    def strains_at_unknowns(self) -> NDArray[np.float64]:
        """a(u, u) if each free unknown gave way to its load alone, Σ f_i² / K_ii (collective).

        Of each body, (bodies,).
        """
        sums = []
        for cls, force in zip(self.classes, self.forces, strict=True):
            flexible = 1.0 / cls.resistance[cls.free]
            sums.append(np.einsum("im,im,i->m", force[cls.free], force[cls.free], flexible))
        return np.asarray(self.comm.allreduce(self.bodies.sum_members(sums)))

    def lengths(self, interface: NDArray[np.float64]) -> NDArray[np.float64]:
        """The reference length of each body, (bodies,), for displacements (interface,)."""
        moved = self.bodies.largest_on_interface(self.comm, interface)
        return body_lengths(self.bodies, moved, self.free_lengths)

    def strain_energy(
        self, multiplier: NDArray[np.float64], displacements: NDArray[np.float64]
    ) -> float:
        """a(u, u) = (f - Bᵀ λ)ᵀ K⁺ (f - Bᵀ λ), twice the energy of the strains.

        Parameters
        ----------
        displacements : (interface,)
            K⁺ (f - Bᵀ λ).
        """
        free, works = self.free
        own = sum(float(work.sum()) for work in works)
        own -= float(self.constraint_forces(multiplier) @ (free + displacements))
        return float(self.comm.allreduce(own))

    @cached_property
    def d(self) -> NDArray[np.float64]:
        """d = B K⁺ f - c."""
        if self.known.d is not None:
            return self.known.d
        return self.residual(self.free_displacements)

    @property
    def effect_of_loads(self) -> NDArray[np.float64]:
        """A vector (any,) that tells load cases apart: d, or `loads_in_energy` (collective)."""
        if self.factored:
            return self.d
        equal = ~self.inequality & ~self.tangential
        return loads_in_energy(self.comm, self.classes, self.loads, self.c[equal])

    @cached_property
    def offset(self) -> NDArray[np.float64]:
        """λ̃ = W Gᵀ (G W Gᵀ)⁻¹ e, the smallest multiplier in equilibrium with the loads.

        On contact rows -λ̃ is the bound of x; rounding errors of zero entries are removed. A
        problem with a given initial multiplier has another λ̃ in equilibrium.
        """
        if self.known.offset is not None:
            return self.known.offset
        result = np.zeros(self.size)
        if self.coarse is not None:
            self.coarse.least_multiplier(self.e, result)
            largest = largest_magnitude(self.comm, result)
            result[self.inequality & (np.abs(result) < 1e-11 * largest)] = 0.0
        return result

    @cached_property
    def displacements_of_offset(self) -> NDArray[np.float64]:
        """K⁺ (f - Bᵀ λ̃) on the interface."""
        if self.known.displacements is not None:
            return self.known.displacements
        result = np.empty_like(self.free_displacements)
        self.F.solve_interface(self.constraint_forces(self.offset), result)
        return np.subtract(self.free_displacements, result, out=result)

    @cached_property
    def projected(self) -> ProjectedOperator | DualOperator:
        """P F P, or F where no subdomain floats."""
        return self.F if self.coarse is None else ProjectedOperator(self.F.apply, self.coarse)

    @cached_property
    def rhs(self) -> NDArray[np.float64]:
        """Pᵀ (d - F λ̃), the right-hand side of the homogenised problem."""
        if self.coarse is None:
            return self.d
        result = self._residual_of_offset.copy()
        self.coarse.project_transpose(result, result)
        return result

    @cached_property
    def _residual_of_offset(self) -> NDArray[np.float64]:
        """d - F λ̃, before projection."""
        return self.residual(self.displacements_of_offset)

    @cached_property
    def round_off(self) -> float:
        """Norm of the right-hand side below which it counts as round-off.

        If rigid motions alone satisfy the conditions, the exact projected right-hand side is zero,
        and the computed one is round-off.
        """
        full = self.d if self.coarse is None else self._residual_of_offset
        square = self.comm.allreduce(float(full @ full) + float(self.d @ self.d))
        return 1e-14 * float(np.sqrt(square))

    @cached_property
    def lower(self) -> NDArray[np.float64] | None:
        """Lower bounds -λ̃ on contact rows, -∞ elsewhere; None without contact rows."""
        if not self.one_sided:
            return None
        return np.where(self.inequality, -self.offset, -np.inf)

    def on_interface(self, displacements: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """The interface vector of displacements, which are (n, members) for each class."""
        result = np.empty(self.B.columns)
        for cls, part, u in zip(
            self.classes, interface_slices(self.classes), displacements, strict=True
        ):
            result[part].reshape(cls.members, -1)[:] = u[cls.interface].T
        return result

    def residual(self, interface: NDArray[np.float64]) -> NDArray[np.float64]:
        """B u - c for displacements on the interface: jumps, and penetration on contact rows."""
        result = np.empty(self.size)
        self.B.apply(interface, result)
        return np.subtract(result, self.c, out=result)

    def constraint_forces(self, multiplier: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bᵀ λ, an interface vector."""
        result = np.empty(self.B.columns)
        self.B.apply_transpose(multiplier, result)
        return result

    def row_stiffness(self, rows: NDArray[np.bool_]) -> NDArray[np.float64]:
        """The stiffness against each of some rows alone, diag(B diag(K) Bᵀ) (collective)."""
        parts = [np.tile(c.stiffness.diagonal()[c.interface], c.members) for c in self.classes]
        diagonal = np.concatenate([np.empty(0), *parts])
        squares = self.B.local[rows].power(2)
        found = np.empty(squares.shape[0])
        ConstraintMatrix(self.comm, squares, self.B.columns).apply(diagonal, found)
        return found

    def kernel_slices(self) -> list[slice]:
        """Slices of the kernels of each class in a coarse vector."""
        ends = np.cumsum([0, *(c.members * c.kernel.shape[1] for c in self.classes)])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
