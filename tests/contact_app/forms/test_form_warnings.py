"""Warnings of `ContactProblem` that need no scene beside it."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from contact_app import Contact, ContactProblem, Plane, Sphere
from meshes import dolfinx_compat
from tests import form_problems as problems
from tests import meshfiles


@pytest.mark.parametrize("order", [(2, 1), (1, 2)])
def test_a_corner_in_a_facet_of_another_body_causes_a_warning(order: tuple[int, int]) -> None:
    """A square on its corner over the middle of a facet enters it by what it is moved down."""
    mesh = problems.stacked("triangle", MPI.COMM_WORLD)
    x = mesh.geometry.x
    above = x[:, 1] > 0.995
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    x[above, :2] = (x[above, :2] - [0.15, 1.0]) @ turn.T + [0.375, 0.99]
    V = problems.vector_space(mesh, 1)

    def upper(x: np.ndarray) -> np.ndarray:
        return (x[1] > 0.9901) | np.isclose(x[0], 0.375)

    flanks = {
        2: lambda x: np.isclose(x[1], 0.99) & ~np.isclose(x[0], 0.375),
        1: lambda x: np.isclose(np.abs(x[0] - 0.375), x[1] - 0.99) & (x[1] < 1.4),
    }
    tags = problems.facet_tags(mesh, flanks)
    a, L = problems.elastic(V, 1.0)
    bcs = [problems.held(V, problems.bottom)]
    bcs += [problems.held(V, upper, i, -0.01 * i) for i in range(2)]
    on, against = order
    problem = ContactProblem(a, L, bcs, [Contact(tags, on, against=against)])
    problem.solve()
    assert problem.certificate.passed
    entered = "enter each other by up to 0.01 at vertices"
    assert any(entered in text for text in problem.certificate.warnings)


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_bodies_that_enter_each_other_without_a_contact_cause_a_warning(cell: str) -> None:
    """The upper block is pushed into the lower one, drawn from it, or stopped by a contact."""
    forms = problems.two_blocks(cell, 1)
    V, up = forms.space, forms.space.mesh.geometry.dim - 1
    for moved, contacts, told in ((-0.05, [], True), (0.05, [], False), (-0.05, None, False)):
        top = [
            problems.held(V, lambda x: np.isclose(x[up], 2.0), i, moved * (i == up))
            for i in range(up + 1)
        ]
        with_contacts = forms.contacts if contacts is None else contacts
        problem = ContactProblem(forms.a, forms.L, [*forms.bcs, *top], with_contacts)
        problem.solve()
        assert problem.certificate.passed
        found = [text for text in problem.certificate.warnings if "enter each other by" in text]
        assert len(found) == told
        assert all(text.endswith("no entry of `contacts` joins them") for text in found)


def test_a_body_that_moves_farther_than_it_is_large_causes_a_warning() -> None:
    forms = problems.block("quadrilateral", 1)
    tags = problems.facet_tags(forms.space.mesh, {3: problems.bottom})
    v = forms.L.arguments()[0]
    down = ufl.inner(fem.Constant(forms.space.mesh, np.array([0.0, -0.1])), v) * ufl.dx
    for place, told in ((-500.0, True), (-0.5, False)):
        floor = Contact(tags, 3, Plane((0, place), (0, 1)))
        problem = ContactProblem(forms.a, down, [], [floor])
        problem.solve()
        moves = "the body moves by 500, farther than it is large (1.17)"
        assert any(moves in text for text in problem.certificate.warnings) == told


def test_bodies_about_one_point_are_named_by_their_sizes() -> None:
    """Nothing holds a square in the hole of a frame."""
    frame = np.stack(np.meshgrid(range(4), range(4), indexing="ij"), -1).reshape(-1, 2)
    square = [[1.1, 1.1], [1.9, 1.1], [1.1, 1.9], [1.9, 1.9]]
    cells = [[k, k + 4, k + 1, k + 5] for k in (0, 1, 2, 4, 6, 8, 9, 10)] + [[16, 17, 18, 19]]
    points = np.concatenate([frame, square])
    mesh = dolfinx_compat.create_mesh(np.array(cells), points, "quadrilateral")
    V = problems.vector_space(mesh, 1)
    a, L = problems.elastic(V, 1.0)
    held = [problems.held(V, problems.bottom)]
    problem = ContactProblem(a, L, held, [])
    problem.solve()
    name = "the body about (1.5, 1.5, 0) of size 0.8 × 0.8 can move freely"
    assert any(name in text for text in problem.certificate.warnings)


@pytest.mark.parametrize(
    ("cell", "cells", "degree", "told"),
    [
        ("quadrilateral", (25, 1), 1, True),
        ("quadrilateral", (100, 4), 1, False),
        ("quadrilateral", (25, 1), 2, False),
        ("hexahedron", (25, 1, 1), 1, True),
    ],
)
def test_bricks_that_lock_in_bending_cause_a_warning(
    cell: str, cells: tuple[int, ...], degree: int, told: bool
) -> None:
    d = len(cells)
    mesh = problems.box(cell, cells, (10.0, 0.4, 0.4)[:d], MPI.COMM_WORLD)
    V = problems.vector_space(mesh, degree)
    tags = problems.facet_tags(mesh, {3: problems.bottom})
    a, L = problems.elastic(V, 1000.0, force=[0.0, -1e-3, 0.0][:d])
    floor = Contact(tags, 3, Plane((0.0, -0.5, 0.0)[:d], (0.0, 1.0, 0.0)[:d]))
    problem = ContactProblem(a, L, [problems.held(V, problems.left)], [floor])
    problem.solve()
    found = [text for text in problem.certificate.warnings if "lock in bending" in text]
    assert [text.startswith("the body: ") for text in found] == [True] * told


def stresses(mesh: Any, kind: str) -> Callable[[Any], Any]:
    """A material by name, as the function from displacement to stress; E = 1000."""
    height = ufl.SpatialCoordinate(mesh)[mesh.geometry.dim - 1]
    if kind == "lining":  # of rubber below steel
        soft = ufl.conditional(ufl.lt(height, 0.2), 1.0, 0.0)
        return lambda u: (
            soft * problems.isotropic(u, 3.0, 0.4995) + (1 - soft) * problems.isotropic(u, 1e3, 0.3)
        )
    if kind == "layers":
        factor = ufl.conditional(ufl.lt(height, 0.2), 1.0, 20.0)
        return lambda u: factor * problems.isotropic(u, 1000.0, 0.3)
    if kind == "orthotropic":
        return problems.orthotropic
    poisson = {"rubber": 0.4999, "soft": 0.47}.get(kind, 0.3)
    return lambda u: problems.isotropic(u, 1000.0, poisson)


def locking_of(cell: str, kind: str, degree: int = 1, cells: tuple[int, ...] = ()) -> list[str]:
    """Warnings of locking of a block, held at its left end, that is pressed on a floor."""
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    cells = cells or (10, 5, 5)[:d]
    upper = (2.0, 1.0, 1.0) if cells[-1] > 2 else (10.0, 0.4, 0.4)
    mesh = problems.box(cell, cells, upper[:d], MPI.COMM_WORLD)
    V = problems.vector_space(mesh, degree)
    up = d - 1
    tags = problems.facet_tags(mesh, {3: lambda x: np.isclose(x[up], 0.0)})
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    if kind == "reduced":
        mean = ufl.dx(metadata={"quadrature_degree": 1})
        a = 2 * 333.0 * ufl.inner(problems.strain(u), problems.strain(v)) * ufl.dx
        a += 1.7e6 * ufl.div(u) * ufl.div(v) * mean
    else:
        a = ufl.inner(stresses(mesh, kind)(u), problems.strain(v)) * ufl.dx
    if kind == "mass":
        a += 1e4 * ufl.inner(u, v) * ufl.dx
    push, normal, point = np.zeros(d), np.zeros(d), np.zeros(d)
    push[up], normal[up], point[up] = -1e-3, 1.0, -1e-6 if cells[-1] > 2 else -0.5
    floor = Contact(tags, 3, Plane(tuple(point), tuple(normal)))
    bcs = [problems.held(V, problems.left)]
    problem = ContactProblem(a, ufl.inner(fem.Constant(mesh, push), v) * ufl.dx, bcs, [floor])
    problem.solve()
    assert problem.certificate.passed
    said = {"lock as Poisson": "volume", "lock in bending": "bending", "stiff in bending": "error"}
    return [
        name for text in problem.certificate.warnings for part, name in said.items() if part in text
    ]


@pytest.mark.parametrize("cell", list(problems.CELLS))
def test_cells_of_degree_1_lock_near_half(cell: str) -> None:
    assert "volume" in locking_of(cell, "rubber")
    assert "volume" in locking_of(cell, "lining")
    for kind in ("soft", "layers", "orthotropic", "mass"):
        assert locking_of(cell, kind) == [], kind


def test_reduced_integration_and_degree_2_do_not_lock() -> None:
    assert locking_of("quadrilateral", "reduced") == []
    assert "volume" in locking_of("triangle", "reduced")  # one point changes nothing there
    assert locking_of("triangle", "rubber", degree=2) == []


@pytest.mark.parametrize(("cell", "cells"), [("triangle", (25, 1)), ("tetrahedron", (25, 1, 1))])
def test_simplices_in_bending_cause_a_warning(cell: str, cells: tuple[int, ...]) -> None:
    assert locking_of(cell, "steel", cells=cells) == ["error"]
    assert locking_of(cell, "steel", degree=2, cells=cells) == []


def test_the_estimate_of_simplices_is_near_the_error() -> None:
    """A beam of triangles, beside the energy on a mesh of degree 2."""
    mesh = problems.box("triangle", (10, 2), (2.0, 0.4), MPI.COMM_WORLD)
    energies, estimate = [], ""
    for degree in (1, 2):
        V = problems.vector_space(mesh, degree)
        a, L = problems.elastic(V, 1000.0, force=[0.0, -0.01])
        tags = problems.facet_tags(mesh, {3: problems.bottom})
        floor = Contact(tags, 3, Plane((0.0, -1.0), (0.0, 1.0)))
        problem = ContactProblem(a, L, [problems.held(V, problems.left)], [floor])
        problem.solve()
        energies.append(problem.summary["solution"]["energy"])
        estimate += " ".join(w for w in problem.certificate.warnings if "estimated" in w)
    error = np.sqrt(1.0 - energies[0] / energies[1])
    (found,) = re.findall(r"estimated at (\d+) %", estimate)
    assert float(found) == pytest.approx(100.0 * error, rel=0.25)


def test_pressures_in_cylindrical_coordinates_cause_a_warning() -> None:
    """A disc pressed flat on a floor: the guide's ratio of integrals gives its uniform pressure."""
    mesh = problems.box("triangle", (6, 4), (1.0, 0.5), MPI.COMM_WORLD)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(mesh, {1: problems.bottom, 2: lambda x: np.isclose(x[1], 0.5)})
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    r = ufl.SpatialCoordinate(mesh)[0]
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)

    def strain(w: Any) -> Any:
        return ufl.as_vector([w[0].dx(0), w[1].dx(1), w[0] / r, (w[0].dx(1) + w[1].dx(0)) / 2**0.5])

    trace = 50.0 * (ufl.div(u) + u[0] / r) * (ufl.div(v) + v[0] / r)
    a = (trace + 70.0 * ufl.inner(strain(u), strain(v))) * r * ufl.dx(degree=4)
    axis = problems.held(V, problems.left, 0)
    floor = Contact(tags, 1, Plane((0.0, 0.0), (0.0, 1.0)))
    problem = ContactProblem(a, -3.0 * v[1] * r * ds(2), [axis], [floor], tolerance=1e-9)
    problem.solve()
    assert any("times r" in text for text in problem.certificate.warnings)
    rough = replace(floor, weight=lambda x: x[:, 0], friction={"tresca": 0.2})
    for contact in (replace(rough, friction=None), rough):
        problem = ContactProblem(a, -3.0 * v[1] * r * ds(2), [axis], [contact], tolerance=1e-9)
        problem.solve()
        assert not any("times r" in text for text in problem.certificate.warnings)
        on = problem.contact_pressure.x.array > 0.0
        (record,) = problem.summary["contacts"]
        assert record["area"] == pytest.approx(0.5, rel=1e-9)
        assert record["force"][1] == pytest.approx(1.5, rel=1e-6)
        if contact is not rough:
            assert problem.contact_pressure.x.array[on] == pytest.approx(3.0, rel=1e-6)
            assert record["max_smoothed_pressure"] == pytest.approx(3.0, rel=1e-6)
    traction = np.linalg.norm(problem.friction_traction.x.array.reshape(-1, 2), axis=1)
    assert traction.max() == pytest.approx(0.2, rel=1e-6)
    plane = ufl.inner(problems.isotropic(u, 1.0, 0.3), problems.strain(v)) * (1 + r) * ufl.dx
    problem = ContactProblem(plane, -3.0 * v[1] * ds(2), [axis], [floor])
    problem.solve()
    assert not any("times r" in text for text in problem.certificate.warnings)


