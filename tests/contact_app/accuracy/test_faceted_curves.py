"""Estimated distances of smooth surfaces through the nodes of cylinders and cones."""

import numpy as np
import pytest

from contact_app.accuracy.faceted_curves import SMOOTH_SURFACE, Distances, largest_distances
from meshes.contact_surface import Surface
from tests.meshes.test_rounded_refinement import OUTER, sector

SHAPES = np.array([[i, j, 4 - i - j] for i in range(5) for j in range(5 - i)]) / 4.0


def skin(slope: float) -> Surface:
    """The outer side of a quarter of a ring, a cone with a slope."""
    mesh = sector("tetrahedron", slope)
    rows = mesh.sides["x+"]
    facets, cells = mesh.topology.facets[rows], mesh.cells[mesh.topology.facet_cells[rows]]
    return Surface.of(3, facets, mesh.points[facets], mesh.points[cells].mean(axis=1))


def distances(slope: float) -> tuple[Distances, Distances]:
    """Estimated distances from the round surface, and true ones."""
    side = skin(slope)
    smooth = side.smooth()
    largest = []
    for bulge in (np.zeros((len(side.nodes), 3, 3)), smooth.bulge):
        height = 0.5 * np.einsum("qa,fab,qb->fq", SHAPES, bulge, SHAPES)
        x = (
            np.einsum("qa,fai->fqi", SHAPES, side.vertices)
            + height[..., None] * side.normals[:, None]
        )
        off = np.hypot(x[..., 0], x[..., 1]) - (OUTER + slope * x[..., 2])
        largest.append(float(np.abs(off).max()) / np.hypot(1.0, slope))
    touching = side.centres, np.zeros(len(side.nodes))
    return largest_distances(side, touching, True), Distances(*largest)


@pytest.mark.parametrize("slope", [0.25, 0.5, 1.0, 2.0])
def test_on_cones_the_estimate_is_near_the_distance(slope: float) -> None:
    """Their curvature changes from facet to facet; a hundredth of the sagitta is too little."""
    estimated, true = distances(slope)
    assert estimated.facets == pytest.approx(true.facets, rel=0.4)
    assert true.smooth > 2.0 * SMOOTH_SURFACE * true.facets
    assert 1.0 < estimated.smooth / true.smooth < 3.0


def test_on_cylinders_the_curvature_is_constant() -> None:
    estimated, true = distances(0.0)
    assert estimated.smooth == pytest.approx(SMOOTH_SURFACE * estimated.facets)
    assert true.smooth < 2.0 * estimated.smooth
