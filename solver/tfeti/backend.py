"""Total FETI as a backend of the active-set loop (protocol `solver.backend.Backend`)."""

from functools import cached_property

from petsc4py import PETSc

from solver.backend import ConstraintHierarchy, Statuses
from solver.problem.constraint_hierarchy import constraint_hierarchy
from solver.tfeti.active_set_problem import ActiveSetProblem
from solver.tfeti.coupled import CoupledRows, coupled_rows
from solver.tfeti.directions import Directions, RecyclingOptions
from solver.tfeti.dual import DualProblem
from solver.tfeti.winkler import winkler_contact
from solver.vectors import Array, Mask


class TotalFeti:
    """Backend of one dual problem for one run of the active-set loop.

    The search directions of earlier sets are used again on later sets.
    """

    def __init__(self, problem: DualProblem, recycling: RecyclingOptions | None = None) -> None:
        self.problem, self._recycling = problem, recycling
        self.comm, self.contact_rows, self.c = problem.comm, problem.inequality, problem.c
        self.forget()

    def on_set(self, statuses: Statuses, multiplier: Array | None) -> ActiveSetProblem:
        """Conjugate gradients on a set (collective).

        Raises
        ------
        ArithmeticError
            The active rows do not hold every body in place.
        """
        return ActiveSetProblem(self.problem, statuses, multiplier, self._directions, self._coupled)

    @cached_property
    def _coupled(self) -> CoupledRows | None:
        """Coupled rows of all sets (collective at the first call)."""
        return coupled_rows(self.problem)

    def estimated_contact(self) -> Mask:
        """Contact rows (dual,) of rigid subdomains on a Winkler foundation (collective)."""
        return winkler_contact(self.problem)

    def corrected_contact(self, multiplier: Array) -> None:
        """None: there is no such model."""

    def hierarchy(self, coarsened: bool) -> ConstraintHierarchy:
        """The constraint hierarchy; several levels for thin bodies if wanted (collective)."""
        return constraint_hierarchy(self.problem, coarsened and self.problem.held_without_contact)

    def release(self) -> None:
        """Free the matrices of the last set now: petsc4py would free them later."""
        PETSc.garbage_cleanup(self.problem.comm)

    def forget(self) -> None:
        """Drop all search directions.

        Directions of sets that hardly hold a body harm other sets.
        """
        problem = self.problem
        self._directions = Directions(problem.B, problem.conditional, self._recycling)
