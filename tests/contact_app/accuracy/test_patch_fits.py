"""Polynomials fitted around vertices: exact for fields of their degree, on the surface, too."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.estimate.stress_recovery import StressRecovery
from contact_app.model.model import build_model
from solver.vectors import Array
from tests import meshfiles, scenes
from tests.contact_app.model.test_meshes_from_files import patch

CELLS = scenes.CELLS_3D + scenes.CELLS_2D
COMPONENTS = 3


def recovery_on(cell: str, n: list[int], parts: list[int], degree: int) -> StressRecovery:
    made = scenes.wall(cell, max(n))
    made["bodies"][0]["mesh"]["box"]["cells"] = n
    made["bodies"][0]["degree"] = degree
    return StressRecovery(build_model(scenes.build(made, parts), MPI.COMM_SELF))


def field(x: Array, degree: int) -> Array:
    """Polynomials of a degree at points (…, dimension), (…, COMPONENTS)."""
    d = x.shape[-1]
    rng = np.random.default_rng(degree)
    result = rng.standard_normal(COMPONENTS) + x @ rng.standard_normal((d, COMPONENTS))
    if degree == 2:
        squares = rng.standard_normal((d, d, COMPONENTS))
        result += np.einsum("...i,...j,ijk->...k", x, x, squares)
    return np.asarray(result)


def at_nodes(recovery: StressRecovery, degree: int) -> list[tuple[Array, Array]]:
    """Points of the nodes of each subdomain, and values there of the fit to samples of the
    field."""
    model, d = recovery.model, recovery.dimension
    offsets: list[list[Array]] = [[] for _ in recovery.cells]
    for s, (cls, _) in zip(model.partition.subdomains, model.place, strict=True):
        offsets[cls].append(s.translation[:d])
    samples = []
    for cells, shifts in zip(recovery.cells, offsets, strict=True):
        own = np.einsum("qg,cgi->cqi", cells.samples.places, cells.places[cells.geometry])
        own = own.reshape(-1, 1, d) + np.array(shifts)
        samples.append(field(own, degree))
    found = recovery.patches.fits.at_vertices(samples)
    spread = recovery.patches.copies.spread(found)
    result = []
    for cells, shifts, part in zip(recovery.cells, offsets, spread, strict=True):
        shape = (*part.shape[:2], recovery.patches.fits.count, COMPONENTS)
        result.append(
            (cells.places[:, None] + np.array(shifts), cells.at_nodes(part.reshape(shape)))
        )
    return result


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_fits_are_exact_to_their_degree(cell: str, degree: int) -> None:
    """Also at vertices with one cell, whose neighbours have too few themselves."""
    d = scenes.dimension(cell)
    for n, parts in (([3, 4, 3], [1, 2, 1]), ([4, 3, 5], [2, 1, 2])):
        recovery = recovery_on(cell, n[:d], parts[:d], degree)
        for places, values in at_nodes(recovery, degree):
            np.testing.assert_allclose(values, field(places, degree), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("cell", ["hexahedron", "quadrilateral"])
def test_a_body_one_cell_thick_is_fitted_along_it(cell: str) -> None:
    """Across it cells tell nothing: there the fit is constant."""
    d = scenes.dimension(cell)
    recovery = recovery_on(cell, [4] * (d - 1) + [1], [2] + [1] * (d - 1), 1)
    for places, values in at_nodes(recovery, 1):
        middle = places.copy()
        middle[..., -1] = 0.5 * (places[..., -1].min() + places[..., -1].max())
        inside = ((places > 1e-6) & (places < 1.0 - 1e-6))[..., :-1].all(axis=-1)
        assert inside.any()
        np.testing.assert_allclose(values[inside], field(middle, 1)[inside], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("cell", ["hexahedron", "quadrilateral"])
def test_fits_are_extrapolated_along_a_fin(cell: str, tmp_path: Path) -> None:
    """One cell thick and three long: vertex by vertex, each from the one before."""
    n, d = 6, scenes.dimension(cell)
    mesh = meshfiles.block(cell, n, distort=0.0)
    middle = mesh.points[mesh.cells[0].data].mean(axis=1)[:, :d]
    cells = mesh.cells[0].data[(middle[:, 0] < 0.5) | (middle[:, 1:] < 1.0 / n).all(axis=1)]
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 2**d)
    file = meshfiles.write(meshfiles.named(cell, mesh.points[used], cells), tmp_path / "fin.msh")
    model = build_model(scenes.build(patch(cell, file), 3), MPI.COMM_SELF)
    far = 0.0
    for places, values in at_nodes(StressRecovery(model), 1):
        np.testing.assert_allclose(values, field(places, 1), rtol=0.0, atol=1e-9)
        far = max(far, places[..., 0].max())
    assert far == pytest.approx(1.0)
