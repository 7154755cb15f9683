"""The matrices of multigrid, which problems under other loads share."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

from solver.backend import SharedPlace
from solver.primal.factor import FactorOptions, predicted_seconds, thinness
from solver.primal.hierarchy import Hierarchy, build_hierarchy, no_hierarchy
from solver.primal.merged import MergedSystem, merge
from solver.primal.rigid_space import FloatingMotions
from solver.problem.decomposed import DecomposedProblem


def free_matrices(comm: MPI.Intracomm) -> None:
    """Free unused PETSc objects now; petsc4py would free them later (collective)."""
    for owner in (PETSc.COMM_SELF, comm):
        PETSc.garbage_cleanup(owner)


@contextmanager
def freed_matrices(comm: MPI.Intracomm) -> Iterator[None]:
    """Free unused PETSc objects after a solve that all ranks end, with an answer or without.

    An error of one rank alone must not wait for the others.
    """
    try:
        yield
    except ArithmeticError:
        free_matrices(comm)
        raise
    free_matrices(comm)


@dataclass(frozen=True, eq=False)
class Matrices:
    """The undecomposed problem and the data that multigrid derives from it before the first set."""

    system: MergedSystem
    seconds: float
    """Predicted for one factor of K."""
    direct: bool
    """Whether factors solve on the sets."""
    thin: bool
    """Whether bodies are thin and held, so that their contact may peel off row by row."""
    peels: bool
    """Whether they are, and a factor is inexpensive from the first set on: without one the many
    sets of a constraint hierarchy would cost too many iterations. With friction these are the sets
    of the contact without friction."""
    hierarchy: Hierarchy
    """All levels, or K alone where a factor solves."""
    floating: FloatingMotions
    """The rigid motions that held unknowns do not stop."""

    @classmethod
    def of(cls, problem: DecomposedProblem, factors: FactorOptions) -> "Matrices":
        """The matrices of an unfactored problem (collective)."""
        system = merge(problem)
        seconds = predicted_seconds(system)
        held = problem.held_without_contact
        by_cycles = problem.dimension == 3 and (problem.friction.acts or not held)
        is_thin = thinness(system) >= factors.thin
        by_factors = is_thin and not by_cycles
        small = factors.small if problem.dimension == 2 or problem.friction.acts else 0.0
        direct = seconds <= (factors.thin_seconds if by_factors else small)
        peels = is_thin and held and seconds <= factors.thin_seconds
        # thin bodies take their first set from levels, though a factor solves on the sets
        make = build_hierarchy if not direct or (by_factors and not peels) else no_hierarchy
        free_matrices(problem.comm)
        hierarchy = make(system)
        free_matrices(problem.comm)
        floating = FloatingMotions(system)
        return cls(system, seconds, direct, is_thin and held, peels, hierarchy, floating)

    def peeling(self, most_seconds: float) -> "Matrices | None":
        """The same matrices with factors on the constraint hierarchy.

        None where they have these already, no body is thin and held, or a factor takes longer.
        """
        if self.peels or not self.thin or self.seconds > most_seconds:
            return None
        return replace(self, direct=True, peels=True)

    @classmethod
    def shared(
        cls, place: SharedPlace, problem: DecomposedProblem, factors: FactorOptions
    ) -> "Matrices":
        """The matrices at a place under the loads of the problem, if they fit it (collective).

        Otherwise new ones, which are left there; the others are freed before.
        """
        matrices = place.take()
        if isinstance(matrices, cls) and matrices.fit(problem):
            matrices = replace(matrices, system=matrices.system.under(problem))
        else:
            del matrices
            matrices = cls.of(problem, factors)
        place.leave(matrices)
        return matrices

    def fit(self, problem: DecomposedProblem) -> bool:
        """Whether a problem has the same stiffness and constraints."""
        same = self.system.problem
        return same.B is problem.B and same.classes is problem.classes
