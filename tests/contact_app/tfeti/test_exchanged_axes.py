"""Subdomains whose axes are exchanged share the factor of one of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contact_app.run.solve import solve_scene
from solver.tfeti.subdomain.classes import SubdomainClass
from tests import scenes
from tests.scenes_on_ranks import summary_of

CELLS = ["quadrilateral", "hexahedron", "tetrahedron"]


def uneven(cell: str, degree: int = 1) -> scenes.Config:
    """A cube, or square, of three cells an edge, which two parts an edge divide into 1 and 2."""
    made = scenes.wall(cell, 3)
    made["bodies"][0]["degree"] = degree
    made["decomposition"] = {"subdomains": [2] * scenes.dimension(cell)}
    return made


def floating(made: scenes.Config) -> list[SubdomainClass]:
    problem = solve_scene(scenes.build(made)).model.problem
    return [cls for cls in problem.classes if cls.kernel.shape[1]]


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
def test_each_shape_has_one_factor(cell: str, degree: int) -> None:
    """With sizes 1 and 2 along each axis, only boxes with sizes in increasing order have their
    own."""
    d = scenes.dimension(cell)
    classes = floating(uneven(cell, degree))
    assert len(classes) == 2**d
    assert sum(cls.model is None for cls in classes) == d + 1


@pytest.mark.parametrize("cell", CELLS)
def test_the_shared_inverse_is_one(cell: str) -> None:
    """K K⁺ K = K, and the block on the interface is a part of K⁺."""
    solved = solve_scene(scenes.build(uneven(cell)))
    random = np.random.default_rng(1)
    shared = [cls for cls in solved.model.problem.classes if cls.model is not None]
    assert shared
    for cls in shared:
        force = np.asfortranarray(cls.stiffness @ random.standard_normal((cls.unknowns, 3)))
        np.testing.assert_allclose(cls.stiffness @ cls.solve(force), force, atol=1e-9 * force.max())
        load = np.zeros((cls.unknowns, 3), order="F")
        load[cls.interface] = random.standard_normal((len(cls.interface), 3))
        load -= cls.kernel @ (cls.kernel.T @ load)
        some = load[cls.interface]
        load[:] = 0.0
        load[cls.interface] = some
        found = np.empty((3, len(cls.interface)))
        cls.apply_interface(np.ascontiguousarray(some.T), found)
        np.testing.assert_allclose(
            found.T, cls.solve(load)[cls.interface], atol=1e-9 * np.abs(found).max()
        )


@pytest.mark.parametrize("cell", CELLS)
def test_the_answer_is_that_of_one_subdomain(cell: str) -> None:
    made = uneven(cell)
    cut = solve_scene(scenes.build(made)).summary
    made["decomposition"] = {"subdomains": 1}
    whole = solve_scene(scenes.build(made)).summary
    assert cut["certificate"]["passed"]
    assert cut["solution"]["energy"] == pytest.approx(whole["solution"]["energy"], rel=1e-6)


def test_other_materials_share_nothing() -> None:
    """Two bodies of one mesh, the second three times as stiff."""
    made = uneven("quadrilateral")
    first = made["bodies"][0]
    second = {**first, "name": "stiff", "material": {"young": 3e3, "poisson": 0.3}}
    assert second["material"] != first["material"]
    second["mesh"] = {"box": {**first["mesh"]["box"], "lower": [0.0, 2.0], "upper": [1.0, 3.0]}}
    made["bodies"].append(second)
    made["conditions"].append({"on": "stiff.y+", "displacement": [0.0, 0.0]})
    classes = floating(made)
    assert len(classes) == 8
    assert sum(cls.model is None for cls in classes) == 6


def test_ranks_agree(tmp_path: Path) -> None:
    one, two = (summary_of(uneven("hexahedron"), tmp_path, ranks) for ranks in (1, 2))
    assert two["solution"]["energy"] == pytest.approx(one["solution"]["energy"], rel=1e-8)
