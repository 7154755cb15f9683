"""Scenes with friction against an undecomposed Gauss-Seidel method, statics and each other."""

import copy
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial import cKDTree

import contact_app
from contact_app.errors import ConfigurationError, NoEquilibriumError
from solver.tfeti.preconditioner import DualPreconditioner, ScaledPreconditioner
from tests import friction_reference, scenes
from tests.comparison import same_displacement, solve
from tests.rows import covering
from tests.scenes_on_ranks import summary_of

LAWS = ({"coulomb": 0.3}, {"tresca": 8.0})
SPLITS = {"quadrilateral": 4, "triangle": [2, 2], "hexahedron": [2, 2, 2], "tetrahedron": 8}


def rough(made: scenes.Config, law: dict[str, float]) -> scenes.Config:
    """The same scene with friction at all contacts."""
    made = copy.deepcopy(made)
    for contact in made["contacts"]:
        contact["friction"] = law
    return made


def pair(cell: str, law: dict[str, float], degree: int = 1) -> scenes.Config:
    """A block pressed onto another one, whose mesh it does not match, and pushed aside."""
    n = 4 if scenes.dimension(cell) == 2 else 3
    bodies = [
        scenes.block(cell, n, "lower", upper=(1, 1, 0.5)),
        scenes.block(cell, n - 1, "upper", (0.1, 0.1, 0.5), (0.8, 0.9, 1.2), young=1500.0),
    ]
    for body in bodies:
        body["degree"] = degree
    up, down = scenes.up(cell), scenes.down(cell)
    return scenes.config(
        cell,
        bodies,
        [
            scenes.clamp(cell, f"lower.{down}"),
            {"on": f"upper.{up}", "displacement": scenes.vector(cell, 0.02, 0.012, -0.02)},
        ],
        [{"on": f"upper.{down}", "against": f"lower.{up}", "friction": law}],
    )


def check(made: scenes.Config, subdomains: Any, part: float = 1e-7, **options: Any) -> Any:
    """Solve a scene and compare energy, displacements and friction with the reference.

    Displacements may differ by a part of the largest one.
    """
    solved = solve(made, subdomains, **options)
    known = friction_reference.solve(scenes.build(made))
    summary = solved.summary
    assert summary["certificate"]["passed"], summary["certificate"]
    same_displacement(known, solved, part)
    assert summary["solution"]["energy"] == pytest.approx(known.energy, rel=1e-8)
    work = float(np.einsum("pi,pi->", known.tangential, known.slip))
    if "coulomb" in made["contacts"][0]["friction"]:
        work *= 0.5  # limits grow from zero with the load
    none = 1e-8 * abs(known.energy)
    assert summary["solution"]["dissipated_work"] == pytest.approx(work, rel=1e-6, abs=none)
    return solved


@pytest.mark.parametrize(
    ("law", "cell", "name"),
    covering(LAWS, SPLITS, ["wall", "pushed", "hollow_sphere"], together=2),
    ids=str,
)
def test_obstacles(name: str, cell: str, law: dict[str, float]) -> None:
    n = 4 if scenes.dimension(cell) == 2 else 2
    check(rough(scenes.ALL[name](cell, n), law), SPLITS[cell])


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_pairs_in_the_plane(cell: str, degree: int, law: dict[str, float]) -> None:
    check(pair(cell, law, degree), 3)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_pairs_in_space(law: dict[str, float]) -> None:
    check(pair("hexahedron", law), 4)


