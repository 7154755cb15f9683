"""L2 errors of displacement and stress over the bodies, compared with exact fields.

Errors are integrated over the cells of the mesh, including curved edges. Where a mesh extends
beyond the true body, the formulas of the exact fields are continued. Meshes may have any cell and
degree.
"""

from collections.abc import Callable

import numpy as np

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.scene.material import CellMaterials
from meshes import dolfinx_compat
from meshes.arrays import Array
from meshes.subdomains import vtk_shapes

Field = Callable[[Array], Array]


def relative_errors(
    solved: SolvedScene, displacement: Field, stresses: Field
) -> tuple[float, float]:
    """‖u - u_h‖/‖u‖ and ‖σ - σ_h‖/‖σ‖ in L2 over the subdomains of this process.

    Parameters
    ----------
    displacement, stresses
        The exact fields at points (n, d): (n, d), and xx, yy, zz, xy, yz, xz (n, 6).
    """
    model, d = solved.model, solved.model.scene.dimension
    sums = np.zeros(4)
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        reference, degree = s.reference, s.reference.degree
        points, weights = dolfinx_compat.quadrature(reference.cell, 2 * degree + 4)
        values, slopes = vtk_shapes(reference.cell, degree, points)
        x = s.points()[reference.cells][..., :d]
        u = solved.solution.displacements[cls][:, column].reshape(-1, d)[reference.cells]
        jacobian = np.einsum("qrk,cki->cqri", slopes, x)
        share = weights * np.abs(np.linalg.det(jacobian))
        gradients = np.linalg.inv(jacobian) @ slopes
        gradient = np.einsum("cki,cqjk->cqij", u, gradients)
        at = np.einsum("qk,cki->cqi", values, x)
        material = CellMaterials(model.materials[cls], reference.tags, model.scene.plane)
        exact_u = displacement(at.reshape(-1, d)).reshape(at.shape)
        exact = stresses(at.reshape(-1, d)).reshape(*at.shape[:2], 6)
        computed = material.stress(np.swapaxes(gradient, 0, 1))
        away = np.einsum("qk,cki->cqi", values, u) - exact_u
        shears_twice = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
        off = np.swapaxes(computed, 0, 1) - exact
        squares = [(f**2).sum(axis=2) for f in (away, exact_u)]
        squares += [f**2 @ shears_twice for f in (off, exact)]
        sums += [(share * square).sum() for square in squares]
    return float(np.sqrt(sums[0] / sums[1])), float(np.sqrt(sums[2] / sums[3]))


def lame_ring(
    young: float, poisson: float, radii: tuple[float, float], pressure: float, inwards: float
) -> tuple[Field, Field, float]:
    """A thick ring about the origin in plane strain (G. Lamé, 1852): u = A r + B/r.

    Parameters
    ----------
    radii
        Inner and outer radius.
    pressure
        Pressure on the inner side.
    inwards
        Displacement of the outer side towards the axis.

    Returns
    -------
    Displacement, stress and the pressure on the outer side.
    """
    mu = young / (2.0 * (1.0 + poisson))
    lam = 2.0 * mu * poisson / (1.0 - 2.0 * poisson)
    a, b = radii
    equations = [[2.0 * (lam + mu), -2.0 * mu / a**2], [b, 1.0 / b]]
    A, B = np.linalg.solve(equations, [-pressure, -inwards])

    def displacement(x: Array) -> Array:
        return np.asarray((A + B / (x**2).sum(axis=1))[:, None] * x)

    def stresses(x: Array) -> Array:
        square = (x**2).sum(axis=1)
        mean, part = 2.0 * (lam + mu) * A, 2.0 * mu * B / square
        cos, sin = (x[:, 0] ** 2 - x[:, 1] ** 2) / square, 2.0 * x[:, 0] * x[:, 1] / square
        stress = np.zeros((len(x), 6))
        stress[:, 0], stress[:, 1] = mean - part * cos, mean + part * cos
        stress[:, 2], stress[:, 3] = 2.0 * lam * A, -part * sin
        return stress

    return displacement, stresses, float(2.0 * mu * B / b**2 - 2.0 * (lam + mu) * A)
