"""The models of load cases or of a load history, which share all that is independent of loads.

All cases, and all increments of a history, have the meshes, the subdomains, the rows and the
factors of one model. A node gets a contact row if any of the cases, or of the ends of steps, may
need it. A later case begins with a combination of the multipliers of the two earlier cases whose
loads are nearest. With d = B K⁺ f - c, the gaps that the loads of a case open without forces of
constraints, it is the combination of least ‖d - Σ a_k d_k‖. While contact does not change, the
multipliers depend linearly on d.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.estimate.stress_recovery import Patches
from contact_app.errors import NoEquilibriumError
from contact_app.machine.timings import Timings
from contact_app.model.candidates import Needed
from contact_app.model.method import is_undecomposed
from contact_app.model.model import Model, build_model, model_of_case, model_of_outline
from contact_app.model.outline import Outline, Report, outline_of_case, outline_of_scene
from contact_app.run.step_equilibrium import leaving_in_step
from contact_app.scene.scene import Scene
from meshes.arrays import Array
from solver.backend import SharedPlace
from solver.contact.solution import Guess, Solution
from solver.problem.constraints.matrix import ConstraintMatrix
from solver.tfeti.dual import DualProblem

FAR = 0.7
"""‖d - Σ a_k d_k‖ over ‖d‖ above which no earlier case is used as initial guess."""

UNCHANGED = 1e-9
"""Change of d over d up to which a loading begins with the multipliers of the last one.

