"""Belts around drums and turned rings: known solutions, and belts that friction alone holds."""

import math
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from contact_app.run.solve import solve_scene
from contact_app.studies.round_friction import BELT, PULL, write_belt
from contact_app.studies.verification import find, study
from solver.qp.result import Reason
from tests import scenes


@pytest.mark.ratchet
def test_force_of_a_sliding_belt_converges_to_that_of_euler() -> None:
    (case,) = find(["belt"])
    coarse, fine = study(case, case.levels[1:3])
    assert coarse.certified
    assert fine.certified
    assert 0.0 < fine.quantities[0].error < coarse.quantities[0].error / 3.0
    assert fine.quantities[0].error < 0.01


def test_moment_of_a_turned_ring_is_exact() -> None:
    (case,) = find(["turned_ring"])
    (row,) = study(case, case.levels[:1])
    assert row.certified
    assert row.quantities[0].error == pytest.approx(0.0, abs=1e-6)


def _pulled_at_both_ends(directory: Path, share: float) -> Any:
    """A belt whose forces have this share of the ratio at which it slides."""
    file = write_belt(directory / "belt.vtu", 60)
    force = share * PULL * math.exp(0.4 * 0.5 * math.pi)
    ends = [f"{{on: ring.moved, total_force: [0, {-force}]}}",
            f"{{on: ring.pulled, total_force: [{-PULL}, 0]}}"]  # fmt: skip
    overrides = [*BELT, f"bodies.0.mesh.file={file}", f"conditions=[{', '.join(ends)}]"]
    scene = scenes.read("thick_ring", overrides)
    return solve_scene(scene, MPI.COMM_SELF)


@pytest.mark.ratchet
@pytest.mark.parametrize("share", [0.7, 0.95])
def test_belt_held_by_friction_alone_slides_to_both_ends(tmp_path: Path, share: float) -> None:
    solved = _pulled_at_both_ends(tmp_path, share)
    assert solved.solution.converged
    nodes = solved.summary["contacts"][0]["nodes"]
    assert nodes["stick"] == 1
    assert nodes["open"] == 0
    assert solved.summary["solver"]["hessian_multiplications"] <= 150


@pytest.mark.ratchet
def test_belt_that_friction_does_not_hold_ends_soon_with_the_reason(tmp_path: Path) -> None:
    solved = _pulled_at_both_ends(tmp_path, 1.05)
    assert not solved.solution.converged
    assert solved.solution.reason is Reason.SLIDES
    assert solved.summary["solver"]["hessian_multiplications"] <= 150
