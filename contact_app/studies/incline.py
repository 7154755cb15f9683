"""Statics of a block on an incline, as `contact-app verify` measures it.

A block rests on an incline as long as tan α < μ, and slides up it under a level force F from
F/G = (tan α + μ)/(1 - μ tan α) on. Whether equilibrium exists is decided before solving. Both
limits follow from this decision by bisection: the first one by turning the weight, the second one
by the run's own search for the load factor at which a step has no equilibrium. A third number is
the ratio of friction force and normal force in the solution just below the second limit: (F/G cos α
- sin α)/(cos α + F/G sin α).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from contact_app.errors import NoEquilibriumError
from contact_app.model.outline import outline_of_scene
from contact_app.run.increments import SolvedIncrement
from contact_app.run.step_equilibrium import leaving_in_step
from contact_app.scene.scene import LoadStep, Scene
from contact_app.studies.hertz import Quantity

DIGITS = 1e-6
"""Accuracy of the limits."""


def incline(increments: Sequence[SolvedIncrement]) -> list[Quantity]:
    """A block that rests on an incline and is pushed up to just below its limit."""
    scene = increments[-1].solved.model.scene
    mu, weight = scene.contacts[0].law.coefficient, np.array(scene.forces[0].vector)
    slope, push = float(weight[0] / weight[1]), increments[-1].factors["push"]
    limit = (slope + mu) / (1.0 - mu * slope)
    force = increments[-1].solved.summary["contacts"][0]["force"]
    return [
        Quantity("tan α that slides down", _steepest(scene), mu),
        Quantity("F/G that slides up", _pushed(scene, push), limit),
        Quantity("friction over pressure", abs(force[0] / force[1]),
                 (push - slope) / (1.0 + push * slope)),
    ]  # fmt: skip


def _steepest(scene: Scene) -> float:
    """Tangent of the angle up to which the block rests under its weight."""
    rests, slides = 0.0, 2.0
    while slides - rests > DIGITS * slides:
        tried = 0.5 * (rests + slides)
        forces = (replace(scene.forces[0], vector=(-tried, -1.0)),)
        try:
            outline_of_scene(replace(scene, forces=forces), MPI.COMM_SELF, needed="distinct")
            rests = tried
        except NoEquilibriumError:
            slides = tried
    return 0.5 * (rests + slides)


def _pushed(scene: Scene, push: float) -> float:
    """F/G at which a step to twice the push has no equilibrium any more."""
    start = (("weight", 1.0), ("push", 0.0))
    steps = (LoadStep(start, 1), LoadStep((("weight", 1.0), ("push", 2.0)), 1))
    history = replace(scene, steps=steps, in_step=False)
    leaves = NoEquilibriumError(f"{scene.source}: the block slides")
    error = leaving_in_step(history, 1, MPI.COMM_SELF, None, leaves, DIGITS)
    return 2.0 * push * error.share
