"""Accuracy as the input: meshes are refined until the estimated error is small enough.

All boxes are refined alike. The error falls as a power of the cell size, e ~ s^-p, where the first
mesh is refined by the factor s along each edge. The rate p is at first the best rate of the degree,
and then the rate between the last two levels. The next mesh is the one on which this law meets the
target. It is at most twice as fine as the last one, since a rate observed on coarse meshes is
uncertain. Boundaries given by an expression select nodes, and only refinement by whole numbers
preserves these nodes: a scene with such a boundary is refined by whole numbers only.

If the file names no degree, meshes after the first have degree 2: smooth solutions converge faster,
singular ones have a smaller error for the same number of nodes, and a far smaller one on graded
cells (docs/benchmarks/accuracy.md).

Cells are graded if the layers of cells of degree 2 have very unequal errors, or if two levels show
that a singularity reduces the rate. From then on the grid lines of each box are placed by the error
of the last mesh (`grading`), and the error falls at the rate of smooth solutions again. New grid
lines without more layers reach only part of the best possible gain, since each mesh shows better
where the error is. The gain is predicted from that of the last grid lines, and the mesh gets more
cells only for the rest; the number of cells may differ between axes. If a scene selects nodes by an
expression, coordinates of the first mesh stay grid lines.

If energies of the levels show that the estimate exceeds the error, it is lowered
(`calibration`).

In a body from a file the cells with a large share of the error are refined (`local_refinement`),
and the degree stays.

Each level is solved to a tenth of its own error and begins with the contact of the last one
(`warm_start`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from mpi4py import MPI

from contact_app.accuracy.agreement import Measured, Verdict
from contact_app.accuracy.contact_limits import LIMITS, coarse_contact, slipped_through
from contact_app.accuracy.faceted_curves import polygon_solved
from contact_app.accuracy.judge import Judge, coarser, lowest_degree, measured
from contact_app.accuracy.refine.grading import evenness, layer_errors
from contact_app.accuracy.refine.levels import Level, Refined, comparable, level_of
from contact_app.accuracy.refine.local_refinement import locally_refined
from contact_app.accuracy.refine.next_mesh import (
    STEPS,
    Grids,
    equal_lines,
    evenness_exponent,
    graded_step,
    has_even_cells,
    has_free_degree,
    layers_for_one,
    next_factor,
    on_lines,
    quadratic,
    rate_of,
    refined,
    regraded,
)
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ContactError
from contact_app.machine.memory import available_bytes, needed_bytes
from contact_app.results.friction import friction_potential
from contact_app.results.percent import percent
from contact_app.scene.bodies import Body, Box
from contact_app.scene.scene import Decomposition, Scene
from solver import Reason

MARGIN = 0.97
"""Meshes are chosen to reach this share of the target, and estimates have to reach it, since an
estimate may be a little below the error."""

CONFIRMING = 1.5
"""Factor by which the next mesh lowers an error that is below the target but not confirmed yet."""

SINGULAR = {1: 0.75, 2: 1.1}
"""Rates by degree below which cells are graded."""

UNEVEN = 0.7
"""Predicted error of the best grid lines relative to the present ones; equal cells of degree 2 are
kept if it is larger."""

SURE = 0.5
"""Evenness below which a mesh of any size is solved again with new grid lines alone."""

LARGE = 10_000
"""Number of nodes from which on a level with new grid lines alone costs more than it saves."""


@dataclass(frozen=True)
class Limits:
    """Limits at which a refinement ends although its target is not met."""

    levels: int = 12
    """Largest number of meshes."""
    memory: float | None = None
    """Bytes that a rank may use; the available memory of the machine unless given."""


NO_STRAINS = "the bodies are not strained beyond rounding errors: a relative error does not exist"


class Solve(Protocol):
    """Function that solves a scene."""

    def __call__(self, scene: Scene, /, *, start: LastLevel | None) -> SolvedScene:
        """Solve, beginning with the solution on another mesh if there is one."""


def solve_to_accuracy(
    scene: Scene,
    solve: Solve,
    report: Callable[[str], None] = lambda text: None,
    limits: Limits | None = None,
    stop: Callable[[], bool] | None = None,
) -> Refined:
    """Refine a scene until its error is below `scene.accuracy` (collective).

    That is the estimated total error, or its guaranteed bound where the scene requests one.

    Parameters
    ----------
    solve
        Solves one level, beginning with the solution of the last one.
    report
        Called with a sentence on each level.
    stop
        Whether the user has interrupted the run, the same on all ranks; called after each level,
        since the model of the next one may take minutes before its solve sees it.
    """
    assert scene.accuracy is not None
    limits = limits or Limits()
    levels = _Levels(scene, scene.accuracy, solve, report, limits.levels)
    current, start = scene, None
    finished: SolvedScene | None = None
    while True:
        solved = solve(current, start=start)
        if finished is not None and solved.interrupted:
            return levels.refined(finished, levels.interrupted())
        assessed = levels.assess(current, solved)
        missed = levels.ended(assessed)
        if missed is not None:
            return levels.refined(assessed.solved, missed)
        if stop is not None and stop():
            return levels.refined(assessed.solved, "the run was interrupted")
        following = levels.following(current, assessed)
        missed = _no_room(following.unknowns, assessed, limits.memory)
        if missed:
            return levels.refined(assessed.solved, missed)
        current, start = following, LastLevel.of(assessed.solved)
        finished = assessed.solved.without_factors()
        del solved, assessed  # free the memory of its factors for the next level


@dataclass(frozen=True, eq=False)
class _AssessedLevel:
    """A level with its verdict."""

    solved: SolvedScene
    """Its solution with the corrected estimate."""
    confirmed: bool
    """Whether its error is below the target and another mesh confirms this."""
    doubt: str
    why: str
    """The reason why an error below the target is not confirmed, as a sentence and as a clause."""


class _Levels:
    """The levels of a run to an accuracy so far, and the choice of the next one.

    Attributes
    ----------
    levels, checks
        Levels in their order, and coarser meshes that were solved to confirm one.
    factors
        Refinement factors of the levels of one degree, relative to the scene's own mesh.
    """

    def __init__(
        self, scene: Scene, accuracy: float, solve: Solve, report: Callable[[str], None], most: int
    ) -> None:
        self._most = most
        self.levels: list[Level] = []
        self.checks: list[Level] = []
        self.factors = [1.0]
        self._scene, self._solve, self._report = scene, solve, report
        self._files = not all(isinstance(body.mesh, Box) for body in scene.bodies)
        self._integer = scene.names_expressions
        self._target = MARGIN * accuracy
        self._enough = accuracy if scene.guaranteed else self._target
        self._judge = Judge(scene)
        self._last, self._doubts = 1.0, 0
        self._grids: Grids | None = None
        self._even, self._step, self._exponent = 1.0, 1.0, STEPS.first_exponent

    def refined(self, solved: SolvedScene, missed: str) -> Refined:
        """The result at the end of the run."""
        return Refined(solved, (*self.checks, *self.levels), missed)

    def interrupted(self) -> str:
        """Message that the run was interrupted after the last finished level."""
        done = len(self.levels)
        return (
            f"the run was interrupted in level {done + 1}; the results are those of level {done}, "
            "the last that was finished"
        )

    # ------------------------------------------------------------------ verdict on a level

    def assess(self, current: Scene, solved: SolvedScene) -> _AssessedLevel:
        """Correct the estimate of a level by the others, and decide whether it is accepted."""
        estimate = solved.accuracy
        share, verdict = self._judge.assess(
            _measured(solved), estimate.discretisation, self._grids is not None
        )
        unseen = slipped_through(solved.model, solved.solution, LIMITS.unpressed_depth)
        if unseen:  # contact is not resolved: two such meshes cannot confirm an estimate
            verdict = Verdict(1.0, unseen[0])
            self._judge.forget()
        solved = replace(solved, accuracy=estimate.calibrated(share))
        self.levels.append(level_of(solved, math.sqrt(share)))
        self._report(f"level {len(self.levels)}: {self.levels[-1]}")
        crossed = _crossed(solved)
        error = self.levels[-1].error
        if not unseen and math.hypot(error, crossed) > self._enough >= error:
            unseen = [f"contact on a few facets may add {percent(crossed)}"]
            verdict = Verdict(1.0, unseen[0])
        ended = not solved.solution.converged or solved.solution.reason is Reason.STOPPED
        if error <= self._enough and not (ended or unseen or self._is_confirmed(verdict)):
            checked = _solved_coarser(current, self._integer, self._solve)
            if checked is not None:
                verdict = self._judge.compare_with(_measured(checked))
                self.checks.append(level_of(checked, 1.0))
                self._report(
                    f"a mesh of half the cells was solved to confirm it: {self.checks[-1]}"
                )
                if verdict.raised > 1.0:
                    solved = replace(solved, accuracy=estimate.calibrated(verdict.raised))
                    self.levels[-1] = level_of(solved, math.sqrt(verdict.raised))
        below = self.levels[-1].error <= self._enough
        doubt = unconfirmed(self.levels[-1].error, verdict) if below else ""
        return _AssessedLevel(solved, below and self._is_confirmed(verdict), doubt, verdict.doubt)

    def _is_confirmed(self, verdict: Verdict) -> bool:
        """Whether the last level's error is a bound or is confirmed by another level."""
        return self._scene.guaranteed or verdict.confirms(self.levels[-1].error, self._enough)

    def ended(self, assessed: _AssessedLevel) -> str | None:
        """Why the run ends with this level: empty if the target is met, None to continue."""
        solution = assessed.solved.solution
        if math.isnan(self.levels[-1].error):
            return NO_STRAINS
        if solution.reason is Reason.STOPPED:
            return "the run was interrupted"
        if assessed.confirmed:
            return ""
        if not solution.converged:
            return "the solver did not reach its tolerance"
        if self._files and len(self.levels) > 1:
            solved = assessed.solved
            polygon = polygon_solved(solved.model.geometry, solution, solved.nodes)
            if polygon:
                return polygon
        if len(self.levels) >= self._most:
            return assessed.doubt or f"{self._most} levels were not enough"
        self._doubts = self._doubts + 1 if assessed.doubt else 0
        if self._doubts > 1 and self.levels[-1].dofs > LARGE * self._scene.dimension:
            return assessed.doubt
        if assessed.doubt:
            self._report(f"one more level: {assessed.why}")
        return None

    # ------------------------------------------------------------------ the next level

    def following(self, current: Scene, assessed: _AssessedLevel) -> Scene:
        """The scene on the next mesh (collective)."""
        level, doubt = self.levels[-1], assessed.doubt
        target = level.error / CONFIRMING if doubt else self._target
        if self._files:
            factor = self._last
            finer = locally_refined(current.bodies, assessed.solved, target / level.error)
            scene = replace(current, bodies=finer)
        elif lowest_degree(current.bodies) == 1 and has_free_degree(self._scene.bodies):
            bodies = quadratic(self._scene.bodies)
            self._scene = replace(self._scene, bodies=bodies)
            self._report("cells of degree 2 from here on")
            finest = self._integer or bool(doubt) or not has_even_cells(current.bodies)
            factor = self._last if finest else 0.5 * self._last
            self.factors, scene = [], replace(self._scene, bodies=refined(bodies, factor))
        else:
            factor, scene = self._finer_box(current.bodies, assessed.solved, target)
        self.factors.append(factor)
        self._last = factor
        return scene

    def _finer_box(
        self, bodies: Sequence[Body], solved: SolvedScene, target: float
    ) -> tuple[float, Scene]:
        """Refinement factor, and the scene with more cells in boxes, equal or graded."""
        degree, scene = lowest_degree(bodies), self._scene
        factors = self.factors
        errors = comparable(self.levels[-len(factors) :]) if factors else []
        lines = equal_lines(bodies) if self._grids is None else self._grids
        squares = layer_errors(solved, lines)
        slow = len(factors) > 1 and rate_of(factors, errors, degree) < SINGULAR[degree]
        if self._grids is None and (slow or degree == 2 and evenness(squares) < UNEVEN):
            self._report("the error is concentrated: cells are graded from here on")
            self._grids, self._last = lines, layers_for_one(lines, equal_lines(scene.bodies))
        if self._grids is None:
            factor = next_factor(factors, errors, target, self._integer, degree)
            return factor, replace(scene, bodies=refined(scene.bodies, factor))
        return self._graded_box(solved, squares, target, degree)

    def _graded_box(
        self, solved: SolvedScene, squares: Grids, target: float, degree: int
    ) -> tuple[float, Scene]:
        """The scene with new grid lines, placed by the errors of layers."""
        assert self._grids is not None
        scene, level = self._scene, self.levels[-1]
        if self._even < 1.0:
            before, after = (each.estimate for each in self.levels[-2:])
            self._exponent = evenness_exponent(before, self._even, self._step, after, degree)
        self._even = evenness(squares)
        if self._even > SURE and level.dofs > LARGE * scene.dimension:
            self._even = 1.0
        step = graded_step(level.error, self._even**self._exponent, target, degree)
        factor, self._grids = regraded(
            scene.bodies, squares, self._grids, self._last * step, self._integer
        )
        self._step = factor / self._last
        ranks = solved.model.comm.size
        bodies, parts = on_lines(scene.bodies, scene.decomposition, self._grids, ranks)
        return factor, replace(scene, bodies=bodies, decomposition=parts)


