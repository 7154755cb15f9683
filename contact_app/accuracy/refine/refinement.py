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
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.accuracy.agreement import Measured, Verdict
from contact_app.accuracy.contact_limits import UNFELT, coarse_contact, slipped_through
from contact_app.accuracy.faceted_curves import polygon_solved
from contact_app.accuracy.judge import Judge, coarser, measured
from contact_app.accuracy.refine.grading import axis_evenness, evenness, graded, layer_errors
from contact_app.accuracy.refine.local_refinement import locally_refined
from contact_app.accuracy.refine.warm_start import LastLevel
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ContactError
from contact_app.machine.memory import available_bytes, needed_bytes
from contact_app.results.friction import dissipated_work
from contact_app.scene.bodies import Box
from contact_app.scene.scene import Decomposition, Scene
from meshes.graded import graded_box
from solver import Reason

MARGIN = 0.97
"""Share of the target that meshes are predicted to reach, and that an estimate, which may be a
little below the error, has to."""

FARTHEST = 2.0
"""Largest step from one mesh to the next, in cells along an edge."""

SLOWEST, FASTEST = 0.4, {1: 1.0, 2: 1.5}
"""Rates that are believed, the fastest by degree."""

GRADED = {1: 1.0, 2: 2.0}
"""The fastest on graded cells."""

CONFIRMING = 1.5
"""What the next mesh takes off an error that is below the target but not believed yet."""

PATIENT = 1.5
"""Largest step between graded meshes of degree 2: their grid lines follow the error."""

WHOLE = {2: 500_000, 3: 80_000}
"""Nodes by dimension up to which graded bodies are not cut into subdomains."""

SINGULAR = {1: 0.75, 2: 1.1}
"""Rates by degree below which cells are graded."""

UNEVEN = 0.7
"""Least error of the best grid lines over that of equal ones, from which on those of degree 2 are
kept."""

SURE = 0.5
"""Evenness below which new grid lines are relied on, however large the mesh."""

LEAST = 1.04
"""Smallest step between graded meshes whose grid lines have settled."""

LARGE = 10_000
"""Nodes from which on a level that new grid lines alone might save costs more than it saves."""

SETTLED = 0.85
"""Error that new grid lines are expected to leave from which on they have."""

PROMISE, KEPT = 0.75, 0.3
"""Power of the evenness that new grid lines are expected to leave of the error: at first, and at
least from then on, when it is what the last ones left."""


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

Grids = list[list[NDArray[np.float64]]]


class Solve(Protocol):
    """Solves a scene."""

    def __call__(self, scene: Scene, /, *, start: LastLevel | None) -> SolvedScene:
        """Begin with the answer on another mesh where there is one."""


@dataclass(frozen=True)
class Level:
    """What one mesh gave and what it cost.

    Attributes
    ----------
    cells, dofs
        Size of the undecomposed mesh.
    discretisation, algebraic, total
        Relative errors in energy norm.
    hessian_multiplications, seconds
        The price: products, and wall-clock time from the scene to its summary.
    calibration
        What the energies of the levels so far made of the estimate: `discretisation` over it, below
        1 where they lowered it, above 1 where they raised it.
    warm
        Whether it began with the answer of the last.
    guaranteed
        Bound of the error, where one was asked for and found.
    """

    cells: int
    dofs: int
    discretisation: float
    algebraic: float
    total: float
    hessian_multiplications: int
    seconds: float
    calibration: float
    warm: bool = False
    guaranteed: float | None = None

    @property
    def error(self) -> float:
        """The error that is held against the target: the bound where there is one."""
        return self.total if self.guaranteed is None else self.guaranteed

    @property
    def estimate(self) -> float:
        """The estimate by stresses alone, before energies lowered it."""
        return self.discretisation / self.calibration

    def as_dict(self) -> dict[str, Any]:
        """As `summary.json` holds it: null where nothing can be said."""
        found = {key: value for key, value in asdict(self).items() if value is not None}
        return {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in found.items()
        }

    def __str__(self) -> str:
        corrected = ""
        if self.calibration != 1.0:
            how = "lowered" if self.calibration < 1.0 else "raised"
            corrected = f" (estimate {100 * self.estimate:.2g} %, {how})"
        return (
            f"{self.dofs:,} degrees of freedom: error {100 * self.error:.2g} %{corrected}, "
            f"{self.hessian_multiplications} Hessian multiplications, {self.seconds:.1f} s"
            f"{', begun with the last' if self.warm else ''}"
        )


