"""The ways to an answer of a scene, in the order in which they are tried.

==============  =======================================  =========================================
way             for scenes                               what comes next
==============  =======================================  =========================================
multigrid       whose method is `primal`, or `auto`      Total FETI as for `auto`, also after more
                where `model.method` takes it            iterations than any measured part takes
few iterations  thin, whose contact may peel off row by  multigrid, without a warning: contact
                row (`model.method.may_peel`)            that peels off is no failure
multigrid       the same                                 Total FETI
Total FETI      all                                      the fewest subdomains there can be
fewest          all that have fewer, and the memory      nothing: its answer counts, whatever
subdomains                                               it is
==============  =======================================  =========================================

A way ends the search where its answer is certified, or where the user stopped or limited it
(`run.fallback.is_final`). Otherwise the next one is tried, and the user is told why. Within Total
FETI, `solve._solution_of` has ways of its own that need no other model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.method import (
    PATIENCE_OF_MULTIGRID,
    is_undecomposed,
    may_peel,
    patience,
)
from contact_app.results.report import log
from contact_app.run.fallback import (
    NoAnswerError,
    NoWayLeftError,
    cause,
    fewest_subdomains,
    is_final,
)
from contact_app.run.summary import summary_of
from contact_app.scene.scene import Scene
from solver import Counts, Reason
from solver.contact.options import Method
from solver.driver import reason_text


class Solve(Protocol):
    """Solves a scene in one way (collective)."""

    def __call__(self, scene: Scene, spent: Counts, first: bool) -> SolvedScene:
        """After work that was spent; the first one may go on from a checkpoint.

        Raises
        ------
        NoAnswerError
            It ended without any answer.
        """


@dataclass(frozen=True)
class Way:
    """One way to an answer.

    Attributes
    ----------
    scene
        With its method; None for the fewest subdomains, which depend on the way that failed.
    patience
        Iterations after which the next way is tried; None for the limit of the scene.
    instead
        What the user is told when it is tried after another one, which ended for a reason {why}.
    warns
        Whether the certificate tells that, too.
    """

    scene: Scene | None
    patience: int | None = None
    instead: str = ""
    warns: bool = True


def ways_to(scene: Scene) -> Iterator[Way]:
    """All ways to an answer of a scene, in order."""
    instead = ""
    if is_undecomposed(scene):
        yield Way(scene, None if scene.has_friction else PATIENCE_OF_MULTIGRID)
        instead = "multigrid left no certified answer ({why}){cause}: solved by Total FETI instead"
        scene = _by(scene, "auto")
    if may_peel(scene):
        yield Way(_by(scene, "active-set"), patience(scene), instead)
        peels = "contact peels off row by row: solving for the displacements instead"
        yield Way(_by(scene, "primal"), instead=peels, warns=False)
        instead = ""
    yield Way(scene, instead=instead)
    fewest = "{where} the answer could not be certified ({why}){cause}: solved in {fewest} instead"
    yield Way(None, instead=fewest)


def _by(scene: Scene, method: Method) -> Scene:
    return replace(scene, solver=replace(scene.solver, method=method))


def first_certified(
    scene: Scene,
    comm: MPI.Intracomm,
    solve: Solve,
    spent: Counts,
    keeps_subdomains: bool = False,
) -> SolvedScene:
    """The answer of the first way that ends certified, or of the last one (collective).

    Parameters
    ----------
    keeps_subdomains
        Whether fewer subdomains are no way.

    Raises
    ------
    NoWayLeftError
        No way left an answer.
    """
    answer: SolvedScene | None = None
    failed, warnings = _Failure(), list[str]()
    for number, way in enumerate(ways_to(scene)):
        own = way.scene
        if own is None and not keeps_subdomains:
            own = fewest_subdomains(scene, failed.subdomains, comm)
        if own is None:  # there are no fewer: what the way before left counts
            break
        if number and way.instead:
            text = failed.told(way.instead, own)
            if comm.rank == 0:
                log.info("%s", text)
            warnings += [text] * way.warns
        scene, answer = own, None  # the factors of the last way make room
        try:
            answer = solve(_limited(own, way.patience), spent, number == 0)
        except NoAnswerError as error:
            failed = _Failure(str(error), error.subdomains)
            continue
        if _ends(way, answer, own.solver.max_iterations):
            break
        spent = answer.solution.counts
        failed = _Failure(reason_text(answer.solution), answer.model.partition.count)
    if answer is None:
        raise NoWayLeftError(
            f"{scene.source}: the solver found no answer: {failed.why} Try other cells (less "
            "slender ones, of degree 2) or a looser solver.tolerance, and report the scene"
        )
    return warned(answer, warnings) if warnings else answer


@dataclass(frozen=True)
class _Failure:
    """Why a way left no certified answer, and in how many subdomains, where that is known."""

    why: str = ""
    subdomains: int | None = None

    def told(self, text: str, scene: Scene) -> str:
        """The sentence on the way that is tried instead, with its scene."""
        where = (
            "in its subdomains" if self.subdomains is None else f"in {self.subdomains} subdomains"
        )
        return text.format(
            why=self.why, where=where, cause=cause(scene), fewest=scene.decomposition.subdomains
        )


def _limited(scene: Scene, patience: int | None) -> Scene:
    if patience is None:
        return scene
    most = min(scene.solver.max_iterations, patience)
    return replace(scene, solver=replace(scene.solver, max_iterations=most))


def _ends(way: Way, answer: SolvedScene, limit: int) -> bool:
    """Whether no other way is to be tried (collective)."""
    impatient = way.patience is not None and way.patience < limit
    if impatient and answer.solution.reason is Reason.MAX_ITERATIONS:
        return answer.solution.converged
    return is_final(answer.model, answer.solution, limit)


def warned(solved: SolvedScene, texts: list[str]) -> SolvedScene:
    """The same with more warnings."""
    certificate = solved.solution.certificate
    certificate = replace(certificate, warnings=(*certificate.warnings, *texts))
    solved = replace(solved, solution=replace(solved.solution, certificate=certificate))
    return replace(solved, summary=summary_of(solved))
