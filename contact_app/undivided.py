"""Scenes whose subdomains leave the dual problem no digits, and the few that are tried instead.

Cells a hundred times longer than wide, cut into subdomains, make forces between them that cancel to
the last digit of the answer: conjugate gradients end at rounding errors, or run on for more steps
than there are multipliers, which in exact arithmetic is the most they take. Solved whole the same
body has its held unknowns eliminated, and contact rows alone are left to the dual problem.
"""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

from contact_app.memory import available_bytes, needed_bytes
from contact_app.model import Model
from contact_app.scene import Decomposition, Scene
from contact_app.solution import Solution
from solver import Reason

STEPS = 10
"""Steps over the rows of B after which a limit on steps is not what ended a solve."""


def undivided(model: Model, solution: Solution, max_iterations: int) -> Scene | None:
    """The scene in as few subdomains as bodies and ranks allow (collective).

    None where the solver did what was asked, was told to stop, or where the scene has no fewer
    subdomains, or no memory for them.
    """
    comm, scene, partition = model.comm, model.scene, model.partition
    fewest = max(len(scene.bodies), comm.size)
    if solution.converged or solution.reason is Reason.STOPPED or partition.count <= fewest:
        return None
    rows = comm.allreduce(model.problem.size)
    if solution.reason is Reason.MAX_ITERATIONS and max_iterations < STEPS * rows:
        return None
    sizes = [scene.dimension * body.nodes for body in scene.bodies]
    factors = tuple((size, scene.dimension) for size in sizes)
    available = comm.allreduce(available_bytes(), op=MPI.MIN)
    if needed_bytes(sum(sizes), rows=0, factors=factors) > available:
        return None
    return replace(scene, decomposition=Decomposition(fewest))
