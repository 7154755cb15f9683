"""Contact for forms of a user's own, beside scenes and an independent solution."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import contact_app
from contact_app import Contact, ContactProblem, Plane, Sphere
from meshes import dolfinx_compat
from tests import form_problems as problems
from tests.ranks import execute


def nodes_of(u: fem.Function) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and values at nodes."""
    d = u.function_space.dofmap.index_map_bs
    return u.function_space.tabulate_dof_coordinates(), u.x.array.reshape(-1, d)


def in_order(points: np.ndarray) -> np.ndarray:
    return np.lexsort(np.round(points, 9).T)


def of_contacts(warnings: Sequence[str]) -> list[str]:
    """Warnings on contacts without the names of bodies, in which forms and scenes differ."""
    own = [w for w in warnings if w.startswith("contacts[")]
    return sorted(re.sub(r"the body( about \([^)]*\))?|\bhigh\b|\blow\b", "body", w) for w in own)


@pytest.mark.parametrize(
    ("cell", "degree"),
    [("hexahedron", 1), ("hexahedron", 2), ("tetrahedron", 1), ("tetrahedron", 2),
     ("quadrilateral", 1), ("triangle", 2)],
)  # fmt: skip
def test_a_form_and_a_scene_have_one_answer(cell: str, degree: int) -> None:
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    mesh = problems.box(cell, (4, 3, 2)[:d], (1.0, 0.8, 0.6)[:d], MPI.COMM_WORLD)
    V = problems.vector_space(mesh, degree)
    tags = problems.facet_tags(
        mesh, {1: problems.right, 2: lambda x: np.isclose(x[1], 0.8)}
    )  # fmt: skip
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    rule = degree if cell in ("triangle", "tetrahedron") else 2 * degree
    dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": rule})
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    a = ufl.inner(problems.isotropic(u, 200.0, 0.3), problems.strain(v)) * dx
    push = np.array([0.0, -5.0, 0.0][:d])
    L = ufl.inner(fem.Constant(mesh, push), v) * ds(2)
    wall = Plane(point=(1.001, 0, 0)[:d], normal=(-1, -0.005, 0)[:d])
    problem = ContactProblem(
        a, L, [problems.held(V, problems.bottom)], [Contact(tags, 1, wall)], tolerance=1e-11
    )
    uh = problem.solve()
    scene = contact_app.solve({
        "dimension": d,
        "bodies": [{
            "name": "body", "degree": degree, "material": {"young": 200.0, "poisson": 0.3},
            "mesh": {"box": {"lower": [0] * d, "upper": [1.0, 0.8, 0.6][:d],
                             "cells": [4, 3, 2][:d], "cell": cell}},
        }],
        "conditions": [{"on": "body.y-", "displacement": [0] * d},
                       {"on": "body.y+", "traction": push.tolist()}],
        "contacts": [{"on": "body.x+", "obstacle": {"plane": {
            "point": [1.001, 0, 0][:d], "normal": [-1, -0.005, 0][:d]}}}],
        "solver": {"tolerance": 1e-11},
    })  # fmt: skip
    assert problem.converged
    assert scene.converged
    for key in ("energy", "max_displacement", "mean_displacement", "max_contact_pressure"):
        found, wanted = (s["solution"][key] for s in (problem.summary, scene.summary))
        assert found == pytest.approx(wanted, rel=1e-9), key
    assert problem.summary["solution"]["active_contacts"] > 0
    one, other = problem.summary["contacts"][0], scene.summary["contacts"][0]
    assert one["nodes"] == other["nodes"]
    for key in ("force", "moment", "point", "area"):
        assert one[key] == pytest.approx(other[key], rel=1e-8, abs=1e-8), key
    x, values = nodes_of(uh)
    mine, theirs = in_order(x), in_order(scene.points)
    assert x[mine] == pytest.approx(scene.points[theirs], abs=1e-12)
    scale = np.abs(values).max()
    assert values[mine] == pytest.approx(scene.displacement[theirs], abs=1e-9 * scale)
    gap = problem.gap.x.array
    mine = in_order(problem.gap.function_space.tabulate_dof_coordinates())
    for name in ("contact_pressure", "smoothed_contact_pressure"):
        field, known = getattr(problem, name).x.array, getattr(scene, name)
        assert field[mine] == pytest.approx(known[theirs], abs=1e-7 * field.max()), name
    assert one["max_smoothed_pressure"] == pytest.approx(other["max_smoothed_pressure"], rel=1e-7)
    assert gap[mine] == pytest.approx(scene.gap[theirs], abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    ("cell", "degree", "kind"),
    [("hexahedron", 1, "orthotropic"), ("tetrahedron", 1, "springs"), ("triangle", 1, "heat"),
     ("quadrilateral", 2, "orthotropic"), ("hexahedron", 1, "sphere"),
     ("tetrahedron", 1, "prescribed")],
)  # fmt: skip
def test_any_elliptic_form_has_the_answer_of_the_undecomposed_reference(
    cell: str, degree: int, kind: str
) -> None:
    forms = problems.block(cell, degree, MPI.COMM_SELF, kind)
    problem = forms.problem()
    uh = problem.solve()
    u, energy = problems.solved_alone(forms)
    assert problem.certificate.passed
    assert problem.summary["solution"]["active_contacts"] > 0
    assert problem.summary["solution"]["energy"] == pytest.approx(energy, rel=1e-8)
    assert nodes_of(uh)[1] == pytest.approx(u, abs=1e-7 * np.abs(u).max())