@dataclass(frozen=True, eq=False)
class Refined:
    """The finest answer and the levels that led to it; `missed` says why it is not enough.

    Coarser meshes that were solved only to confirm an estimate come first.
    """

    solved: SolvedScene
    levels: tuple[Level, ...]
    missed: str = ""


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
        self.levels.append(_level(solved, math.sqrt(share)))
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
                self.checks.append(_level(checked, 1.0))
                self._tell(f"a mesh of half the cells was solved to confirm it: {self.checks[-1]}")
                if verdict.raised > 1.0:
                    solved = replace(solved, accuracy=estimate.calibrated(verdict.raised))
                    self.levels[-1] = _level(solved, math.sqrt(verdict.raised))
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
        elif self._degree(current) == 1 and _free_degree(self._scene):
            self._scene = quadratic(self._scene)
            self._tell("cells of degree 2 from here on")
            finest = self._whole or bool(doubt) or not _even(current)
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
            self._grids, self._last = lines, _layers_for_one(lines, equal_lines(scene))
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


def comparable(levels: Sequence[Level]) -> list[float]:
    """Errors of levels, all raised as the last one is: what two of them tell is a rate."""
    last = max(levels[-1].calibration, 1.0)
    return [level.error / max(level.calibration, 1.0) * last for level in levels]


