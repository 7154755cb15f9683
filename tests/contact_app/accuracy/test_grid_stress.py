"""Stresses on a grid: continuous tractions, divergence, energy, equilibrium, least energy."""

import numpy as np
import pytest

from contact_app.accuracy.guarantee.equilibrated import (
    AdmissibleStresses,
    FaceData,
    NoAdmissibleStressError,
    SearchOptions,
)
from contact_app.accuracy.guarantee.grid_stress import GridStresses
from contact_app.accuracy.guarantee.separable import EquilibriumPreconditioner, conjugate_gradients

CELLS = [(3, 2), (1, 4), (2, 3, 2), (1, 1, 3)]


def uneven(cells: tuple[int, ...], seed: int = 0) -> list[np.ndarray]:
    random = np.random.default_rng(seed)
    return [np.cumsum([0.3 * k, *random.uniform(0.2, 1.5, n)]) for k, n in enumerate(cells)]


def compliance(d: int, poisson: float = 0.3, young: float = 7.0) -> np.ndarray:
    """Compliance matrix in plane stress, and in space."""
    size = d * (d + 1) // 2
    C = np.diag([1.0 / young] * d + [2.0 * (1.0 + poisson) / young] * (size - d))
    C[:d, :d] -= poisson / young * (1.0 - np.eye(d))
    return C


