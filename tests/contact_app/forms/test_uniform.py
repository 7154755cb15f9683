"""The stiffness of sub-boxes of a regular mesh, made from that of one cell."""

from typing import Any

import dolfinx
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from contact_app import Contact, ContactProblem
from contact_app.forms.energies import CellEnergies
from contact_app.forms.grid import grid_of
from contact_app.forms.parts import parts_of
from contact_app.forms.subdomains import Subdomains, subdomains_of
from contact_app.forms.uniform import EqualCells, split_form
from meshes import dolfinx_compat
from tests import form_problems as problems


def cut(cell: str, degree: int, cells: tuple[int, ...]) -> Subdomains:
    mesh = problems.box(cell, cells, (1.0, 0.8, 0.6)[: len(cells)], MPI.COMM_SELF)
    space = problems.vector_space(mesh, degree)
    grid = grid_of(space)
    assert grid is not None
    return subdomains_of(parts_of(space, grid), grid)


def energy(space: Any, stress: Any, dx: Any) -> Any:
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return ufl.inner(stress(u), problems.strain(v)) * dx


def steel(u: Any) -> Any:
    return problems.isotropic(u, 200.0, 0.3)


@pytest.mark.parametrize(
    ("cell", "degree", "cells"),
    [
        ("quadrilateral", 1, (40, 24)),
        ("quadrilateral", 2, (40, 30)),
        ("hexahedron", 1, (11, 11, 10)),
    ],
)
@pytest.mark.parametrize("springs", [0.0, 50.0])
def test_it_is_that_of_an_integration_over_all_cells(
    cell: str, degree: int, cells: tuple[int, ...], springs: float
) -> None:
    own = cut(cell, degree, cells)
    space = own.parts.space
    a = energy(space, steel, ufl.dx)
    if springs:
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        a += springs * ufl.inner(u, v) * ufl.ds
    made, integrated = (
        own.stiffness(a, EqualCells.of(own.parts, own.grid, a)),
        own.parts.stiffness(a),
    )
    assert len(made) == own.count > 3
    for one, other in zip(made, integrated, strict=True):
        assert abs(one - other).max() <= 1e-12 * abs(other).max()
    distinct = len({id(K) for K in made})
    sides = len(np.unique(own.grid.cells, axis=0)) if own.grid is not None else 0
    # of the sub-boxes only those that no spring is at share the matrix of their size
    assert distinct >= own.count // 2 if springs else distinct == sides


def two_boxes(upper: tuple[float, float], gap: float = 0.01) -> Any:
    """Two rectangles with cells of other sizes above each other; they share nodes without a gap."""
    boxes = [
        problems.box("quadrilateral", cells, size, MPI.COMM_SELF)
        for cells, size in (((60, 40), (1.0, 1.0)), ((45, 30), upper))
    ]
    shift = (np.zeros(2), np.array([1.0 if gap == 0.0 else 0.1, 1.0 + gap]))
    places = [b.geometry.x[:, :2] + s for b, s in zip(boxes, shift, strict=True)]
    cells = [dolfinx_compat.cell_nodes(boxes[0]), dolfinx_compat.cell_nodes(boxes[1])]
    points, place = np.unique(np.round(np.concatenate(places), 12), axis=0, return_inverse=True)
    joined = place.reshape(-1)[np.concatenate([cells[0], cells[1] + len(places[0])])]
    return dolfinx_compat.create_mesh(joined.astype(np.int64), points, "quadrilateral")


