"""Feasible neighbours of an approximate solution, primal and dual.

The dual solution is made exactly admissible (λ_I ≥ 0, Gλ = e), the primal one too (glued, held,
no penetration). Between two admissible points weak duality leaves a gap that bounds the error.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from solver.tfeti.dual import DualProblem

ROUNDS = 40
"""Corrections tried; a solver's iterate needs two or three."""

OPEN_WEIGHT = 1e-3
"""Root of the share of a correction that an open contact row takes beside touching ones."""


def feasible_multiplier(
    problem: DualProblem, x: NDArray[np.float64], touching: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """λ = λ̃ + x made admissible: zero on contact rows that do not touch, nowhere negative, Gλ = e.

    What is missing in Gλ = e is put on the rows that hold with equality, gluing, held and
    touching contact rows; where those cannot carry it (a body kept by too few touching rows) open
    contact rows take a small share.

    Parameters
    ----------
    x : (dual,)
        Homogenised multiplier.
    touching : (dual,)
        Contact rows whose multiplier is above its bound.
    """
    multiplier = problem.offset + x
    multiplier[problem.inequality & ~touching] = 0.0
    if problem.coarse is None:
        return np.where(problem.inequality, np.maximum(multiplier, 0.0), multiplier)
    return _balance(problem, multiplier, problem.inequality & ~touching)


def _balance(
    problem: DualProblem, multiplier: NDArray[np.float64], open_rows: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Add W Gᵀ (G W Gᵀ)⁻¹ (e - Gλ) with small weights on open rows until Gλ = e and λ_I ≥ 0.

    Open rows are emptied again after each correction, as long as the others can carry it.
    """
    assert problem.coarse is not None
    root = np.where(open_rows, OPEN_WEIGHT, 1.0)
    coarse = problem.coarse.weighted(root)
    missing, solution = np.empty(len(problem.e)), np.empty(len(problem.e))
    change = np.empty(problem.size)
    tolerance = 1e-13 * max(
        largest_magnitude(problem.comm, problem.e), largest_magnitude(problem.comm, multiplier)
    )
    for attempt in range(2 * ROUNDS):
        empty = problem.inequality & (multiplier < 0.0)
        if attempt < ROUNDS:
            empty |= open_rows
        multiplier[empty] = 0.0
        problem.coarse.restrict(multiplier, missing)
        np.subtract(problem.e, missing, out=missing)
        if largest_magnitude(problem.comm, missing) <= tolerance:
            break
        coarse.solve(missing, solution)
        coarse.extend(solution, change)
        change *= root
        multiplier += change
    multiplier[problem.inequality & (multiplier < 0.0)] = 0.0
    return multiplier


def feasible_displacements(
    problem: DualProblem, displacements: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The admissible û nearest to u, both on the interface, and B û - c.

    B has orthonormal rows, so û = u - Bᵀ v with v the violation is the projection onto the
    admissible set; where contact rows are not orthogonal it is repeated, damped. Inside the
    subdomains û = u.
    """
    damping = _overlap(problem)
    repaired = displacements.copy()
    residual = problem.residual(repaired)
    tolerance = 1e-15 * max(1e-300, largest_magnitude(problem.comm, displacements))
    previous = np.inf
    for _ in range(200):
        violation = np.where(problem.inequality, np.maximum(residual, 0.0), residual)
        size = largest_magnitude(problem.comm, violation)
        if size <= tolerance or size > 0.99 * previous:
            break
        repaired -= problem.constraint_forces(violation / damping)
        residual = problem.residual(repaired)
        previous = size
    return repaired, residual


def _overlap(problem: DualProblem) -> NDArray[np.float64]:
    """Row sums of |B Bᵀ| over contact rows, 1 for other rows.

    They bound what the corrections of rows that are not orthogonal add up to.
    """
    result = np.ones(problem.size)
    B = problem.B.matrix
    first = B.getOwnershipRange()[0]
    rows = (first + np.flatnonzero(problem.inequality)).astype(PETSc.IntType)
    columns = np.arange(*B.getOwnershipRangeColumn(), dtype=PETSc.IntType)
    contact = B.createSubMatrix(
        *(PETSc.IS().createGeneral(i, comm=problem.comm) for i in (rows, columns))
    )
    product = contact.matMult(contact.transpose(PETSc.Mat()))
    starts, _, values = product.getValuesCSR()
    sums = np.bincount(
        np.repeat(np.arange(len(rows)), np.diff(starts)), np.abs(values), minlength=len(rows)
    )
    result[problem.inequality] = np.maximum(sums, 1.0)
    return result


def largest_magnitude(comm: MPI.Intracomm, *arrays: NDArray[np.float64]) -> float:
    """Largest magnitude on all ranks."""
    local = max((float(np.abs(a).max()) for a in arrays if a.size), default=0.0)
    return float(comm.allreduce(local, op=MPI.MAX))
