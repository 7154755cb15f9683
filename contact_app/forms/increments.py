"""Increments of a load history of forms: slip is measured from the displacement of the last one.

The answer of an increment may depend on its size (`contact_app.run.coarse_increments`). It is
compared with that of two halves, as a step of one increment of a scene.
"""

from dataclasses import replace

import numpy as np

from contact_app.forms.model import FormModel
from contact_app.forms.results import Owners
from contact_app.results.friction import closing_points
from contact_app.run.coarse_increments import UNFINISHED
from contact_app.run.fallback import FAILURES
from contact_app.run.other_increments import change_to, loosely
from contact_app.run.path_dependence import CLOSING
from meshes.arrays import Array
from solver.contact.options import SolverOptions
from solver.contact.solution import Solution
from solver.driver import solve
from solver.qp.result import Monitor
from solver.tfeti.dual import DualProblem


def following(model: FormModel, displacement: Array) -> FormModel:
    """The model with slip measured from a displacement (collective).

    Motions that no force determines are the least from there.

    Parameters
    ----------
    displacement : (nodes, dimension)
        At the nodes of the space on this rank, including ghosts.
    """
    owned = Owners.of_parts(model).at(displacement[model.parts.blocks])
    copies = Owners.of_subdomains(model).copies(owned)
    begin = [np.zeros_like(forces) for forces in model.problem.forces]
    for number, (cls, column) in enumerate(model.place):
        begin[cls][:, column] = copies[model.subdomains.copies(number)].ravel()
    problem = model.problem.with_least_motion_from(begin).with_slip_from(begin)
    return replace(model, problem=problem)


def differs_in_halves(
    before: DualProblem,
    now: DualProblem,
    solution: Solution,
    options: SolverOptions,
    monitor: Monitor | None,
) -> str:
    """A warning if two half increments have another answer; empty otherwise (collective).

    Loads, held displacements and gaps of the middle are the means of both ends.

    Parameters
    ----------
    before
        The problem of the last increment, with the same rows.
    options
        Those that led to the answer.
    """
    begin, loads = list(now.load_case.displacements_before), now.load_case
    changed, touching = closing_points(now, solution, begin)
    if not solution.converged or changed <= CLOSING * touching:
        return ""
    why = f"{changed:,} of {touching:,} contact points with friction close or open in it"
    forces, lifting = (
        [0.5 * (one + other) for one, other in zip(*ends, strict=True)]
        for ends in ((before.forces, now.forces), (before.lifting, loads.lifting))
    )
    middle = now.with_loads(forces, lifting, 0.5 * (before.c + now.c), loads.thermal)
    middle = middle.with_least_motion_from(begin).with_slip_from(begin)
    options, monitor = loosely(options, solution, monitor)
    try:
        first = solve(middle, options, monitor)
        second = solve(
            now.with_slip_from(first.displacements), options, monitor, start=solution.guess
        )
        finished = first.converged and second.converged
    except FAILURES:
        finished = False
    if not finished:
        return UNFINISHED.format(of="this increment", other="two half increments", reasons=why)
    change = change_to(now, solution, second.multiplier, second.displacements)
    if not change.matters:
        return ""
    return f"halving this increment changes {change} ({why}): apply the loads in more increments"