def pressed(cell: str, whole: bool, degree: int) -> scenes.Config:
    """A hard block pressed onto a soft one, symmetric about x = 0; whole, or one half."""
    start, side, n = (-1.0, None, 2) if whole else (0.0, "x-", 1)
    bodies = [
        scenes.block(cell, 2, "lower", (start, 0, 0), (1, 1, 0.5), young=500.0),
        scenes.block(cell, 1, "upper", (0.6 * start, 0, 0.5), (0.6, 1, 1), young=2000.0),
    ]
    for body, cells in zip(bodies, (7, 3), strict=True):
        body["degree"] = degree
        count = body["mesh"]["box"]["cells"]
        count[0], count[-1] = n * cells, 2
    up, down = scenes.up(cell), scenes.down(cell)
    conditions = [
        {"on": f"lower.{down}", "displacement": scenes.vector(cell, 0.0, 0.0, 0.0)},
        {"on": f"upper.{up}", "displacement": scenes.vector(cell, None, 0.0, -0.05)},
    ]
    for name in ("lower", "upper") if side else ():
        held = {"on": f"{name}.{side}", "displacement": scenes.vector(cell, 0.0, None, None)}
        conditions.append(held)
    rough = {"on": f"upper.{down}", "against": f"lower.{up}", "friction": {"coulomb": 0.1}}
    return scenes.config(cell, bodies, conditions, [rough])


@pytest.mark.parametrize(
    ("cell", "degree"), [("quadrilateral", 1), ("quadrilateral", 2), ("hexahedron", 1)], ids=str
)
def test_half_of_a_symmetric_pair_is_half_of_the_whole(cell: str, degree: int) -> None:
    """At the plane of symmetry nothing slides and no friction acts."""
    half, whole = (solve(pressed(cell, w, degree), 1) for w in (False, True))
    upper, of_whole = (slice(s.model.partition.first_node[1], None) for s in (half, whole))
    ours, theirs = half.nodes, whole.nodes
    away, at = cKDTree(theirs.points[of_whole]).query(ours.points[upper])
    assert away.max() < 1e-12
    assert (ours.contact_status == 2).sum() > 1 < (ours.contact_status == 1).sum()
    for name in ("displacement", "contact_pressure", "friction_traction"):
        one, other = getattr(ours, name)[upper], getattr(theirs, name)[of_whole][at]
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6 * np.abs(other).max())


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_obstacles_of_degree_two(cell: str) -> None:
    made = scenes.wall(cell, 2)
    made["bodies"][0]["degree"] = 2
    check(rough(made, {"tresca": 6.0}), 2)


@pytest.mark.parametrize("subdomains", [1, 2, [1, 3]], ids=str)
def test_any_split(subdomains: Any) -> None:
    """One subdomain included, whose held unknowns are rows of B here."""
    check(rough(scenes.pushed("quadrilateral", 6), {"coulomb": 0.3}), subdomains)


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_mprgp_for_convex_sets_inside_smalbe(cell: str, law: dict[str, float]) -> None:
    """Bounds in the plane, discs in space; limits of Coulomb's law by a fixed point."""
    made = rough(scenes.pushed(cell, 3), law)
    made["solver"]["method"] = "smalbe"
    assert check(made, 2).summary["solver"]["method"] == "smalbe"


@pytest.mark.ratchet
@pytest.mark.parametrize(
    ("cell", "law", "most"),
    [
        ("quadrilateral", LAWS[0], 30),
        ("quadrilateral", LAWS[1], 25),
        ("hexahedron", LAWS[0], 70),
        ("hexahedron", LAWS[1], 62),
    ],
    ids=str,
)
def test_operator_applications(cell: str, law: dict[str, float], most: int) -> None:
    """The pair takes 16 applications without friction in the plane and 23 in space."""
    solved = solve(pair(cell, law), 4)
    assert solved.summary["solver"]["hessian_multiplications"] <= most


@pytest.mark.ratchet
@pytest.mark.parametrize(("law", "most"), [(LAWS[0], 50), ({"tresca": 1.0}, 50)], ids=str)
def test_operator_applications_at_an_obstacle(law: dict[str, float], most: int) -> None:
    """A block on a rough wall, whose points slide in changing directions."""
    solved = solve(rough(scenes.wall("hexahedron", 6), law), [2, 2, 2])
    assert solved.summary["solver"]["hessian_multiplications"] <= most


