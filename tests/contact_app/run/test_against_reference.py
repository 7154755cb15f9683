"""The application's answer is that of the undecomposed problem solved by other means.

Each scene is solved with a tolerance of 1e-9 and compared with the active-set reference: energy
to 1e-8, displacement to 1e-7 of the largest, contact forces to 1e-6 of the load. Scenes that may
slide have a unique energy and strain only, so their displacement is compared in the energy norm.
"""

import numpy as np
import pytest

from tests import scenes
from tests.comparison import in_order_of, in_space, reference_of, same_displacement, solve
from tests.rows import covering

ENERGY, DISPLACEMENT, FORCE = 1e-8, 1e-7, 1e-6

SPLITS_3D = (1, [2, 2, 2], [3, 3, 3], [2, 1, 3], 8, 27)
SPLITS_2D = (1, [2, 2], [3, 3], [1, 3], 4, 9)


def check(name: str, cell: str, n: int, subdomains: int | list[int]) -> None:
    solution = solve(scenes.ALL[name](cell, n), subdomains)
    known = reference_of(name, cell, n)
    summary = solution.summary
    assert summary["solver"]["converged"], summary["solver"]["reason"]
    assert summary["certificate"]["passed"], summary["certificate"]

    found = summary["solution"]
    energy_scale = max(abs(known.energy), 0.5 * abs(known.u.ravel() @ known.system.load))
    assert found["energy"] == pytest.approx(known.energy, rel=0, abs=ENERGY * energy_scale)

    u = in_order_of(known, solution)
    largest = np.linalg.norm(known.u, axis=1).max()
    strain_energy = known.u.ravel() @ (known.system.stiffness @ known.u.ravel())
    assert np.sqrt(max(known.energy_error(u), 0.0)) < 1e-6 * np.sqrt(strain_energy)
    if name not in scenes.SLIDING:
        np.testing.assert_allclose(u, known.u, rtol=0, atol=DISPLACEMENT * largest)
        assert found["max_displacement"] == pytest.approx(largest, rel=1e-6)
        mean = np.linalg.norm(known.u, axis=1).mean()
        assert found["mean_displacement"] == pytest.approx(mean, rel=1e-6)

    load = max(np.abs(known.contact_force).max(), np.abs(known.system.load).sum())
    np.testing.assert_allclose(
        found["contact_force"], in_space(known.contact_force), rtol=0, atol=FORCE * load
    )
    held = known.system.dimension * known.points.shape[0]
    assert summary["mesh"]["dofs"] == held
    assert summary["mesh"]["nodes"] == known.points.shape[0]


@pytest.mark.parametrize(("name", "cell"), covering(scenes.ALL, scenes.CELLS_3D))
def test_eight_subdomains(name: str, cell: str) -> None:
    check(name, cell, 4, [2, 2, 2])


@pytest.mark.parametrize(
    ("name", "cell"), covering([n for n in scenes.ALL if n not in scenes.ONLY_3D], scenes.CELLS_2D)
)
def test_four_subdomains(name: str, cell: str) -> None:
    check(name, cell, 4, [2, 2])


@pytest.mark.parametrize("name", scenes.ALL)
def test_one_subdomain(name: str) -> None:
    """Held unknowns may be eliminated instead of being rows of B."""
    check(name, "hexahedron", 3, 1)


@pytest.mark.parametrize(
    ("subdomains", "cell", "name"),
    covering(SPLITS_3D, scenes.CELLS_3D, ["wall", "floating_in_corner"], together=2),
    ids=str,
)
def test_any_split_in_space(name: str, cell: str, subdomains: int | list[int]) -> None:
    check(name, cell, 6 if cell == "hexahedron" else 3, subdomains)


@pytest.mark.parametrize(
    ("subdomains", "cell", "name"),
    covering(SPLITS_2D, scenes.CELLS_2D, ["wall", "floating_in_corner"], together=2),
    ids=str,
)
def test_any_split_in_the_plane(name: str, cell: str, subdomains: int | list[int]) -> None:
    check(name, cell, 6, subdomains)


@pytest.mark.parametrize("name", ["wall", "sliding"])
def test_a_split_that_does_not_divide_the_cells(name: str) -> None:
    check(name, "hexahedron", 5, [2, 3, 1])


@pytest.mark.parametrize("name", ["floating_in_corner", "wall"])
@pytest.mark.parametrize("cell", scenes.CELLS_2D)
def test_plane_stress(name: str, cell: str) -> None:
    from tests import reference

    made = scenes.ALL[name](cell, 4)
    made["dimension"] = "plane_stress"
    known = reference.solve(scenes.build(made))
    solution = solve(made, [2, 2])
    assert solution.summary["solution"]["energy"] == pytest.approx(known.energy, rel=ENERGY)
    same_displacement(known, solution, DISPLACEMENT)
    strain = reference_of(name, cell, 4)
    assert abs(strain.energy / known.energy - 1) > 1e-3, "plane stress must differ from strain"


@pytest.mark.parametrize("expansion", ["fixed", "gfgr-optapprox", "gfgf-opt", "projcg"])
def test_every_expansion_finds_the_same_answer(expansion: str) -> None:
    known = reference_of("two_planes", "hexahedron", 4)
    solution = solve(scenes.two_planes("hexahedron", 4), [2, 2, 2], expansion=expansion)
    assert solution.summary["solution"]["energy"] == pytest.approx(known.energy, rel=ENERGY)


def test_active_contacts_are_counted() -> None:
    """The wall's scene is strictly complementary, so that the count is well defined."""
    known = reference_of("wall", "hexahedron", 4)
    solution = solve(scenes.wall("hexahedron", 4), [2, 2, 2])
    assert solution.summary["solution"]["active_contacts"] == known.active