def _no_room(dofs: int, assessed: _AssessedLevel, memory: float | None) -> str:
    """Message that the next mesh, of so many unknowns, exceeds the memory; empty if it fits.

    Collective.
    """
    needed = needed_bytes(dofs)
    available = assessed.solved.model.comm.allreduce(memory or available_bytes(), op=MPI.MIN)
    if needed <= available:
        return ""
    missed = (
        f"the next mesh has {dofs:,} degrees of freedom, which need about "
        f"{needed / 1e9:.3g} GB; {available / 1e9:.3g} GB are available"
    )
    return f"{assessed.doubt}; {missed}" if assessed.doubt else missed


def unconfirmed(error: float, verdict: Verdict) -> str:
    """The reason why a level with an estimate below the target is not accepted."""
    return f"its error is estimated at {percent(error)}, but {verdict.doubt}"


def _measured(solved: SolvedScene) -> Measured:
    """The estimated error of an answer before any correction (collective).

    With Tresca friction the solution minimises J(u) + Σ s |w|, with the slips w.
    """
    energy, scene = solved.solution.measures.energy, solved.model.scene
    if scene.has_friction:
        energy += friction_potential(solved.model.problem, solved.solution)
    return measured(solved.accuracy, energy, scene.bodies)


def _crossed(solved: SolvedScene) -> float:
    """Relative error in energy norm that coarse contact with obstacles adds."""
    square = coarse_contact(solved.model, solved.solution, solved.nodes)
    return math.sqrt(square / solved.accuracy.square) if square > 0.0 else 0.0


def _solved_coarser(scene: Scene, even: bool, solve: Solve) -> SolvedScene | None:
    """The solution on a coarser mesh; None if there is no mesh (`coarser`) or no solution."""
    bodies = coarser(scene.bodies, even)
    if bodies is None:
        return None
    try:
        solved = solve(replace(scene, bodies=bodies, decomposition=Decomposition()), start=None)
    except ContactError:  # for instance a boundary without a facet
        return None
    return solved if solved.solution.converged else None