def test_no_coefficient_is_no_friction() -> None:
    bare, none = (solve(m, 4) for m in (scenes.pushed("quadrilateral", 4),
                  rough(scenes.pushed("quadrilateral", 4), {"coulomb": 0.0})))  # fmt: skip
    assert none.summary["solution"]["energy"] == bare.summary["solution"]["energy"]
    assert "friction_cone" not in none.summary["certificate"]


def test_units() -> None:
    """Lengths in thousandths, forces in millions: the same statuses, all numbers scaled."""
    made = pair("quadrilateral", {"coulomb": 0.3})
    other = copy.deepcopy(made)
    for body in other["bodies"]:
        box = body["mesh"]["box"]
        box["lower"], box["upper"] = ([1e3 * x for x in box[k]] for k in ("lower", "upper"))
        body["material"]["young"] *= 1e-4
    moved = other["conditions"][1]["displacement"]
    other["conditions"][1]["displacement"] = [1e3 * x for x in moved]
    one, two = (solve(m, 3).summary for m in (made, other))
    assert one["contacts"][0]["nodes"] == two["contacts"][0]["nodes"]
    assert two["solution"]["energy"] == pytest.approx(1e2 * one["solution"]["energy"], rel=1e-8)


def on_a_slope(cell: str, law: dict[str, float], angle: float, along: float = 0.0) -> scenes.Config:
    """A block on a plane that is level, under a weight that is not."""
    weight = 20.0
    push = weight * np.sin(angle)
    force = scenes.vector(
        cell, float(push * np.cos(along)), float(push * np.sin(along)),
        float(-weight * np.cos(angle)),
    )  # fmt: skip
    return scenes.config(
        cell,
        [scenes.block(cell, 3, upper=(1.0, 1.0, 0.4))],
        [{"in": "block", "force": force}],
        [
            {
                "on": f"block.{scenes.down(cell)}",
                "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1)),
                "friction": law,
            }
        ],
    )


@pytest.mark.parametrize(
    ("cell", "along"), [("quadrilateral", 0.0), ("hexahedron", 0.0), ("hexahedron", 0.7)]
)
@pytest.mark.parametrize(
    ("law", "limit"),
    [({"coulomb": 0.4}, np.arctan(0.4)), ({"tresca": 3.0}, np.arcsin(3.0 / (20.0 * 0.4)))],
    ids=str,
)
def test_a_block_on_a_slope_rests_up_to_the_friction_angle(
    cell: str, along: float, law: dict[str, float], limit: float
) -> None:
    """The limit is tan α = μ, or W sin α = s A; friction alone holds the block."""
    weight = 20.0 * 0.4
    rests = solve(on_a_slope(cell, law, 0.99 * limit, along), 2)
    assert rests.summary["certificate"]["passed"]
    force = np.array(rests.summary["contacts"][0]["force"])
    held = np.linalg.norm(force[: scenes.dimension(cell) - 1])
    assert held == pytest.approx(weight * np.sin(0.99 * limit), rel=1e-6)
    with pytest.raises(NoEquilibriumError, match="leaving along") as refused:
        solve(on_a_slope(cell, law, 1.01 * limit, along), 2)
    said = re.search(r"it starts at (\S+) times all loads", str(refused.value))
    if "coulomb" in law:
        assert said is None  # loads that are scaled together slide at every factor
    else:
        assert said is not None
        carried = np.sin(limit) / np.sin(1.01 * limit)
        assert float(said[1]) == pytest.approx(carried, abs=6e-4)


