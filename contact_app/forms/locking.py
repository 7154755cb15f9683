"""Locking of cells of degree 1, seen in the energies that a form gives to their displacements.

Near ν = 0.5 all of them lock. Poisson's ratio is that of an isotropic material with the same ratio
of the energies of a change of volume and of a change of shape,

    a_T(I x, I x) |D|² / (a_T(D x, D x) d)    in a cell T, with tr D = 0,

which is (1 + ν) / (1 - 2 ν) in three dimensions and 1 / (1 - 2 ν) in plane strain. Quadrilaterals
and hexahedra with an integral by one point are left out: reduced integration of the change of
volume prevents the locking.

In bending, quadrilaterals and hexahedra lock where much of the energy,

    1 - Σ a_T(ū, ū) / a(u, u)    with the affine displacement ū that is nearest to u in each cell T,

lies in strains that vary within cells; scenes test the same (`contact_app.run.model_warnings`).
Strains of triangles and tetrahedra are constant. For these the energy of the difference between the
strains of cells and their means at nodes, interpolated, estimates the error (O. C. Zienkiewicz, J.
Z. Zhu, Int. J. Numer. Methods Eng. 24, 1987). Means are over cells of one rank whose stiffness is
similar, since strains jump where the material changes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_app.forms.energies import CellEnergies
from contact_app.forms.parts import Parts
from contact_app.forms.uniform import EqualCells
from meshes import dolfinx_compat
from meshes.arrays import Array, Ints

SHAPE = {2: [[1.0, 1.0], [1.0, -1.0]], 3: [[1.0, 1.0, 1.0], [1.0, -0.5, 1.0], [1.0, 1.0, -0.5]]}
"""A change of shape in all components, by dimension."""


@dataclass(frozen=True, eq=False)
class Moduli:
    """Energies that a form gives to each cell under a change of volume and of shape."""

    energies: CellEnergies
    """Energies of the form."""
    volume: Array
    shape: Array
    """a_T(I x, I x) / d, and a_T(D x, D x) / |D|² with tr D = 0: in an isotropic body d |T| times
    the bulk modulus of d dimensions, and 2 |T| times the shear modulus. Shape (cells,)."""

    @classmethod
    def of(cls, parts: Parts, form: Any, equal: EqualCells | None = None) -> "Moduli":
        """The moduli of the cells of this rank."""
        energies, d = CellEnergies(form, parts.space, equal), parts.dimension
        middle = parts.points[parts.cells].mean(axis=1)[:, :d]
        zero = np.zeros_like(middle)
        return cls(energies, *(
            energies.of_affine(np.tile(D, (len(middle), 1, 1)), middle, zero) / (D**2).sum()
            for D in (np.eye(d), np.array(SHAPE[d]))
        ))  # fmt: skip

    def poisson(self, d: int) -> Array:
        """Poisson's ratio of isotropic cells with these moduli, (cells,)."""
        ratio = self.volume / self.shape
        return 0.5 * (1.0 - 1.0 / ratio) if d == 2 else (ratio - 1.0) / (2.0 * ratio + 1.0)

    def energy(self, strain: Array) -> Array:
        """Energies (cells,) of isotropic cells, summed over several strains (…, cells, d, d)."""
        d = strain.shape[-1]
        trace = np.trace(strain, axis1=-2, axis2=-1) ** 2
        square = np.einsum("...ij,...ij->...", strain, strain)
        energy = self.shape * square + (self.volume - self.shape) / d * trace
        return np.asarray(energy.reshape(-1, len(self.volume)).sum(axis=0))


@dataclass(frozen=True, eq=False)
class Locking:
    """Signs of locking of the cells of degree 1."""

    varying: Array  # (bodies,)
    """Share of the energy of each body in strains that vary within quadrilaterals or hexahedra."""
    poisson: Array  # (bodies,)
    """The largest Poisson's ratio of a cell that an isotropic material would have; 0 if that is
    negative."""
    error: float
    """Estimated relative error in energy norm on triangles or tetrahedra."""