@pytest.mark.parametrize(
    ("kind", "distance", "degree"), [("sphere", "distance", 2), ("bore", "distance in a bore", 1)]
)
def test_round_obstacles_have_a_signed_distance(kind: str, distance: str, degree: int) -> None:
    one, other = (
        problems.block("tetrahedron", degree, kind=k).problem() for k in (kind, distance)
    )  # fmt: skip
    u, w = one.solve(), other.solve()
    assert one.certificate.passed
    assert one.summary["solution"]["active_contacts"] > 0
    assert w.x.array == pytest.approx(u.x.array, abs=1e-8 * np.abs(u.x.array).max())
    assert other.summary["contacts"][0]["with"] == "signed distance"


def test_a_level_set_need_be_no_distance() -> None:
    forms = problems.block("triangle", 1)
    (floor,) = forms.contacts
    n = np.array([0.1, 1.0]) / np.hypot(0.1, 1.0)
    scaled = Contact(floor.facet_tags, 3, lambda x: 7.0 * ((x - [0.0, -0.05]) @ n))
    u = forms.problem().solve()
    w = ContactProblem(forms.a, forms.L, forms.bcs, [scaled], tolerance=1e-10).solve()
    assert w.x.array == pytest.approx(u.x.array, abs=1e-9)


def test_interference_moves_the_obstacle() -> None:
    forms = problems.block("triangle", 1)
    tags = forms.contacts[0].facet_tags
    up = (0, 1)
    answers = [
        ContactProblem(forms.a, forms.L, forms.bcs, [contact], tolerance=1e-10).solve().x.array
        for contact in (Contact(tags, 3, Plane((0, -0.02), up)),
                        Contact(tags, [3], Plane((0, -0.1), up), interference=0.08))
    ]  # fmt: skip
    assert answers[1] == pytest.approx(answers[0], abs=1e-9)


def test_a_problem_is_solved_again_for_new_loads() -> None:
    forms = problems.block("triangle", 1)
    V = forms.space
    push = fem.Constant(V.mesh, np.array([0.1, -0.5]))
    v = forms.L.arguments()[0]
    floor = Contact(forms.contacts[0].facet_tags, 3, Plane((0, 0), (0.02, 1)), name="floor")
    u = fem.Function(V)
    problem = ContactProblem(
        forms.a, ufl.inner(push, v) * ufl.dx, forms.bcs, [floor], tolerance=1e-10, u=u
    )
    assert problem.solve() is u
    first, force = u.x.array.copy(), np.array(problem.summary["contacts"][0]["force"])
    assert force[1] > 0.0
    pressure = problem.contact_pressure
    lower = pressure.x.array.max()
    push.value *= 3.0
    problem.solve()
    assert problem.contact_pressure is pressure  # a file or a form that has it is up to date
    assert pressure.x.array.max() > 2.0 * lower
    gap = problem.gap.x.array
    assert np.nanmin(gap) > -1e-9
    assert u.x.array != pytest.approx(first, rel=1e-3)
    assert np.linalg.norm(problem.summary["contacts"][0]["force"]) > 2.0 * np.linalg.norm(force)
    assert problem.summary["contacts"][0]["on"] == "floor"