def test_load_cases() -> None:
    """A case whose loads have other factors is the scene with these loads."""
    import contact_app

    made = pair("quadrilateral", {"coulomb": 0.3})
    made["conditions"][1]["name"] = "push"
    made["cases"] = {"one": {"push": 1.0}, "other": {"push": 0.6}}
    cases = contact_app.solve(made).cases
    del made["cases"], made["conditions"][1]["name"]
    for name, factor in (("one", 1.0), ("other", 0.6)):
        alone = copy.deepcopy(made)
        moved = alone["conditions"][1]["displacement"]
        alone["conditions"][1]["displacement"] = [factor * x for x in moved]
        summary, known = cases[name].summary, solve(alone).summary
        assert summary["contacts"][0]["nodes"] == known["contacts"][0]["nodes"]
        energy = known["solution"]["energy"]  # the tolerance, 1e-9, is a share of it
        for key in ("energy", "dissipated_work"):
            expected = pytest.approx(known["solution"][key], rel=1e-7, abs=1e-8 * abs(energy))
            assert summary["solution"][key] == expected


def test_the_preconditioner_of_sliding_points_is_symmetric() -> None:
    """xᵀ M y = yᵀ M x for residuals x, y, in the range of Pᵀ, with factors that differ."""
    problem = scenes.problem(rough(scenes.wall("hexahedron", 2), LAWS[0]), 8, comm=MPI.COMM_WORLD)
    random = np.random.default_rng(1)
    scale = np.where(problem.tangential, random.uniform(0.1, 1e2, problem.size), 1.0)
    base = DualPreconditioner(problem, np.inf)
    preconditioner = ScaledPreconditioner(base, scale)
    x, y = random.normal(size=(2, problem.size))
    Mx, My = np.empty((2, problem.size))
    for vector, result in ((x, Mx), (y, My)):
        problem.coarse.project_transpose(vector, vector)
        preconditioner.apply(vector, np.ones(problem.size, bool), result)
    assert x @ My == pytest.approx(y @ Mx, rel=1e-5)  # of numbers in single precision
    assert x @ Mx > 0.0


@pytest.mark.mpi
def test_ranks(tmp_path: Path) -> None:
    """A pair, and a floor that some ranks do not touch: one answer on one, two and three ranks."""
    made = pair("hexahedron", {"coulomb": 0.3})
    made["conditions"] = [{"on": "upper.z+", "traction": [3, 2, -25]}]
    floor = scenes.plane("hexahedron", (0, 0, 0), (0, 0, 1))
    made["contacts"].append({"on": "lower.z-", "obstacle": floor, "friction": {"tresca": 6.0}})
    made["decomposition"] = {"subdomains": 6}
    one, *others = (summary_of(made, tmp_path, ranks) for ranks in (1, 2, 3))
    assert one["certificate"]["passed"]
    for other in others:
        assert other["certificate"]["passed"]
        assert [c["nodes"] for c in other["contacts"]] == [c["nodes"] for c in one["contacts"]]
        for key in ("energy", "dissipated_work", "max_displacement"):
            assert other["solution"][key] == pytest.approx(one["solution"][key], rel=1e-8)


def test_fields() -> None:
    """Tractions are against slips, add up to the force, and statuses to the counts."""
    solved = solve(rough(scenes.pushed("hexahedron", 3), {"coulomb": 0.3}), [2, 2, 2])
    nodes, summary = solved.nodes, solved.summary
    slides = nodes.contact_status == 2.0
    sticks = nodes.contact_status == 1.0
    found = summary["contacts"][0]["nodes"]
    assert (slides.sum(), sticks.sum()) == (found["slip"], found["stick"])
    assert slides.any()
    traction, slip = nodes.friction_traction[slides], nodes.slip[slides]
    size = np.linalg.norm(traction, axis=1)
    np.testing.assert_allclose(size, 0.3 * nodes.contact_pressure[slides], rtol=1e-6)
    cosine = np.einsum("ni,ni->n", traction, slip) / (size * np.linalg.norm(slip, axis=1))
    np.testing.assert_allclose(cosine, -1.0, atol=1e-6)
    still = 1e-8 * np.abs(nodes.displacement).max()
    assert np.abs(nodes.slip[sticks]).max(initial=0.0) < still


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"friction": {}}, "has no law"),
        ({"friction": {"coulomb": 0.1, "tresca": 1.0}}, "has coulomb and tresca"),
        ({"friction": {"coulomb": -0.1}}, "coulomb"),
        ({"friction": {"kinetic": 0.1}}, "kinetic"),
        ({"friction": 0.3}, "friction"),
    ],
    ids=str,
)
def test_a_law_that_is_none(change: dict[str, Any], words: str) -> None:
    made = scenes.pushed("quadrilateral", 2)
    made["contacts"][0].update(change)
    with pytest.raises((ConfigurationError, ValueError), match=words):
        scenes.build(made)


