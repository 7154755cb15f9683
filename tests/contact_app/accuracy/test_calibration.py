"""Calibration of estimates by the energies of a run's meshes: never below the error."""

import numpy as np
import pytest

from contact_app.accuracy.estimate.calibration import LEAST, UNCERTAIN, Calibration, conforms
from contact_app.accuracy.refine.levels import Refined
from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from tests import scenes
from tests.contact_app.accuracy.test_refinement import DATA, shipped
from tests.contact_app.model.test_two_bodies import stack

CUBE = -0.51237
"""J(u) of the paper's cube, extrapolated from meshes of 10³, 20³ and 40³ cells (`contact-app
effectivity`); those of 6³, 12³ and 24³ of degree 2 tell -0.512364, by which 3 % would be 2.98 %."""

CANTILEVER = -0.568692
"""J(u) of the packaged cantilever: the energy of a run to 0.3 % minus its estimated squared
error."""


def packaged(name: str, cells: list[int], accuracy: float) -> Scene:
    made = [f"bodies.0.mesh.box.cells={cells}", f"accuracy={accuracy}", "decomposition=auto"]
    return scenes.read(DATA / f"{name}.yaml", made)


def cube(accuracy: float) -> Scene:
    return packaged("paper_cube", [4, 4, 4], accuracy)


def measured(found: Refined, exact: float) -> float:
    """The relative error from the energy of an answer."""
    energy = found.solved.summary["solution"]["energy"]
    return float(np.sqrt(2.0 * (energy - exact) / found.solved.accuracy.square))


@pytest.mark.parametrize("multiple", [0.9, 1.0, 1.3, 1.4, 2.0])
def test_a_steady_multiple_is_found(multiple: float) -> None:
    """Estimates are lowered to the error up to the uncertainty, never raised, and never halved."""
    energy, made = -3.0, Calibration()
    shares = []
    for error in (0.5, 0.2, 0.1, 0.05):
        shares.append(made.share("graded", energy + 0.5 * error**2, (multiple * error) ** 2))
    assert shares[0] == 1.0, "one mesh says nothing"
    quotient = 1.0 / multiple**2
    expected = min(UNCERTAIN * quotient, 1.0) if quotient > LEAST else 1.0
    assert shares[1:] == pytest.approx([expected] * 3)


def test_levels_that_cannot_be_compared_are_not() -> None:
    """Cells of another kind, meshes with nearly the same error, energies that rise."""
    made = Calibration()
    assert made.share("equal", 1.0, 4.0) == 1.0
    assert made.share("graded", 0.5, 1.0) == 1.0
    assert made.share("graded", 0.4, 0.5) == 1.0
    assert made.share("graded", 0.3, 0.2) == pytest.approx(UNCERTAIN * 2 * 0.1 / 0.3)
    assert made.share("graded", 0.31, 0.05) == 1.0


def test_the_most_cautious_quotient_counts() -> None:
    """A multiple that falls on finer meshes makes quotients too small: the first stays."""
    made = Calibration()
    shares = [
        made.share("graded", 0.5 * e**2, (m * e) ** 2)
        for e, m in ((4.0, 1.35), (2.0, 1.35), (1.0, 1.2), (0.5, 1.1))
    ]
    first = UNCERTAIN / 1.35**2
    assert shares[1:3] == pytest.approx([first] * 2), "not 0.94 of it"
    assert shares[3] > first


def _conforms(scene: Scene) -> bool:
    return conforms(scene.bodies, scene.touching)


def test_only_meshes_whose_energies_are_above_the_true_one() -> None:
    assert _conforms(cube(0.1))
    assert _conforms(shipped("flat_punch", "accuracy=0.1"))
    assert not _conforms(shipped("sphere", "accuracy=0.1")), "gaps at nodes of a round obstacle"
    assert not _conforms(shipped("bracket", "accuracy=0.1")), "meshes from files"
    assert not _conforms(scenes.build(stack("hexahedron", "hexahedron", (2, 3)))), "two bodies"
    assert not _conforms(shipped("cube", "bodies.0.mean_dilatation=true")), "another energy"


def test_a_run_ends_where_the_error_does() -> None:
    """The cube to 3 %: estimates on graded cells are 1.3 to 1.4 times the error, and energies
    correct them."""
    found = solve_to_accuracy(cube(0.03), solve_scene)
    assert not found.missed
    last, accuracy = found.levels[-1], found.solved.accuracy
    assert last.calibration < 0.9
    assert accuracy.discretisation == last.discretisation
    error = measured(found, CUBE)
    assert error < 0.03
    assert 0.95 < last.total / error < 1.3
    assert last.total / last.calibration / error > 1.3, "the estimate alone is farther off"
    assert last.dofs < 8_000
    assert found.levels[0].calibration == found.levels[1].calibration == 1.0


@pytest.mark.parametrize("accuracy", [0.1, 0.05, 0.02])
def test_where_estimates_come_closer_on_the_way_targets_are_met(accuracy: float) -> None:
    """The cantilever: 1.3 times the error on the first mesh of degree 2, 1.05 on the next."""
    found = solve_to_accuracy(packaged("cantilever", [8, 8], accuracy), solve_scene)
    assert not found.missed
    assert 0.6 * accuracy < measured(found, CANTILEVER) < accuracy
