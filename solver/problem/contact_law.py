"""The contact law of a decomposed problem."""

import numpy as np

from solver.contact.friction_law import Friction, FrictionOptions
from solver.contact.law import ContactLaw
from solver.contact.slip_front import SlipFront
from solver.problem.decomposed import DecomposedProblem
from solver.vectors import largest_magnitude

FLAT = 1e-12
"""Gaps, over the largest coordinate, that count as zero."""

SURE = 0.3
"""Share of the tolerance that the friction numbers have to meet before an answer is certified: at
1e-6 displacements are then right to 9e-7, and to 3e-6 with a share of one."""


def contact_law(problem: DecomposedProblem) -> ContactLaw:
    """The law of the contacts of a problem."""
    points = problem.friction
    if not points.acts:
        return ContactLaw()
    options, shared_compliance = FrictionOptions(), None
    stiffness = problem.row_stiffness(problem.tangential)
    if problem.comm.allreduce(len(points.shared)):
        shared_compliance = options.sticking_compliance / stiffness
    held = problem.held_without_contact
    front = SlipFront(points, problem.comm, held)
    gaps = np.zeros(problem.size)
    gaps[problem.inequality] = problem.contact.gaps
    size = largest_magnitude(problem.comm, problem.contact.points)
    has_gap = gaps[points.normals[points.first]] > FLAT * size
    return Friction(
        points=points,
        comm=problem.comm,
        stiffness=points.mean(stiffness * points.spread**2),
        shared_compliance=shared_compliance,
        has_gap=has_gap,
        front=front,
        options=options,
        may_vanish=held,
    )
