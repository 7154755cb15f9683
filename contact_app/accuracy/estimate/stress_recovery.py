"""A continuous stress field fitted to the stresses of a finite-element solution.

Around each vertex a polynomial of the degree of the displacement is fitted to the stresses at
points where they are superconvergent: the centres of first-order cells, and the points of a rule of
degree 2 in second-order cells (Zienkiewicz & Zhu, *The superconvergent patch recovery and a
posteriori error estimates*, IJNME 33, 1992). Its value at the vertex is the recovered stress σ*; at
a midside node of a second-order cell σ* is the mean of the polynomials of the vertices between
which it lies. A vertex on the surface may have too few cells for a fit. Linear polynomials of its
neighbours are then extrapolated to it. Quadratic polynomials diverge when extrapolated; they are
fitted to the cells of the neighbours as well, with less weight than to the vertex's own cells. On
the surface σ* satisfies the known tractions (`tractions`).

Sums over cells are computed by subdomain and added at the owner of each vertex, so that σ* depends
neither on the decomposition nor on the number of ranks. Bodies share no nodes, so stresses are not
averaged across bodies. Where materials of one body meet, the true stress jumps: a recovery in the
cells of one material gives the stress on its side.

With mean dilatation (B-bar) the stress of the solution contains λ times the mean of div u over each
cell. The fit and the estimate use this stress.

Stress and strain have the components xx, yy, xy in the plane and xx, yy, zz, xy, yz, xz in space;
shear strains are engineering ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contact_app.accuracy.estimate.patch_fits import FLAT, Copies, LinearFits, QuadraticFits
from contact_app.accuracy.estimate.patches import Cells, Table
from contact_app.accuracy.estimate.touching import Touching
from contact_app.accuracy.estimate.tractions import SHEARS, Surface
from contact_app.model.model import Model
from meshes.arrays import Array, Ints


def strain_of_gradient(dimension: int) -> Array:
    """V of ε = V vec(∂u_i/∂x_j), j fastest: (components, dimension²)."""
    shears = SHEARS[: 2 * dimension - 3]
    V = np.zeros((dimension + len(shears), dimension**2))
    for i in range(dimension):
        V[i, i * dimension + i] = 1.0
    for row, (i, j) in enumerate(shears, dimension):
        V[row, i * dimension + j] = V[row, j * dimension + i] = 1.0
    return V


def at_cells(values: Array, nodes: NDArray[np.int32]) -> Array:
    """Values (nodes, members, k) at the vertices of cells, (members, cells, vertices · k)."""
    by_member = np.ascontiguousarray(np.swapaxes(values, 0, 1))
    at = np.take(by_member, nodes, axis=1, mode="clip")
    return at.reshape(values.shape[1], len(nodes), -1)


def apply(operator: Array, values: Array) -> Array:
    """Apply one operator a cell (cells or 1, n, m) to (members, cells, n): (members, cells, m)."""
    if len(operator) == 1:
        return values @ operator[0]
    return np.matmul(values[:, :, None], operator)[:, :, 0]


def stress_operator(gradients: Array, DV: Array) -> Array:
    """Matrices that map displacements at nodes to stresses at points.

    Parameters
    ----------
    gradients : (cells, points, dimension, nodes)
    DV : (components, dimension²)

    Returns
    -------
    (cells, nodes · dimension, points · components)
    """
    count, points, d, nodes = gradients.shape
    tensor = DV.reshape(-1, d, d)
    result = np.einsum("sij,cqjv->cviqs", tensor, gradients, optimize=True)
    return result.reshape(count, nodes * d, points * len(DV))


@dataclass(frozen=True, eq=False)
class Patches:
    """The part of a recovery that depends on the meshes of a model, not on its loads."""

    cells: list[Cells]
    """Cells of each class."""
    copies: Copies
    """Meeting places of the vertices of subdomains."""
    surface: Surface
    """Nodes on the surface of the bodies."""
    fits: LinearFits | QuadraticFits
    """Polynomial fits to the samples around each vertex."""

    @classmethod
    def of(
        cls,
        model: Model,
        material: int | None = None,
        surface: Surface | None = None,
        flat: float = FLAT,
    ) -> "Patches":
        """Around the vertices of a model (collective).

        Parameters
        ----------
        material
            Number of a material within its body: σ* is fitted in the cells of that material alone
            and holds at their nodes. All cells unless given.
        surface
            Surface of the model's meshes, if already computed.
        flat
            Smallest determinant of a patch's moments that determines a linear polynomial.
        """
        made: dict[int, Cells] = {}
        for element in model.elements:
            if id(element) not in made:
                made[id(element)] = Cells(element, material)
        cells = [made[id(element)] for element in model.elements]
        copies = Copies(model, [c.vertices for c in cells])
        fits: LinearFits | QuadraticFits = (
            LinearFits(model.comm, cells, copies, flat)
            if max(body.degree for body in model.scene.bodies) == 1
            else QuadraticFits(model.comm, cells, copies)
        )
        return cls(cells, copies, surface or Surface(model, cells), fits)

    def determined_from(self, flat: float) -> "Patches":
        """Patches with another threshold of linear polynomials, or the same object if equal."""
        fits = self.fits.determined_from(flat)
        return self if fits is self.fits else replace(self, fits=fits)


class StressRecovery:
    """Recovers σ* from solutions of one model; construction and calls are collective.

    Parameters
    ----------
    patches
        Patches of the model's meshes, if known from another load case.
    """

    def __init__(self, model: Model, patches: Patches | None = None) -> None:
        self.model = model
        self.dimension = model.scene.dimension
        self.patches = patches or Patches.of(model)
        self.cells = self.patches.cells
        self.moduli = [
            [material.elasticity(model.scene.plane, self.dimension) for material in materials]
            for materials in model.materials
        ]
        self.thermal = [
            [material.thermal_stress(model.scene.plane) for material in materials]
            for materials in model.materials
        ]
        self.averaged = [materials[0].mean_dilatation for materials in model.materials]
        self.V = strain_of_gradient(self.dimension)

    def stress_at(self, number: int, rows: Ints, table: Table, DV: Array) -> Array:
        """Operators of a class from displacements of cells to D V times gradients at points.

        Parameters
        ----------
        DV : (2, components, dimension²)
            Deviatoric and volumetric part; mean dilatation evaluates the volumetric part with means
            over cells.
        """
        cells = self.cells[number]
        gradients, _ = cells.gradients(rows, table)
        if not self.averaged[number]:
            return stress_operator(gradients, DV.sum(axis=0))
        means = np.broadcast_to(cells.mean_gradients(rows), gradients.shape)
        return stress_operator(gradients, DV[0]) + stress_operator(means, DV[1])

    def thermal_at(self, number: int, rows: Ints, members: slice, table: Table) -> Array | None:
        """Thermal stress to subtract in cells of one material; None without heat.

        Returns
        -------
        (members, cells, points, components)
        """
        heat = self.model.temperatures[number]
        if heat is None:
            return None
        cells = self.cells[number]
        shape, volume = self.thermal[number][cells.tags[rows[0]]]
        nodal = at_cells(heat[:, members, None], cells.nodes[rows])
        at = nodal @ table.values.T
        mean = at
        if self.averaged[number]:
            mean = np.einsum("mcn,cn->mc", nodal, cells.mean_values(rows))[..., None]
        missing = np.zeros((*at.shape, len(self.V)))
        missing[..., : self.dimension] = (shape * at + volume * mean)[..., None]
        return missing

    def samples(self, displacements: Sequence[Array]) -> list[Array]:
        """Stresses for the fit, (cells · points, members, components) of each class."""
        result = []
        for number, u in enumerate(displacements):
            cells = self.cells[number]
            table = cells.samples
            q, s = len(table.weights), len(self.V)
            field = u.reshape(len(cells.places), self.dimension, -1).swapaxes(1, 2)
            stress = np.empty((len(cells.nodes), q, u.shape[1], s))
            for rows, shape, part in cells.batches(u.shape[1], q):
                D = np.array(self.moduli[number][cells.tags[rows[0]]])
                operator = self.stress_at(number, shape, table, D @ self.V)
                stresses = apply(operator, at_cells(field[:, part], cells.nodes[rows]))
                stresses = stresses.reshape(*stresses.shape[:2], q, s)
                missing = self.thermal_at(number, rows, part, table)
                if missing is not None:
                    stresses = stresses - missing
                stress[rows, :, part] = np.moveaxis(stresses, 0, 2)
            result.append(stress.reshape(-1, u.shape[1], s))
        return result

    def __call__(self, displacements: Sequence[Array], touching: Touching) -> list[Array]:
        """σ* at nodes, (nodes, members, components) of each class.

        Parameters
        ----------
        displacements : one (n, members) array per class
        """
        return self.meeting(self.patches.surface.changes(self.model, touching), displacements)

    def meeting(self, changes: Array, displacements: Sequence[Array]) -> list[Array]:
        """Recovered stresses with the corrections of `Surface` for the known tractions."""
        patches = self.patches
        at_vertices, s = patches.fits.at_vertices(self.samples(displacements)), len(self.V)
        recovered = [
            c.at_nodes(part.reshape(*part.shape[:2], patches.fits.count, s))
            for c, part in zip(self.cells, patches.copies.spread(at_vertices), strict=True)
        ]
        patches.surface.meet(changes, recovered)
        return recovered
