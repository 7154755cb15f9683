"""Random scenes with friction: ``python -m tests.stability.fuzz_friction 200``.

``mpirun -n 2 python -m tests.stability.fuzz_friction 200`` solves the same scenes on ranks, and
``--variant 1`` in other units and decompositions; the answers have to be the same.

Every scene of `friction_scenes` must end in one of these ways:

agrees       certified, with the displacements of the Gauss-Seidel reference (`friction_reference`):
             to 1e-6 in energy where all limits are given, to 1e-5 in displacements with Coulomb's
             law, in the one answer that the reference finds from two starts
second       certified, with another solution of Coulomb's problem: the contact forces of the
             answer leave next to nothing of the conditions of the undecomposed system, and sweeps
             that start there stay there, or move the forces of a node in several contacts
             without end
undecided    certified, where the reference does not settle; the answer meets the conditions
degraded     not certified, where the reference does not settle, either
contradicts  held nodes are pushed into an obstacle

Anything else is a fault.
"""

import sys
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.errors import NoEquilibriumError
from contact_app.run.solve import solve_scene
from tests import scenes
from tests.friction_reference import SWEEPS, Condensed, FrictionReference, condense, sweep
from tests.reference import ReferenceError
from tests.stability import verdicts
from tests.stability.friction_scenes import friction_scene
from tests.stability.groups import in_order
from tests.stability.verdicts import Verdict, attempt

ENERGY = 1e-6
"""Difference of energies with Tresca's law, over the energy of the strains."""

MOVED = 1e-5
"""Difference of displacements with Coulomb's law, over the largest."""

OPTIMAL = 1e-6
"""Residual of the conditions of contact and friction that shows an answer to be right."""

EXACT = 1e-8
"""The same where sweeps from the answer do not settle."""


def judge(
    seed: int,
    method: str = "auto",
    variant: int = 0,
    *,
    solve: Any = solve_scene,
    patience: float = 120.0,
    draw: Any = friction_scene,
    compare: Any = None,
) -> Verdict:
    """Solve a random scene and hold it against the reference (collective).

    Parameters
    ----------
    method
        As `solver.method` has it.
    variant
        Of its units and its decomposition.
    solve
        In place of `solve_scene`.
    patience
        Seconds of processor time after which it is said to hang.
    draw
        In place of `friction_scene`.
    compare
        Kind, detail and operator applications of a solved scene, in place of `compared`.
    """
    made, subdomains = draw(seed, variant)
    made["solver"]["method"] = method
    done = attempt(made, max(subdomains, MPI.COMM_WORLD.size), solve, patience)
    if done.fault is not None:
        return Verdict(seed, *done.fault, done.seconds)
    if done.error is not None:
        kind = "gives up"
        if isinstance(done.error, NoEquilibriumError):
            held = "push held nodes" in str(done.error)
            kind = "contradicts" if held else "denies an equilibrium"
        return Verdict(seed, kind, str(done.error), done.seconds)
    kind, detail, products = (compare or compared)(made, done.scene, done.solved)
    return Verdict(seed, kind, detail, done.seconds, products)


def compared(_made: scenes.Config, scene: Any, solved: Any) -> tuple[str, str, int]:
    """The verdict on an answer, what it stands on, and its operator applications (collective)."""
    kind, detail, _ = judged(condense(scene), solved)
    return kind, detail, solved.summary["solver"]["hessian_multiplications"]


def judged(condensed: Condensed, solved: Any) -> tuple[str, str, np.ndarray]:
    """The verdict on an answer, what it stands on, and its displacements (collective).

    The reference of rank 0 decides, and has the displacements, (n, dim), in its order.
    """
    comm = solved.model.comm
    ours, nodes = forces_of(condensed, solved), solved.nodes
    parts = comm.gather((nodes.first, nodes.points, nodes.displacement))
    told = None
    if comm.rank == 0:
        _, points, u = zip(*sorted(parts, key=lambda part: part[0]), strict=True)
        ordered = in_order(condensed.system, np.concatenate(points), np.concatenate(u))
        assert ordered is not None, "the nodes of the reference are others"
        u = ordered.reshape(-1, condensed.system.dimension)
        told = *_compared(condensed, solved.summary, ours, u), u
    return comm.bcast(told)


def _compared(
    condensed: Condensed, summary: dict[str, Any], ours: np.ndarray, u: np.ndarray
) -> tuple[str, str]:
    """Like `judged`, for contact forces in the rows of the reference and displacements (n, dim)."""
    certificate = summary["certificate"]
    stays = _settled(condensed, ours) if certificate["passed"] else None
    most = SWEEPS if stays is None else SWEEPS // 10
    known = _settled(condensed, np.zeros(len(condensed.q)), most=most)
    if known is None and stays is None:
        known = _settled(condensed, np.full(len(condensed.q), condensed.scale), backwards=True)
    known = known or stays  # sweeps that settle only from the answer on show it to be right
    if not certificate["passed"]:
        return ("degraded" if known is None else "given up"), str(certificate)
    left = condensed.residual(ours)
    if known is None:
        told = f"ours leaves {left:.1e} of the conditions"
        return ("undecided" if left < OPTIMAL else "certified wrongly"), told
    size = float(np.abs(known.u).max())
    apart = float(np.abs(u - known.u).max()) / size
    stiffness = condensed.system.stiffness
    strained = float(known.u.ravel() @ (stiffness @ known.u.ravel())) or 1.0
    energy = abs(summary["solution"]["energy"] - known.energy) / strained
    told = f"displacements {apart:.1e}, energy {energy:.1e} apart; ours leaves {left:.1e}"
    same = apart <= MOVED if condensed.coefficient.any() else energy <= ENERGY
    if same:
        return "agrees", told
    if stays is None:
        second = left < EXACT and condensed.coefficient.any()
        return ("second" if second else "certified wrongly"), f"{told}; sweeps from ours go on"
    moved = float(np.abs(u - stays.u).max()) / size
    told += f", sweeps from ours move by {moved:.1e}"
    second = moved <= MOVED and condensed.coefficient.any()
    return ("second" if second else "certified wrongly"), told


def forces_of(condensed: Condensed, solved: Any) -> np.ndarray:
    """The contact forces of an answer in the rows of the reference (collective)."""
    problem, multiplier = solved.model.problem, solved.solution.multiplier
    contact, points = problem.contact, problem.friction
    normal = multiplier[problem.inequality] * contact.spread
    tangential = np.zeros((len(normal), problem.dimension))
    if points is not None:
        place = np.searchsorted(np.flatnonzero(problem.inequality), points.normals)
        directions = -problem.shared.friction.rows.normals
        np.add.at(tangential, place, points.forces(multiplier)[:, None] * directions)
    own = condensed.rows_of(contact.points, contact.sources, normal, tangential)
    return np.asarray(solved.model.comm.allreduce(own))


def _settled(
    condensed: Condensed, start: np.ndarray, backwards: bool = False, most: int = SWEEPS
) -> FrictionReference | None:
    """The reference from some contact forces on; None where it does not settle in time."""
    try:
        return condensed.answer(sweep(condensed, start, backwards, most))
    except ReferenceError:
        return None


if __name__ == "__main__":
    sys.exit(verdicts.main(__doc__, judge, method="auto", variant=0))
