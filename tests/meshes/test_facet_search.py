"""The search along normals finds every facet that lies there, and every facet that may face."""

import numpy as np
import pytest

from meshes.contact_surface import Surface
from meshes.facet_search import facets_along_normals
from meshes.facing import FACING, facets_that_may_face
from solver.vectors import Array


def small_facets(centres: Array, size: float, seed: int) -> Surface:
    """Triangles about given centres, which look in random directions."""
    rng = np.random.default_rng(seed)
    points = centres[:, None] + size * rng.normal(size=(len(centres), 3, 3))
    inside = points.mean(axis=1) + rng.normal(size=centres.shape)
    return Surface.of(3, np.arange(3 * len(centres)).reshape(-1, 3), points, inside)


@pytest.mark.parametrize(("seed", "far"), [(0, 1.5), (1, 1.5), (2, 1.5), (3, 0.2), (4, 0.1)])
def test_the_search_finds_all_facets_along_the_normals_inside_a_sphere(
    seed: int, far: float
) -> None:
    """About the centre of a sphere all of its facets are nearly equally near.

    Lines as short as a few facets have one ball.
    """
    rng = np.random.default_rng(seed)
    shell = rng.normal(size=(4000, 3))
    shell /= np.linalg.norm(shell, axis=1, keepdims=True)
    on = small_facets(0.5 * rng.normal(size=(300, 3)), 0.02, seed)
    against = small_facets(shell, 0.01, seed)
    chosen, reach = np.arange(len(on.nodes)), np.full(len(on.nodes), far)
    away = against.centres[None] - on.centres[:, None]
    along = np.einsum("ijk,ik->ij", away, on.normals)
    across = np.linalg.norm(away - along[..., None] * on.normals[:, None], axis=2)
    near = across <= on.radii[:, None] + against.radii
    expected = set(zip(*np.nonzero(near & (np.abs(along) <= far)), strict=True))
    found = set(zip(*facets_along_normals(on, against, chosen, reach), strict=True))
    assert len(expected) > (500 if far > 1.0 else 20)
    assert expected <= found <= set(zip(*np.nonzero(near), strict=True))


@pytest.mark.parametrize("widest", [0.3, 1.0, 2.0, np.pi])
def test_no_facet_that_faces_another_is_left_out(widest: float) -> None:
    """Against normals within a cone; half of a sphere cannot face a narrow one."""
    rng = np.random.default_rng(5)
    on, against = (small_facets(rng.normal(size=(500, 3)), 0.02, seed) for seed in (1, 2))
    inside = np.arccos(np.clip(against.normals @ [0.6, 0.0, 0.8], -1.0, 1.0)) <= widest
    normals = against.normals[inside]
    against = Surface.of(3, against.nodes[inside], against.points[inside],
                         against.centres[inside] - normals)  # fmt: skip
    found = facets_that_may_face(on, against)
    expected = np.flatnonzero((-(on.normals @ normals.T) >= FACING).any(axis=1))
    assert len(expected) > 50
    assert set(expected) <= set(found)
    assert len(found) < 300 or widest > 0.3
