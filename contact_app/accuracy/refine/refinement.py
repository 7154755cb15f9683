"""Accuracy as the input: meshes are refined until the estimated error is small enough.

All boxes are refined alike. The error falls as a power of the cell size, e ~ s^-p with s cells for
one of the start; p is the best that cells of the degree attain at first, and then what the last
two levels showed. The next mesh is the one on which that law meets the target, but at most twice
as fine as the last, so that a rate seen on coarse meshes is not trusted far. Boundaries given by
an expression pick nodes, and only meshes whose cells are whole multiples of the start's have the
same: where a scene uses one, only those are taken.

Where the file names no degree, meshes after the first are of degree 2: smooth answers converge
faster, singular ones have less error on as many nodes, graded cells far less
(docs/guide/accuracy.md).

Where the layers of cells of degree 2 have shares of the error that are far from even, or two levels
show that a singularity holds the rate down, equal cells are given up: from then on the grid lines
of each box are laid by the error of the last mesh (`grading`), and the error falls at the rate of
smooth answers again. New lines alone, no more of them, take off part of what they could at best,
since each set shows better where the error is: how much is foreseen from what the last ones did.
Only what is missing beyond that makes a mesh larger, and by no more cells than are missing: axes
need not have equally many. Coordinates of the start stay grid lines where a scene picks nodes by an
expression.

Where energies of the levels tell by what the estimate exceeds the error, it is lowered
(`calibration`).

Where a body comes from a file, the cells that carry the error are refined
(`local_refinement`), and the degree stays.

Each level is solved to a tenth of its own error and begins with the answer of the last
(`warm_start`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from mpi4py import MPI

from contact_app.accuracy.agreement import Measured, Verdict
from contact_app.accuracy.contact_limits import UNFELT, coarse_contact, slipped_through
from contact_app.accuracy.faceted_curves import polygon_solved
from contact_app.accuracy.judge import Judge, coarser, measured
from contact_app.accuracy.refine.grading import evenness, layer_errors
from contact_app.accuracy.refine.levels import Level, Refined, comparable, level_of
from contact_app.accuracy.refine.local_refinement import locally_refined
from contact_app.accuracy.refine.next_mesh import (
    PROMISE,
    Grids,
    equal_lines,
    graded_step,
    has_even_cells,
    has_free_degree,
    kept,
    layers_for_one,
    needs_multiples,
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
from contact_app.results.friction import dissipated_work
from contact_app.scene.bodies import Box
from contact_app.scene.scene import Scene
from solver import Reason

MARGIN = 0.97
"""Share of the target that meshes are predicted to reach, and that an estimate, which may be a
little below the error, has to."""

CONFIRMING = 1.5
"""Factor by which the next mesh lowers an error that is below the target but not confirmed yet."""

SINGULAR = {1: 0.75, 2: 1.1}
"""Rates by degree below which cells are graded."""

UNEVEN = 0.7
"""Least error of the best grid lines over that of equal ones, from which on those of degree 2 are
kept."""

SURE = 0.5
"""Evenness below which new grid lines are relied on, however large the mesh."""

LARGE = 10_000
"""Nodes from which on a level that new grid lines alone might save costs more than it saves."""


@dataclass(frozen=True)
class Limits:
    """Where a refinement ends although its target is not met.

    Attributes
    ----------
    levels
        Meshes that are solved.
    memory
        Bytes a rank may take; what the machine has left unless given.
    """

    levels: int = 12
    memory: float | None = None


NO_STRAINS = "the bodies are not strained beyond rounding errors: a relative error does not exist"


class Solve(Protocol):
    """Solves a scene."""

    def __call__(self, scene: Scene, /, *, start: LastLevel | None) -> SolvedScene:
        """Begin with the answer on another mesh where there is one."""


def solve_to_accuracy(
    scene: Scene,
    solve: Solve,
    tell: Callable[[str], None] = lambda text: None,
    limits: Limits | None = None,
) -> Refined:
    """Refine a scene until its error is below `scene.accuracy` (collective).

    That is the estimated total error, or its guaranteed bound where the scene asks for one.

    Parameters
    ----------
    solve
        Solves one level, beginning with the answer of the last.
    tell
        Called with a sentence on each level.
    """
    assert scene.accuracy is not None
    limits = limits or Limits()
    levels = _Levels(scene, scene.accuracy, solve, tell, limits.levels)
    current, start = scene, None
    finished: SolvedScene | None = None
    while True:
        solved = solve(current, start=start)
        if finished is not None and _interrupted(solved):
            return levels.refined(finished, levels.interrupted())
        heard = levels.hear(current, solved)
        missed = levels.ended(heard)
        if missed is not None:
            return levels.refined(heard.solved, missed)
        following = levels.following(current, heard)
        missed = _no_room(following, heard, limits.memory)
        if missed:
            return levels.refined(heard.solved, missed)
        current, start = following, LastLevel.of(heard.solved)
        finished = heard.solved.without_factors()
        del solved, heard  # its factors make room for the next


def _interrupted(solved: SolvedScene) -> bool:
    """Whether an answer is what a stopped solve had reached."""
    solution = solved.solution
    return solution.reason is Reason.STOPPED and not solution.converged


@dataclass(frozen=True, eq=False)
class _Heard:
    """A level, with what the others say of it.

    Attributes
    ----------
    solved
        Its answer, with the corrected estimate.
    sure
        Whether its error is below the target, and that is confirmed.
    doubt, why
        That and why it is not, where it is below.
    """

    solved: SolvedScene
    sure: bool
    doubt: str
    why: str


class _Levels:
    """The levels of a run to an accuracy so far, and where the next one comes from.

    Attributes
    ----------
    levels, checks
        Levels in their order, and coarser meshes that were solved to confirm one.
    factors
        How fine the levels of one degree were, in units of the scene's own mesh.
    """

    def __init__(
        self, scene: Scene, accuracy: float, solve: Solve, tell: Callable[[str], None], most: int
    ) -> None:
        self._most = most
        self.levels: list[Level] = []
        self.checks: list[Level] = []
        self.factors = [1.0]
        self._scene, self._solve, self._tell = scene, solve, tell
        self._files = not all(isinstance(body.mesh, Box) for body in scene.bodies)
        self._whole = needs_multiples(scene)
        self._target = MARGIN * accuracy
        self._enough = accuracy if scene.guaranteed else self._target
        self._judge = Judge(scene)
        self._last, self._doubts = 1.0, 0
        self._grids: Grids | None = None
        self._even, self._step, self._promise = 1.0, 1.0, PROMISE

    def refined(self, solved: SolvedScene, missed: str) -> Refined:
        """The product of the run, as it ends."""
        return Refined(solved, (*self.checks, *self.levels), missed)

    def interrupted(self) -> str:
        """That a level after the last finished one was given up."""
        done = len(self.levels)
        return (
            f"the run was interrupted in level {done + 1}; what is written is level {done}, the "
            "last that was finished"
        )

    # ------------------------------------------------------------------ what a level is worth

    def hear(self, current: Scene, solved: SolvedScene) -> _Heard:
        """Correct the estimate of a level by the others, and see whether it is believed."""
        estimate = solved.accuracy
        share, verdict = self._judge.hear(
            _measured(solved), estimate.discretisation, self._grids is not None
        )
        unseen = slipped_through(solved.model, solved.solution, UNFELT)
        if unseen:  # what no mesh so coarse shows no two can agree on
            verdict = Verdict(1.0, unseen[0])
            self._judge.forget()
        solved = replace(solved, accuracy=estimate.calibrated(share))
        self.levels.append(level_of(solved, math.sqrt(share)))
        self._tell(f"level {len(self.levels)}: {self.levels[-1]}")
        crossed = _crossed(solved)
        error = self.levels[-1].error
        if not unseen and math.hypot(error, crossed) > self._enough >= error:
            unseen = [f"contact on a few facets may add {100 * crossed:.2g} %"]
            verdict = Verdict(1.0, unseen[0])
        ended = not solved.solution.converged or solved.solution.reason is Reason.STOPPED
        if error <= self._enough and not (ended or unseen or self._sure(verdict)):
            checked = _solved_coarser(coarser(current, self._whole), self._solve)
            if checked is not None:
                verdict = self._judge.compare_with(_measured(checked))
                self.checks.append(level_of(checked, 1.0))
                self._tell(f"a mesh of half the cells was solved to confirm it: {self.checks[-1]}")
                if verdict.raised > 1.0:
                    solved = replace(solved, accuracy=estimate.calibrated(verdict.raised))
                    self.levels[-1] = level_of(solved, math.sqrt(verdict.raised))
        below = self.levels[-1].error <= self._enough
        doubt = unconfirmed(self.levels[-1].error, verdict) if below else ""
        return _Heard(solved, below and self._sure(verdict), doubt, verdict.doubt)

    def _sure(self, verdict: Verdict) -> bool:
        """Whether the last level's error is a bound, or is confirmed."""
        return self._scene.guaranteed or verdict.confirms(self.levels[-1].error, self._enough)

    def ended(self, heard: _Heard) -> str | None:
        """Why the run ends with this level: empty where its target is met, None to go on."""
        solution = heard.solved.solution
        if math.isnan(self.levels[-1].error):
            return NO_STRAINS
        if solution.reason is Reason.STOPPED:
            return "the run was interrupted"
        if heard.sure:
            return ""
        if not solution.converged:
            return "the solver did not reach its tolerance"
        if self._files and len(self.levels) > 1:
            solved = heard.solved
            polygon = polygon_solved(solved.model, solution, solved.nodes)
            if polygon:
                return polygon
        if len(self.levels) >= self._most:
            return heard.doubt or f"{self._most} levels were not enough"
        self._doubts = self._doubts + 1 if heard.doubt else 0
        if self._doubts > 1 and self.levels[-1].dofs > LARGE * self._scene.dimension:
            return heard.doubt
        if heard.doubt:
            self._tell(f"one more level: {heard.why}")
        return None

    # ------------------------------------------------------------------ the next level

    def following(self, current: Scene, heard: _Heard) -> Scene:
        """The scene on the next mesh (collective)."""
        level, doubt = self.levels[-1], heard.doubt
        aim = level.error / CONFIRMING if doubt else self._target
        if self._files:
            factor, scene = self._last, locally_refined(current, heard.solved, aim / level.error)
        elif self._degree(current) == 1 and has_free_degree(self._scene):
            self._scene = quadratic(self._scene)
            self._tell("cells of degree 2 from here on")
            finest = self._whole or bool(doubt) or not has_even_cells(current)
            factor = self._last if finest else 0.5 * self._last
            self.factors, scene = [], refined(self._scene, factor)
        else:
            factor, scene = self._finer_box(current, heard.solved, aim)
        self.factors.append(factor)
        self._last = factor
        return scene

    @staticmethod
    def _degree(scene: Scene) -> int:
        """The lowest of its bodies."""
        return min(body.degree for body in scene.bodies)

    def _finer_box(self, current: Scene, solved: SolvedScene, aim: float) -> tuple[float, Scene]:
        """More cells of boxes, equal ones or graded by the error; the factor and the scene."""
        degree, scene = self._degree(current), self._scene
        factors = self.factors
        errors = comparable(self.levels[-len(factors) :]) if factors else []
        lines = equal_lines(current) if self._grids is None else self._grids
        squares = layer_errors(solved, lines)
        slow = len(factors) > 1 and rate_of(factors, errors, degree) < SINGULAR[degree]
        if self._grids is None and (slow or degree == 2 and evenness(squares) < UNEVEN):
            self._tell("the error is in few places: cells are graded from here on")
            self._grids, self._last = lines, layers_for_one(lines, equal_lines(scene))
        if self._grids is None:
            factor = next_factor(factors, errors, aim, self._whole, degree)
            return factor, refined(scene, factor)
        return self._graded_box(solved, squares, aim, degree)

    def _graded_box(
        self, solved: SolvedScene, squares: Grids, aim: float, degree: int
    ) -> tuple[float, Scene]:
        """Grid lines laid anew by the errors of layers."""
        assert self._grids is not None
        scene, level = self._scene, self.levels[-1]
        if self._even < 1.0:
            before, after = (each.estimate for each in self.levels[-2:])
            self._promise = kept(before, self._even, self._step, after, degree)
        self._even = evenness(squares)
        if self._even > SURE and level.dofs > LARGE * scene.dimension:
            self._even = 1.0
        step = graded_step(level.error, self._even**self._promise, aim, degree)
        factor, self._grids = regraded(scene, squares, self._grids, self._last * step)
        self._step = factor / self._last
        return factor, on_lines(scene, self._grids, solved.model.comm.size)


