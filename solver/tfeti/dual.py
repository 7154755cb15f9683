"""The dual problem: min ½ λᵀ F λ - λᵀ d  subject to  λ_I ≥ 0 and G λ = e.

    F = B K⁺ Bᵀ,  d = B K⁺ f - c,  G = Rᵀ Bᵀ,  e = Rᵀ f

(paper, section 4.1). The multipliers are homogenised by λ = x + λ̃ with λ̃ = Gᵀ (G Gᵀ)⁻¹ e, and
F is projected, which leaves

    min ½ xᵀ P F P x - xᵀ P (d - F λ̃)  subject to  x_I ≥ -λ̃_I and Q x = 0.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from solver.problem.constraints.shared_rows import SharedRows
from solver.problem.decomposed import DecomposedProblem
from solver.problem.parts import Loads
from solver.tfeti.coarse.coarse_problem import CoarseProblem
from solver.tfeti.dual_operator import DualOperator, FreeSolution, solve_free
from solver.tfeti.projected import ProjectedOperator
from solver.tfeti.subdomain.classes import FactoredClass
from solver.vectors import Array, largest_magnitude


@dataclass(frozen=True, eq=False)
class Reused:
    """Results of another problem of the same system; None where they have to be computed."""

    operator: DualOperator | None = None
    """F."""
    free_solution: FreeSolution | None = None
    """The displacements under the loads without constraints."""
    d: Array | None = None  # (dual,)
    """B K⁺ f - c."""
    offset: Array | None = None
    displacements: Array | None = None
    """λ̃ if it is not the smallest one, and K⁺ (f - Bᵀ λ̃). Shapes (dual,), (interface,)."""


@dataclass(frozen=True, eq=False)
class DualProblem(DecomposedProblem):
    """The dual problem with all data of solve, recovery and certificate; local parts."""

    classes: tuple[FactoredClass, ...]
    """Congruence classes of subdomains on this rank, with their factors if there are any."""
    coarse: CoarseProblem | None = None
    """The coarse problem of rigid motions; None where no subdomain floats."""
    reused: Reused = Reused()
    """Results that other problems of the same system have computed already."""

    def _under(self, load_case: Loads, shared: SharedRows) -> Self:
        """The problem of another load case; constraints and factors are shared."""
        reused = Reused(operator=self.F if self.factored else None)
        return replace(self, load_case=load_case, shared=shared, reused=reused)

    def without_factors(self) -> "DualProblem":
        """The problem without factors, for the evaluation of its answer alone."""
        classes = tuple(replace(cls, inverse=None, block=None) for cls in self.classes)
        return replace(self, classes=classes, place=None, reused=Reused())

    def with_slip_from(self, displacements: list[Array]) -> "DualProblem":
        """The problem with slip measured from given displacements, not from the unstrained state.

        The slip of these displacements is the right-hand side of the tangential rows. Collective.

        Parameters
        ----------
        displacements : one (n, members) array per class
            Displacements of a problem with the same subdomains.
        """
        if [u.shape for u in displacements] != [f.shape for f in self.forces]:
            raise ValueError("slip is measured from displacements of other subdomains")
        moved, interface = np.empty(self.size), self.on_interface(displacements)
        self.B.apply(interface, moved)
        c = np.where(self.tangential, moved, self.c)
        lengths = self.bodies.largest_on_interface(self.comm, interface)
        loads = replace(self.load_case, c=c, lengths_before=lengths)
        return replace(self, load_case=loads, reused=replace(self.reused, d=None))

    def with_least_motion_from(self, displacements: list[Array]) -> "DualProblem":
        """The problem with the least undetermined motions from given displacements (collective).

        The problem itself if they are of other subdomains.

        Parameters
        ----------
        displacements : one (n, members) array per class
        """
        other = [u.shape for u in displacements] != [f.shape for f in self.forces]
        if self.comm.allreduce(int(other)):
            return self
        loads = replace(self.load_case, displacements_before=tuple(displacements))
        return replace(self, load_case=loads)

    @cached_property
    def F(self) -> DualOperator:
        """The dual operator."""
        if self.reused.operator is not None:
            return self.reused.operator
        return DualOperator(self.B, self.classes)

    @cached_property
    def free_solution(self) -> FreeSolution:
        """The displacements under the loads without constraints."""
        if self.reused.free_solution is not None:
            return self.reused.free_solution
        return solve_free(self.classes, self.loads)

    @property
    def free_displacements(self) -> Array:
        """K⁺ f on the interface."""
        return self.free_solution[0]

    @cached_property
    def free_lengths(self) -> Array:
        """Largest K⁺ f on the interface of each body, (bodies,) (collective at the first call)."""
        if not self.factored:
            return super().free_lengths
        free = self.bodies.largest_on_interface(self.comm, self.free_displacements)
        return np.maximum(free, self.resting_lengths)

    @cached_property
    def free_strains(self) -> Array:
        """fᵀ K⁺ f of each body, (bodies,), held unknowns at rest (collective at the first call)."""
        if not self.factored:
            return super().free_strains
        works = list(self.free_solution[1])
        for number, (cls, load, lift) in enumerate(
            zip(self.classes, self.forces, self.lifting, strict=True)
        ):
            if lift.any():
                works[number] = np.einsum("ij,ij->j", load, cls.solve(load.copy(order="F")))
        return np.asarray(self.comm.allreduce(self.bodies.sum_members(works))) + self.pushes[1]

    def strain_energy(self, multiplier: Array, jumps: Array) -> float:
        """a(u, u) = (f - Bᵀ λ)ᵀ K⁺ (f - Bᵀ λ), twice the energy of the strains.

        Parameters
        ----------
        jumps : (dual,)
            d - F λ.
        """
        total = sum(float(work.sum()) for work in self.free_solution[1])
        total -= float(multiplier @ (self.d + jumps + 2.0 * self.c))
        return float(self.comm.allreduce(total))

    @cached_property
    def d(self) -> Array:
        """d = B K⁺ f - c."""
        if self.reused.d is not None:
            return self.reused.d
        return self.residual(self.free_displacements)

    @property
    def effect_of_loads(self) -> Array:
        """A vector (any,) that tells load cases apart: d where it is known (collective)."""
        return self.d if self.factored else super().effect_of_loads

    @cached_property
    def offset(self) -> Array:
        """λ̃ = W Gᵀ (G W Gᵀ)⁻¹ e, the smallest multiplier in equilibrium with the loads.

        On contact rows -λ̃ is the bound of x; rounding errors of zero entries are removed. A
        problem with a given initial multiplier has another λ̃ in equilibrium.
        """
        if self.reused.offset is not None:
            return self.reused.offset
        result = np.zeros(self.size)
        if self.coarse is not None:
            self.coarse.least_multiplier(self.e, result)
            largest = largest_magnitude(self.comm, result)
            result[self.inequality & (np.abs(result) < 1e-11 * largest)] = 0.0
        return result

    @cached_property
    def displacements_of_offset(self) -> Array:
        """K⁺ (f - Bᵀ λ̃) on the interface."""
        if self.reused.displacements is not None:
            return self.reused.displacements
        result = np.empty_like(self.free_displacements)
        self.F.solve_interface(self.constraint_forces(self.offset), result)
        return np.subtract(self.free_displacements, result, out=result)

    @cached_property
    def projected(self) -> ProjectedOperator | DualOperator:
        """P F P, or F where no subdomain floats."""
        return self.F if self.coarse is None else ProjectedOperator(self.F.apply, self.coarse)

    @cached_property
    def rhs(self) -> Array:
        """Pᵀ (d - F λ̃), the right-hand side of the homogenised problem."""
        if self.coarse is None:
            return self.d
        result = self._residual_of_offset.copy()
        self.coarse.project_transpose(result, result)
        return result

    @cached_property
    def _residual_of_offset(self) -> Array:
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
    def lower(self) -> Array | None:
        """Lower bounds -λ̃ on contact rows, -∞ elsewhere; None without contact rows."""
        if not self.one_sided:
            return None
        return np.where(self.inequality, -self.offset, -np.inf)

    def kernel_slices(self) -> list[slice]:
        """Slices of the kernels of each class in a coarse vector."""
        ends = np.cumsum([0, *(c.members * c.kernel.shape[1] for c in self.classes)])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
