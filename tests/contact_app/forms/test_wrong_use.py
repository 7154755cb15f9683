"""Errors of `ContactProblem` and their messages; missing equilibrium, and held motions."""

from collections.abc import Callable
from typing import Any

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from contact_app import Contact, ContactProblem, Cylinder, Plane, SignedDistance, Sphere
from contact_app.errors import ConfigurationError, NoEquilibriumError
from tests import form_problems as problems

FLOOR = Plane(point=(0, 0), normal=(0, 1))


@pytest.fixture(scope="module")
def square() -> Any:
    return problems.box("triangle", (3, 3), (1.0, 1.0), MPI.COMM_WORLD)


@pytest.fixture(scope="module")
def tags(square: Any) -> Any:
    return problems.facet_tags(square, {1: problems.bottom, 2: problems.left})


class Square:
    """A space on the square with the forms of an elastic body."""

    def __init__(self, space: Any) -> None:
        self.space = space
        self.u, self.v = ufl.TrialFunction(space), ufl.TestFunction(space)
        self.a = ufl.inner(problems.strain(self.u), problems.strain(self.v)) * ufl.dx
        self.L = self.load(0.0, -1.0)

    def load(self, *force: float) -> Any:
        return ufl.inner(fem.Constant(self.space.mesh, np.array(force)), self.v) * ufl.dx


@pytest.fixture(scope="module")
def body(square: Any) -> Square:
    return Square(problems.vector_space(square, 1))


WRONG_FORMS: dict[str, tuple[Callable[[Square], tuple], type, str]] = {
    "compiled": (lambda b: (fem.form(b.a), b.L), TypeError, "not yet compiled"),
    "swapped": (lambda b: (b.L, b.a), ValueError, "have 1 and 2 arguments"),
    "scalar": (lambda b: scalar_forms(b), ValueError, "continuous vector Lagrange"),
    "discontinuous": (
        lambda b: forms_over(problems.vector_space(b.space.mesh, 1, "DG")), ValueError,
        "continuous vector Lagrange",
    ),
    "cubic": (
        lambda b: forms_over(problems.vector_space(b.space.mesh, 3)), ValueError, "degree 3"
    ),
    "other space": (
        lambda b: (b.a, Square(problems.vector_space(b.space.mesh, 2)).L), ValueError, "one space"
    ),
    "interior facets": (
        lambda b: (b.a + ufl.inner(ufl.jump(b.u), ufl.jump(b.v)) * ufl.dS, b.L), ValueError,
        "interior_facet",
    ),
    "complex": (
        lambda b: (fem.Constant(b.space.mesh, 1j) * b.a, b.L), TypeError, "complex constant"
    ),
    "no tags": (
        lambda b: (b.a, b.L + b.v[1] * ufl.ds(2)), ValueError, r"over ds\(2\) without tags"
    ),
    "no such tag": (
        lambda b: (b.a, b.L + b.v[1] * tagged_ds(b)(7)), ValueError, "no entity with the value 7"
    ),
    "other mesh": (
        lambda b: (b.a, b.L + ufl.TestFunction(b.space)[1] * ufl.dx(domain=another_square())),
        ValueError, "L has an integral over another mesh",
    ),
}  # fmt: skip


def tagged_ds(body: Square) -> Any:
    mesh = body.space.mesh
    tags = problems.facet_tags(mesh, {1: problems.bottom, 2: problems.left})
    return ufl.Measure("ds", domain=mesh, subdomain_data=tags)


def another_square() -> Any:
    return problems.box("triangle", (2, 2), (1.0, 1.0), MPI.COMM_WORLD)


def scalar_forms(body: Square) -> tuple:
    space = problems.scalar_space(body.space.mesh, 1)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx, v * ufl.dx


def forms_over(space: Any) -> tuple:
    other = Square(space)
    return other.a, other.L


@pytest.mark.parametrize("name", WRONG_FORMS)
def test_forms_that_are_refused(name: str, body: Square) -> None:
    make, kind, text = WRONG_FORMS[name]
    with pytest.raises(kind, match=text):
        ContactProblem(*make(body))


