"""The error estimate of two tied bodies of two materials, one of them warm, against the true error.

The true error of each body is that of the strains against a mesh of four times as many cells.
"""

import numpy as np
import pytest

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.run.solve import solve_scene
from tests import scenes

Array = np.ndarray

FINE = 48


def tied_blocks(cells: tuple[int, int], warm: int) -> scenes.Config:
    """A stiff block tied onto a soft one that is held below; meshes do not match."""
    bodies = [
        scenes.box(name, [1, k + 1], [cells[k]] * 2, [0, k], "", young, 0.3 - 0.1 * k)
        for k, (name, young) in enumerate((("soft", 1e5), ("stiff", 5e5)))
    ]
    bodies[warm]["material"]["expansion"] = 1e-5
    return {
        "dimension": 2,
        "bodies": bodies,
        "conditions": [
            {"on": "soft.y-", "displacement": [0, 0]},
            {"in": bodies[warm]["name"], "temperature": "100 * (1 + x)"},
        ],
        "contacts": [{"on": "stiff.y-", "against": "soft.y+", "tied": True}],
        "solver": {"tolerance": 1e-10},
    }


def lattice(solved: SolvedScene, body: int) -> Array:
    """Displacements (n + 1, n + 1, 2) of the nodes of a block."""
    mesh, nodes = solved.model.scene.bodies[body].mesh, solved.model.partition.first_node
    points, u = solved.nodes.points, solved.nodes.displacement
    mine = slice(nodes[body], nodes[body + 1])
    n = round((len(points[mine])) ** 0.5) - 1
    place = np.rint((points[mine, :2] - np.array(mesh.lower)) * n).astype(int)
    result = np.full((n + 1, n + 1, 2), np.nan)
    result[place[:, 0], place[:, 1]] = u[mine]
    return result


def strains(u: Array, x: Array, y: Array) -> Array:
    """ε_xx, ε_yy and γ_xy (points, 3) of bilinear displacements on the unit square."""
    n = len(u) - 1
    i, j = (np.minimum((v * n).astype(int), n - 1) for v in (x, y))
    a, b = (x * n - i)[:, None], (y * n - j)[:, None]
    along = (1 - b) * (u[i + 1, j] - u[i, j]) + b * (u[i + 1, j + 1] - u[i, j + 1])
    across = (1 - a) * (u[i, j + 1] - u[i, j]) + a * (u[i + 1, j + 1] - u[i + 1, j])
    return n * np.stack([along[:, 0], across[:, 1], along[:, 1] + across[:, 0]], axis=1)


def true_errors(solved: SolvedScene, fine: SolvedScene) -> Array:
    """Energy norm of the error of each body, by two Gauss points an edge of the fine cells."""
    gauss = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    at = ((np.arange(FINE)[:, None] + gauss) / FINE).ravel()
    x, y = (v.ravel() for v in np.meshgrid(at, at, indexing="ij"))
    result = []
    for body in (0, 1):
        exx, eyy, gamma = (
            strains(lattice(solved, body), x, y) - strains(lattice(fine, body), x, y)
        ).T
        material = solved.model.scene.bodies[body].materials[0]
        young, poisson = material.young, material.poisson
        shear = young / (2 * (1 + poisson))
        lame = 2 * shear * poisson / (1 - 2 * poisson)
        density = lame * (exx + eyy) ** 2 + 2 * shear * (exx**2 + eyy**2) + shear * gamma**2
        result.append(np.sqrt(density.mean()))
    return np.array(result)


@pytest.mark.parametrize("warm", [0, 1])
def test_each_side_has_its_own_error(warm: int) -> None:
    """The strains jump at the tie; a stress recovered across it would be wrong on both sides."""
    solved, fine = (
        solve_scene(scenes.build(tied_blocks(cells, warm))) for cells in ((8, 12), (FINE, FINE))
    )
    estimated = np.sqrt(ErrorEstimator(solved.model).squares(solved.solution)[0])
    np.testing.assert_allclose(estimated, true_errors(solved, fine), rtol=0.2)