@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 1), ("triangle", 2)])
def test_tagged_facets_press_on_each_other_as_two_bodies_of_a_scene(cell: str, degree: int) -> None:
    problem = problems.two_blocks(cell, degree).problem()
    problem.solve()
    d = 3 if cell == "hexahedron" else 2
    up = "xyz"[d - 1]
    boxes = {
        "low": ([0, 0, 0], [1, 1, 0.99], [4, 3, 3], 1.0) if d == 3 else
        ([0, 0], [1, 0.99], [4, 3], 1.0),
        "high": ([0.15, 0.2, 1], [0.85, 0.8, 2], [3, 2, 2], 5.0) if d == 3 else
        ([0.15, 1], [0.85, 2], [3, 2], 5.0),
    }  # fmt: skip
    scene = contact_app.solve({
        "dimension": d,
        "bodies": [
            {"name": name, "degree": degree, "material": {"young": young, "poisson": 0.3},
             "mesh": {"box": {"lower": lower, "upper": upper, "cells": cells, "cell": cell}}}
            for name, (lower, upper, cells, young) in boxes.items()
        ],
        "conditions": [{"on": f"low.{up}-", "displacement": [0] * d},
                       {"on": f"high.{up}+", "traction": [0] * (d - 1) + [-0.05]}],
        "contacts": [{"on": f"high.{up}-", "against": f"low.{up}+"}],
        "solver": {"tolerance": 1e-10},
    })  # fmt: skip
    assert of_contacts(problem.certificate.warnings) == of_contacts(scene.certificate.warnings)
    assert problem.certificate.passed
    assert scene.converged
    one, other = (s["contacts"][0] for s in (problem.summary, scene.summary))
    pushed = 0.05 * (0.7 * 0.6 if d == 3 else 0.7)
    assert one["force"][d - 1] == pytest.approx(pushed, rel=1e-8)
    assert one["nodes"] == other["nodes"]
    for key in ("area", "max_pressure", "max_smoothed_pressure"):
        assert one[key] == pytest.approx(other[key], rel=1e-7), key
    energies = [s["solution"]["energy"] for s in (problem.summary, scene.summary)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-8)


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_coarse_ball_gives_the_warnings_of_a_scene(cell: str) -> None:
    """Contact narrower than a facet, and wider than its boundary."""
    mesh = problems.box(cell, (6, 6, 3), (3.0, 3.0, 1.5), MPI.COMM_WORLD)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(mesh, {
        1: lambda x: np.isclose(x[2], 1.5) & (x[0] < 1.6) & (x[1] < 1.6)
    })  # fmt: skip
    a, L = problems.elastic(V, 1.0)
    feet = [problems.held(V, lambda x: np.isclose(x[2], 0.0), i, 0.05 * i) for i in range(3)]
    ball = Sphere(center=(1.5, 1.0, 5.5), radius=4.0)
    problem = ContactProblem(a, L, feet, [Contact(tags, 1, ball, name="top")])
    problem.solve()
    scene = contact_app.solve({
        "dimension": 3,
        "bodies": [{"name": "body", "material": {"young": 1.0, "poisson": 0.3},
                    "mesh": {"box": {"lower": [0, 0, 0], "upper": [3, 3, 1.5],
                                     "cells": [6, 6, 3], "cell": cell}},
                    "boundaries": {"top": {"where": "z > 1.49 and x < 1.6 and y < 1.6"}}}],
        "conditions": [{"on": "body.z-", "displacement": [0, 0.05, 0.1]}],
        "contacts": [{"on": "body.top", "obstacle": {
            "sphere": {"center": [1.5, 1.0, 5.5], "radius": 4.0}}}],
    })  # fmt: skip
    found = of_contacts(problem.certificate.warnings)
    of_scene = of_contacts(scene.certificate.warnings)  # of whose bodies the moduli are known
    assert found == [text.partition("; for bodies large")[0] for text in of_scene]
    assert any("outside top penetrate the obstacle" in text for text in found)
    assert any("the pressure varies within single facets" in text for text in found)


@pytest.mark.parametrize("method", ["primal", "active-set"])
def test_springs_hold_some_motions_and_none_others(method: str) -> None:
    forms = problems.block("hexahedron", 1)
    mesh = forms.space.mesh
    v, u = forms.a.arguments()
    floor = Contact(forms.contacts[0].facet_tags, 3, Plane(point=(0, 0, 0), normal=(0, 1, 0)))
    problem = ContactProblem(
        forms.a + 2.0 * u[0] * v[0] * ufl.dx,
        ufl.inner(fem.Constant(mesh, np.array([0.3, -1.0, 0.0])), v) * ufl.dx,
        contacts=[floor], tolerance=1e-9, method=method,
    )  # fmt: skip
    uh = problem.solve()
    assert problem.certificate.passed
    assert problem.summary["solver"]["method"] == method
    assert "can move freely" in problem.certificate.warnings[0]
    assert problem.summary["contacts"][0]["force"] == pytest.approx([0, 0.3, 0], abs=1e-7)
    carried = fem.assemble_scalar(fem.form(2.0 * uh[0] * ufl.dx))
    assert carried == pytest.approx(0.3 * 0.3, rel=1e-6)