def test_forms_that_are_found_out_when_assembled(body: Square) -> None:
    u, v = body.u, body.v
    skew = u[0].dx(0) * v[1] * ufl.dx
    for a, text in (
        (body.a + skew, "not symmetric"),
        (-body.a, "not elliptic: some displacement"),
        (body.a - ufl.inner(u, v) * ufl.dx, "not elliptic: the energy"),
        (body.a - 0.8 * ufl.div(u) * ufl.div(v) * ufl.dx, "not elliptic: the energy"),
        (fem.Constant(body.space.mesh, np.nan) * body.a, "not finite"),
    ):
        with pytest.raises(ValueError, match=text):
            ContactProblem(a, body.L).solve()


def test_numbers_that_are_not_finite_are_named(body: Square) -> None:
    """Also where a solve has gone well before."""
    mesh, left = body.space.mesh, problems.held(body.space, problems.left)
    load = fem.Constant(mesh, np.array([0.0, -1.0]))
    problem = ContactProblem(body.a, ufl.inner(load, body.v) * ufl.dx, [left])
    problem.solve()
    load.value[1] = np.nan
    with pytest.raises(ValueError, match="L has entries that are not finite"):
        problem.solve()
    with pytest.raises(ValueError, match="L has entries that are not finite"):
        ContactProblem(body.a, body.load(np.inf, 0.0), [left]).solve()
    moved = problems.held(body.space, problems.left, 0, np.nan)
    with pytest.raises(ValueError, match="value of a Dirichlet condition is not finite"):
        ContactProblem(body.a, body.L, [moved]).solve()


def test_a_plane_mesh_in_space_is_refused() -> None:
    """Gmsh's meshes have three coordinates unless asked for two."""
    cube = problems.box("tetrahedron", (1, 1, 1), (1.0, 1.0, 1.0), MPI.COMM_WORLD)
    facets = dolfinx.mesh.locate_entities_boundary(cube, 2, problems.left)
    mesh = dolfinx.mesh.create_submesh(cube, 2, facets)[0]
    space = problems.vector_space(mesh, 1)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    with pytest.raises(ValueError, match="cells triangle in 3D; .* gdim=2"):
        ContactProblem(ufl.inner(problems.strain(u), problems.strain(v)) * ufl.dx, v[0] * ufl.dx)


def test_conditions_that_are_refused(body: Square) -> None:
    other = problems.held(problems.vector_space(body.space.mesh, 2), problems.left)
    with pytest.raises(ValueError, match=r"bcs\[0\] is of another space"):
        ContactProblem(body.a, body.L, [other])
    with pytest.raises(TypeError, match=r"bcs\[0\] is no Dirichlet"):
        ContactProblem(body.a, body.L, [3])
    left, beside = (problems.held(body.space, where) for where in (problems.left, nowhere))
    with pytest.raises(ValueError, match=r"bcs\[1\] holds no node"):
        ContactProblem(body.a, body.L, [left, beside]).solve()


def nowhere(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[0], 5.0)