@pytest.mark.parametrize("degree", [1, 2])
def test_two_bodies_are_cut_into_sub_boxes_of_their_own_cells(degree: int) -> None:
    mesh = two_boxes((0.7, 0.5))
    space = problems.vector_space(mesh, degree)
    grid = grid_of(space)
    assert grid is not None
    assert len(np.unique(grid.bodies)) == 2
    own, a = subdomains_of(parts_of(space, grid), grid), energy(space, steel, ufl.dx)
    made, integrated = (
        own.stiffness(a, EqualCells.of(own.parts, own.grid, a)),
        own.parts.stiffness(a),
    )
    for one, other in zip(made, integrated, strict=True):
        assert abs(one - other).max() <= 1e-9 * abs(other).max()  # of rounded points
    tags = problems.facet_tags(mesh, {
        1: lambda x: np.isclose(x[1], 1.01), 2: lambda x: np.isclose(x[1], 1.0),
        3: lambda x: np.isclose(x[1], 1.51),
    })  # fmt: skip
    v = ufl.TestFunction(space)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    L = ufl.inner(fem.Constant(mesh, np.array((0.3, -2.0))), v) * ds(3)
    feet = [
        problems.held(space, lambda x: np.isclose(x[1], 0.0)),
        problems.held(space, lambda x: np.isclose(x[1], 1.51), 0),
    ]
    energies, methods = [], []
    for method in ("auto", "primal"):
        problem = ContactProblem(a, L, feet, [Contact(tags, 1, against=2)], 1e-8, method)
        problem.solve()
        assert problem.certificate.passed
        energies.append(problem.summary["solution"]["energy"])
        methods.append(problem.summary["solver"]["method"])
    assert methods == ["active-set", "primal"]
    assert energies[0] == pytest.approx(energies[1], rel=1e-7)


def test_energies_of_equal_cells_are_those_of_the_form() -> None:
    space = problems.vector_space(two_boxes((0.7, 0.5)), 1)
    grid, a = grid_of(space), energy(space, steel, ufl.dx)
    equal = EqualCells.of(parts_of(space, grid), grid, a)
    assert equal is not None
    assert equal.complete
    ways, rng = (CellEnergies(a, space), CellEnergies(a, space, equal)), np.random.default_rng(1)
    u = rng.normal(size=(len(space.tabulate_dof_coordinates()), 2))
    affine = [rng.normal(size=(len(equal.body), *shape)) for shape in ((2, 2), (2,), (2,))]
    results = [(way.of(u), way.of_affine(*affine)) for way in ways]
    for compiled, summed in zip(*results, strict=True):
        np.testing.assert_allclose(summed, compiled, rtol=1e-9, atol=1e-11 * compiled.max())


def test_bodies_that_share_nodes_are_no_grids() -> None:
    """The corner of one is that of the other."""
    assert grid_of(problems.vector_space(two_boxes((0.7, 0.5), 0.0), 1)) is None


def test_integrals_that_vary_are_left_to_an_integration_over_all_cells() -> None:
    mesh = problems.box("quadrilateral", (4, 4), (1.0, 1.0), MPI.COMM_SELF)
    space = problems.vector_space(mesh, 1)
    x = ufl.SpatialCoordinate(mesh)
    modulus = fem.Function(problems.scalar_space(mesh, 1))
    constant = fem.Constant(mesh, 2.0)
    every = np.arange(16, dtype=np.int32)
    tags = dolfinx.mesh.meshtags(mesh, 2, every, (every % 2).astype(np.int32))
    tagged = ufl.Measure("dx", domain=mesh, subdomain_data=tags)
    dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": 2})

    def counts(a: Any) -> tuple[int, ...]:
        return tuple(len(form.integrals()) for form in split_form(a, mesh))

    assert counts(energy(space, steel, dx)) == (1, 0)
    assert counts(energy(space, lambda u: constant * steel(u), dx)) == (1, 0)
    assert counts(energy(space, lambda u: (1 + x[0]) * steel(u), dx)) == (0, 1)
    assert counts(energy(space, lambda u: modulus * steel(u), dx)) == (0, 1)
    assert counts(energy(space, steel, tagged(1))) == (0, 1)
    assert counts(energy(space, steel, dx) + energy(space, steel, tagged(1))) == (1, 1)