@pytest.mark.parametrize(("cell", "kind"), [("tetrahedron", "prescribed"), ("triangle", "sphere")])
def test_loads_contact_forces_and_reactions_are_in_balance(cell: str, kind: str) -> None:
    forms = problems.block(cell, 2, kind=kind)
    problem = forms.problem()
    problem.solve()
    d = forms.space.mesh.geometry.dim
    size = (1.0, 0.6, 0.5)[:d]
    middle = 0.5 * np.array([1.0, 0.6, 0.5 if d == 3 else 0.0])
    load = np.zeros(3)
    load[:d] = np.array([0.1, -0.5, 0.05])[:d] * np.prod(size)
    force, moment = load.copy(), np.zeros(3)
    records = problem.summary["contacts"] + problem.summary["reactions"]
    assert len(records) == 1 + len(forms.bcs)
    for record in records:
        arm = np.array(record["point"]) - middle
        force += record["force"]
        turn = record["moment"] if d == 3 else [0.0, 0.0, record["moment"]]
        moment += np.cross(arm, record["force"]) + turn
    scale = max(np.linalg.norm(record["force"]) for record in records)
    assert np.linalg.norm(problem.summary["contacts"][0]["force"]) > 0.0
    assert force == pytest.approx(np.zeros(3), abs=1e-8 * scale)
    assert moment == pytest.approx(np.zeros(3), abs=1e-8 * scale)


@pytest.mark.mpi
def test_answers_are_the_same_on_1_2_and_3_ranks() -> None:
    program = "import tests.form_problems as problems; problems.tell_answers()"
    found = [json.loads(execute(program, ranks=n).splitlines()[-1]) for n in (1, 2, 3)]
    for name, first in found[0].items():
        assert first["passed"], name
        for other in (answers[name] for answers in found[1:]):
            assert other["passed"], name
            assert other["nodes"] == first["nodes"], name
            assert other["contact warnings"] == first["contact warnings"], name
            for key in ("sums", "energy", "force", "area", "reactions"):
                assert other[key] == pytest.approx(first[key], rel=2e-7, abs=1e-9), (name, key)
            if "grid" in name:  # the same congruent sub-boxes, whichever ranks have their cells
                assert other["subdomains"] == first["subdomains"] > 3
                assert other["applications"] == first["applications"]


@pytest.fixture(scope="module")
def on_grid() -> tuple[ContactProblem, Any]:
    """A block of 9³ cells beside a wall, as a form and as a scene."""
    return grid_problem(), contact_app.solve({
        "dimension": 3,
        "bodies": [{
            "name": "body", "material": {"young": 200.0, "poisson": 0.3},
            "mesh": {"box": {"lower": [0, 0, 0], "upper": [1, 0.8, 0.6], "cells": [9, 9, 9]}},
        }],
        "conditions": [{"on": "body.y-", "displacement": [0, 0, 0]},
                       {"on": "body.y+", "traction": [0, -5, 0]}],
        "contacts": [{"on": "body.x+", "obstacle": {"plane": {
            "point": [1.001, 0, 0], "normal": [-1, -0.005, 0]}}}],
    })  # fmt: skip


def grid_problem(stiffer: str = "", support: float = 0.0) -> ContactProblem:
    """`stiffer` is how Young's modulus varies, `support` the stiffness of springs on a side."""
    mesh = problems.box("hexahedron", (9, 9, 9), (1.0, 0.8, 0.6), MPI.COMM_WORLD)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(
        mesh, {1: problems.right, 2: lambda x: np.isclose(x[1], 0.8)}
    )  # fmt: skip
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": 2})
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    x = ufl.SpatialCoordinate(mesh)
    factor = 1.0 + x[0] * x[1] if stiffer else 1.0
    a = factor * ufl.inner(problems.isotropic(u, 200.0, 0.3), problems.strain(v)) * dx
    if support:
        a += support * ufl.inner(u, v) * ds(2)
    L = ufl.inner(fem.Constant(mesh, np.array([0.0, -5.0, 0.0])), v) * ds(2)
    wall = Plane(point=(1.001, 0, 0), normal=(-1, -0.005, 0))
    problem = ContactProblem(
        a, L, [problems.held(V, problems.bottom)], [Contact(tags, 1, wall)]
    )  # fmt: skip
    problem.solve()
    return problem