def _measured(solved: SolvedScene) -> Measured:
    """What an answer says of its error, before any correction (collective).

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


def rate_of(factors: list[float], errors: list[float], degree: int = 1) -> float:
    """p of e ~ s^-p between the last two meshes, between 0.4 and the best, which it is of one."""
    fastest = FASTEST[degree]
    if len(factors) < 2:
        return fastest
    if errors[-1] >= errors[-2] or factors[-1] <= factors[-2]:
        return SLOWEST
    rate = math.log(errors[-2] / errors[-1]) / math.log(factors[-1] / factors[-2])
    return min(max(rate, SLOWEST), fastest)


def next_factor(
    factors: list[float],
    errors: list[float],
    target: float,
    whole: bool = False,
    degree: int = 1,
) -> float:
    """How many cells for one of the start the next mesh has along an edge.

    Parameters
    ----------
    factors, errors
        Of the meshes so far; the last error is above the target.
    whole
        Whether only whole numbers will do.
    degree
        Of the cells.

    Examples
    --------
    >>> round(next_factor([1.0, 2.0], [0.08, 0.04], 0.025), 3)
    3.2
    >>> next_factor([1.0], [0.5], 0.01)
    2.0
    """
    rate = rate_of(factors, errors, degree)
    step = (errors[-1] / target) ** (1.0 / rate)
    factor = factors[-1] * min(step, FARTHEST)
    return float(math.ceil(factor - 1e-9)) if whole else factor


def graded_step(error: float, left: float, target: float, degree: int) -> float:
    """How many layers for one of the last the next graded mesh has.

    Parameters
    ----------
    error
        Of the last, above the target.
    left
        Of the error by new grid lines alone, as far as foreseen.

    Examples
    --------
    >>> graded_step(0.19, 0.5, 0.1, 2), graded_step(0.19, 0.5, 0.01, 2)  # new lines will do
    (1.0, 1.5)
    >>> round(graded_step(0.02, 1.0, 0.01, 2), 3)
    1.414
    """
    step = (error * left / target) ** (1.0 / GRADED[degree])
    least = LEAST if left > SETTLED else 1.0
    return min(max(step, least), PATIENT if degree == 2 else FARTHEST)


def kept(before: float, even: float, step: float, after: float, degree: int) -> float:
    """Power of the evenness that new grid lines left of the error, beyond what more layers took.

    Examples
    --------
    >>> kept(0.2, 0.25, 1.0, 0.1, 2), kept(0.2, 0.25, 1.0, 0.05, 2), kept(0.2, 0.25, 1.0, 0.3, 2)
    (0.5, 1.0, 0.3)
    """
    left = max(after / before * step ** GRADED[degree], even)
    return max(math.log(left) / math.log(even), KEPT)


def _free_degree(scene: Scene) -> bool:
    """Whether the degree is left to the refinement."""
    averaged = any(body.mean_dilatation for body in scene.bodies)
    return not averaged and not any(body.degree_given for body in scene.bodies)


def quadratic(scene: Scene) -> Scene:
    """The scene with bodies of degree 2."""
    return replace(scene, bodies=tuple(replace(body, degree=2) for body in scene.bodies))


def _even(scene: Scene) -> bool:
    """Whether all boxes have an even number of cells along every edge: half of it has its nodes."""
    return all(
        n % 2 == 0 for body in scene.bodies if isinstance(body.mesh, Box) for n in body.mesh.cells
    )


def refined(scene: Scene, factor: float) -> Scene:
    """The scene with that many cells for one along every edge of its boxes."""
    bodies = []
    for body in scene.bodies:
        assert isinstance(body.mesh, Box)
        cells = tuple(math.ceil(factor * n - 1e-9) for n in body.mesh.cells)
        bodies.append(replace(body, mesh=replace(body.mesh, cells=cells)))
    return replace(scene, bodies=tuple(bodies))


def equal_lines(scene: Scene) -> Grids:
    """Grid coordinates of boxes of equal cells, by body and axis."""
    grids = []
    for body in scene.bodies:
        assert isinstance(body.mesh, Box)
        box = body.mesh
        corners = zip(box.lower, box.upper, box.cells, strict=True)
        grids.append([np.linspace(a, b, n + 1) for a, b, n in corners])
    return grids


def regraded(scene: Scene, squares: Grids, grids: Grids, factor: float) -> tuple[float, Grids]:
    """New grids with so many layers for one of the start, by the η² of the last ones' layers.

    As many cells as that makes, no more than whole layers ask for; how many layers for one they
    are is returned beside them.
    """
    starts = equal_lines(scene)
    whole = needs_multiples(scene)
    result, made = [], factor
    for body, lines, errors, start in zip(scene.bodies, grids, squares, starts, strict=True):
        cells = [len(line) - 1 for line in start]
        layers = whole_layers(factor, cells, [axis_evenness(part) for part in errors])
        made = max(made, (math.prod(layers) / math.prod(cells)) ** (1.0 / len(cells)))
        result.append(
            [
                graded(old, part, count, line if whole else line[[0, -1]], body.degree)
                for old, part, count, line in zip(lines, errors, layers, start, strict=True)
            ]
        )
    return made, result


def whole_layers(factor: float, cells: Sequence[int], even: Sequence[float]) -> list[int]:
    """Layers along each axis, so many for one of the start over all: the least even have more.

    Examples
    --------
    >>> whole_layers(1.05, [8, 8], [0.9, 0.8])  # 70.6 cells at least
    [8, 9]
    >>> whole_layers(1.1, [8, 8], [0.9, 0.8]), whole_layers(2.0, [3, 5], [1.0, 1.0])
    ([9, 9], [6, 10])
    """
    layers = [max(math.floor(factor * n + 1e-9), 1) for n in cells]
    wanted = factor ** len(cells) * math.prod(cells) * (1.0 - 1e-9)
    for axis in sorted(range(len(cells)), key=lambda a: round(even[a], 6)):
        if math.prod(layers) < wanted:
            layers[axis] = max(math.ceil(factor * cells[axis] - 1e-9), 1)
    return layers


def _layers_for_one(grids: Grids, starts: Grids) -> float:
    """How many layers for one of the start along an axis on the average, at most."""
    cells = ([math.prod(len(x) - 1 for x in axes) for axes in each] for each in (grids, starts))
    return max(
        (now / start) ** (1.0 / len(axes)) for now, start, axes in zip(*cells, grids, strict=True)
    )


def on_lines(scene: Scene, grids: Grids, ranks: int) -> Scene:
    """The scene with graded boxes; slivers cut at random converge slowly, so bodies stay whole."""
    bodies = tuple(
        replace(body, mesh=graded_box(body.mesh.cell, axes))
        for body, axes in zip(scene.bodies, grids, strict=True)
    )
    parts = scene.decomposition.subdomains
    if not isinstance(parts, int):
        nodes = sum(body.nodes for body in bodies)
        parts = len(bodies) if ranks == 1 and nodes <= WHOLE[scene.dimension] else None
    return replace(scene, bodies=bodies, decomposition=Decomposition(parts))


def with_levels(summary: dict[str, Any], refined: Refined) -> dict[str, Any]:
    """`summary.json` with the accuracy asked for and the price of each level."""
    target = refined.solved.model.scene.accuracy
    found = refined.solved.accuracy.as_dict()
    accuracy = {**summary["accuracy"], **found, "target": target, "met": not refined.missed}
    certificate = dict(summary["certificate"])
    if refined.missed:
        text = f"the accuracy {target:g} was not reached: {refined.missed}"
        certificate["warnings"] = [*certificate["warnings"], text]
    levels = [level.as_dict() for level in refined.levels]
    return {**summary, "certificate": certificate, "accuracy": accuracy, "levels": levels}


def needs_multiples(scene: Scene) -> bool:
    """Whether a condition or contact names a boundary that an expression picks."""
    named = {(c.body, c.boundary) for c in scene.displacements}
    named |= {(c.body, c.boundary) for c in scene.tractions}
    named |= {(c.body, c.boundary) for c in scene.pressures}
    named |= {(c.body, c.boundary) for c in scene.total_loads}
    named |= {(c.body, c.boundary) for c in scene.touching}
    named |= {(pair.other, pair.other_boundary) for pair in scene.pairs}
    return any(boundary in scene.bodies[body].boundaries for body, boundary in named)


def _level(solved: SolvedScene, calibration: float) -> Level:
    mesh, accuracy = solved.summary["mesh"], solved.accuracy
    return Level(
        cells=mesh["cells"],
        dofs=mesh["dofs"],
        discretisation=accuracy.discretisation,
        algebraic=accuracy.algebraic,
        total=accuracy.total,
        hessian_multiplications=solved.summary["solver"]["hessian_multiplications"],
        seconds=solved.summary["timings"]["total"],
        calibration=calibration,
        warm=solved.solution.warm,
        guaranteed=solved.guaranteed.bound if solved.guaranteed is not None else None,
    )
