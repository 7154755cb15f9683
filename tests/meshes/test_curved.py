"""Second-order meshes: read, checked, refined, cut and turned with their curved edges."""

import re
from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.assembly import Element
from meshes import CellMesh, MeshError, decompose
from meshes.refine import refined
from meshes.repair import Placement, load_mesh
from tests import meshfiles

NAMES = [(cell, name) for cell, names in meshfiles.SECOND.items() for name in names]
VOLUME = np.pi / 8 * (2**2 - 1**2)
"""Volume of the bent block."""


def bent(cell: str, name: str, directory: Path, n: int = 2, **options: object) -> CellMesh:
    """The bent block of cells with curved edges, of degree 2."""
    mesh = meshfiles.second_order(meshfiles.block(cell, n, 0.1), cell, name, meshfiles.bend)
    path = meshfiles.write(mesh, directory / "part.msh")
    return load_mesh(path, meshfiles.dimension(cell), degree=2, **options)  # type: ignore[arg-type]


def volumes(mesh: CellMesh, parts: int = 1) -> np.ndarray:
    """Volumes of the cells by dolfinx, subdomain by subdomain."""
    partition = decompose([mesh.shape(2)], parts, MPI.COMM_SELF)
    elements = [Element(s.reference, mesh.dimension) for s in partition.subdomains]
    return np.concatenate([e.cell_volumes() for e in elements])


@pytest.mark.parametrize(("cell", "name"), NAMES)
def test_curved_edges_stay_curved(cell: str, name: str, tmp_path: Path) -> None:
    """Middles lie on the circles; the volume is right to fourth order, in any cut."""
    mesh = bent(cell, name, tmp_path)
    lacking = name in ("quad8", "hexahedron20")
    assert any("serendipity" in note for note in mesh.notes) == lacking
    whole = mesh.shape(2)
    facets = whole.topology.facets[mesh.sides["x+"]]
    radius = np.hypot(*whole.points[np.unique(facets)][:, :2].T)
    np.testing.assert_allclose(radius, 2.0, rtol=2e-4 if lacking and mesh.dimension == 3 else 1e-14)
    errors = []
    for n in (2, 4):
        given = bent(cell, name, tmp_path, n)
        for parts in (1, 3):
            found = volumes(given, parts)
            assert found.min() > 0.0
        errors.append(abs(found.sum() / VOLUME - 1.0))
    assert errors[1] < 4e-5
    assert np.log2(errors[0] / errors[1]) > 3.5


@pytest.mark.parametrize(("cell", "name"), NAMES)
def test_straight_edges_stay_of_first_order(cell: str, name: str, tmp_path: Path) -> None:
    """Nodes in the middles bring nothing: the geometry is that of the corners."""
    mesh = meshfiles.second_order(meshfiles.block(cell, 2), cell, name, np.array)
    path = meshfiles.write(mesh, tmp_path / "part.msh")
    read = load_mesh(path, meshfiles.dimension(cell), degree=2)
    assert read.middles is None
    (subdomain,) = decompose([read.shape(2)], 1, MPI.COMM_SELF).subdomains
    assert not subdomain.reference.curved


@pytest.mark.parametrize(("cell", "name"), NAMES)
def test_inside_out_and_written_apart(cell: str, name: str, tmp_path: Path) -> None:
    """Cells turned with all their nodes, each with nodes of its own: the same body."""
    d = meshfiles.dimension(cell)
    known = bent(cell, name, tmp_path)
    first = meshfiles.block(cell, 2, 0.1)
    mirror = {"triangle": [0, 2, 1], "quadrilateral": [0, 3, 2, 1], "tetrahedron": [1, 0, 2, 3],
              "hexahedron": [0, 3, 2, 1, 4, 7, 6, 5]}[cell]  # fmt: skip
    first.cells[0].data[::2] = first.cells[0].data[::2][:, mirror]
    mesh = meshfiles.second_order(first, cell, name, meshfiles.bend)
    cells = mesh.cells[0].data
    torn = meshio.Mesh(mesh.points[cells].reshape(-1, 3),
                       [(name, np.arange(cells.size).reshape(cells.shape))])  # fmt: skip
    read = load_mesh(meshfiles.write(torn, tmp_path / "a.vtu", None), d, degree=2)
    assert any("turned" in note for note in read.notes)
    assert read.shape(2).nodes == known.shape(2).nodes
    np.testing.assert_allclose(volumes(read).sum(), volumes(known).sum(), rtol=1e-13)


