"""The initial active set, from rigid subdomains on a Winkler foundation.

The dual operator F is replaced by a diagonal D: each gluing row is a spring between two subdomains,
each contact row a spring to the obstacle that can only push. The subdomains are rigid. The unknowns
that remain in

    min ½ λᵀ D λ - λᵀ d   subject to   λ_I ≥ 0 and G λ = e

are the rigid motions α, with λ = D⁻¹ (d - Gᵀ α), set to zero where negative on contact rows. They
minimise

    φ(α) = ½ Σ D⁻¹ (d - Gᵀ α)²₊ + eᵀ α,

which is convex and piecewise quadratic. Newton's method finds the minimum with one coarse factor
per step and without an application of F. This is the Winkler foundation of contact mechanics (K. L.
Johnson, *Contact Mechanics*, 1985, section 4.3). If all gaps are zero, the solver starts with every
contact row active instead, since rigid subdomains do not bulge.
"""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from solver.tfeti.dual import DualProblem
from solver.vectors import Array, Mask


@dataclass(frozen=True)
class WinklerOptions:
    """The tuned numbers of the foundation and of Newton's method."""

    softness: float = 0.1
    """Stiffness of a contact spring over that of its node in K: under a pressure its neighbours
    move, too."""
    steps: int = 40
    """Largest number of Newton steps, each with a coarse factor."""
    balanced: float = 1e-2
    """Relative residual of equilibrium at which the steps end: the model is not more accurate."""
    faint: float = 1e-3
    """Weight of open contact rows, without which the coarse factor could be singular."""
    shortest: float = 1e-4
    """Step length below which a step is taken without testing whether φ falls."""


def contact_stiffness(problem: DualProblem) -> tuple[Array, float]:
    """The stiffness against each contact row alone, and the largest one of an unknown (collective).

    Returns
    -------
    Diagonal of B diag(K) Bᵀ, (contact rows,), and the largest entry of diag(K) on interfaces; one
    if only rigid bodies have an interface, as beside held nodes.
    """
    parts = [c.stiffness.diagonal()[c.interface] for c in problem.classes if c.members]
    top = max((float(part.max(initial=0.0)) for part in parts), default=0.0)
    top = problem.comm.allreduce(top, op=MPI.MAX)
    return problem.row_stiffness(problem.inequality), top or 1.0


def winkler_contact(problem: DualProblem, options: WinklerOptions | None = None) -> Mask:
    """Contact rows (dual,) with contact forces of rigid subdomains on a Winkler foundation."""
    coarse, comm, options = problem.coarse, problem.comm, options or WinklerOptions()
    assert coarse is not None
    contact = problem.inequality
    springs, top = contact_stiffness(problem)
    stiffness = top * coarse.metric
    # no spring between two rigid bodies
    springs = np.where(springs > 0.0, options.softness * springs, top)
    stiffness[contact] = np.minimum(springs, top)
    stiffness[problem.tangential] *= options.faint  # friction adds no foundation
    motion = np.empty(problem.size)

    def force(alpha: Array) -> Array:
        coarse.extend(alpha, motion)
        pull = stiffness * (problem.d - motion)
        return np.where(contact, np.maximum(pull, 0.0), pull)

    def cost(alpha: Array, forces: Array) -> float:
        value = 0.5 * float(forces @ (forces / stiffness)) + float(problem.e @ alpha)
        return float(comm.allreduce(value))

    load = _norm(comm, problem.e)
    alpha = np.zeros(coarse.kernels)
    rest, step = np.empty(coarse.kernels), np.empty(coarse.kernels)
    forces = force(alpha)
    value = cost(alpha, forces)
    for _ in range(options.steps):
        coarse.restrict(forces, rest)
        rest -= problem.e
        if _norm(comm, rest) <= options.balanced * load:
            break
        faint = np.where(forces <= 0.0, options.faint, 1.0)
        weights = np.where(contact, faint * stiffness / top, 1.0)
        weights[problem.tangential] = options.faint
        coarse.weighted(np.sqrt(weights)).solve(rest, step)
        step /= top
        share = 1.0
        while True:
            trial = alpha + share * step
            forces = force(trial)
            after = cost(trial, forces)
            if after <= value or share < options.shortest:
                break
            share *= 0.5
        alpha, value = trial, after
    return contact & (forces > 0.0)


def _norm(comm: MPI.Intracomm, x: Array) -> float:
    return float(np.sqrt(comm.allreduce(float(x @ x))))
