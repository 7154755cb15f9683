"""The certificate: how right an answer is, recomputed from the answer.

Nothing here trusts the solver's residuals. From the multiplier λ and the displacements u are
computed anew: jumps and penetration B u - c, the residual of equilibrium K u - f + Bᵀ λ on every
unknown, the sign of the contact forces, complementarity, and the duality gap.

The gap. u minimises L(·, λ) = ½ a(u,u) - l(u) + λᵀ(B u - c), because K u = f - Bᵀ λ; so for any
admissible û (glued, held, not penetrating)

    J(û) - D(λ) = ½ (û - u)ᵀ K (û - u) - λᵀ (B û - c) ≥ 0,

a sum of non-negative terms without cancellation, and the exact solution u* obeys
½ ‖û - u*‖²_K ≤ J(û) - J(u*) ≤ J(û) - D(λ). It bounds the algebraic error; the error of the mesh
is another matter. Any û will do. The nearest one to u is open wherever u is, which costs
λᵀ (c - B u), first order in the error; rows that press are therefore closed in û where that costs
less, second order.

Lengths are relative to the largest displacement, forces to the load (the largest of the sums of
the magnitudes of loads, of reactions and of contact forces), the gap to the energy.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from solver.tfeti.constraints import RowKind
from solver.tfeti.dual import DualProblem, interface_slices
from solver.tfeti.feasible import (
    feasible_displacements,
    follows,
    motion_energy,
    relaxed_energy,
    worth_closing,
)

NUMBERS = (
    "max_penetration",
    "max_gluing_jump",
    "min_multiplier",
    "complementarity",
    "equilibrium",
    "duality_gap",
)

EQUILIBRIUM_FLOOR = 1e-9
"""Residual of equilibrium that round-off may leave, relative to the load."""

ROUNDED = 1.0
"""Rounding errors of a displacement, in units of ε diag(K) max|u|, that its residual may show."""

ROUNDED_LIMIT = 1e-6
"""Residual of equilibrium beyond which rounding is no excuse."""


@dataclass(frozen=True)
class Certificate:
    """Numbers of `summary.json`'s certificate, all relative.

    Attributes
    ----------
    max_penetration, max_gluing_jump
        Over the largest displacement; the jump covers gluing and held rows.
    min_multiplier
        Most negative contact force over the load; zero or positive when none pulls.
    complementarity
        Σ λ_i |gap_i| over load times largest displacement.
    equilibrium
        ‖K u - f + Bᵀ λ‖ over the load, in the 2-norm of all unknowns that are solved for.
    duality_gap
        J(û) - D(λ) over the energy.
    passed
        Whether all of them are below the tolerance asked for.
    round_off
        What rounding u to its last digit leaves of equilibrium, over the load; the residual may
        come to that (and to no more than 1e-6). A body that is moved far and hardly strained, a
        stiff one on a soft one, cannot do better: its forces are differences of large numbers.
    """

    max_penetration: float
    max_gluing_jump: float
    min_multiplier: float
    complementarity: float
    equilibrium: float
    duality_gap: float
    passed: bool
    round_off: float = 0.0
    warnings: tuple[str, ...] = field(default=())

    def judged(self, tolerance: float) -> Certificate:
        """The same numbers, held against a tolerance."""
        limits = dict.fromkeys(NUMBERS, tolerance)
        rounded = min(self.round_off, ROUNDED_LIMIT)
        limits["equilibrium"] = max(tolerance, EQUILIBRIUM_FLOOR, rounded)
        passed = all(abs(getattr(self, name)) <= limit for name, limit in limits.items())
        return replace(self, passed=passed)

    def as_dict(self) -> dict[str, Any]:
        """As `summary.json` holds it."""
        return {**asdict(self), "warnings": list(self.warnings)}


@dataclass(frozen=True)
class Measures:
    """Sizes the certificate refers to.

    Attributes
    ----------
    displacement
        Largest |u| over all nodes, in units of length.
    load
        Largest of the sums of magnitudes of loads, reactions and contact forces.
    energy
        ½ a(û,û) - l(û) of the admissible û; its error is second order, at most the duality gap.
    gap
        The duality gap J(û) - D(λ), in units of energy.
    """

    displacement: float
    load: float
    energy: float
    gap: float


def certify(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    displacements: list[NDArray[np.float64]],
    tolerance: float,
    relaxations: int = 0,
) -> tuple[Certificate, Measures]:
    """Compute the certificate of an answer.

    Parameters
    ----------
    multiplier : (dual,)
        λ, local part.
    displacements : one (n, members) array a class
        u.
    tolerance
        `solver.tolerance` of the scene.
    relaxations
        Steps that sharpen the gap: û's inside follows its interface, or where there are Schur
        complements does so at once, and the interface moves where nothing holds it.
    """
    comm = problem.comm
    contact, glued = problem.inequality, ~problem.inequality
    interface = problem.on_interface(displacements)
    residual = problem.residual(interface)
    slack = residual / problem.spread
    largest = _largest_displacement(problem, displacements)
    unit = largest or 1.0

    imbalance, energy = _equilibrium(problem, multiplier, displacements)
    contact_forces = multiplier[contact] * problem.spread[contact]
    load = _load(problem, multiplier, contact_forces)
    gap = duality_gap(problem, multiplier, interface, relaxations)
    complementarity = float(np.abs(contact_forces * slack[contact]).sum())
    sums = np.array([complementarity, multiplier @ residual])
    complementarity, work = (float(v) for v in comm.allreduce(sums))
    energy += work + gap

    numbers = Certificate(
        max_penetration=_max(comm, np.maximum(slack[contact], 0.0)) / unit,
        max_gluing_jump=_max(comm, np.abs(slack[glued])) / unit,
        min_multiplier=0.0 - _max(comm, -np.minimum(contact_forces, 0.0)) / (load or 1.0),
        complementarity=complementarity / ((load or 1.0) * unit),
        equilibrium=imbalance / (load or 1.0),
        duality_gap=gap / (abs(energy) or 1.0),
        passed=False,
        round_off=_round_off(problem, displacements) / (load or 1.0),
    )
    return numbers.judged(tolerance), Measures(largest, load, energy, gap)


def nearest_admissible(
    problem: DualProblem, multiplier: NDArray[np.float64], displacements: list[NDArray[np.float64]]
) -> NDArray[np.float64]:
    """The admissible û whose duality gap is least, on the interface; elsewhere it is u."""
    interface = problem.on_interface(displacements)
    return interface + _nearest(problem, multiplier, interface)[0]


def duality_gap(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    interface: NDArray[np.float64],
    relaxations: int = 0,
    rest: float = 0.0,
) -> float:
    """J(û) - D(λ) of what λ and u on the interface stand for, in units of energy.

    Parameters
    ----------
    multiplier : (dual,)
        λ ≥ 0 on contact rows, in equilibrium with the loads.
    relaxations
        As for `certify`.
    rest
        As for `feasible_displacements`.
    """
    change, opened, gap = _nearest(problem, multiplier, interface, rest)
    if not relaxations:
        return gap
    if not follows(problem):
        return float(problem.comm.allreduce(opened + motion_energy(problem, change, relaxations)))
    pressing = problem.inequality & (multiplier > 0.0)
    ways = [(change, opened), _way(problem, multiplier, interface, pressing, rest)]
    return min(
        problem.comm.allreduce(opened) + relaxed_energy(problem, change, relaxations)
        for change, opened in ways
    )


def _nearest(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    interface: NDArray[np.float64],
    rest: float = 0.0,
) -> tuple[NDArray[np.float64], float, float]:
    """The cheapest way û - u to an admissible û, λᵀ (c - B û) on this rank, and the gap.

    One way closes the contact rows that are worth it, another does not.
    """
    closed = worth_closing(problem, multiplier, problem.residual(interface))
    ways = [_way(problem, multiplier, interface, rows, rest) for rows in (closed, None)]
    costs = [opened + motion_energy(problem, change) for change, opened in ways]
    costs = problem.comm.allreduce(np.array(costs))
    best = int(np.argmin(costs))
    return *ways[best], float(costs[best])


def _way(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    interface: NDArray[np.float64],
    closed: NDArray[np.bool_] | None,
    rest: float,
) -> tuple[NDArray[np.float64], float]:
    """The way û - u to an admissible û that closes some contact rows, and λᵀ (c - B û)."""
    change, residual = feasible_displacements(problem, interface, closed, rest)
    contact = problem.inequality
    change -= interface
    return change, -float(multiplier[contact] @ np.minimum(residual[contact], 0.0))


def _equilibrium(
    problem: DualProblem,
    multiplier: NDArray[np.float64],
    displacements: list[NDArray[np.float64]],
) -> tuple[float, float]:
    """‖K u - f + Bᵀ λ‖ over free unknowns, and the energy ½ a(u,u) - l(u)."""
    sums = np.zeros(2)
    forces = problem.constraint_forces(multiplier)
    for cls, part, u, load in zip(
        problem.classes,
        interface_slices(problem.classes),
        displacements,
        problem.forces,
        strict=True,
    ):
        force = forces[part].reshape(cls.members, -1)
        for members in cls.batches():
            some = u[:, members].copy()
            Ku = cls.stiffness @ some
            sums[1] += np.vdot(some, 0.5 * Ku - load[:, members])
            Ku -= load[:, members]
            Ku[cls.interface] += force[members].T
            sums[0] += np.sum(Ku[cls.free] ** 2)
    square, energy = problem.comm.allreduce(sums)
    return float(np.sqrt(square)), float(energy)


def _round_off(problem: DualProblem, displacements: list[NDArray[np.float64]]) -> float:
    """2-norm of what rounding errors of the displacements do to K u."""
    square = 0.0
    for cls, u in zip(problem.classes, displacements, strict=True):
        stiff = float(np.sum(cls.stiffness.diagonal()[cls.free] ** 2))
        largest = np.maximum(u.max(axis=0), -u.min(axis=0))
        square += stiff * float(largest @ largest)
    unit = ROUNDED * float(np.finfo(np.float64).eps)
    return unit * float(np.sqrt(problem.comm.allreduce(square)))


def _largest_displacement(problem: DualProblem, displacements: list[NDArray[np.float64]]) -> float:
    squares = [
        (u[:, members].reshape(-1, problem.dimension, u[:, members].shape[1]) ** 2)
        .sum(axis=1)
        .max()
        for cls, u in zip(problem.classes, displacements, strict=True)
        for members in cls.batches()
    ]
    return float(np.sqrt(_max(problem.comm, np.array(squares))))


def _load(
    problem: DualProblem, multiplier: NDArray[np.float64], contact_forces: NDArray[np.float64]
) -> float:
    """Largest of the sums of magnitudes of loads, reactions of held rows and contact forces."""
    held = problem.kinds == RowKind.DIRICHLET
    sums = np.array(
        [
            sum(float(np.abs(f).sum()) for f in problem.forces),
            float(np.abs(multiplier[held]).sum()),
            float(np.abs(contact_forces).sum()),
        ]
    )
    for cls, lift in zip(problem.classes, problem.lifting, strict=True):
        if lift.any():
            sums[1] += float(np.abs(cls.stiffness @ lift).sum())
    return float(problem.comm.allreduce(sums).max())


def _max(comm: MPI.Intracomm, *arrays: NDArray[np.float64]) -> float:
    """Largest value on all ranks, zero of nothing; NaN wins."""
    local = [float(a.max()) for a in arrays if a.size]
    gathered = np.array([v for part in comm.allgather(local) for v in part] or [0.0])
    return float(gathered.max())
