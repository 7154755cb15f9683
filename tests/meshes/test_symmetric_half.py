"""Halves of boxes and of meshes, against the box of half the cells."""

from pathlib import Path

import numpy as np
import pytest

from meshes import BoxShape
from meshes.repair import load_mesh
from meshes.symmetric_half import AsymmetryError, half_box, half_mesh
from tests import meshfiles

ALIKE = np.zeros(1, np.int64)


def box(cell: str, degree: int = 1, n: int = 4) -> BoxShape:
    d = meshfiles.dimension(cell)
    return BoxShape((0.0,) * d, (1.0,) * d, (n,) * d, cell, degree)


def rows(points: np.ndarray) -> set[tuple[float, ...]]:
    """Facets as sets of places, whatever the order of their nodes."""
    return {tuple(sorted(map(tuple, np.round(facet, 9) + 0.0))) for facet in points}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", list(meshfiles.MESHIO))
def test_surface_of_half_a_box(cell: str, degree: int) -> None:
    """The facets of the box of half the cells, but for its cut; images beyond the plane."""
    shape = box(cell, degree)
    d, axis = shape.dimension, 1
    upper = tuple(0.5 if a == axis else 1.0 for a in range(d))
    cells = tuple(2 if a == axis else 4 for a in range(d))
    mesh = BoxShape(shape.lower, upper, cells, cell, degree).cell_mesh()
    found = half_box(shape, axis)
    for name, sides in mesh.sides.items():
        own, image = found.sides[name]
        expected = np.pad(mesh.points[mesh.topology.facets[sides]], ((0, 0), (0, 0), (0, 3 - d)))
        if name == "y+":
            assert not own.any()
            assert rows(found.images[found.facets[image]]) == {
                tuple(sorted((x, 1.0 - y + 0.0, z) for x, y, z in facet))
                for facet in rows(found.points[found.facets[found.sides["y-"][0]]])
            }
            continue
        assert rows(found.points[found.facets[own]]) == rows(expected)
        assert image.any() == (name != "y-")
    assert (found.on_plane == (np.abs(found.points[:, axis] - 0.5) < 1e-12)).all()
    np.testing.assert_allclose(found.images[:, axis], 1.0 - found.points[:, axis], atol=1e-12)


@pytest.mark.parametrize("cell", list(meshfiles.MESHIO))
def test_half_of_a_mesh(cell: str, tmp_path: Path) -> None:
    """Cells and parts of the surface of the lower side; the cut is flat, and has its place."""
    file = meshfiles.write(meshfiles.mirrored(cell, 4, "x"), tmp_path / "block.msh")
    mesh = load_mesh(file, meshfiles.dimension(cell))
    half, surface = half_mesh(mesh, 1, ALIKE, 0, 0.5, "cut")
    d = mesh.dimension
    known = BoxShape((0.0,) * d, (0.5, *(1.0,) * (d - 1)), (2, *(4,) * (d - 1)), cell).cell_mesh()
    assert rows(half.points[half.cells]) == rows(known.points[known.cells])
    for name, sides in known.sides.items():
        here = half.sides["cut" if name == "x+" else name]
        assert rows(half.points[half.topology.facets[here]]) == rows(
            known.points[known.topology.facets[sides]]
        )
    assert len(surface.facets) == len(half.topology.facets) - len(half.sides["cut"])
    assert sorted(half.groups) == ["hard", "soft"]
    assert len(half.groups["hard"]) == 0
    assert len(half.groups["soft"]) == half.total_cells


def test_bodies_that_are_no_mirror_images_are_refused(tmp_path: Path) -> None:
    with pytest.raises(AsymmetryError, match="odd number of cells, 3"):
        half_box(box("hexahedron", n=3), 2)
    file = meshfiles.write(meshfiles.block("tetrahedron", 2, 0.0), tmp_path / "block.msh")
    with pytest.raises(AsymmetryError, match="whose mirror image is none"):
        half_mesh(load_mesh(file, 3), 1, ALIKE, 0, 0.5, "cut")
    with pytest.raises(AsymmetryError, match="no node at the image"):
        half_mesh(load_mesh(file, 3), 2, ALIKE, 0, 0.4, "cut")