@pytest.mark.parametrize(("law", "acts"), [({"tresca": 8.0}, True), ({"coulomb": 0.3}, False)])
def test_the_status_shows_friction_on_open_nodes(law: dict[str, float], acts: bool) -> None:
    solved = solve(rough(scenes.ALL["wall"]("quadrilateral", 6), law))
    nodes, summary = solved.nodes, solved.summary
    pulled = np.linalg.norm(nodes.friction_traction, axis=1) > 0.0
    pressed = nodes.contact_pressure > 0.0
    assert (pulled & ~pressed).any() == acts
    np.testing.assert_array_equal(nodes.contact_status > 0, pulled | pressed)
    counts = summary["contacts"][0]["nodes"]
    assert counts["stick"] + counts["slip"] == (pulled | pressed).sum()
    said = [w for w in summary["certificate"]["warnings"] if "Tresca friction acts on" in w]
    assert len(said) == acts
    if acts:
        assert f"acts on {(pulled & ~pressed).sum()} nodes" in said[0]


@pytest.mark.parametrize("tied", [False, True])
def test_tresca_friction_without_area_causes_a_warning(tied: bool) -> None:
    """Tresca's limit is a force per area: on an edge it is zero, also below a rigid body."""
    made = scenes.wall("hexahedron", 3)
    body = made["bodies"][0]
    body["boundaries"] = {"edge": {"where": "x > 1 - 1e-9 and z < 1e-9"}}
    floor = {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}
    made["conditions"] = [{"on": "block.z+", "displacement": [0.01, 0.0, -0.01]}]
    made["contacts"] = [{"on": "block.edge", "obstacle": floor, "friction": {"tresca": 1.0}}]
    if tied:
        made["bodies"].append({"name": "foot", "rigid": floor})
        made["contacts"].append({"on": "block.z-", "against": "foot", "tied": True})
    certificate = solve(made).summary["certificate"]
    assert certificate["passed"]
    expected = "contacts[0]: 4 nodes lie on no whole facet of edge"
    assert any(expected in warning for warning in certificate["warnings"])


@pytest.mark.parametrize("method", ["auto", "primal"])
def test_a_heated_block_that_one_node_holds_is_certified(method: str) -> None:
    """The active sets slide on, though friction at their contact forces holds the push."""
    steel = {"young": 2.1e5, "poisson": 0.3}
    found = contact_app.solve({
        "dimension": 2,
        "bodies": [
            {"name": "low", "material": steel, "mesh": {"box": {
                "lower": [0, 0], "upper": [4, 1], "cells": [8, 2], "cell": "triangle"}}},
            {"name": "up", "mesh": {"box": {"lower": [1, 1], "upper": [3, 2], "cells": [4, 2]}},
             "material": {"young": 7e4, "poisson": 0.33, "expansion": 2.3e-5}},
        ],
        "conditions": [
            {"on": "low.y-", "displacement": [0, 0]},
            {"on": "up.y+", "traction": [5, -60]},
            {"in": "up", "temperature": "30 * y"},
        ],
        "contacts": [{"on": "up.y-", "against": "low.y+", "friction": {"coulomb": 0.3}}],
        "solver": {"method": method},
    })  # fmt: skip
    assert found.converged
    assert found.summary["contacts"][0]["force"] == pytest.approx([-10.0, 120.0, 0.0], abs=1e-3)
    assert found.summary["contacts"][0]["nodes"] == {"open": 0, "stick": 1, "slip": 4}
