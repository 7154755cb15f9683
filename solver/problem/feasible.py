"""Admissible displacements near approximate ones: glued, held, without penetration.

By weak duality the difference of their energy and that of admissible multipliers, the duality gap,
bounds the error.
"""

import numpy as np

from solver.distributed import lent
from solver.problem.decomposed import DecomposedProblem
from solver.vectors import Array, Mask, largest_magnitude

CLOSED = 1e-14
"""Jumps and penetrations, over the largest displacement, up to which rows count as closed. With
1e-15 the rounding errors of rows of 50 entries do not count as such."""

MOST_STEPS = 200
"""Largest number of conjugate gradient steps to close jumps; tied surfaces take 20 to 50."""

DIVERGED = 1e4
"""Square of the jumps over the least so far at which these steps end: where tied rows depend on one
another, rounding errors that no displacement closes grow for ever."""


def feasible_displacements(
    problem: DecomposedProblem,
    displacements: Array,
    closed: Mask | None = None,
    rest: float = 0.0,
    sliding: Mask | None = None,
) -> tuple[Array, Array]:
    """The admissible û nearest to u, both on the interface, and B û - c.

    B has orthonormal rows, so û = u - Bᵀ v with v the violation is the projection onto the
    admissible set; if contact rows are not orthogonal, damped projections are repeated. Inside the
    subdomains û = u. Rigid bodies do not move; the other bodies are corrected.

    Parameters
    ----------
    displacements : (interface,)
        u `without_jumps` of tied rows, which are not orthogonal, either, and many.
    closed : (dual,)
        Contact rows whose gaps are closed as well, as far as û remains admissible.
    rest
        Share of the largest violation that may be left.
    sliding : (dual,)
        Tangential rows that may have any slip; None where there are none.
    """
    change, repaired = np.empty_like(displacements), displacements.copy()
    tolerance = CLOSED * max(1e-300, largest_magnitude(problem.comm, displacements))
    residual = problem.residual(repaired)
    one_sided = problem.inequality if closed is None else problem.inequality & ~closed
    for rows in (one_sided, problem.inequality)[closed is None :]:
        previous = np.inf
        for attempt in range(200):
            violation = np.where(rows, np.maximum(residual, 0.0), residual)
            if sliding is not None:
                violation[sliding] = 0.0
            size = largest_magnitude(problem.comm, violation)
            if attempt == 0:
                tolerance = max(tolerance, rest * size)
            if size <= tolerance or size > 0.99 * previous:
                break
            problem.deforming.apply_transpose(violation / problem.overlap, change)
            repaired -= change
            residual = problem.residual(repaired)
            previous = size
    return repaired, residual


def without_jumps(problem: DecomposedProblem, displacements: Array) -> Array:
    """The û nearest to u with B û = c on tied and mean rows, on the interface (collective).

    û = u - Bᵀ (B Bᵀ)⁻¹ (B u - c) on these rows by conjugate gradients. B Bᵀ is much like the mass
    matrix of the tied surface.
    """
    comm = problem.comm
    if not comm.allreduce(int((problem.tied | problem.means).any())):
        return displacements
    closed = ~problem.conditional[problem.overlapping]
    residual = np.where(closed, problem.residual(displacements)[problem.overlapping], 0.0)
    tolerance = CLOSED * max(1e-300, largest_magnitude(comm, displacements))
    direction, image = residual.copy(), np.empty_like(residual)
    total = np.zeros_like(residual)
    least = square = comm.allreduce(float(residual @ residual))
    best = total.copy()
    with lent(comm, direction, image) as (source, target):
        for _ in range(MOST_STEPS):
            if largest_magnitude(comm, residual) <= tolerance or square > DIVERGED * least:
                break
            problem.products.mult(source, target)
            image[~closed] = 0.0
            curvature = comm.allreduce(float(direction @ image))
            if not curvature > 0.0:
                break
            length = square / curvature
            total += length * direction
            residual -= length * image
            before, square = square, comm.allreduce(float(residual @ residual))
            if square < least:
                least = square
                np.copyto(best, total)
            direction *= square / before
            direction += residual
    multiplier, change = np.zeros(problem.size), np.empty_like(displacements)
    multiplier[problem.overlapping] = best
    problem.deforming.apply_transpose(multiplier, change)
    return displacements - change


def worth_closing(problem: DecomposedProblem, multiplier: Array, residual: Array) -> Mask:
    """Mask (dual,) of contact rows whose open gap adds more to the duality gap than closing it.

    An open row adds λ_i |r_i| to the duality gap. Closing all rows, w = Bᵀ r, adds ½ wᵀ K w, and
    the share of a row is ½ r_i (B K w)_i.

    Parameters
    ----------
    multiplier, residual : (dual,)
        λ and r = B u - c.
    """
    opened = problem.inequality & (multiplier > 0.0) & (residual < 0.0)
    gaps = np.where(opened, residual, 0.0)
    motion, force = np.empty((2, problem.B.columns))
    problem.deforming.apply_transpose(gaps, motion)
    for cls, part in zip(problem.classes, problem.slices, strict=True):
        moved = motion[part].reshape(cls.members, -1)
        shared = force[part].reshape(cls.members, -1)
        for members in cls.batches():
            shared[members] = (cls.interface_stiffness @ moved[members].T).T
    share = np.empty(problem.size)
    problem.B.apply(force, share)
    return opened & (-multiplier * gaps > 0.5 * gaps * share)


def motion_energies(problem: DecomposedProblem, motion: Array) -> Array:
    """½ wᵀ K w of each body on this rank, (bodies,), w zero inside the subdomains.

    Parameters
    ----------
    motion : (interface,)
        w on the interface.
    """
    energies = []
    for cls, part in zip(problem.classes, problem.slices, strict=True):
        moved, energy = motion[part].reshape(cls.members, -1), np.empty(cls.members)
        for members in cls.batches():
            some = moved[members].T.copy()
            energy[members] = 0.5 * np.einsum("im,im->m", some, cls.interface_stiffness @ some)
        energies.append(energy)
    return problem.bodies.sum_members(energies)
