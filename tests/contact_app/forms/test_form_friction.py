"""Friction of `ContactProblem` beside the contact of a scene, and the last way to an answer."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import contact_app
from contact_app import Contact, ContactProblem, Plane, Sphere
from contact_app.errors import NoEquilibriumError
from contact_app.forms.stress_loads import stress_loads
from meshes import dolfinx_compat
from tests import form_problems as problems
from tests.ranks import execute

CELLS, SIZE, PUSH = (5, 4, 3), (1.0, 0.6, 0.5), (0.08, -0.5, 0.03)


class Rough:
    """A block that is pressed on a rough floor and pushed along it, as a form and as a scene."""

    def __init__(self, cell: str, degree: int, law: dict[str, float]) -> None:
        d = 2 if cell in ("quadrilateral", "triangle") else 3
        mesh = problems.box(cell, CELLS[:d], SIZE[:d], MPI.COMM_WORLD)
        V = problems.vector_space(mesh, degree)
        tags = problems.facet_tags(
            mesh, {1: problems.bottom, 2: lambda x: np.isclose(x[1], SIZE[1])}
        )
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
        self.push = fem.Constant(mesh, np.array(PUSH[:d]))
        self.forms = (
            ufl.inner(problems.isotropic(u, 10.0, 0.3), problems.strain(v)) * ufl.dx,
            ufl.inner(self.push, v) * ds(2),
        )
        self.floor = Contact(tags, 1, Plane((0,) * d, (0, 1, 0)[:d]), friction=law)
        box = {"lower": [0] * d, "upper": SIZE[:d], "cells": CELLS[:d], "cell": cell}
        self.scene = {
            "dimension": d,
            "bodies": [{"name": "b", "degree": degree, "mesh": {"box": box},
                        "material": {"young": 10.0, "poisson": 0.3}}],
            "conditions": [{"on": "b.y+", "traction": PUSH[:d]}],
            "contacts": [{"on": "b.y-", "friction": law, "obstacle": {
                "plane": {"point": [0] * d, "normal": [0, 1, 0][:d]}}}],
            "solver": {"tolerance": 1e-10},
        }  # fmt: skip

    def problem(self, **options: Any) -> ContactProblem:
        return ContactProblem(*self.forms, [], [self.floor], tolerance=1e-10, **options)


@pytest.mark.parametrize(
    ("cell", "degree", "law", "method"),
    [
        ("quadrilateral", 1, {"coulomb": 0.3}, "auto"),
        ("triangle", 2, {"coulomb": 0.3}, "smalbe"),
        ("hexahedron", 1, {"tresca": 0.25}, "active-set"),
        ("tetrahedron", 2, {"coulomb": 0.3}, "auto"),
    ],
)
def test_friction_is_that_of_a_scene(
    cell: str, degree: int, law: dict[str, float], method: str
) -> None:
    rough = Rough(cell, degree, law)
    problem, scene = rough.problem(method=method), contact_app.solve(rough.scene)
    problem.solve()
    assert problem.certificate.passed
    assert scene.converged
    one, other = (s["solution"] for s in (problem.summary, scene.summary))
    for key in ("energy", "dissipated_work", "max_displacement", "max_contact_pressure"):
        assert one[key] == pytest.approx(other[key], rel=1e-6), key
    ours, theirs = (s["contacts"][0] for s in (problem.summary, scene.summary))
    assert ours["nodes"] == theirs["nodes"]
    assert min(ours["nodes"]["stick"], ours["nodes"]["slip"]) > 0
    assert ours["force"] == pytest.approx(theirs["force"], abs=1e-8)
    for name in ("friction_traction", "slip", "contact_status"):
        field, known = getattr(problem, name).x.array, getattr(scene, name)
        assert np.sort(np.abs(field)) == pytest.approx(
            np.sort(np.abs(known).ravel()), abs=1e-6 * np.abs(known).max()
        ), name


HISTORY = ((1.0, 0.0), (1.0, 0.5), (1.0, 1.0), (1.0, 0.0), (1.0, -1.0), (0.5, -0.4))
"""Factors of pressing and of pushing at the end of each increment."""


@pytest.mark.parametrize(
    ("cell", "degree", "law", "method"),
    [
        ("quadrilateral", 1, {"coulomb": 0.3}, "auto"),
        ("triangle", 2, {"tresca": 0.12}, "primal"),
        ("hexahedron", 1, {"coulomb": 0.3}, "auto"),
        ("tetrahedron", 1, {"coulomb": 0.3}, "active-set"),
    ],
)
def test_increments_are_those_of_a_load_history(
    cell: str, degree: int, law: dict[str, float], method: str
) -> None:
    """A block that is pressed, pushed to and fro, and partly released."""
    rough = Rough(cell, degree, law)
    d = len(rough.push.value)
    press, push = np.array([0.0, -0.5, 0.0][:d]), np.array([0.12, 0.0, 0.02][:d])
    rough.scene["conditions"] = [
        {"name": name, "on": "b.y+", "traction": load.tolist()}
        for name, load in (("press", press), ("push", push))
    ]
    rough.scene["steps"] = [{"press": one, "push": other} for one, other in HISTORY]
    scene, problem = contact_app.solve(rough.scene), rough.problem(method=method)
    slides = 0
    for number, (factors, theirs) in enumerate(zip(HISTORY, scene.summary["steps"], strict=True)):
        rough.push.value[:] = factors[0] * press + factors[1] * push
        u = problem.solve(increment=number > 0)
        assert problem.certificate.passed
        ours = problem.summary
        assert ours["contacts"][0]["force"] == pytest.approx(
            theirs["contacts"][0]["force"], abs=1e-7
        )
        assert ours["contacts"][0]["nodes"] == theirs["contacts"][0]["nodes"]
        assert ours["solution"]["dissipated_work"] == pytest.approx(
            theirs["solution"]["dissipated_work_of_increment"], abs=1e-8
        )
        known = scene.increments[number].displacement
        size = np.abs(known).max()
        assert np.sort(u.x.array) == pytest.approx(np.sort(known.ravel()), abs=1e-5 * size)
        slides += ours["contacts"][0]["nodes"]["slip"]
    assert slides > 0
    problem.solve()
    forgotten = problem.u.x.array.copy()
    assert np.abs(np.sort(forgotten) - np.sort(known.ravel())).max() > 1e-3 * size


@pytest.mark.parametrize("method", ["auto", "primal"])
def test_changes_by_halving_an_increment_cause_a_warning(method: str) -> None:
    """The warning has the change to the answer in two halves; small increments have none."""
    (one, said), (two, _), (_, small) = (pressed_on_a_ball(n, method) for n in (1, 2, 8))
    (text,) = [w for w in said if "halving" in w]
    found = re.search(r"displacements by ([\d.]+) % of the largest", text)
    assert found is not None
    change = np.abs(one - two).max() / np.abs(one).max()
    assert float(found[1]) == pytest.approx(100.0 * change, rel=0.05)
    assert not [w for w in said if "applied at once" in w]
    assert not [w for w in small if "halving" in w]


def pressed_on_a_ball(count: int, method: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """Displacement and warnings of a block that is pressed on a rough ball and aside."""
    mesh = problems.box("quadrilateral", (20, 20), (1.0, 0.5), MPI.COMM_SELF)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(mesh, {1: problems.bottom})
    a, L = problems.elastic(V, 1.0)
    ball = Contact(tags, 1, Sphere((0.45, -1), 1), friction={"coulomb": 0.3})
    problem = ContactProblem(a, L, [], [ball], method=method)
    for factor in np.linspace(0.01, 1.0, count + 1):
        problem.bcs[:] = [
            problems.held(V, lambda x: np.isclose(x[1], 0.5), i, factor * (0.02, -0.04)[i])
            for i in range(2)
        ]
        problem.solve(increment=factor > 0.01)
        assert problem.certificate.passed
    return problem.u.x.array.copy(), problem.certificate.warnings


PROGRAM = """
import numpy as np
from tests.contact_app.forms.test_form_friction import Rough
rough = Rough("tetrahedron", 1, {"coulomb": 0.3})
problem = rough.problem()
for number, push in enumerate((0.0, 0.12, 0.0)):
    rough.push.value[:] = push, -0.5, 0.0
    problem.solve(increment=number > 0)
