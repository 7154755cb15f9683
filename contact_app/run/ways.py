"""Methods to solve a scene, in the order in which they are tried.

==============  =======================================  =========================================
way             for scenes                               what comes next
==============  =======================================  =========================================
multigrid       whose method is `primal`, or `auto`      Total FETI as for `auto`, also after more
                where `model.method` takes it            iterations than any measured part takes
few iterations  thin, whose contact may peel off row by  multigrid, without a warning: contact
                row (`MethodChoice.may_peel`)            that peels off is no failure
multigrid       the same                                 Total FETI
many            with friction (`MethodChoice.may_stall`) multigrid, without a warning
iterations
active sets     of several bodies without friction       multigrid, without a warning: it has a
                (`MethodChoice.may_jump`)                safeguard for sets that do not settle
multigrid       the same                                 Total FETI
Total FETI      all                                      the fewest subdomains there can be
fewest          all that have fewer, and the memory      multigrid, unless it was tried before
subdomains
multigrid       all for which it was not tried before    nothing: the answer before counts, if any
==============  =======================================  =========================================

A method ends the search if its answer is certified, or if the user stopped or limited it
(`run.fallback.is_final`). Otherwise the next one is tried, and a message has the reason.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.method import LIMITS, MethodChoice, is_undecomposed, patience
from contact_app.results.report import log
from contact_app.run.fallback import (
    NoAnswerError,
    NoWayLeftError,
    cause,
    fewest_subdomains,
    is_final,
)
from contact_app.run.summary import warned
from contact_app.scene.bodies import Body
from contact_app.scene.scene import Scene
from solver import Counts, Reason
from solver.driver import reason_text


class Solve(Protocol):
    """Solve a scene by one method (collective)."""

    def __call__(self, scene: Scene, counts_before: Counts, first: bool) -> SolvedScene:
        """Solve after some work spent before; the first method may go on from a checkpoint.

        Raises
        ------
        NoAnswerError
            The method ended without any answer.
        """


@dataclass(frozen=True)
class Way:
    """One method to solve a scene."""

    scene: Scene | None
    """The scene with this method; None for the fewest subdomains, which depend on the failed
    method."""
    patience: int | None = None
    """Iterations after which the next method is tried; None for the limit of the scene."""
    instead: str = ""
    """Message when this method is tried after another one that ended for a reason {why}."""
    warns: bool = True
    """Whether the message is also a warning of the certificate."""
    keeps: bool = False
    """Whether the answer of the method before counts if this method leaves no certified one."""


def ways_to(scene: Scene, keeps_subdomains: bool = False) -> Iterator[Way]:
    """All methods to solve a scene, in order; parameters as of `first_certified`."""
    instead = ""
    choice = MethodChoice.of(scene)
    if keeps_subdomains and choice.may_stall:
        yield Way(scene, LIMITS.patience_with_friction)  # `run.increments` has the next method
        return
    stalls = choice.may_stall and not keeps_subdomains
    jumps, peels = choice.may_jump, choice.may_peel
    tried = stalls or jumps or peels or is_undecomposed(scene.solver)
    if is_undecomposed(scene.solver):
        yield Way(scene, None if scene.has_friction else LIMITS.patience_of_multigrid)
        if keeps_subdomains:
            return
        instead = "multigrid left no certified answer ({why}){cause}: solved by Total FETI instead"
        scene = scene.solved_by(method="auto")
    if peels:
        yield Way(scene.solved_by(method="active-set"), patience(scene.bodies))
        peeling = "contact opens row by row: solving for the displacements instead"
        yield Way(scene.solved_by(method="primal"), instead=peeling, warns=False)
    elif stalls:
        yield Way(scene.solved_by(method="active-set"), LIMITS.patience_with_friction)
        slow = "friction converges slowly in subdomains: solving for the displacements instead"
        yield Way(scene.solved_by(method="primal"), instead=slow, warns=False)
    elif jumps:
        yield Way(scene.solved_by(method="active-set"), instead=instead)
        jumping = "the active sets do not settle: solving for the displacements instead"
        yield Way(
            scene.solved_by(method="primal"), LIMITS.patience_of_multigrid, jumping, warns=False
        )
        instead = ""
    yield Way(scene, instead=instead)
    fewest = "{where} the answer could not be certified ({why}){cause}: solved in {fewest} instead"
    yield Way(None, instead=fewest)
    if not tried and not keeps_subdomains:
        last = "the answer could not be certified ({why}){cause}: solved by multigrid instead"
        yield Way(scene.solved_by(method="primal"), instead=last, keeps=True)


def first_certified(
    scene: Scene,
    comm: MPI.Intracomm,
    solve: Solve,
    counts_before: Counts,
    keeps_subdomains: bool = False,
) -> SolvedScene:
    """The answer of the first method that ends with a certificate, or of the last one (collective).

    Parameters
    ----------
    keeps_subdomains
        Whether the number of subdomains must not change.

    Raises
    ------
    NoWayLeftError
        No method left an answer.
    """
    answer: SolvedScene | None = None
    failed, warnings = _Failure(), list[str]()
    for number, way in enumerate(ways_to(scene, keeps_subdomains)):
        undecomposed = way.scene
        if undecomposed is None and not keeps_subdomains:
            parts = scene.bodies, scene.decomposition
            fewest = fewest_subdomains(*parts, failed.subdomains, comm)
            undecomposed = None if fewest is None else replace(scene, decomposition=fewest)
        if undecomposed is None:  # no fewer subdomains: the answer of the method before counts
            continue
        if number and way.instead:
            text = failed.message(
                way.instead, undecomposed.bodies, undecomposed.decomposition.subdomains
            )
            if comm.rank == 0:
                log.info("%s", text)
            warnings += [text] * way.warns
        before = answer if way.keeps else None
        scene, answer = undecomposed, None  # free the factors of the last method
        limit = undecomposed.solver.max_iterations
        most = limit if way.patience is None else min(limit, way.patience)
        try:
            limited = undecomposed.solved_by(max_iterations=most)
            answer = solve(limited, counts_before, number == 0)
            if _ends(way, answer, limit):
                break
            counts_before = answer.solution.counts
            failed = _Failure(reason_text(answer.solution), answer.model.partition.count)
        except NoAnswerError as error:
            failed = _Failure(str(error), error.subdomains)
            counts_before = counts_before + error.counts
        if before is not None:
            warnings.append(f"multigrid left no certified answer, either: {failed.why}")
            answer = before
    if answer is None:
        raise NoWayLeftError(
            f"{scene.source}: the solver found no answer: {failed.why} Try less slender cells, "
            "cells of degree 2 or a larger solver.tolerance, and report the scene",
            counts_before,
        )
    return warned(answer, warnings) if warnings else answer


@dataclass(frozen=True)
class _Failure:
    """Reason why a method left no certified answer, and its number of subdomains if known."""

    why: str = ""
    subdomains: int | None = None

    def message(self, text: str, bodies: Sequence[Body], fewest: object) -> str:
        """The message on the method that is tried instead."""
        where = (
            "in its subdomains" if self.subdomains is None else f"in {self.subdomains} subdomains"
        )
        return text.format(why=self.why, where=where, cause=cause(bodies), fewest=fewest)


def _ends(way: Way, answer: SolvedScene, limit: int) -> bool:
    """Whether to try no other method (collective)."""
    impatient = way.patience is not None and way.patience < limit
    if impatient and answer.solution.reason is Reason.MAX_ITERATIONS:
        return answer.solution.converged
    return is_final(answer.model.problem, answer.solution, limit)
