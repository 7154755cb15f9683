"""The fallbacks where the first way to an answer ends without a certificate.

Cells a hundred times longer than wide, cut into subdomains, make forces between them that cancel to
the last digit of the answer: conjugate gradients end at rounding errors, run on for more steps than
there are multipliers, which in exact arithmetic is the most they take, or meet directions whose
curvature has no digits left, along which the cost seems to fall without end. Two ways are left:

1. the scene in as few subdomains as bodies and ranks allow (`fewest_subdomains`). Held unknowns are
   then eliminated, and contact rows alone are left to the dual problem;
2. that system solved for its displacements by Newton's method, a sparse factor a step
   (`solve_directly`), which needs no dual operator at all.

Both are tried whatever ended the first way, an exception of the solver included, unless the user
stopped it or limited its iterations.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from contact_app.errors import CouldNotRunError
from contact_app.machine.memory import available_bytes, factor_bytes, needed_bytes
from contact_app.model.model import Model
from contact_app.scene.scene import Decomposition, Scene
from solver import Reason
from solver.contact.solution import Solution
from solver.driver import ROUNDED_AWAY
from solver.errors import QPError, UnboundedError
from solver.qp.result import Monitor
from solver.tfeti.certify import certify
from solver.tfeti.dual import DualProblem
from solver.tfeti.feasible import feasible_multiplier

STEPS = 10
"""Steps over the rows of B after which a limit on steps is not what ended a solve."""

SLENDER = 20.0
"""Length over thickness of a body from which on the user is told that it is slender."""

CONTRAST = 1e4
"""Largest over smallest Young's modulus from which on the user is told of it."""

FAILURES = (QPError, ArithmeticError, np.linalg.LinAlgError)
"""The exceptions of the solver where rounding errors take its matrices' properties away."""


class NoAnswerError(Exception):
    """A way ended without any answer; the text says why.

    Attributes
    ----------
    subdomains
        Of that way; None where they are not known.
    """

    def __init__(self, text: str, subdomains: int | None = None) -> None:
        super().__init__(text)
        self.subdomains = subdomains


class NoWayLeftError(CouldNotRunError):
    """No way left an answer; the text says what to do."""


def failure_text(error: Exception) -> str:
    """A sentence on an exception of the solver for a scene that has an equilibrium.

    Its cost is bounded below: directions along which it seems to fall without end are such along
    which rounding errors took the curvature away.
    """
    return ROUNDED_AWAY if isinstance(error, UnboundedError) else f"{error}."


def is_final(model: Model, solution: Solution, max_iterations: int) -> bool:
    """Whether no other way is to be tried (collective).

    So it is where the answer is certified, or the user stopped or limited the solve. A method that
    the user named is tried first and gives way to the others like the automatic one: the warnings
    and `summary.solver.method` tell which method answered.
    """
    if solution.converged or solution.reason is Reason.STOPPED:
        return True
    rows = model.comm.allreduce(model.problem.size)
    return solution.reason is Reason.MAX_ITERATIONS and max_iterations < STEPS * rows


def fewest_subdomains(scene: Scene, count: int | None, comm: MPI.Intracomm) -> Scene | None:
    """The scene in as few subdomains as bodies and ranks allow (collective).

    None where it has no fewer, or there is no memory for them.

    Parameters
    ----------
    count
        Subdomains of the way that failed; None where they are not known.
    """
    fewest = max(len(scene.bodies), comm.size)
    if (count is not None and count <= fewest) or scene.decomposition.subdomains == fewest:
        return None
    return replace(scene, decomposition=Decomposition(fewest)) if _fits(scene, comm) else None


def _fits(scene: Scene, comm: MPI.Intracomm) -> bool:
    """Whether there is memory for one factor of each body (collective)."""
    sizes = [scene.dimension * body.nodes for body in scene.bodies]
    factors = tuple((size, scene.dimension) for size in sizes)
    needed = needed_bytes(sum(sizes), rows=0, factors=factors)
    return needed <= float(comm.allreduce(available_bytes(), op=MPI.MIN))


def solve_directly(
    problem: DualProblem,
    dofs: int,
    tolerance: float,
    before: Solution | None,
    monitor: Monitor | None,
) -> Solution | None:
    """The answer by Newton's method (collective); None where it cannot be had.

    Parameters
    ----------
    dofs
        Unknowns of the undecomposed bodies.
    tolerance
        Of the certificate.
    before
        Where the dual methods ended, if they left anything.
    """
    if not problem.comm.allreduce(problem.size) or not _has_room(problem, dofs):
        return None
    from solver.primal.newton import solve_by_newton

    start = None if before is None else before.multiplier
    try:
        found = solve_by_newton(problem, start, monitor)
    except FAILURES:
        return None
    multiplier = feasible_multiplier(problem, found.multiplier, found.multiplier > 0.0)
    certificate, measures = certify(problem, multiplier, found.displacements, tolerance)
    spent = found.counts if before is None else before.counts + found.counts
    return Solution(
        multiplier, found.displacements, certificate, measures, spent, found.reason, tolerance,
        method="newton",
    )  # fmt: skip


def _has_room(problem: DualProblem, dofs: int) -> bool:
    """Whether there is memory for a factor of everything (collective)."""
    factor = factor_bytes(dofs, problem.dimension)
    return factor <= float(problem.comm.allreduce(available_bytes(), op=MPI.SUM))


def cause(scene: Scene) -> str:
    """The cause of rounding errors in a scene, as an addition to a sentence."""
    said = []
    for body in scene.bodies:
        extent = np.subtract(body.mesh.upper, body.mesh.lower)
        slender = float(extent.max() / extent.min())
        if slender >= SLENDER:
            said.append(f"{body.name} is {slender:.0f} times as long as thick")
    moduli = [m.young for body in scene.bodies for m in body.materials]
    if max(moduli) >= CONTRAST * min(moduli):
        said.append(f"Young's moduli differ by a factor of {max(moduli) / min(moduli):.1g}")
    return f" ({'; '.join(said)})" if said else ""