def test_a_warning_names_a_play() -> None:
    """A block between two walls that do not touch it stands anywhere between them."""
    forms = problems.block("quadrilateral", 1)
    tags = problems.facet_tags(forms.space.mesh, {3: problems.bottom, 4: problems.left,
                                                  5: problems.right})  # fmt: skip
    v = forms.L.arguments()[0]
    down = ufl.inner(fem.Constant(forms.space.mesh, np.array([0.0, -0.1])), v) * ufl.dx
    contacts = [Contact(tags, 3, Plane((0, 0), (0, 1))), Contact(tags, 4, Plane((-0.1, 0), (1, 0))),
                Contact(tags, 5, Plane((1.2, 0), (-1, 0)))]  # fmt: skip
    problem = ContactProblem(forms.a, down, [], contacts)
    problem.solve()
    told = problem.certificate.warnings
    assert any("the body has a play of 0.299 along +x" in text for text in told), told


@pytest.mark.parametrize("steep", [True, False])
def test_surfaces_that_press_and_are_tilted_cause_a_warning(steep: bool) -> None:
    """A tooth, with flanks of 50° or of 6°, overlaps a block by 0.2."""
    block = meshfiles.block("triangle", 16, 0.0)
    below, cells = block.points[:, :2], block.cells_dict["triangle"].astype(np.int64)

    def foot(x: np.ndarray) -> np.ndarray:
        return 0.8 + (1.2 if steep else 0.1) * np.abs(x - 0.5)

    tooth = below + [0.0, 0.8]
    tooth[:, 1] += (foot(below[:, 0]) - 0.8) * (1.0 - below[:, 1])
    mesh = dolfinx_compat.create_mesh(
        np.concatenate([cells, cells + len(below)]), np.concatenate([below, tooth]), "triangle"
    )
    tags, V = problems.facet_tags(mesh, {
        1: lambda x: np.isclose(x[1], foot(x[0])) & ~np.isclose(x[1], 1.0),
        2: lambda x: np.isclose(x[1], 1.0),
    }), problems.vector_space(mesh, 1)  # fmt: skip
    a, L = problems.elastic(V, 1.0, 0.35)
    bcs = [problems.held(V, lambda x, y=y: np.isclose(x[1], y)) for y in (0.0, 1.8)]
    problem = ContactProblem(a, L, bcs, [Contact(tags, 1, against=2)])
    problem.solve()
    assert problem.certificate.passed
    told = "\n".join(problem.certificate.warnings)
    tilted = "press that are tilted against each other and up to 0.2 apart" in told
    assert ("contacts[0]: surfaces of the body" in told and tilted) == steep, told


