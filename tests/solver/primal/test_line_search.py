"""The step along which the energy of springs is least."""

import numpy as np
import pytest
from mpi4py import MPI

from solver.primal.line_search import minimum_along


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("yielding", [False, True])
def test_line_search_finds_the_least_energy(yielding: bool, seed: int) -> None:
    """Springs that only press, and springs along one slip that yield.

    Beyond its limit s a spring that yields has the energy s |p| - ½ s², and ½ p² below.
    """
    random = np.random.default_rng(seed)
    force, image, start, rate = random.normal(size=(4, 9))
    stiffness, limit = random.uniform(0.1, 10.0, 9), random.uniform(0.1, 1.0, 9)
    curvature = random.uniform(0.1, 10.0)
    slope = -abs(random.normal()) - 20.0 - float(image @ np.maximum(force, 0.0))

    def energy(t: float) -> float:
        pressed = np.maximum(force + t * stiffness * image, 0.0)
        size = np.abs(start + t * rate)
        slips = np.where(size > limit, limit * size - 0.5 * limit**2, 0.5 * size**2)
        springs = float(pressed**2 @ (0.5 / stiffness)) + yielding * float(slips.sum())
        return slope * t + 0.5 * curvature * t**2 + springs

    def rest(t: float) -> tuple[float, float]:
        p = start + t * rate
        inside = yielding * (np.abs(p) <= limit)
        pull = yielding * float(rate @ np.clip(p, -limit, limit))
        return slope + curvature * t + pull, curvature + float(rate @ (rate * inside))

    t = minimum_along(MPI.COMM_SELF, rest, force, stiffness * image, image)
    assert t > 0.0
    assert energy(t) <= min(energy((1.0 - 1e-4) * t), energy((1.0 + 1e-4) * t))