Fit = tuple[Array, Array, Array]


def affine_fit(parts: Parts, u: Array) -> Fit:
    """Gradient (cells, d, d), middle and value there (cells, d) of the affine fit to the vertices.

    Parameters
    ----------
    u : (copies, d)
        Displacements.
    """
    vertices = len(dolfinx_compat.lagrange_nodes(parts.space.mesh.topology.cell_name(), 1)[0])
    corners = parts.cells[:, :vertices]
    x, u = parts.points[corners][..., : parts.dimension], u[corners]
    middle, value = x.mean(axis=1), u.mean(axis=1)
    x = x - middle[:, None]
    transposed = np.swapaxes(x, 1, 2)
    gradient = np.linalg.solve(transposed @ x, transposed @ u)
    return np.swapaxes(gradient, 1, 2), middle, value


def locking(parts: Parts, moduli: Moduli, u: tuple[Array, Fit], body: tuple[Ints, int]) -> Locking:
    """Signs of locking of a space of degree 1 (collective).

    Parameters
    ----------
    u : (nodes of the space with ghosts, d)
        Displacements, and `affine_fit` of them.
    body : (cells,)
        Body of each cell, and the number of bodies.
    """
    comm, energies, (of_cell, count) = parts.comm, moduli.energies, body
    bricks = parts.space.mesh.topology.cell_name() in ("quadrilateral", "hexahedron")
    poisson = np.zeros(count)
    if not (bricks and energies.reduced):
        np.maximum.at(poisson, of_cell, moduli.poisson(parts.dimension))
    poisson = np.max(comm.allgather(poisson), axis=0)
    if bricks:
        shares = energies.of(u[0]), energies.of_affine(*u[1])
        sums = [np.bincount(of_cell, energy, count) for energy in shares]
        total, affine = comm.allreduce(np.stack(sums))
        some = total > 0.0
        return Locking(np.where(some, 1.0 - affine / np.where(some, total, 1.0), 0.0), poisson, 0.0)
    gradient = u[1][0]
    strain = 0.5 * (gradient + np.swapaxes(gradient, 1, 2))
    off = _off_means(parts, moduli, strain)
    error, energy = comm.allreduce(np.array([off.sum(), moduli.energy(strain).sum()]))
    relative = float(np.sqrt(error / (energy + error))) if energy > 0.0 else 0.0
    return Locking(np.zeros(count), poisson, relative)


def _off_means(parts: Parts, moduli: Moduli, strain: Array) -> Array:
    """Energy (cells,) of the difference between a cell's strain and the interpolated means.

    The integral of the square of a linear function with the values f_v at the vertices of a simplex
    is |T| (Σ f_v² + (Σ f_v)²) / ((d + 1) (d + 2)).
    """
    d, nodes = parts.dimension, parts.cells.shape[1]
    level = _stiffness_levels(parts, moduli)
    place = parts.cells + len(parts.points) * level[:, None]
    if level.any():
        place = np.unique(place, return_inverse=True)[1].reshape(place.shape)
    count = np.maximum(np.bincount(place.ravel()), 1)
    columns = strain.reshape(-1, d * d).T
    sums = [np.bincount(place.ravel(), np.repeat(column, nodes)) for column in columns]
    means = np.stack([column / count for column in sums], axis=1)[place.T]
    off = means.reshape(nodes, -1, d, d) - strain
    total = moduli.energy(off) + moduli.energy(off.sum(axis=0))
    return np.asarray(total / ((d + 1) * (d + 2)))


def _stiffness_levels(parts: Parts, moduli: Moduli) -> Ints:
    """Number (cells,) from 0 on that is equal where moduli differ by less than a half."""
    d, x = parts.dimension, parts.points[parts.cells]
    size = np.abs(np.linalg.det(x[:, 1 : d + 1, :d] - x[:, :1, :d]))
    stiffness = (moduli.volume + moduli.shape) / size
    return np.rint(2.0 * np.log2(stiffness.max(initial=0.0) / stiffness)).astype(np.int64)