def sampled(grid: GridStresses, s: np.ndarray, points: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Values at Gauss points of every cell, (cells, q, components), and their weights."""
    x, w = np.polynomial.legendre.leggauss(points)
    d = grid.dimension
    local = np.stack(np.meshgrid(*[0.5 * (1.0 + x)] * d, indexing="ij"), axis=-1).reshape(-1, d)
    weight = np.prod(np.meshgrid(*[0.5 * w] * d, indexing="ij"), axis=0).ravel()
    cells = np.stack(np.unravel_index(np.arange(np.prod(grid.cells)), grid.cells), axis=1)
    volume = np.prod([h[cells[:, k]] for k, h in enumerate(grid.widths)], axis=0)
    values = grid.stress(s).at(
        cells, np.broadcast_to(local, (len(cells), *local.shape)), grid.pairs
    )
    return values, volume[:, None] * weight


@pytest.mark.parametrize("cells", CELLS)
def test_energy_is_that_of_quadrature(cells: tuple[int, ...]) -> None:
    grid = GridStresses(uneven(cells))
    s = np.random.default_rng(1).normal(size=grid.size)
    C = compliance(len(cells))
    values, weight = sampled(grid, s)
    expected = np.einsum("cq,cqs,st,cqt->", weight, values, C, values)
    assert s @ (grid.energy_matrix(C) @ s) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("cells", CELLS)
def test_divergence_is_constant_in_cells_and_that_of_differences(cells: tuple[int, ...]) -> None:
    """Central differences are exact: each component is quadratic along each axis."""
    grid = GridStresses(uneven(cells))
    d = grid.dimension
    s = np.random.default_rng(2).normal(size=grid.size)
    places = np.stack(np.unravel_index(np.arange(np.prod(cells)), cells), axis=1)
    local = np.random.default_rng(3).uniform(0.3, 0.7, (len(places), 4, d))
    field, component = grid.stress(s), {(i, i): i for i in range(d)}
    component |= {p: d + k for k, p in enumerate(grid.pairs)}
    component |= {p[::-1]: d + k for k, p in enumerate(grid.pairs)}
    found = np.zeros((len(places), 4, d))
    for j in range(d):
        step = np.zeros(d)
        step[j] = 0.1
        change = field.at(places, local + step, grid.pairs) - field.at(
            places, local - step, grid.pairs
        )
        slope = change / (0.2 * grid.widths[j][places[:, j]])[:, None, None]
        for i in range(d):
            found[..., i] += slope[..., component[i, j]]
    expected = (grid.divergence @ s).reshape(d, -1).T
    assert found == pytest.approx(np.broadcast_to(expected[:, None], found.shape), abs=1e-11)


@pytest.mark.parametrize("cells", [(3, 2), (2, 3, 2)])
def test_tractions_pass_from_cell_to_cell(cells: tuple[int, ...]) -> None:
    grid = GridStresses(uneven(cells))
    d, field = grid.dimension, grid.stress(np.random.default_rng(4).normal(size=grid.size))
    local = np.random.default_rng(5).uniform(size=(7, d))
    places = np.stack(np.unravel_index(np.arange(np.prod(cells)), cells), axis=1)
    for axis in range(d):
        below = places[places[:, axis] + 1 < cells[axis]]
        above = below + np.eye(d, dtype=int)[axis]
        sides = []
        for place, at in ((below, 1.0), (above, 0.0)):
            points = np.broadcast_to(local, (len(place), *local.shape)).copy()
            points[..., axis] = at
            sides.append(field.at(place, points, grid.pairs))
        shared = [axis, *(d + k for k, pair in enumerate(grid.pairs) if axis in pair)]
        assert sides[0][..., shared] == pytest.approx(sides[1][..., shared], abs=1e-13)
        others = [k for k in range(d) if k != axis]
        assert np.abs(sides[0][..., others] - sides[1][..., others]).max() > 0.1


def free_faces(cells: tuple[int, ...]) -> list[FaceData]:
    d = len(cells)
    return [FaceData.free(tuple(np.delete(cells, k // 2)), d) for k in range(2 * d)]


@pytest.mark.parametrize("cells", [(4, 3), (3, 4, 2)])
def test_admissible_stresses_meet_all_their_data(cells: tuple[int, ...]) -> None:
    """Weight, a loaded top, a held foot, a contact beside: from a start that obeys nothing."""
    d, force = len(cells), np.arange(1.0, len(cells) + 1.0)
    axes, faces = uneven(cells), free_faces(cells)
    faces[2 * d - 2].held[...] = True
    faces[2 * d - 1].traction[..., d - 1] = -40.0
    faces[1].contact[...] = True
    faces[0].traction[..., 0] = 9.0
    stresses = AdmissibleStresses(axes, compliance(d), faces, force)
    random = np.random.default_rng(6)
    start = random.normal(scale=50.0, size=stresses.space.size)
    touching = [face.contact for face in faces]
    found = stresses.search(start, touching, np.inf)
    assert found.residual < 1e-14
    assert found.slip < 1e-12
    assert min(p.min() for p in found.pressures) >= 0.0
    assert max(p.max() for p in found.pressures) > 1.0
    # of the field itself: forces of each cell by its tractions, and the loads on the surface
    field, space = found.stress, stresses.space
    for i in range(d):
        total = np.zeros(cells)
        for j in range(d):
            values = field.faces[i] if i == j else field.edges[min(i, j), max(i, j)]
            values = np.moveaxis(values, j, 0)
            values = np.moveaxis(values[1:] - values[:-1], 0, j)
            if i != j:
                along = np.moveaxis(values, i, 0)
                values = np.moveaxis(0.5 * (along[1:] + along[:-1]), 0, i)
            shape = [-1 if k == j else 1 for k in range(d)]
            total += values / space.widths[j].reshape(shape)
        assert total == pytest.approx(np.full(cells, -force[i]), abs=1e-10)
    assert np.moveaxis(field.faces[d - 1], d - 1, 0)[-1] == pytest.approx(-40.0)
    assert field.faces[0][0] == pytest.approx(-9.0)
    assert field.faces[0][-1] == pytest.approx(-found.pressures[1])
    assert np.abs(field.edges[0, d - 1][-1]).max() == 0.0  # frictionless, and free at the top


@pytest.mark.parametrize("cells", [(4, 3), (3, 4, 2)])
def test_held_faces_work_on_their_displacement(cells: tuple[int, ...]) -> None:
    """A body moved as a whole: J* changes by the work of all its loads, whatever the stress."""
    d, moved = len(cells), np.arange(0.3, len(cells))
    axes, energies = uneven(cells), []
    force = np.arange(1.0, d + 1.0)
    for by in (0.0 * moved, moved):
        faces = free_faces(cells)
        faces[0].held[...] = True
        faces[0].displacement[...] = by
        faces[2].held[..., 1] = True
        faces[2].displacement[..., 1] = by[1]
        faces[1].traction[..., 0] = -4.0
        faces[3].contact[...] = True
        faces[3].gap[...] = by[1]
        stresses = AdmissibleStresses(axes, compliance(d), faces, force)
        start = np.random.default_rng(7).normal(size=stresses.space.size)
        found = stresses.search(start, [face.contact for face in faces], np.inf)
        energies.append(found.energy)
    sides = [x[-1] - x[0] for x in axes]
    total = force * np.prod(sides)
    total[0] -= 4.0 * np.prod(sides[1:])
    assert energies[1] - energies[0] == pytest.approx(moved @ total, rel=1e-5)


def test_facets_with_tension_are_released() -> None:
    """A beam clamped at its foot and pushed at its top bends away from the wall below."""
    cells = (2, 8)
    axes = [np.linspace(0.0, 1.0, 3), np.linspace(0.0, 4.0, 9)]
    faces = free_faces(cells)
    faces[2].held[...] = True
    faces[0].traction[6:, 0] = 1.0
    faces[0].traction[:3, 0] = -1.0
    faces[1].contact[...] = True
    stresses = AdmissibleStresses(axes, compliance(2), faces, np.zeros(2))
    touching = [face.contact for face in faces]
    found = stresses.search(np.zeros(stresses.space.size), touching, -np.inf)
    assert found.residual < 1e-14
    assert found.pressures[1].min() == 0.0
    assert (found.pressures[1] == 0.0).sum() >= 2
    assert found.pressures[1][-1] > 0.1


def test_the_search_finds_the_least_energy() -> None:
    """Against the same quadratic programme by dense linear algebra, its pressed facets given."""
    cells = (4, 3)
    faces = free_faces(cells)
    faces[2].held[...] = True
    faces[2].displacement[..., 1] = 0.02
    faces[3].traction[..., 1] = -3.0
    faces[1].contact[...] = True
    faces[1].gap[...] = 0.001
    stresses = AdmissibleStresses(uneven(cells), compliance(2), faces, np.array([0.3, -0.1]))
    touching = [face.contact for face in faces]
    found = stresses.search(np.zeros(stresses.space.size), touching, -np.inf)
    assert found.steps > 5
    A, B = stresses.matrix.toarray(), stresses.space.divergence.toarray()
    values = np.concatenate([*map(np.ravel, found.stress.faces), found.stress.edges[0, 1].ravel()])
    pressed = np.zeros(len(values), bool)
    pressed[stresses.space.rows_on_face(0, 1)] = found.pressures[1] > 0.0
    free = (~stresses.prescribed & ~stresses.contact) | pressed
    fixed = np.where(free, 0.0, values)
    size, rows = free.sum(), len(B)
    saddle = np.block([[A[np.ix_(free, free)], B[:, free].T], [B[:, free], np.zeros((rows, rows))]])
    right = np.concatenate([(stresses.work - A @ fixed)[free], stresses.divergence - B @ fixed])
    least = fixed.copy()
    least[free] = np.linalg.lstsq(saddle, right, rcond=None)[0][:size]
    assert values == pytest.approx(least, abs=1e-3 * np.abs(least).max())
    assert found.energy == pytest.approx(stresses.energy(least), rel=1e-6)


@pytest.mark.parametrize("cells", [(12, 9), (6, 5, 7)])
def test_the_same_by_iterations(cells: tuple[int, ...]) -> None:
    """Beyond the size up to which equations are factored."""
    d, energies = len(cells), []
    for direct in (10**6, 0):
        faces = free_faces(cells)
        faces[2 * d - 2].held[...] = True
        faces[2 * d - 1].traction[..., d - 1] = -4.0
        faces[1].contact[...] = True
        options = SearchOptions(direct=(direct, direct))
        stresses = AdmissibleStresses(uneven(cells), compliance(d), faces, np.zeros(d), options)
        touching = [face.contact for face in faces]
        found = stresses.search(np.zeros(stresses.space.size), touching, -np.inf)
        assert found.residual < 1e-14
        energies.append(found.energy)
    assert energies[0] == pytest.approx(energies[1], rel=1e-5)


@pytest.mark.parametrize("cells", [(24, 18), (12, 10, 11)])
def test_the_preconditioner_is_near(cells: tuple[int, ...]) -> None:
    """Tens of iterations to six digits on an uneven grid held at one face."""
    space, d = GridStresses(uneven(cells)), len(cells)
    inverse = 1.0 / space.energy_matrix(compliance(d)).diagonal()
    for face in range(2 * d - 1):
        for component, pair in enumerate([(k,) for k in range(d)] + space.pairs):
            if face // 2 in pair:
                inverse[space.rows_on_face(component, face)] = 0.0
    B = space.divergence
    calls, approximate = [], EquilibriumPreconditioner(space, inverse)

    def counted(residual: np.ndarray) -> np.ndarray:
        calls.append(1)
        return approximate(residual)

    right = np.random.default_rng(8).normal(size=B.shape[0])
    y = conjugate_gradients(lambda x: B @ (inverse * (B.T @ x)), counted, right, 1e-6, 1000)
    assert np.linalg.norm(B @ (inverse * (B.T @ y)) - right) < 2e-6 * np.linalg.norm(right)
    assert len(calls) < 80


def test_contradicting_shears_are_refused() -> None:
    faces = free_faces((3, 2))
    faces[3].traction[..., 0] = 5.0  # shear on y+, none on x- and x+
    with pytest.raises(NoAdmissibleStressError, match=r"at x = 0 and y = .* contradict"):
        AdmissibleStresses(uneven((3, 2)), compliance(2), faces, np.zeros(2))
    faces[0].held[...] = True
    faces[1].traction[..., 1], faces[2].traction[..., 0] = 5.0, -5.0
    AdmissibleStresses(uneven((3, 2)), compliance(2), faces, np.zeros(2))


def test_a_single_cell_between_free_faces_carries_no_shear() -> None:
    for cells in ((3, 1), (3, 2)):
        faces = free_faces(cells)
        faces[0].held[...] = True
        stresses = AdmissibleStresses(uneven(cells), compliance(2), faces, np.array([0.0, -1.0]))
        start, touching = np.zeros(stresses.space.size), [face.contact for face in faces]
        if cells[1] == 1:
            with pytest.raises(NoAdmissibleStressError, match="take two cells or more along y"):
                stresses.search(start, touching, np.inf)
        else:
            assert stresses.search(start, touching, np.inf).residual < 1e-14


def test_loads_that_pressures_cannot_carry_are_refused() -> None:
    """A body that nothing but a floor keeps, pulled up."""
    for pull in (-2.0, 2.0):
        faces = free_faces((3, 2))
        faces[2].contact[...] = True
        faces[3].traction[..., 1] = pull
        stresses = AdmissibleStresses(uneven((3, 2)), compliance(2), faces, np.zeros(2))
        start, touching = np.zeros(stresses.space.size), [face.contact for face in faces]
        if pull < 0.0:
            assert stresses.search(start, touching, np.inf).pressures[2] == pytest.approx(2.0)
        else:
            with pytest.raises(NoAdmissibleStressError, match="keep the loads in equilibrium$"):
                stresses.search(start, touching, np.inf)
