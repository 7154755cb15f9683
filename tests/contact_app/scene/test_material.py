"""Moduli, stress and energy of a material against each other and against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_app.scene.material import CellMaterials, Material, von_mises

STEEL = Material(210e3, 0.3)
RUBBER = Material(2.0, 0.4999)

materials = st.builds(Material, st.floats(1e-3, 1e6), st.floats(-0.9, 0.499))


def components(tensor: np.ndarray, shears: float) -> np.ndarray:
    """Normal components, then xy, yz, xz times a factor."""
    d = tensor.shape[-1]
    pairs = [(0, 1), (1, 2), (0, 2)][: 2 * d - 3]
    normal = [tensor[..., i, i] for i in range(d)]
    return np.stack(normal + [shears * tensor[..., i, j] for i, j in pairs], axis=-1)


@given(materials, st.sampled_from([(2, "strain"), (2, "stress"), (3, None)]))
def test_stress_elasticity_compliance_and_energy_agree(
    material: Material, space: tuple[int, str | None]
) -> None:
    dimension, plane = space
    gradient = np.random.default_rng(1).normal(size=(4, dimension, dimension))
    strain = 0.5 * (gradient + np.swapaxes(gradient, 1, 2))
    cells = CellMaterials((STEEL, material), np.ones(4, np.int32), plane)
    found = cells.stress(gradient)
    seen = [0, 1, 3] if dimension == 2 else list(range(6))
    D = sum(material.elasticity(plane, dimension))
    np.testing.assert_allclose(found[:, seen], components(strain, 2.0) @ D, rtol=1e-10)
    back = found[:, seen] @ material.compliance(plane, dimension)
    size = np.abs(strain).max()
    np.testing.assert_allclose(back, components(strain, 2.0), atol=1e-8 * size, rtol=1e-6)
    energy = (found[:, seen] * components(strain, 2.0)).sum(axis=1)
    np.testing.assert_allclose(cells.energy_density(strain), energy, rtol=1e-9)


def test_a_rod_in_tension() -> None:
    """σ = E ε along it and contraction ν ε across, in space and in plane stress."""
    stretch = np.diag([1.0, -0.3, -0.3])[None]
    stress = CellMaterials((STEEL,), np.zeros(1, np.int32), None).stress(stretch)
    np.testing.assert_allclose(stress, [[210e3, 0, 0, 0, 0, 0]], atol=1e-6)
    assert von_mises(stress) == pytest.approx([210e3])
    plane = CellMaterials((STEEL,), np.zeros(1, np.int32), "stress").stress(stretch[:, :2, :2])
    np.testing.assert_allclose(plane, [[210e3, 0, 0, 0, 0, 0]], atol=1e-6)


def test_in_plane_strain_the_stress_across_the_plane_is_nu_times_the_others() -> None:
    gradient = np.array([[[1e-3, 2e-3], [0.0, -5e-4]]])
    stress = CellMaterials((STEEL,), np.zeros(1, np.int32), "strain").stress(gradient)[0]
    assert stress[2] == pytest.approx(0.3 * (stress[0] + stress[1]))


def test_near_incompressibility_matters_only_where_volume_is_held() -> None:
    assert RUBBER.nearly_incompressible(None)
    assert RUBBER.nearly_incompressible("strain")
    assert not RUBBER.nearly_incompressible("stress")
    assert not STEEL.nearly_incompressible(None)