def contacts_of(tags: Any, mesh: Any) -> dict[str, tuple[Any, type, str]]:
    cells = dolfinx.mesh.meshtags(mesh, 2, np.array([0], np.int32), np.array([1], np.int32))
    other = problems.box("triangle", (3, 3), (1.0, 1.0), MPI.COMM_WORLD)
    foreign = problems.facet_tags(other, {1: problems.bottom})
    return {
        "foreign": (Contact(foreign, 1, FLOOR), ValueError, "of another mesh"),
        "no contact": (FLOOR, TypeError, "must be a Contact"),
        "no tags": (Contact(None, 1, FLOOR), TypeError, "mesh tags of facets"),
        "cell tags": (Contact(cells, 1, FLOOR), ValueError, "of dimension 2"),
        "nothing": (Contact(tags, 1), ValueError, "obstacle or `against`"),
        "both": (Contact(tags, 1, FLOOR, against=2), ValueError, "not both"),
        "itself": (Contact(tags, 1, against=1), ValueError, "on both sides"),
        "word": (Contact(tags, "floor", FLOOR), TypeError, "integer"),
        "number": (Contact(tags, 1, 3.0), TypeError, "Plane, Sphere"),
        "bar": (Contact(tags, 1, Cylinder((0, 0), (0, 1), 1)), ValueError, "needs 3D"),
        "in space": (Contact(tags, 1, Plane((0, 0, 1), (0, 1, 0))), ValueError, "point must be 2"),
        "no normal": (Contact(tags, 1, Plane((0, 0), (0, 0))), ValueError, "normal is zero"),
        "radius": (Contact(tags, 1, Sphere((0, 0), -1.0)), ValueError, "radius must be a positive"),
        "gap": (Contact(tags, 1, FLOOR, interference=np.nan), ValueError, "interference"),
        "word as gap": (Contact(tags, 1, FLOOR, interference="a"), ValueError, "interference"),
        "radius as text": (Contact(tags, 1, Sphere((0, 0), "1")), ValueError, "radius must be"),
        "hollow": (Contact(tags, 1, Sphere((0, 0), 1.0, hollow="no")), TypeError, "True or False"),
        "weight": (Contact(tags, 1, FLOOR, weight=2.0), TypeError, "weight must be a Python func"),
        "expression": (
            Contact(tags, 1, ufl.SpatialCoordinate(mesh)[1]),
            TypeError,
            "obstacle must be a Python",
        ),
        "constant": (
            Contact(tags, 1, fem.Constant(mesh, 1.0)),
            TypeError,
            "obstacle must be a Python",
        ),
        "slope": (
            Contact(tags, 1, SignedDistance(lambda x: x[:, 1], ufl.SpatialCoordinate(mesh))),
            TypeError,
            r"obstacle\.gradient must be a Python function",
        ),
        "weighted pair": (
            Contact(tags, 1, against=2, weight=lambda x: x[:, 0]),
            ValueError,
            "weight is for obstacles",
        ),
        "name": (Contact(tags, 1, FLOOR, name=3), TypeError, "name must be of type str"),
        "round as text": (Contact(tags, 1, against=2, round="no"), TypeError, "of type bool"),
        "round": (Contact(tags, 1, FLOOR, round=True), ValueError, "facets against facets"),
        "friction": (Contact(tags, 1, FLOOR, friction=0.3), TypeError, "must be one law"),
        "law": (Contact(tags, 1, FLOOR, friction={"mohr": 1.0}), ValueError, "must be one law"),
        "two laws": (
            Contact(tags, 1, FLOOR, friction={"coulomb": 0.1, "tresca": 1.0}),
            ValueError,
            "one law",
        ),
        "coefficient": (
            Contact(tags, 1, FLOOR, friction={"coulomb": -0.1}),
            ValueError,
            "coulomb.*positive",
        ),
        "limit": (Contact(tags, 1, FLOOR, friction={"tresca": "x"}), TypeError, "a number"),
    }


def test_contacts_that_are_refused(body: Square, tags: Any) -> None:
    for name, (contact, kind, text) in contacts_of(tags, body.space.mesh).items():
        with pytest.raises(kind, match=text):
            ContactProblem(body.a, body.L, contacts=[contact])
            pytest.fail(name)


def test_weights_that_are_of_no_use(body: Square, tags: Any) -> None:
    other = Square(problems.vector_space(body.space.mesh, 2))
    radius = Contact(tags, 1, FLOOR, weight=lambda x: x[:, 0] - 0.5)
    with pytest.raises(ValueError, match="weight is for spaces of degree 1, not 2"):
        ContactProblem(other.a, other.L, contacts=[radius])
    with pytest.raises(ConfigurationError, match="the weight of facets 1 is negative"):
        ContactProblem(body.a, body.L, contacts=[radius]).solve()


def test_one_obstacle_has_one_law_of_friction(body: Square, tags: Any) -> None:
    smooth, rough = Contact(tags, 1, FLOOR), Contact(tags, [1, 2], FLOOR, friction={"coulomb": 0.3})
    with pytest.raises(
        ValueError, match=r"contacts\[1\] repeats contacts\[0\] with other friction"
    ):
        ContactProblem(body.a, body.L, contacts=[smooth, rough])


