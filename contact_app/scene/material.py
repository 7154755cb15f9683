"""Materials: moduli, stress and energy of isotropic linear elasticity.

Small strain: σ = λ tr(ε - α T I) I + 2 μ (ε - α T I) with Lamé's parameters, the coefficient of
thermal expansion α and the rise of temperature T. In plane stress λ is replaced by
2λμ/(λ + 2μ), so that the same formula gives the stresses in the plane. Stresses are in the unit of
Young's modulus. The rest of the application takes all moduli from these objects.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEARLY_INCOMPRESSIBLE = 0.48
"""Poisson's ratio from which on a material counts as nearly incompressible: first-order cells lock,
and estimates of the error fall short more often (0.5 to 0.7 of the error on quadrilaterals of
degree 2 at 0.49 to 0.4999, docs/benchmarks/accuracy.md)."""


@dataclass(frozen=True)
class Material:
    """Isotropic linear elasticity: Young's modulus (force per area) and Poisson's ratio."""

    young: float
    poisson: float
    mean_dilatation: bool = False
    """Whether the change of volume is taken as its mean over each cell (B-bar)."""
    yield_stress: float | None = None
    """Von Mises stress (force per area) above which the certificate warns; None for no warning."""
    expansion: float = 0.0
    """α, strain per degree."""

    def lame(self, plane: str | None) -> tuple[float, float]:
        """Lamé's λ (reduced in plane stress) and μ, force per area."""
        mu = self.young / (2.0 * (1.0 + self.poisson))
        lam = self.young * self.poisson / ((1.0 + self.poisson) * (1.0 - 2.0 * self.poisson))
        if plane == "stress":
            lam = 2.0 * lam * mu / (lam + 2.0 * mu)
        return lam, mu

    def thermal_stress(self, plane: str | None) -> tuple[float, float]:
        """Thermal stress per degree, which is subtracted from σ: 2 μ α and m λ α.

        Both act on the normal stresses. m is 3; in plane stress, where λ is reduced and the strain
        across the plane is free, m is 2.
        """
        lam, mu = self.lame(plane)
        count = 2.0 if plane == "stress" else 3.0
        return 2.0 * mu * self.expansion, count * lam * self.expansion

    def elasticity(self, plane: str | None, dimension: int) -> tuple[Array, Array]:
        """D of σ = D ε in two parts: of the change of shape, and of the change of volume.

        Components are the normal ones, then xy, yz, xz with shears doubled in ε: (d(d+1)/2,) each.
        """
        lam, mu = self.lame(plane)
        size = dimension * (dimension + 1) // 2
        volume = np.zeros((size, size))
        volume[:dimension, :dimension] = lam
        return np.diag(np.where(np.arange(size) < dimension, 2.0 * mu, mu)), volume

    def compliance(self, plane: str | None, dimension: int) -> Array:
        """C⁻¹ of ε = C⁻¹ σ, components as in `elasticity`."""
        return np.linalg.inv(sum(self.elasticity(plane, dimension)))

    def stress_across(self, plane: str | None, in_plane: Array, rise: Array) -> Array:
        """σ_zz in the plane: ν (σ_xx + σ_yy) - E α T in plane strain, zero in plane stress.

        Parameters
        ----------
        in_plane : (…,)
            σ_xx + σ_yy.
        rise : (…,)
            T.
        """
        if plane != "strain":
            return np.zeros(in_plane.shape)
        return self.poisson * in_plane - self.young * self.expansion * rise

    def nearly_incompressible(self, plane: str | None) -> bool:
        """Whether Poisson's ratio is near 0.5; never in plane stress."""
        return plane != "stress" and self.poisson >= NEARLY_INCOMPRESSIBLE


@dataclass(frozen=True, eq=False)
class CellMaterials:
    """The material of each cell of a mesh."""

    materials: tuple[Material, ...]
    """Materials by number."""
    tags: NDArray[np.int32]  # (cells,)
    """The number of each cell's material."""
    plane: str | None
    """"strain" or "stress"; None in space."""

    @cached_property
    def lame(self) -> Array:
        """Lamé's λ and μ of each cell, (2, cells)."""
        return np.array([m.lame(self.plane) for m in self.materials]).T[:, self.tags]

    @cached_property
    def thermal_stress(self) -> Array:
        """`Material.thermal_stress` of each cell, (2, cells)."""
        return np.array([m.thermal_stress(self.plane) for m in self.materials]).T[:, self.tags]

    def stress(self, gradient: Array, temperature: Array | None = None) -> Array:
        """Stress xx, yy, zz, xy, yz, xz (…, cells, 6) of displacement gradients (…, cells, d, d).

        In the plane yz and xz vanish; zz does too in plane stress.

        Parameters
        ----------
        temperature : (…, cells)
            Rise over the stress-free temperature.
        """
        lam, mu = self.lame
        strain = 0.5 * (gradient + np.swapaxes(gradient, -1, -2))
        volumetric = lam * np.trace(strain, axis1=-2, axis2=-1)
        result = np.zeros((*gradient.shape[:-2], 6))
        dimension = gradient.shape[-1]
        for i in range(dimension):
            result[..., i] = volumetric + 2.0 * mu * strain[..., i, i]
        result[..., 3] = 2.0 * mu * strain[..., 0, 1]
        if dimension == 3:
            result[..., 4] = 2.0 * mu * strain[..., 1, 2]
            result[..., 5] = 2.0 * mu * strain[..., 0, 2]
        elif self.plane == "strain":
            result[..., 2] = volumetric
        if temperature is not None:
            strained = 2 if self.plane == "stress" else 3
            missing = self.thermal_stress.sum(axis=0) * temperature
            result[..., :strained] -= missing[..., None]
        return result

    def energy_density(self, strain: Array) -> Array:
        """σ : ε (…, cells) of strains (…, cells, d, d)."""
        lam, mu = self.lame
        density = lam * np.trace(strain, axis1=-2, axis2=-1) ** 2
        density += 2.0 * mu * np.einsum("...ij,...ij->...", strain, strain)
        return np.asarray(density)


def von_mises(stress: Array) -> Array:
    """Von Mises stress of components xx, yy, zz, xy, yz, xz (…, 6)."""
    xx, yy, zz, xy, yz, xz = np.moveaxis(stress, -1, 0)
    return np.sqrt(
        0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
        + 3.0 * (xy**2 + yz**2 + xz**2)
    )  # fmt: skip
