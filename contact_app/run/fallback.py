"""Fallbacks for solves that end without a certificate.

With cells a hundred times longer than wide, forces between subdomains cancel to the last digit of
the answer. Conjugate gradients then end at rounding errors, take more steps than there are
multipliers (the limit in exact arithmetic), or meet directions whose curvature is lost in rounding
errors, along which the cost seems unbounded. The scene is then solved in as few subdomains as
bodies and ranks allow (`fewest_subdomains`): held unknowns are eliminated, and the dual problem has
contact rows alone. `run.ways` has the methods that follow. They are tried for any end of a method,
also an exception of the solver, unless the user stopped it or limited its iterations.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from contact_app.errors import CouldNotRunError
from contact_app.machine.memory import available_bytes, needed_bytes
from contact_app.scene.bodies import Body
from contact_app.scene.scene import Decomposition
from solver import Counts, Reason
from solver.contact.solution import Solution
from solver.driver import ROUNDED_AWAY
from solver.errors import QPError, UnboundedError
from solver.tfeti.dual import DualProblem
from solver.tfeti.friction_share import may_hold

STEPS = 10
"""Steps over the rows of B above which the iteration limit is not the reason why a solve ended."""

SLENDER = 20.0
"""Length over thickness from which on a message names a body as slender."""

CONTRAST = 1e4
"""Largest over smallest Young's modulus from which on a message names the contrast."""

FAILURES = (QPError, ArithmeticError, np.linalg.LinAlgError)
"""Exceptions of the solver when rounding errors destroy the properties of its matrices."""


class NoAnswerError(Exception):
    """A method ended without any answer; the text has the reason.

    Attributes
    ----------
    subdomains
        Number of subdomains of the method; None if unknown.
    counts
        Its work up to the failure.
    """

    def __init__(
        self, text: str, subdomains: int | None = None, counts: Counts | None = None
    ) -> None:
        super().__init__(text)
        self.subdomains, self.counts = subdomains, counts or Counts()


class NoWayLeftError(CouldNotRunError):
    """No method found an answer; the text has the remedy.

    Attributes
    ----------
    counts
        The work of all methods.
    """

    def __init__(self, text: str, counts: Counts) -> None:
        super().__init__(text)
        self.counts = counts


def failure_text(error: Exception) -> str:
    """The message for an exception of the solver on a scene that has an equilibrium.

    The cost of such a scene is bounded below. If it seems unbounded along a direction, rounding
    errors have destroyed the curvature along it.
    """
    return ROUNDED_AWAY if isinstance(error, UnboundedError) else f"{error}."


def is_final(problem: DualProblem, solution: Solution, max_iterations: int) -> bool:
    """Whether to try no other method (collective).

    This holds if the answer is certified, if friction at its contact forces does not hold a body,
    or if the user stopped or limited the solve. A method named by the user is tried first and has
    the same fallbacks as the automatic one; the warnings and `summary.solver.method` name the
    method of the answer.
    """
    if solution.converged or solution.reason is Reason.STOPPED:
        return True
    if solution.reason is Reason.SLIDES:
        return not may_hold(problem, solution)
    rows = problem.comm.allreduce(problem.size)
    return solution.reason is Reason.MAX_ITERATIONS and max_iterations < STEPS * rows


def fewest_subdomains(
    bodies: Sequence[Body], before: Decomposition, count: int | None, comm: MPI.Intracomm
) -> Decomposition | None:
    """Decomposition into as few subdomains as bodies and ranks allow (collective).

    None if no fewer are possible, or if they need too much memory.

    Parameters
    ----------
    before, count
        Decomposition and number of subdomains of the failed method; None if the number is unknown.
    """
    fewest = max(len(bodies), comm.size)
    if (count is not None and count <= fewest) or before.subdomains == fewest:
        return None
    return Decomposition(fewest) if _fits(bodies, comm) else None


def _fits(bodies: Sequence[Body], comm: MPI.Intracomm) -> bool:
    """Whether there is memory for one factor of each body (collective)."""
    d = bodies[0].mesh.dimension
    sizes = [d * body.nodes for body in bodies]
    factors = tuple((size, d) for size in sizes)
    needed = needed_bytes(sum(sizes), rows=0, factors=factors)
    return needed <= float(comm.allreduce(available_bytes(), op=MPI.MIN))


def cause(bodies: Sequence[Body]) -> str:
    """The cause of rounding errors in a scene, as a phrase in parentheses; may be empty."""
    notes = []
    for body in bodies:
        extent = np.subtract(body.mesh.upper, body.mesh.lower)
        slender = float(extent.max() / extent.min())
        if slender >= SLENDER:
            notes.append(f"{body.name} is {slender:.0f} times as long as thick")
    moduli = [m.young for body in bodies for m in body.materials]
    if max(moduli) >= CONTRAST * min(moduli):
        notes.append(f"Young's moduli differ by a factor of {max(moduli) / min(moduli):.1g}")
    return f" ({'; '.join(notes)})" if notes else ""