def test_a_boundary_that_faces_away_causes_a_warning(body: Square, tags: Any) -> None:
    """An obstacle whose normal is turned round touches nothing."""
    held = [problems.held(body.space, problems.left)]
    for sign, count in ((1, 0), (-1, 1)):
        contact = Contact(tags, 1, Plane((0, 0), (0, sign)))
        problem = ContactProblem(body.a, body.L, held, [contact])
        problem.solve()
        warned = [w for w in problem.certificate.warnings if "faces away from the obstacle" in w]
        assert len(warned) == count


def test_facets_that_are_not_there(body: Square, tags: Any) -> None:
    with pytest.raises(ValueError, match=r"contacts\[0\]: .* tag 7 \(no facet has it\)"):
        ContactProblem(body.a, body.L, contacts=[Contact(tags, 7, FLOOR)]).solve()
    with pytest.raises(ValueError, match=r"contacts\[0\]: .* tag 7 \(no facet has it\)"):
        ContactProblem(body.a, body.L, contacts=[Contact(tags, [1, 7], FLOOR)]).solve()
    with pytest.raises(ValueError, match=r"contacts\[0\].against: .* tag 8"):
        ContactProblem(body.a, body.L, contacts=[Contact(tags, 1, against=8)]).solve()
    mesh = body.space.mesh
    inside = dolfinx.mesh.locate_entities(
        mesh, 1, lambda x: np.isclose(x[0], 1 / 3)
    )  # fmt: skip
    within = dolfinx.mesh.meshtags(mesh, 1, np.sort(inside), np.full(len(inside), 5, np.int32))
    with pytest.raises(ValueError, match="3 facets have it inside of the bodies"):
        ContactProblem(body.a, body.L, contacts=[Contact(within, 5, FLOOR)]).solve()


def test_distances_that_are_of_no_use(body: Square, tags: Any) -> None:
    for distance, text in (
        (lambda x: x, "a row of x is a point"),
        (lambda x: 0.0 * x[:, 0], "no gradient"),
        (lambda x: np.log(x[:, 1] - 1.0), "not finite"),
        (lambda x: 1 / 0, "raised ZeroDivisionError: division by zero"),
        (lambda x, y: x[:, 1], "raised TypeError: .*missing 1 required"),
        (lambda x: x[:, 1] + 0j, "returned values of type complex128"),
        (lambda x: None, "returned nothing"),
    ):
        with np.errstate(invalid="ignore"), pytest.raises(ConfigurationError, match=text):
            ContactProblem(body.a, body.L, contacts=[Contact(tags, 1, distance)]).solve()
    wrong = SignedDistance(lambda x: x[:, 1], lambda x: x[:, 1])
    with pytest.raises(ConfigurationError, match="the gradient"):
        ContactProblem(body.a, body.L, contacts=[Contact(tags, 1, wrong)]).solve()


@pytest.mark.parametrize(
    ("degree", "at", "hint"), [(1, 0.8, None), (1, 0.9, False), (2, 0.8, True)]
)
def test_a_block_that_tips_in_the_mean_over_its_facets_gets_a_hint(
    degree: int, at: float, hint: bool | None
) -> None:
    """Facets of 0.233 end at 0.85: with degree 2 the pressure reaches to 0.772."""
    forms = problems.two_blocks("quadrilateral", degree)
    x, v = ufl.SpatialCoordinate(forms.space.mesh), ufl.TestFunction(forms.space)
    off = 1.0 + (at - 0.5) * 12.0 / 0.49 * (x[0] - 0.5)
    top = ufl.conditional(ufl.gt(x[1], 1.99), off, 0.0)
    problem = ContactProblem(forms.a, -0.05 * top * v[1] * ufl.ds, forms.bcs, forms.contacts)
    if hint is None:
        problem.solve()
        assert problem.certificate.passed
        return
    with pytest.raises(NoEquilibriumError, match="nothing stops") as caught:
        problem.solve()
    assert ("contacts[0]: this motion closes the gap at nodes" in str(caught.value)) == hint


