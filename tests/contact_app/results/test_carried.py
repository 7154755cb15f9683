"""Bodies that slide wherever friction acts on them: `contact_app.results.carried`."""

import pytest

from contact_app.run.solve import solve_scene
from tests import scenes

ON_FLOOR, PUSHED = 0.3, 0.1


def between_rough_sides(above: float) -> scenes.Config:
    """A block on a rough floor, pressed and pushed by a slab with a coefficient of friction."""
    slab = {"plane": {"point": [1, 1], "normal": [0, -1]}}
    floor = {"plane": {"point": [0, 0], "normal": [0, 1]}}
    return {
        "dimension": 2,
        "bodies": [scenes.box("block", [2, 1], [6, 4]), {"name": "slab", "rigid": slab}],
        "conditions": [{"in": "slab", "displacement": [PUSHED, -0.001], "rotation": 0}],
        "contacts": [
            {"on": "block.y-", "obstacle": floor, "friction": {"coulomb": ON_FLOOR}},
            {"on": "block.y+", "against": "slab", "friction": {"coulomb": above}},
        ],
    }


@pytest.mark.parametrize("method", ["active-set", "primal"])
@pytest.mark.parametrize(("above", "open_"), [(ON_FLOOR, True), (0.2, False)])
def test_a_block_between_equally_rough_sides_is_carried_by_either(
    above: float, open_: bool, method: str
) -> None:
    """With less friction above, the block rests on the floor."""
    made = {**between_rough_sides(above), "solver": {"method": method}}
    summary = solve_scene(scenes.build(made)).summary
    assert summary["certificate"]["passed"]
    found = [w for w in summary["certificate"]["warnings"] if "wherever friction acts" in w]
    assert len(found) == open_
    if open_:
        reach = float(found[0].split("by up to ")[1].split()[0])
        assert 0.9 * PUSHED < reach < PUSHED
        assert found[0].startswith("block slides")
        assert "along +x" in found[0]