@pytest.mark.ratchet
def test_a_regular_mesh_costs_as_much_as_a_box_of_a_scene(
    on_grid: tuple[ContactProblem, Any],
) -> None:
    """The same congruent sub-boxes: one factor, as many applications, one answer."""
    form, scene = (answer.summary for answer in on_grid)
    for key in ("subdomains", "congruence_classes", "dual", "gluing", "contact"):
        assert form["decomposition"][key] == scene["decomposition"][key], key
    assert form["decomposition"]["subdomains"] > 1
    assert form["decomposition"]["congruence_classes"] == 1
    assert form["solver"]["method"] == "active-set"
    done, allowed = (s["solver"]["hessian_multiplications"] for s in (form, scene))
    assert done <= allowed
    assert form["solution"]["energy"] == pytest.approx(scene["solution"]["energy"], rel=1e-9)
    (one,), (other,) = form["reactions"], scene["reactions"]
    assert one["force"] == pytest.approx(other["force"], rel=1e-5, abs=1e-5)


def test_sub_boxes_with_springs_are_classes_of_their_own() -> None:
    """The reference is solved more exactly than the comparison asks for."""
    cut = grid_problem(support=50.0)
    assert cut.summary["decomposition"]["congruence_classes"] == 2
    whole = ContactProblem(
        cut.a, cut.L, cut.bcs, cut.contacts, method="primal", tolerance=1e-9
    )  # fmt: skip
    whole.solve()
    for key in ("energy", "max_displacement"):
        found, wanted = (p.summary["solution"][key] for p in (cut, whole))
        assert found == pytest.approx(wanted, rel=1e-6)


def test_sub_boxes_that_all_differ_are_left_to_multigrid() -> None:
    varying = grid_problem(stiffer="everywhere")
    assert varying.certificate.passed
    assert varying.summary["solver"]["method"] == "primal"
    assert not varying.certificate.warnings


@pytest.mark.parametrize("degree", [1, 2])
def test_facets_that_stand_for_circles(degree: int) -> None:
    """A shaft 0.01 too large in a hub: Lamé's pressure in the mean.

    Of straight cells only with `round`; of curved ones, degree 2, at each node.
    """
    file = meshio.read(Path(__file__).parents[3] / "meshes" / "samples" / "shaft_and_hub.msh")
    blocks = [b.data for b in file.cells if b.type.startswith("quad")]
    order = [0, 1, 3, 2, 4, 7, 5, 6, 8][: (degree + 1) ** 2]  # dolfinx's
    cells = np.concatenate(blocks)[:, order]
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = file.points[used, :2], cells.reshape(-1, len(order))
    radius = np.linalg.norm(points[cells].mean(axis=1), axis=1)
    shaft = np.unique(cells[radius < 10.0])
    points[shaft] *= 1.001
    mesh = dolfinx_compat.create_mesh(cells, points, "quadrilateral", degree)
    V = problems.vector_space(mesh, degree)
    at = {
        tag: lambda x, r=r: np.isclose(np.hypot(x[0], x[1]), r, atol=1e-6)
        for tag, r in ((1, 10.0), (2, 10.01))
    }
    tags = problems.facet_tags(mesh, at)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain, lam = problems.strain(u), 2.1e5 * 0.3 / (1.0 - 0.3**2)
    stress = lam * ufl.tr(strain) * ufl.Identity(2) + 2.1e5 / 1.3 * strain  # plane stress
    bcs = [
        problems.held(V, lambda x, k=k: np.isclose(x[k], 0.0), k) for k in (0, 1)
    ]  # fmt: skip
    L = ufl.inner(fem.Constant(mesh, np.zeros(2)), v) * ufl.dx
    forces = []
    for smooth in (True, False):
        problem = ContactProblem(
            ufl.inner(stress, problems.strain(v)) * ufl.dx, L, bcs,
            [Contact(tags, 1, against=2, round=smooth)],
        )  # fmt: skip
        problem.solve()
        assert problem.certificate.passed
        forces.append(problem.summary["contacts"][0]["force"][0] / 10.0)
    assert forces[0] == pytest.approx(78.75, rel=0.01)
    if degree == 1:
        assert abs(forces[1] - 78.75) > 0.05 * 78.75
        assert any("meet by flat facets" in w for w in problem.certificate.warnings)
        return
    assert forces[1] == pytest.approx(forces[0], rel=1e-9)
    pressure = problem.contact_pressure.x.array
    assert pressure[pressure > 0.0] == pytest.approx(78.75, rel=0.01)
    assert not problem.certificate.warnings