def test_a_body_that_leaves_is_refused(body: Square, tags: Any) -> None:
    floor = Contact(tags, 1, FLOOR)
    with pytest.raises(NoEquilibriumError, match=r"leaving along \+y"):
        ContactProblem(body.a, body.load(0.0, 1.0), contacts=[floor]).solve()
    with pytest.raises(NoEquilibriumError, match=r"leaving along \+x"):
        ContactProblem(body.a, body.load(1.0, -1.0), contacts=[floor]).solve()
    springs = 1e-3 * body.u[0] * body.v[0] * ufl.dx
    problem = ContactProblem(body.a + springs, body.load(1.0, -1.0), contacts=[floor])
    problem.solve()
    assert problem.certificate.passed
    assert problem.summary["contacts"][0]["force"] == pytest.approx([0, 1, 0], abs=1e-6)


def test_motions_that_no_load_works_on_are_held(body: Square, tags: Any) -> None:
    problem = ContactProblem(body.a, body.L, contacts=[Contact(tags, 1, FLOOR)], tolerance=1e-9)
    uh = problem.solve()
    assert problem.certificate.passed
    assert "can move freely" in problem.certificate.warnings[0]
    x, u = body.space.tabulate_dof_coordinates(), uh.x.array.reshape(-1, 2)
    bottom = np.isclose(x[:, 1], 0.0)
    assert u[bottom, 1] == pytest.approx(0.0, abs=1e-9)
    assert problem.summary["contacts"][0]["force"] == pytest.approx([0, 1, 0], abs=1e-8)


def test_conditions_that_exclude_each_other(body: Square, tags: Any) -> None:
    above = Contact(tags, 1, Plane(point=(0, 0.1), normal=(0, 1)), name="floor")
    with pytest.raises(NoEquilibriumError, match="push held nodes of floor .* by up to 0.1"):
        ContactProblem(
            body.a, body.L, [problems.held(body.space, problems.bottom)], [above]
        ).solve()


def test_an_answer_is_there_after_solving(body: Square, tags: Any) -> None:
    problem = ContactProblem(body.a, body.L, contacts=[Contact(tags, 1, FLOOR)])
    with pytest.raises(RuntimeError, match="call solve"):
        _ = problem.certificate
    with pytest.raises(ValueError, match="tolerance"):
        ContactProblem(body.a, body.L, tolerance=0.0)


def test_an_uncertified_answer_causes_a_warning() -> None:
    problem = problems.block("hexahedron", 1).problem(tolerance=1e-9, max_iterations=1)
    with pytest.warns(RuntimeWarning, match="not certified"):
        problem.solve()
    assert not problem.converged


WRONG_OPTIONS: dict[str, tuple[dict[str, Any], type, str]] = {
    "method": ({"method": "cg"}, ValueError, "method is 'cg'; allowed: auto, active-set, smalbe"),
    "text": ({"tolerance": "1e-8"}, TypeError, "tolerance must be a number, not '1e-8'"),
    "iterations": ({"max_iterations": 0}, ValueError, "whole number from 1 on, not 0"),
}


@pytest.mark.parametrize("name", list(WRONG_OPTIONS))
def test_options_are_checked(name: str, body: Square, tags: Any) -> None:
    options, kind, text = WRONG_OPTIONS[name]
    with pytest.raises(kind, match=text):
        ContactProblem(body.a, body.L, [], [Contact(tags, 1, FLOOR)], **options)


def test_a_single_contact_or_condition_is_no_list(body: Square, tags: Any) -> None:
    floor, held = Contact(tags, 1, FLOOR), problems.held(body.space, problems.left)
    with pytest.raises(TypeError, match="contacts must be a list, not Contact; of one: contacts="):
        ContactProblem(body.a, body.L, [held], floor)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="bcs must be a list, not DirichletBC; of one: bcs="):
        ContactProblem(body.a, body.L, held, [floor])  # type: ignore[arg-type]


def test_the_message_of_a_function_names_its_contact(body: Square, tags: Any) -> None:
    contact = Contact(tags, 1, lambda x: x, name="foot")
    problem = ContactProblem(body.a, body.L, [problems.held(body.space, problems.left)], [contact])
    with pytest.raises(ConfigurationError, match="contact of foot: the signed distance of the"):
        problem.solve()