print(*problem.summary["contacts"][0]["force"], problem.summary["solution"]["dissipated_work"])
"""


def test_increments_on_ranks() -> None:
    one, two = (np.array(execute(PROGRAM, ranks=n).split(), float) for n in (1, 2))
    assert one[-1] > 0.0
    assert two == pytest.approx(np.tile(one, 2), abs=1e-8)


def test_friction_of_a_pair_keeps_its_factors_and_is_in_balance() -> None:
    """A second solve with another load is that of a new problem."""
    forms = problems.two_blocks("hexahedron", 1)
    push = fem.Constant(forms.space.mesh, np.array([0.004, 0.002, 0.0]))
    v = forms.L.arguments()[0]
    load = forms.L + ufl.inner(push, v) * ufl.dx
    contact = replace(forms.contacts[0], friction={"coulomb": 0.3})
    problem = ContactProblem(forms.a, load, forms.bcs, [contact], tolerance=1e-10)
    problem.solve()
    push.value *= 0.5
    problem.solve()
    new = ContactProblem(forms.a, load, forms.bcs, [contact], tolerance=1e-10)
    new.solve()
    assert problem.certificate.passed
    energies = [p.summary["solution"]["energy"] for p in (problem, new)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)
    (touching,), (held,) = (problem.summary[name] for name in ("contacts", "reactions"))
    assert touching["force"][:2] == pytest.approx([-0.002 * 0.42, -0.001 * 0.42], rel=1e-6)
    total = np.array([0.002, 0.001]) * (0.99 + 0.42)
    assert held["force"][:2] == pytest.approx(-total, rel=1e-6)
    assert touching["nodes"]["stick"] > 0
    assert np.abs(problem.friction_traction.x.array).max() > 0.0


def test_a_body_beyond_its_friction_limit_slides_away() -> None:
    rough = Rough("quadrilateral", 1, {"coulomb": 0.15})
    with pytest.raises(NoEquilibriumError, match=r"along \+x .*not even friction at its limit"):
        rough.problem().solve()


@pytest.mark.ratchet
def test_where_the_dual_methods_fail_multigrid_follows() -> None:
    """A strip 500 times as long as thick, lifted at its end."""
    mesh = problems.box("quadrilateral", (400, 2), (500.0, 1.0), MPI.COMM_SELF)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(mesh, {1: problems.bottom})
    a, L = problems.elastic(V, 1e5, force=[0.0, -1e-3])
    bcs = [problems.held(V, problems.left, 0), problems.held(V, problems.left, 1, 0.02)]
    floor = Contact(tags, 1, Plane((0, 0), (0, 1)))
    found, known = (
        ContactProblem(a, L, bcs, [floor], method=method) for method in ("active-set", "primal")
    )
    found.solve()
    known.solve()
    assert found.certificate.passed
    assert found.summary["solver"]["method"] == "primal"
    assert "solved by multigrid" in found.certificate.warnings[0]
    energies = [p.summary["solution"]["energy"] for p in (found, known)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-6)


def test_prestress_between_clamps_does_not_loosen_the_certificate() -> None:
    """A bar between two clamps is pressed on a rough floor, without and with a stress along it.

    Uniform stress between clamps moves nothing. Measured by the reactions to it, displacements were
    certified at 1e-6 that were 4.7 % off, and pressures that were 3.2 % off.
    """
    mesh = problems.box("triangle", (16, 6), (4.0, 1.0), MPI.COMM_WORLD)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(mesh, {1: problems.bottom, 2: lambda x: np.isclose(x[1], 1.0)})
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    push, stress = fem.Constant(mesh, (0.3, -1.0)), fem.Constant(mesh, np.zeros((2, 2)))
    problem = ContactProblem(
        ufl.inner(problems.isotropic(u, 1000.0, 0.3), problems.strain(v)) * ufl.dx,
        ufl.inner(push, v) * ds(2) + ufl.inner(stress, problems.strain(v)) * ufl.dx,
        [problems.held(V, lambda x: np.isclose(x[0], 0.0) | np.isclose(x[0], 4.0))],
        [Contact(tags, 1, Plane((0, -1e-4), (0, 1)), friction={"coulomb": 0.3})],
        tolerance=1e-6,
    )
    answers = []
    for size in (0.0, 1e6):
        stress.value[0, 0] = size
        problem.solve()
        assert problem.certificate.passed
        answers.append((problem.u.x.array.copy(), problem.contact_pressure.x.array.copy()))
    for plain, stressed in zip(*answers, strict=True):
        assert stressed == pytest.approx(plain, abs=1e-4 * np.nanmax(np.abs(plain)), nan_ok=True)
    problem = ContactProblem(problem.a, problem.L, problem.bcs, problem.contacts)
    problem.solve()
    scale = np.abs(answers[0][0]).max()
    assert problem.u.x.array == pytest.approx(answers[0][0], abs=1e-4 * scale), "built with stress"


def test_terms_with_derivatives_of_the_argument_are_stress_loads() -> None:
    mesh = problems.box("triangle", (2, 2), (1.0, 1.0), MPI.COMM_SELF)
    V = problems.vector_space(mesh, 1)
    v, x = ufl.TestFunction(V), ufl.SpatialCoordinate(mesh)
    force, stress = ufl.as_vector((x[1], 1.0)), ufl.as_matrix(((1.0, x[0]), (x[0], 2.0)))

    def loads(form: Any) -> Any:
        return fem.assemble_vector(dolfinx_compat.compile_form(form)).array

    acting = ufl.inner(force, v) * ufl.dx + ufl.dot(force, v) * ufl.ds
    on_strains = ufl.inner(stress, problems.strain(v)) * ufl.dx
    assert stress_loads(acting) is None
    mixed = (ufl.inner(force, v) + ufl.inner(stress, problems.strain(v))) * ufl.dx
    for form in (on_strains, acting + on_strains, mixed):
        assert loads(stress_loads(form)) == pytest.approx(loads(on_strains), abs=1e-15)
    of_product = ufl.div(x[0] * v) * ufl.dx  # x div v + v_x
    expected = loads(x[0] * ufl.div(v) * ufl.dx)
    assert loads(stress_loads(of_product)) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("method", ["auto", "primal"])
def test_a_sweep_of_loads_may_begin_with_zero(method: str) -> None:
    """The answer at rest took up to 805 operator applications, with a warning of another method."""
    rough = Rough("tetrahedron", 1, {"coulomb": 0.3})
    wavy = Contact(
        rough.floor.facet_tags,
        1,
        lambda x: 1e-15 + x[:, 1] + 0.02 * x[:, 0] ** 2,  # coordinates have rounding errors
        friction=rough.floor.friction,
    )
    problem = ContactProblem(*rough.forms, [], [wavy], tolerance=1e-8, method=method)
    push = rough.push.value.copy()
    rough.push.value[:] = 0.0
    u = problem.solve()
    assert problem.certificate.passed
    assert not re.search("multigrid|close or open", " ".join(problem.certificate.warnings))
    assert problem.summary["solver"]["hessian_multiplications"] == 0
    assert not u.x.array.any()
    rough.push.value[:] = push
    problem.solve()
    force = problem.summary["contacts"][0]["force"]
    assert force[1] == pytest.approx(0.5 * SIZE[0] * SIZE[2], rel=1e-6)
