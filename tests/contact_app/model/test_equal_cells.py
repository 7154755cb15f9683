"""The stiffness of equal cells against the compiled form, which materials by cells use."""

import numpy as np
import pytest

from contact_app.model.assembly import Element
from contact_app.model.equal_cells import has_equal_cells
from contact_app.scene.material import Material
from meshes import Reference
from meshes.box import BoxShape


def reference(cell: str, degree: int, cells: tuple[int, ...]) -> Reference:
    """A box whose spacings differ, as one mesh."""
    d = len(cells)
    box = BoxShape((0.0,) * d, (1.0, 2.5, 0.7)[:d], cells, cell, degree)
    return Reference.of(box.mesh(), cell, degree)


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize(
    ("cell", "degree", "cells", "plane"),
    [
        ("quadrilateral", 1, (4, 3), "strain"),
        ("quadrilateral", 2, (3, 2), "stress"),
        ("hexahedron", 1, (3, 2, 4), None),
        ("hexahedron", 2, (2, 1, 2), None),
    ],
)
def test_one_cell_gives_the_matrix_of_the_form(
    cell: str, degree: int, cells: tuple[int, ...], plane: str | None, averaged: bool
) -> None:
    """Two equal materials are integrated cell by cell; one is not."""
    mesh = reference(cell, degree, cells)
    assert has_equal_cells(mesh)
    element, material = Element(mesh, len(cells)), Material(1000.0, 0.3, mean_dilatation=averaged)
    by_one, by_form = (element.stiffness((material,) * n, plane) for n in (1, 2))
    np.testing.assert_array_less(abs(by_one - by_form).max(), 1e-13 * abs(by_form).max())
    np.testing.assert_array_less(abs(by_one - by_one.T).max(), 1e-13 * abs(by_form).max())


def test_simplices_and_moved_nodes_are_integrated_cell_by_cell() -> None:
    """A square of two triangles has two shapes, and one moved node makes a cell of its own."""
    assert not has_equal_cells(reference("triangle", 1, (2, 2)))
    mesh = reference("hexahedron", 1, (2, 2, 2))
    mesh.points[0, 0] -= 1e-6
    assert not has_equal_cells(mesh)
