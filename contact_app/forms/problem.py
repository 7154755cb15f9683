"""`ContactProblem`: contact for a dolfinx user's own forms, used like dolfinx's `LinearProblem`."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem

from contact_app.errors import CouldNotRunError
from contact_app.forms.checks import (
    check_contacts,
    check_forms,
    check_lists,
    check_options,
)
from contact_app.forms.contacts import Contact
from contact_app.forms.grid import Grid, grid_of
from contact_app.forms.increments import differs_in_halves, following
from contact_app.forms.model import (
    FormModel,
    NotCongruentError,
    build_model,
    with_new_loads,
)
from contact_app.forms.planes import planes_of_contacts
from contact_app.forms.results import (
    OnSpace,
    Owners,
    contact_at_nodes,
    contact_records,
    friction_fields,
    nearest_gap,
    reaction_records,
    summary_of,
)
from contact_app.forms.warnings import FormAnswer, form_warnings
from contact_app.machine.environment import slow_blas_warning
from contact_app.machine.timings import Timings
from contact_app.model.normal_forces import NormalForces
from contact_app.results.division import loads_of_rows
from contact_app.run.fallback import FAILURES, failure_text
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints
from solver.contact.certificate import Certificate
from solver.contact.options import Method, SolverOptions
from solver.contact.solution import Solution
from solver.driver import reason_text, solve
from solver.qp.result import Monitor, Reason
from solver.tfeti.constraints.options import TotalFetiOptions

WAYS: dict[Method, tuple[Method, Method]] = {
    "auto": ("primal", "auto"),
    "primal": ("primal", "auto"),
    "active-set": ("active-set", "primal"),
    "smalbe": ("smalbe", "primal"),
}
"""Two methods for each method of the user: the second one follows without a certificate."""


@dataclass(frozen=True, eq=False)
class _Answer:
    """The result of a solve; Functions of fields at nodes by name."""

    solution: Solution
    fields: dict[str, Any]
    summary: dict[str, Any]


class ContactProblem:
    """Find u with a(u, v - u) ≥ L(v - u) for all admissible v (no penetration).

    The solution minimises ½ a(u, u) - L(u) among the displacements that satisfy the Dirichlet
    conditions and do not penetrate.

    Parameters
    ----------
    a, L
        ufl forms over one continuous vector Lagrange space of degree 1 or 2: a symmetric elliptic
        bilinear form and a linear one, with integrals over cells (`ufl.dx`) and facets of the
        surface (`ufl.ds`). The form is taken as it is: any material, springs, thermal strains.
    bcs
        Dirichlet conditions, of the space or of components of it.
    contacts
        Contacts of tagged facets, with or without friction.
    tolerance
        The solve ends when penetration, equilibrium, complementarity and duality gap are below
        it, relative to displacement, load and energy.
    method
        ``auto``: Total FETI with congruent sub-boxes where the mesh is a regular grid, or on one
        rank several separate ones; else active
        sets on the undecomposed bodies with multigrid, and Total FETI with one subdomain a rank
        where that ends without a certificate. Or an algorithm by name, as `solver.method` of a
        scene: ``primal``, ``active-set``, ``smalbe``; if it ends without a certificate, Total FETI
        follows ``primal``, and ``primal`` the others.
    max_iterations
        Of the solver.
    u
        The Function for the displacement; a new one by default.

    Attributes
    ----------
    u
        The displacement.

    Raises
    ------
    TypeError, ValueError
        A form, a condition or a contact is not admissible; the message says why.
    """

    def __init__(
        self,
        a: Any,
        L: Any,
        bcs: Sequence[Any] = (),
        contacts: Sequence[Contact] = (),
        tolerance: float = 1e-6,
        method: Method = "auto",
        max_iterations: int = 10_000,
        u: Any = None,
    ) -> None:
        check_lists(bcs, contacts)
        self.a, self.L, self.bcs, self.contacts = a, L, list(bcs), list(contacts)
        self._space = check_forms(a, L, self.bcs)
        degree = dolfinx_compat.lagrange_degree(self._space)
        check_contacts(self.contacts, self._space.mesh, degree)
        check_options(method, tolerance, max_iterations)
        self.options = SolverOptions(
            method=method, tolerance=float(tolerance), max_iterations=max_iterations
        )
        if u is not None and getattr(u, "function_space", None) != self._space:
            raise ValueError("u must be a Function of the space of the forms")
        self.u = fem.Function(self._space, name="displacement") if u is None else u
        self._functions: dict[str, Any] = {}
        self._answer: _Answer | None = None
        self._begin: Array | None = None
        self._pressed: NormalForces | None = None
        self._in_halves: str | None = None
        self._model: tuple[bool, bool, FormModel] | None = None

    def solve(self, monitor: Monitor | None = None, increment: bool = False) -> Any:
        """Solve and certify (collective), with the present coefficients and conditions.

        Matrices, factors and constraints that have not changed are reused from the last solve.
        The Functions of displacement, pressure and other fields remain, with new values.

        Parameters
        ----------
        increment
            Whether this is an increment of a load history: slip is measured from the displacement
            that `u` holds, that of the last solve unless it was changed, and not from zero.
        monitor
            Called with each step of the solver.

        Returns
        -------
        The displacement `u`. If the tolerance is not reached, a `RuntimeWarning` says why, and
        `converged` is False.

        Raises
        ------
        ValueError, ConfigurationError
            A form or a contact is not admissible; the message says why.
        NoEquilibriumError
            A body would move away under its loads.
        CouldNotRunError
            The solver found no answer; the message says why.
        """
        self._answer = None
        self._begin = (
            self.u.x.array.reshape(-1, self._space.dofmap.index_map_bs).copy()
            if increment
            else None
        )
        self._pressed = self._pressed if increment else None
        timings, messages = Timings(), []
        method, failure = self.options.method, None
        model, solution = self._on_grid(timings, monitor) if method == "auto" else (None, None)
        first, second = WAYS[method]
        for way in (first, second) if solution is None else ():
            try:
                model, solution = self._by(way, timings, monitor)
                if _is_final(solution):
                    break
                why = reason_text(solution).partition(";")[0]
            except CouldNotRunError as error:
                failure, why = error, str(error)
            if way == first:
                one, other = (
                    "multigrid" if m == "primal" else "Total FETI" for m in (first, second)
                )
                messages.append(f"{one} left no certified answer ({why}): solved by {other}")
        if solution is None:
            assert failure is not None
            raise failure
        assert model is not None
        messages += filter(None, [slow_blas_warning()])
        self._answer = self._evaluated(model, solution, timings, messages)
        self._pressed = NormalForces.of(model.problem, solution)
        if not solution.converged and model.parts.comm.rank == 0:
            warnings.warn(f"not certified: {reason_text(solution)}", RuntimeWarning, stacklevel=2)
        return self.u

    def _on_grid(
        self, timings: Timings, monitor: Monitor | None
    ) -> tuple[FormModel | None, Solution | None]:
        """The answer by congruent sub-boxes of a regular mesh; none where there is none."""
        grid = grid_of(self._space)
        if grid is None:
            return None, None
        try:
            model, solution = self._by("active-set", timings, monitor, grid)
        except (NotCongruentError, CouldNotRunError):
            return None, None
        return (model, solution) if _is_final(solution) else (None, None)

    def _by(
        self, method: Method, timings: Timings, monitor: Monitor | None, grid: Grid | None = None
    ) -> tuple[FormModel, Solution]:
        """The answer of a method (collective).

        Raises
        ------
        CouldNotRunError
            There is none.
        """
        kind = method != "primal", grid is not None
        try:
            with timings.measure("setup"):
                forms, model = (self.a, self.L), None
                former, self._model = self._model, None
                if former is not None and former[:2] == kind:
                    model = with_new_loads(
                        former[2], forms, self.bcs, self.contacts, timings.measure
                    )  # fmt: skip
                before = None if former is None or model is None else former[2].problem
                del former  # its factors make room for new ones
                if model is None:
                    model = build_model(
                        self._space, forms, self.bcs, self.contacts, timings.measure,
                        TotalFetiOptions(factored=kind[0]), grid,
                    )  # fmt: skip
                self._model = (*kind, model)
                if self._begin is not None:
                    model = following(model, self._begin)
            with timings.measure("solve"):
                options = replace(self.options, method=method)
                solution = solve(model.problem, options, monitor)
                self._in_halves = None
                if before is not None and self._begin is not None:
                    ends = before, model.problem
                    self._in_halves = differs_in_halves(*ends, solution, options, monitor)
                return model, solution
        except NotCongruentError:
            raise
        except FAILURES as error:
            raise _no_answer(error) from error

    def _evaluated(
        self, model: FormModel, solution: Solution, timings: Timings, messages: list[str]
    ) -> _Answer:
        """Fields, warnings after some messages, and summary (collective)."""
        parts, d = model.parts, model.parts.dimension
        with timings.measure("output"):
            copies = model.at_copies(solution.displacements)
            displacement = Owners.of_subdomains(model).mean(copies)
            on_space, owners = OnSpace(parts, model.exchange), Owners.of_parts(model)
            self.u.x.array[:] = on_space.values(displacement).ravel()
            problem = model.problem
            force = solution.multiplier[problem.inequality] * problem.contact.spread
            loads = loads_of_rows(problem, solution, force)
            at_nodes = [
                contact_at_nodes(model, solution, owners, loads, i, planes)
                for i, planes in enumerate(planes_of_contacts(model, owners, self.bcs))
            ]
            answer = FormAnswer(
                model, solution, owners, on_space, displacement, at_nodes, self.bcs, self._in_halves
            )
            messages = [*messages, *model.notes, *form_warnings(answer)]
            peaks = [None if coarse is None else coarse.peak for coarse in answer.coarse_pressures]
            certificate = replace(solution.certificate, warnings=tuple(messages))
            solution = replace(solution, certificate=certificate)
            none = np.zeros(owners.count)
            pressure = np.max([none, *(c.pressure for c in at_nodes)], axis=0)
            smoothed = np.max([none, *(c.smoothed for c in at_nodes)], axis=0)
            scalars, of_space = self._scalars
            fields: dict[str, Any] = {}

            def function(values: Array, name: str) -> None:
                space, at_nodes = self._space, on_space.values(values)
                if values.ndim == 1:
                    space, at_nodes = scalars, at_nodes[of_space]
                if name not in self._functions:
                    self._functions[name] = fem.Function(space, name=name)
                fields[name] = self._functions[name]
                fields[name].x.array[:] = at_nodes.ravel()

            function(pressure, "contact_pressure")
            function(smoothed, "smoothed_contact_pressure")
            function(nearest_gap(at_nodes, owners.count), "gap")
            if any(contact.friction for contact in model.contacts):
                traction, slip, status = friction_fields(at_nodes, owners.count, d)
                function(traction, "friction_traction")
                function(slip, "slip")
                function(status.astype(float), "contact_status")
            records = (
                contact_records(model, owners, at_nodes, peaks),
                reaction_records(model, solution, owners, self.bcs),
            )
        summary = summary_of(model, solution, displacement, records, timings, self._pressed)
        return _Answer(solution, fields, summary)

    @cached_property
    def _scalars(self) -> tuple[Any, Ints]:
        """The space of one component, and the node of the forms' space of each of its nodes."""
        space, unknowns = self._space.sub(0).collapse()
        return space, np.asarray(unknowns) // self._space.dofmap.index_map_bs

    @property
    def _solved(self) -> _Answer:
        if self._answer is None:
            raise RuntimeError("there is no answer yet: call solve() first")
        return self._answer

    @property
    def certificate(self) -> Certificate:
        """The certificate.

        Relative errors of the answer; `passed` tells whether all meet the tolerance.
        """
        return self._solved.solution.certificate

    @property
    def converged(self) -> bool:
        """Whether every number of the certificate is below the tolerance."""
        return self._solved.solution.converged

    @property
    def contact_pressure(self) -> Any:
        """Function of the pressure (force per area) on the side of `tag`, 0 away from contact."""
        return self._solved.fields["contact_pressure"]

    @property
    def smoothed_contact_pressure(self) -> Any:
        """Function of the pressure without what straight facets make of it, as a scene has it."""
        return self._solved.fields["smoothed_contact_pressure"]

    @property
    def gap(self) -> Any:
        """Function of the remaining distance (length) at contact nodes, NaN at others."""
        return self._solved.fields["gap"]

    @property
    def friction_traction(self) -> Any:
        """Vector Function of the friction force per area on the side of `tag`.

        None if no contact has friction; also `slip` and `contact_status`.
        """
        return self._solved.fields.get("friction_traction")

    @property
    def slip(self) -> Any:
        """Vector Function of what the side of `tag` moves along what it touches."""
        return self._solved.fields.get("slip")

    @property
    def contact_status(self) -> Any:
        """Function that is 0 where a node is open, 1 where it sticks, 2 where it slides."""
        return self._solved.fields.get("contact_status")

    @property
    def summary(self) -> dict[str, Any]:
        """Summary with the keys of `summary.json`.

        Mesh, solver, solution, contacts, certificate.
        """
        return self._solved.summary


def _is_final(solution: Solution) -> bool:
    """Whether no other method is to be tried."""
    return solution.converged or solution.reason in (Reason.STOPPED, Reason.MAX_ITERATIONS)


def _no_answer(error: Exception) -> CouldNotRunError:
    return CouldNotRunError(
        f"the solver found no answer: {failure_text(error)} The form must be elliptic, with no "
        "motions of zero energy but rigid ones, and bodies must hang together through facets"
    )
