"""Nodes of second-order cells: VTK's order, one number a place, nothing left out."""

import numpy as np
import pytest
from mpi4py import MPI

from meshes import BoxShape, decompose
from meshes.quadratic import node_vertices
from meshes.subdomains import Reference

CELLS = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}

# vtkTriQuadraticHexahedron::GetParametricCoords() of VTK 9, nodes 8 to 26, in halves
HEXAHEDRON = """
100 210 120 010 102 212 122 012 001 201 221 021 011 211 101 121 110 112 111
"""


def box(cell: str, n: int = 3) -> BoxShape:
    d = CELLS[cell]
    return BoxShape((0.5,) * d, (1.5, 2.5, 3.5)[:d], (n, n + 1, n + 2)[:d], cell, 2)


def test_order_of_the_hexahedron_is_that_of_vtk() -> None:
    corners = np.array(
        [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]]
    )
    ours = [corners[list(on)].mean(axis=0) for on in node_vertices("hexahedron")[8:]]
    np.testing.assert_array_equal(ours, [[int(c) for c in node] for node in HEXAHEDRON.split()])


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("parts", [1, 5, "regular"])
def test_nodes_of_a_box(cell: str, parts: int | str) -> None:
    """Every place of the finer lattice has one number, the same in every subdomain."""
    shape, d = box(cell), CELLS[cell]
    split = (2,) * d if parts == "regular" else parts
    found = np.full((shape.nodes, 3), np.nan)
    cells = 0
    for s in decompose([shape], split, MPI.COMM_SELF).subdomains:  # type: ignore[arg-type]
        known = ~np.isnan(found[s.nodes, 0])
        np.testing.assert_allclose(found[s.nodes][known], s.points()[known], atol=1e-12)
        found[s.nodes] = s.points()
        middles_are_means(s.reference)
        cells += len(s.reference.cells)
    assert cells == shape.total_cells
    assert not np.isnan(found).any()
    assert len(np.unique(np.round(found, 9), axis=0)) == shape.nodes


def middles_are_means(reference: Reference) -> None:
    """Nodes of cells in VTK's order, of facets the vertices first."""
    x = reference.points[reference.cells]
    for place, on in enumerate(node_vertices(reference.cell)):
        np.testing.assert_allclose(x[:, place], x[:, list(on)].mean(axis=1), atol=1e-12)
    facet = reference.points[reference.facets]
    vertices = {3: 2, 6: 3, 9: 4}[facet.shape[1]]
    middle = facet[:, :vertices].mean(axis=1)
    np.testing.assert_allclose(facet.mean(axis=1), middle, atol=1e-12)
    apart = np.linalg.norm(facet[:, vertices:, None] - facet[:, None, :vertices], axis=-1)
    assert apart.min() > 0.01