Slips that the last increment ended with do not count: where no load changes, its forces remain.
"""

LONGEST = 2.0
"""Change of loads over the last change up to which answers are extrapolated."""

PARALLEL = 1e-6
"""Square of the sine of the angle between changes of loads that count as parallel."""

LARGEST = 3.0
"""Largest factor of a case in a combination: larger ones extrapolate too far."""


def outlines_of_cases(
    scene: Scene, comm: MPI.Intracomm, timings: Timings | None = None
) -> dict[str, Outline | None]:
    """The outline of each loading of a scene, with the contact rows that any loading needs.

    None for a loading whose displacements change which rows are redundant, never for the first one.
    Collective.

    Raises
    ------
    NoEquilibriumError
        A loading has no equilibrium; the message names the case, or the step and the factor within
        it at which a body leaves.
    """
    outlines: dict[str, Outline | None] = {}
    first: Outline | None = None
    for number, case in enumerate(scene.loadings):
        loaded = scene.under(case)
        try:
            if first is None:
                first = outlines[case.name] = outline_of_scene(loaded, comm, timings, "distinct")
            else:
                outlines[case.name] = outline_of_case(first, loaded, timings)
        except NoEquilibriumError as error:
            if scene.steps:
                raise leaving_in_step(scene, number, comm, first, error) from error
            raise NoEquilibriumError(f"case {case.name}: {error}") from error
    needed = np.any(
        [outline.needed for outline in outlines.values() if outline is not None], axis=0
    )
    return {name: outline and replace(outline, needed=needed) for name, outline in outlines.items()}


@dataclass(frozen=True, eq=False)
class _Earlier:
    """A solved loading."""

    B: ConstraintMatrix
    """Constraints of its model."""
    effect: Array  # (any,)
    """`DualProblem.effect_of_loads`."""
    multiplier: Array
    c: Array
    """Right-hand sides c of the rows. Shapes (dual,), (dual,)."""


class CaseModels:
    """Makes the models of a scene's loadings; all methods are collective.

    Parameters
    ----------
    scene
        With its cases or steps.
    outlines
        Outlines of `outlines_of_cases`, or outlines with fewer contact rows.
    """

    keeps_subdomains = False

    def __init__(
        self,
        scene: Scene,
        comm: MPI.Intracomm,
        outlines: Mapping[str, Outline | None] | None = None,
    ) -> None:
        self._scene, self._comm = scene, comm
        self._outlines = dict(outlines or {})
        self._model: Model | None = None
        self._patches: Patches | None = None
        self._earlier: list[_Earlier] = []
        self._place = SharedPlace()

    def model(self, scene: Scene, timings: Timings, needed: Needed, report: Report | None) -> Model:
        """The model of the scene of a loading; parameters as in `build_model`.

        A loading gets a model of its own if it has other subdomains or rigid bodies (whose
        placements differ), or if other rows are redundant.
        """
        with timings.measure("setup"):
            if not self._outlines:
                self._outlines = outlines_of_cases(self._scene, self._comm, timings)
            outline = self._outline(scene, timings)
        others = scene.decomposition != self._scene.decomposition
        others |= is_undecomposed(scene.solver) != is_undecomposed(self._scene.solver)
        if outline is None or scene.rigid.bodies or others:
            model = build_model(scene, self._comm, timings, needed, report)
        else:
            with timings.measure("setup"):
                model = self._shared(scene, outline, timings, needed, report)
        if model.problem.factored:
            return model
        return replace(model, problem=replace(model.problem, place=self._place))

    def _outline(self, scene: Scene, timings: Timings) -> Outline | None:
        """The outline of a loading; within a step, with the rows that the steps need."""
        if scene.case in self._outlines:
            return self._outlines[scene.case]
        first = next(outline for outline in self._outlines.values() if outline is not None)
        outline = outline_of_case(first, scene, timings)
        return outline and replace(outline, needed=first.needed)

    def _shared(
        self,
        scene: Scene,
        outline: Outline,
        timings: Timings,
        needed: Needed,
        report: Report | None,
    ) -> Model:
        """The model of a case with the factors of other cases, or with new ones for more rows."""
        rows = outline.needed.copy()
        if not isinstance(needed, str):
            rows |= needed
        elif needed == "all":
            rows[:] = True
        if self._model is not None:
            more = bool((rows & ~self._model.needed).any())
            if not self._comm.allreduce(int(more)):
                return model_of_case(
                    self._model, replace(outline, needed=self._model.needed), scene
                )
            rows |= self._model.needed
        outline = replace(outline, needed=rows)
        if report is not None:
            report(self._scene, outline)
        self._patches = None
        self._model = model_of_outline(scene, outline, timings)
        return self._model

    def estimator(self, model: Model) -> ErrorEstimator:
        """The estimator of errors of answers to a model."""
        if self._model is None or model.elements is not self._model.elements:
            return ErrorEstimator(model)
        if self._patches is None:
            self._patches = Patches.of(self._model)
        return ErrorEstimator(model, self._patches)

    def add(self, problem: DualProblem, solution: Solution) -> None:
        """Store the answer of a case as initial guess for later ones."""
        self._earlier.append(
            _Earlier(problem.B, problem.effect_of_loads, solution.multiplier, problem.c)
        )

    def is_near_last(self, problem: DualProblem) -> bool:
        """Whether the loads are near those of the last answer, by `FAR` (collective)."""
        if not self._earlier or self._earlier[-1].B is not problem.B:
            return False
        effect, last = problem.effect_of_loads, self._earlier[-1].effect
        vectors = effect - last, effect, last
        change, *squares = self._comm.allreduce(np.array([v @ v for v in vectors]))
        return bool(change <= FAR**2 * max(squares))

    def change_of_loads(self, problem: DualProblem) -> float | None:
        """Change of the loads since the last answer, over the change before (collective).

        None if it is not along that change.
        """
        earlier = self._earlier[-2:]
        if len(earlier) < 2 or any(e.B is not problem.B for e in earlier):
            return None
        before, change = earlier[1].effect - earlier[0].effect, problem.effect_of_loads
        change = change - earlier[1].effect
        vectors = np.array([before, change])
        (old, inner), (_, new) = self._comm.allreduce(vectors @ vectors.T)
        if not inner > 0.0 or inner**2 < (1.0 - PARALLEL) * old * new or inner > LONGEST * old:
            return None
        return float(inner / old)

    def on(self, model: Model) -> Guess | None:
        """Initial multipliers; None if no earlier case is near (collective)."""
        comparable = [e for e in self._earlier if e.B is model.problem.B]
        if not comparable:
            return None
        problem, last, effect = model.problem, comparable[-1], model.problem.effect_of_loads
        change = effect - last.effect
        if problem.factored:  # d has the slips before: those of the last loading do not count
            change = change + np.where(problem.tangential, problem.c - last.c, 0.0)
        changed, square = self._comm.allreduce(np.array([change @ change, effect @ effect]))
        if changed <= UNCHANGED**2 * square:
            return Guess(last.multiplier)
        vectors = np.array([e.effect for e in comparable] + [effect])
        shares = nearest_combination(self._comm.allreduce(vectors @ vectors.T))
        if shares is None:
            return None
        return Guess(shares @ np.array([e.multiplier for e in comparable]))


def nearest_combination(products: Array) -> Array | None:
    """Factors a_k of the two earlier cases nearest to the last vector d, of least ‖d - Σ a_k d_k‖.

    The nearest case alone has a factor if one of the two would be too large.

    Parameters
    ----------
    products : (cases + 1, cases + 1)
        Inner products of the vectors d_1, …, d.

    Returns
    -------
    (cases,) or None where no earlier case is near.
    """
    inner, with_new, square = products[:-1, :-1], products[:-1, -1], products[-1, -1]
    order = np.argsort(square - 2.0 * with_new + np.diag(inner), kind="stable")
    for nearest in (order[:2], order[:1]):
        of_nearest = inner[np.ix_(nearest, nearest)]
        factors = np.linalg.lstsq(of_nearest, with_new[nearest], rcond=1e-10)[0]
        near = square - factors @ with_new[nearest] <= FAR**2 * square
        if near and factors.sum() > 0.0 and np.abs(factors).max() <= LARGEST:
            result = np.zeros(len(with_new))
            result[nearest] = factors
            return result
    return None
