"""Refined meshes of round bodies: new nodes on circles, cylinders and cones, all others at rest."""

from dataclasses import replace

import numpy as np
import pytest

from meshes.bisect import bisected
from meshes.graded import graded_box
from meshes.refine import refined
from meshes.rounded_refinement import rounded
from meshes.unstructured import CellMesh

INNER, OUTER, HIGH, FACETS = 5.0, 10.0, 4.0, 8
SLOPE = 0.5
"""Growth of the radius of a cone over its height."""


def sector(cell: str, slope: float) -> CellMesh:
    """A quarter of a ring, its radii growing along z; x- inside, x+ outside."""
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    lines = [np.linspace(0.0, 1.0, n + 1) for n in (3, FACETS, 2)[:d]]
    mesh = graded_box(cell, lines)
    x = np.pad(mesh.points, ((0, 0), (0, 3 - d)))
    radius = INNER + (OUTER - INNER) * x[:, 0] + slope * HIGH * x[:, 2]
    turn = 0.5 * np.pi * x[:, 1]
    bent = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), HIGH * x[:, 2]])
    return replace(mesh, points=bent[:, :d])


def off_the_surface(mesh: CellMesh, side: str, slope: float) -> float:
    """Largest distance along the radius of nodes of a round side from the surface."""
    x = mesh.points[np.unique(mesh.topology.facets[mesh.sides[side]])]
    high = x[:, 2] if mesh.dimension == 3 else 0.0
    radius = {"x-": INNER, "x+": OUTER}[side] + slope * high
    return float(np.abs(np.hypot(x[:, 0], x[:, 1]) - radius).max())


CASES = [
    ("triangle", 0.0), ("quadrilateral", 0.0), ("tetrahedron", 0.0), ("hexahedron", 0.0),
    ("tetrahedron", SLOPE), ("hexahedron", SLOPE),
]  # fmt: skip


@pytest.mark.parametrize("marked", [False, True])
@pytest.mark.parametrize(("cell", "slope"), CASES)
def test_new_nodes_are_on_the_round_surface(cell: str, slope: float, marked: bool) -> None:
    """Twice refined; the distance of the midpoints of edges is OUTER π²/(32 FACETS²) at first.

    The ends of the ring remain plane: rims of a cone move within them. The quadrics through the
    nodes fit a cone less well than a cylinder.
    """
    if marked and cell not in ("triangle", "tetrahedron"):
        pytest.skip("only simplices are bisected")
    mesh = sector(cell, slope)
    sagitta = (OUTER + slope * HIGH) * np.pi**2 / (32.0 * FACETS**2)
    share = 0.15 if slope else 0.02
    for _ in range(2):
        every = np.arange(len(mesh.cells))
        finer = bisected(mesh, every) if marked else refined(mesh)
        assert off_the_surface(finer, "x+", slope) > 0.2 * sagitta
        sides = np.concatenate([mesh.sides["x-"], mesh.sides["x+"]])
        mesh = rounded(finer, mesh, sides)
        assert max(off_the_surface(mesh, side, slope) for side in ("x-", "x+")) < share * sagitta
        for side, height in (("z-", 0.0), ("z+", HIGH)) if mesh.dimension == 3 else ():
            at = mesh.points[np.unique(mesh.topology.facets[mesh.sides[side]]), 2]
            np.testing.assert_allclose(at, height, atol=1e-12)


def test_other_boundaries_stay_where_they_are() -> None:
    """The inner polygon keeps the straight edges of the coarse mesh."""
    coarse = sector("triangle", 0.0)
    fine = refined(coarse)
    moved = rounded(fine, coarse, coarse.sides["x+"])
    inner = np.unique(fine.topology.facets[fine.sides["x-"]])
    np.testing.assert_array_equal(moved.points[inner], fine.points[inner])
    assert off_the_surface(moved, "x-", 0.0) > 0.02


def test_cells_that_would_turn_inside_out_keep_straight_edges() -> None:
    """A layer thinner than the distance of the facets from the bore."""
    thin = sector("triangle", 0.0)
    radius = np.linalg.norm(thin.points, axis=1, keepdims=True)
    layers = INNER + (radius - INNER) * 1e-3
    thin = replace(thin, points=thin.points * layers / radius)
    fine = refined(thin)
    mesh = rounded(fine, thin, thin.sides["x-"])
    sizes = [
        np.linalg.det(m.points[m.cells][:, 1:] - m.points[m.cells][:, :1]) for m in (fine, mesh)
    ]
    assert (sizes[1] / sizes[0]).min() > 0.2