def _no_room(following: Scene, heard: _Heard, memory: float | None) -> str:
    """That the next mesh needs more memory than there is, if so (collective)."""
    dofs = sum(body.nodes for body in following.bodies) * following.dimension
    needed = needed_bytes(dofs)
    available = heard.solved.model.comm.allreduce(memory or available_bytes(), op=MPI.MIN)
    if needed <= available:
        return ""
    missed = (
        f"the next mesh has {dofs:,} degrees of freedom, which need about "
        f"{needed / 1e9:.3g} GB; {available / 1e9:.3g} GB are available"
    )
    return f"{heard.doubt}; {missed}" if heard.doubt else missed


def unconfirmed(error: float, verdict: Verdict) -> str:
    """Why a level whose estimate is below the target is not enough."""
    return f"its error is estimated at {100 * error:.2g} %, but {verdict.doubt}"


def _measured(solved: SolvedScene) -> Measured:
    """The estimated error of an answer before any correction (collective).

    With friction of given limits an answer minimises J(u) + Σ s |w|: the work of friction counts.
    """
    energy, scene = solved.solution.measures.energy, solved.model.scene
    if scene.has_friction:
        energy += dissipated_work(solved.model.problem, solved.solution)
    return measured(solved.accuracy, energy, scene)


def _crossed(solved: SolvedScene) -> float:
    """Relative error in energy norm that coarse contact with obstacles adds."""
    square = coarse_contact(solved.model, solved.solution, solved.nodes)
    return math.sqrt(square / solved.accuracy.square) if square > 0.0 else 0.0


def _solved_coarser(scene: Scene | None, solve: Solve) -> SolvedScene | None:
    """The answer on a coarser mesh; None where it has none."""
    if scene is None:
        return None
    try:
        solved = solve(scene, start=None)
    except ContactError:  # a boundary without a facet, say
        return None
    return solved if solved.solution.converged else None