@pytest.mark.parametrize(("cell", "name"), NAMES)
def test_refinement_fills_the_same_place(cell: str, name: str, tmp_path: Path) -> None:
    """Parts of a curved cell are curved as it is: volumes agree, nodes lie on its map."""
    coarse = bent(cell, name, tmp_path)
    fine = refined(coarse)
    d = coarse.dimension
    assert fine.total_cells == coarse.total_cells * 2**d
    by_parent = volumes(fine)
    assert by_parent.min() > 0.0
    np.testing.assert_allclose(by_parent.sum(), volumes(coarse).sum(), rtol=1e-12)
    # the nodes of a twice refined mesh lie on parabolas through those of the first
    radius = [np.hypot(*x[:, :2].T) for x in (_side(coarse, "x+"), _side(fine, "x+"))]
    assert np.abs(radius[1] - 2.0).max() < 3e-3
    fine_again = refined(fine)
    np.testing.assert_allclose(volumes(fine_again).sum(), by_parent.sum(), rtol=1e-12)


def _side(mesh: CellMesh, name: str) -> np.ndarray:
    whole = mesh.shape(2)
    return whole.points[np.unique(whole.topology.facets[mesh.sides[name]])]


@pytest.mark.parametrize("cell", list(meshfiles.SECOND))
def test_placement_moves_all_nodes(cell: str, tmp_path: Path) -> None:
    d = meshfiles.dimension(cell)
    axis, move = ((1.0, 2.0, 3.0), (3.0, -1.0, 2.0)) if d == 3 else ((0, 0, 1), (3.0, -1.0, 0.0))
    name = meshfiles.SECOND[cell][0]
    plain = bent(cell, name, tmp_path)
    placed = bent(cell, name, tmp_path, placement=Placement(0.5, axis, 30.0, move))
    a, b = (m.shape(2).points[m.shape(2).cells] for m in (plain, placed))
    length, turned = (np.linalg.norm(x[:, 1:] - x[:, :1], axis=2) for x in (a, b))
    np.testing.assert_allclose(turned, 0.5 * length, rtol=1e-12)
    np.testing.assert_allclose(volumes(placed).sum(), 0.5**d * volumes(plain).sum())


@pytest.mark.parametrize("cell", list(meshfiles.SECOND))
def test_a_folded_cell_is_named(cell: str, tmp_path: Path) -> None:
    """One middle pulled far across its cell: the cell's number in the file, and what would do."""
    name = meshfiles.SECOND[cell][0]
    mesh = meshfiles.second_order(meshfiles.block(cell, 2, 0.0), cell, name, np.array)
    cells = mesh.cells[0].data
    place = np.array([0.0, 0.25, 0.0])  # amid an edge of the surface
    pulled = np.flatnonzero(np.linalg.norm(mesh.points - place, axis=1) < 1e-12)
    mesh.points[pulled, 0] += 0.9  # through cells half a unit wide
    bad = np.flatnonzero(np.isin(cells, pulled).any(axis=1))
    path = meshfiles.write(mesh, tmp_path / "part.msh")
    d = meshfiles.dimension(cell)
    with pytest.raises(MeshError) as caught:
        load_mesh(path, d, degree=2)
    said = str(caught.value)
    found = re.search(rf"{cell}s folded by their curved edges .* cell (\d+) of the file, at", said)
    assert found is not None
    assert int(found[1]) - 1 in bad
    assert "Mesh.HighOrderOptimize" in said
    assert load_mesh(path, d).middles is None


def test_neighbours_must_fit(tmp_path: Path) -> None:
    """A node amid an inner edge that two cells have apart: a gap between them."""
    mesh = meshfiles.second_order(
        meshfiles.block("quadrilateral", 2, 0.0), "quadrilateral", "quad9", np.array
    )
    row = mesh.cells[0].data[0]
    x = mesh.points[row]
    inner = next(k for k in range(4, 8) if 0.01 < x[k, 0] < 0.99 and 0.01 < x[k, 1] < 0.99)
    mesh.points[row[inner], :2] += 0.01
    path = meshfiles.write(mesh, tmp_path / "part.msh")
    with pytest.raises(MeshError, match="1 quadrilaterals that have nodes amid an edge or face "
                                        "elsewhere than their neighbours"):  # fmt: skip
        load_mesh(path, 2, degree=2)
