"""Repeated solves of one problem under changing loads: equal data are reused, others computed
again."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from contact_app import Contact, ContactProblem, Plane
from contact_app.forms import friction as forms_friction
from contact_app.forms import sides as forms_sides
from tests import form_problems as problems


@dataclass
class Pressed:
    """A square beside a wall, with everything that a user may change between two solves."""

    problem: ContactProblem
    young: Any
    push: Any
    foot: Any


def pressed(method: Any, cells: int, values: tuple[float, float, float]) -> Pressed:
    """`values` are Young's modulus, the push and the displacement of the foot."""
    mesh = problems.box("quadrilateral", (cells, cells), (1.0, 0.8), MPI.COMM_WORLD)
    V = problems.vector_space(mesh, 1)
    tags = problems.facet_tags(
        mesh, {1: problems.right, 2: lambda x: np.isclose(x[1], 0.8)}
    )  # fmt: skip
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    young = fem.Constant(mesh, values[0])
    push, foot = fem.Constant(mesh, np.array([0.0, values[1]])), fem.Function(V)
    foot.x.array[::2] = values[2]
    dofs = fem.locate_dofs_geometrical(V, problems.bottom)
    problem = ContactProblem(
        young * ufl.inner(problems.isotropic(u, 1.0, 0.3), problems.strain(v)) * ufl.dx,
        ufl.inner(push, v) * ds(2),
        [fem.dirichletbc(foot, dofs)],
        [Contact(tags, 1, Plane(point=(1.01, 0), normal=(-1, -0.005)))],
        tolerance=1e-10,
        method=method,
    )
    return Pressed(problem, young, push, foot)


@pytest.mark.parametrize(("method", "cells"), [("auto", 30), ("auto", 6), ("active-set", 6)])
def test_the_second_solve_is_that_of_a_fresh_problem(method: Any, cells: int) -> None:
    """A regular mesh in sub-boxes, multigrid, and a whole body with its held nodes eliminated."""
    own = pressed(method, cells, (200.0, -5.0, 0.0))
    own.problem.solve()
    first = own.problem.summary
    own.push.value[:] = [0.0, -9.0]
    own.foot.x.array[::2] = 0.004
    u = own.problem.solve()
    second = own.problem.summary
    assert second["timings"]["factorization"] == 0.0
    fresh = pressed(method, cells, (200.0, -9.0, 0.004))
    w = fresh.problem.solve()
    assert own.problem.certificate.passed
    assert u.x.array == pytest.approx(w.x.array, abs=1e-8 * np.abs(w.x.array).max())
    energies = [s["solution"]["energy"] for s in (second, fresh.problem.summary, first)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)
    assert energies[0] != pytest.approx(energies[2], rel=1e-2)


@pytest.mark.parametrize("cells", [30, 6])
def test_another_stiffness_or_condition_changes_the_class(cells: int) -> None:
    own = pressed("auto", cells, (200.0, -5.0, 0.0))
    own.problem.solve()
    own.young.value = 300.0
    u = own.problem.solve()
    w = pressed("auto", cells, (300.0, -5.0, 0.0)).problem.solve()
    assert u.x.array == pytest.approx(w.x.array, abs=1e-8 * np.abs(w.x.array).max())
    V = u.function_space
    left = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    own.problem.bcs.append(fem.dirichletbc(np.zeros(2), left, V))
    held = own.problem.solve()
    assert np.abs(held.x.array.reshape(-1, 2)[left]).max() < 1e-10
    assert own.problem.certificate.passed


def counted(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """How often surfaces are gathered from all ranks and overlaps of pairs are found."""
    calls = dict.fromkeys(("gathered_surface", "mean_gaps", "mean_jumps"), 0)
    for module in (forms_sides, forms_friction):
        for name in calls:
            if hasattr(module, name):
                monkeypatch.setattr(module, name, counting(calls, name, getattr(module, name)))
    return calls


def counting(calls: dict[str, int], name: str, function: Any) -> Any:
    def call(*given: Any, **options: Any) -> Any:
        calls[name] += 1
        return function(*given, **options)

    return call


def test_the_surfaces_of_a_rough_pair_are_gathered_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """For mortar rows, friction and smoothing, also in a second solve with another load."""
    calls = counted(monkeypatch)
    forms = problems.rough(problems.two_blocks("triangle", 1))
    push = fem.Constant(forms.space.mesh, np.array([0.002, -0.05]))
    ds = ufl.Measure("ds", domain=forms.space.mesh, subdomain_data=top_of(forms.space.mesh))
    load = ufl.inner(push, ufl.TestFunction(forms.space)) * ds(3)
    own = ContactProblem(forms.a, load, forms.bcs, forms.contacts, tolerance=1e-10)
    own.solve()
    assert calls == {"gathered_surface": 2, "mean_gaps": 1, "mean_jumps": 1}
    push.value[:] = [-0.004, -0.06]
    u = own.solve().x.array.copy()
    assert calls == {"gathered_surface": 2, "mean_gaps": 1, "mean_jumps": 1}
    fresh = ContactProblem(forms.a, load, forms.bcs, forms.contacts, tolerance=1e-10)
    np.testing.assert_allclose(fresh.solve().x.array, u, atol=1e-8 * np.abs(u).max())
    assert fresh.summary["contacts"][0]["nodes"] == own.summary["contacts"][0]["nodes"]
    smoothed = own.smoothed_contact_pressure.x.array
    assert smoothed.max() > 0.0
    known = fresh.smoothed_contact_pressure.x.array
    np.testing.assert_allclose(smoothed, known, atol=1e-6 * smoothed.max())


def test_other_tags_make_other_sides() -> None:
    """The values of facet tags may change between two solves, as those of forms."""
    own = pressed("auto", 6, (200.0, -5.0, 0.0))
    own.problem.solve()
    tags = own.problem.contacts[0].facet_tags
    if not tags.values.flags.writeable:
        pytest.skip("this dolfinx does not let tags change")
    right = np.flatnonzero(tags.values == 1)
    assert own.problem.summary["contacts"][0]["nodes"]["open"] > 0
    count = sum(own.problem.summary["contacts"][0]["nodes"].values())
    tags.values[right[len(right) // 2 :]] = 9
    own.problem.solve()
    assert own.problem.certificate.passed
    assert sum(own.problem.summary["contacts"][0]["nodes"].values()) < count


def test_fields_of_friction_are_made_where_there_is_friction() -> None:
    smooth = problems.two_blocks("triangle", 1)
    plain = smooth.problem()
    plain.solve()
    assert (plain.friction_traction, plain.slip, plain.contact_status) == (None, None, None)
    rough = problems.rough(smooth).problem()
    rough.solve()
    assert set(rough.contact_status.x.array) <= {0.0, 1.0, 2.0}
    assert np.abs(rough.friction_traction.x.array).max() > 0.0


def top_of(mesh: Any) -> Any:
    return problems.facet_tags(mesh, {3: lambda x: np.isclose(x[1], 2.0)})
