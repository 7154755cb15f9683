"""The trial parts, on which the choice of a method is measured."""

from pathlib import Path

import pytest

from contact_app.run.solve import solve_scene
from meshes.samples import make_trials as trials
from tests import scenes


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, 2])
def test_trial_parts_are_scenes(tmp_path: Path, degree: int) -> None:
    """Coarse ones: every boundary has facets, and every tetrahedron a volume."""
    for name in trials.TRIALS:
        path = trials.write(name, 1.8, tmp_path)
        scene = scenes.read(path, [f"bodies.0.degree={degree}"])
        assert not scene.bodies[0].mesh.congruent
        assert len(scene.contacts) == len(trials.TRIALS[name](1.8).contacts)


def test_a_trial_part_is_solved_to_a_certificate_with_some_of_its_nodes_open(
    tmp_path: Path,
) -> None:
    for friction in (None, 0.3):
        scene = scenes.read(trials.write("eye_on_pin", 2.5, tmp_path, friction))
        assert scene.has_friction == (friction is not None)
        found = solve_scene(scene).summary
        assert found["certificate"]["passed"]
        nodes = found["contacts"][0]["nodes"]
        assert nodes["open"] > 0
        assert nodes["slip"] > 0


@pytest.mark.parametrize("size", [3.0, 4.0])
def test_a_load_on_one_side_does_not_turn_the_ring(tmp_path: Path, size: float) -> None:
    """Nothing resists its turn on the shaft; 76 facets around make 25 and 19 of these sizes."""
    scene = scenes.read(trials.write("ring_on_shaft", size, tmp_path))
    assert solve_scene(scene).summary["certificate"]["passed"]