@pytest.mark.parametrize(("above", "told"), [(0.3, True), (0.2, False)])
def test_a_body_between_equally_rough_sides_is_carried_by_either(above: float, told: bool) -> None:
    """A block on a rough floor under a slab that is pressed and pushed by 0.1."""
    mesh = problems.stacked("quadrilateral", MPI.COMM_WORLD)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(mesh, {
        1: lambda x: np.isclose(x[1], 1.0),
        2: lambda x: np.isclose(x[1], 0.99),
        3: problems.bottom,
    })  # fmt: skip
    a, L = problems.elastic(V, 1.0)
    top = [problems.held(V, lambda x: np.isclose(x[1], 2.0), i, (0.1, -0.011)[i]) for i in (0, 1)]
    sides = [
        Contact(tags, 3, Plane((0, 0), (0, 1)), friction={"coulomb": 0.3}),
        Contact(tags, 1, against=2, friction={"coulomb": above}),
    ]
    problem = ContactProblem(a, L, top, sides)
    problem.solve()
    assert problem.certificate.passed
    found = [w for w in problem.certificate.warnings if "wherever friction acts" in w]
    assert len(found) == told, problem.certificate.warnings


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron", "tetrahedron"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("material", ["isotropic", "orthotropic", "layered"])
def test_few_facets_across_have_the_peak_of_hertz(cell: str, degree: int, material: str) -> None:
    """A roller and a ball two facets wide; the theory is of one isotropic material."""
    d, cells = (2, (16, 8)) if cell == "quadrilateral" else (3, (10, 10, 5))
    size = (2.0, 2.0, 1.0)[3 - d :]
    mesh = problems.box(cell, cells, size, MPI.COMM_WORLD)
    V, up = problems.vector_space(mesh, degree), d - 1
    tags = problems.facet_tags(mesh, {1: lambda x: np.isclose(x[up], 1.0)})
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    young: Any = 1000.0
    if material == "layered":
        young *= 1.0 + ufl.conditional(ufl.lt(ufl.SpatialCoordinate(mesh)[up], 0.5), 1.0, 0.0)
    a = ufl.inner(problems.isotropic(u, young, 0.3), problems.strain(v)) * ufl.dx
    if material == "orthotropic":
        a += 500.0 * u[0].dx(0) * v[0].dx(0) * ufl.dx
    L = ufl.inner(fem.Constant(mesh, np.zeros(d)), v) * ufl.dx
    ball = Contact(tags, 1, Sphere((*(1.03,) * up, 5.0), 4.0), interference=0.003)
    problem = ContactProblem(a, L, [problems.held(V, lambda x: np.isclose(x[up], 0.0))], [ball])
    problem.solve()
    (record,), modulus = problem.summary["contacts"], 1000.0 / 0.91
    force, largest = -record["force"][up], problem.smoothed_contact_pressure.x.array.max()
    right = (6.0 * force * modulus**2 / (np.pi**3 * 16.0)) ** (1.0 / 3.0)
    if d == 2:
        right = (force * modulus / (np.pi * 4.0)) ** 0.5
    told = [text for text in problem.certificate.warnings if "Hertz's theory gives" in text]
    if material == "isotropic":
        assert record["max_smoothed_pressure"] == pytest.approx(right, rel=0.01)
        assert f"max_smoothed_pressure, {right:.2g}"[:-1] in told[0]
        assert abs(largest / right - 1.0) > 0.015
    else:
        assert record["max_smoothed_pressure"] == pytest.approx(largest, rel=1e-12)
        assert not told
