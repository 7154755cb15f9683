"""Nodal stresses are exact where the stress is uniform in each material, and keep its jumps."""

from pathlib import Path

import meshio
import numpy as np
import pytest

import contact_app
from tests import meshfiles, scenes
from tests.scenes_on_ranks import summary_of

CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
SOFT, HARD, STRETCH = 500.0, 4000.0, 1e-3


def side_by_side(cell: str, file: Path, degree: int) -> scenes.Config:
    """Two materials without Poisson effect, stretched along y by one strain: σ = E ε in each."""
    d = scenes.dimension(cell)
    pulled = [None, STRETCH, None][:d]
    return {
        "dimension": d,
        "bodies": [
            {"name": "block", "degree": degree, "mesh": {"file": str(file)},
             "material": {"soft": {"young": SOFT, "poisson": 0.0},
                          "hard": {"young": HARD, "poisson": 0.0}}},
        ],
        "conditions": [
            {"on": "block.y-", "displacement": [0.0] * d},
            {"on": "block.y+", "displacement": pulled},
        ],
        "solver": {"tolerance": 1e-10},
    }  # fmt: skip


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_each_material_has_its_own_stress_at_the_interface(
    cell: str, degree: int, tmp_path: Path
) -> None:
    file = meshfiles.write(meshfiles.block(cell, 4), tmp_path / "block.msh")
    made = side_by_side(cell, file, degree) | {"decomposition": {"subdomains": 3}}
    answer = contact_app.solve(made)
    x = answer.points[:, 0]
    assert answer.nodal_stress is not None
    assert answer.nodal_von_mises is not None
    expected = np.where(x < 0.5 - 1e-9, SOFT, HARD) * STRETCH
    np.testing.assert_allclose(answer.nodal_stress[:, 1], expected, rtol=1e-6)
    np.testing.assert_allclose(answer.nodal_stress[:, [0, 2, 3, 4, 5]], 0.0, atol=1e-6)
    np.testing.assert_allclose(answer.nodal_von_mises, expected, rtol=1e-6)
    soft, hard = (answer.solved.nodal[f"nodal_stress_material_{k}"] for k in (0, 1))
    on = x < 0.5 + 1e-9
    np.testing.assert_allclose(soft[on, 1], SOFT * STRETCH, rtol=1e-6)
    assert np.isnan(soft[~on]).all()
    on = x > 0.5 - 1e-9
    np.testing.assert_allclose(hard[on, 1], HARD * STRETCH, rtol=1e-6)
    assert np.isnan(hard[~on]).all()
    assert answer.summary["accuracy"]["discretisation"] < 1e-6


@pytest.mark.parametrize(("cell", "degree"), [("triangle", 1), ("quadrilateral", 2)])
def test_the_error_at_an_interface_is_estimated(cell: str, degree: int, tmp_path: Path) -> None:
    """The energies of this mesh and of a finer one give the error; one material is 8 times stiffer.

    A stress without a jump at the interface estimates two to ten times the error.
    """
    energies, estimates = [], []
    for cells in (8, 48):
        file = meshfiles.write(meshfiles.block(cell, cells), tmp_path / "block.msh")
        made = side_by_side(cell, file, degree)
        made["conditions"][1] = {"on": "block.y+", "traction": [1.0, 0.0]}
        summary = contact_app.solve(made).summary
        energies.append(summary["solution"]["energy"])
        estimates.append(summary["accuracy"]["discretisation"])
    error = np.sqrt((energies[1] - energies[0]) / energies[1])
    assert 0.8 < estimates[0] / error < 1.5


@pytest.mark.parametrize(
    ("plane", "load", "expected"),
    [
        ("plane_strain", {"on": "b.y+", "pressure": 10}, [0, -10, -3, 0, 0, 0]),
        ("plane_stress", {"on": "b.y+", "pressure": 10}, [0, -10, 0, 0, 0, 0]),
        ("plane_strain", {"in": "b", "temperature": 50}, [0, 0, -0.5, 0, 0, 0]),
    ],
)
def test_the_stress_across_the_plane(plane: str, load: scenes.Config, expected: list[int]) -> None:
    """A block of ν = 0.3, free along x: ν σ under a pressure, -E α T alone if it is warmer."""
    block = scenes.block("quadrilateral", 3, "b")
    block["material"]["expansion"] = 1e-5
    answer = contact_app.solve({
        "dimension": plane,
        "bodies": [block],
        "conditions": [*scenes.rollers("quadrilateral", body="b"), load],
    })  # fmt: skip
    assert answer.nodal_stress is not None
    np.testing.assert_allclose(answer.nodal_stress - expected, 0.0, atol=1e-8)


@pytest.mark.parametrize(
    ("cell", "largest"),
    [("triangle", 0.2), ("quadrilateral", 0.1), ("tetrahedron", 0.2), ("hexahedron", 0.05)],
)
def test_no_node_of_a_distorted_mesh_runs_away(cell: str, largest: float, tmp_path: Path) -> None:
    """Pure bending, σ = -12 (y - ½) M: the error at the worst node, over the largest stress."""
    d = scenes.dimension(cell)
    file = meshfiles.write(meshfiles.block(cell, 6), tmp_path / "block.msh")
    answer = contact_app.solve({
        "dimension": d,
        "bodies": [{"name": "b", "mesh": {"file": str(file)},
                    "material": {"young": 1000, "poisson": 0.0}}],
        "conditions": [
            {"on": "b.x-", "displacement": [0] * d},
            {"on": "b.x+", "total_moment": 1.0 if d == 2 else [0, 0, 1.0]},
        ],
    })  # fmt: skip
    assert answer.nodal_stress is not None
    error = answer.nodal_stress.copy()
    error[:, 0] += 12.0 * (answer.points[:, 1] - 0.5)
    assert np.abs(error).max() < 6.0 * largest


def test_a_symmetric_half_has_the_nodal_stress_of_the_whole() -> None:
    """Shears change their sign across the planes; near these the fit knows cells of one side only.

    A beam held at both ends bends.
    """
    made = {
        "dimension": 3,
        "bodies": [scenes.box("b", [4, 1, 1], [8, 4, 4])],
        "conditions": [
            {"on": "b.x-", "displacement": [0, 0, 0]}, {"on": "b.x+", "displacement": [0, 0, 0]},
            {"on": "b.z+", "traction": [0, 0, -1]},
        ],
        "solver": {"tolerance": 1e-11},
    }  # fmt: skip
    found = []
    for symmetry in ("none", "allow"):
        answer = contact_app.solve({**made, "symmetry": symmetry})
        assert answer.nodal_stress is not None
        order = np.lexsort(np.round(answer.points, 9).T)
        found.append(answer.nodal_stress[order])
    largest = np.abs(found[0]).max()
    assert np.abs(found[0][:, 3:]).max() > 0.15 * largest
    np.testing.assert_allclose(found[1], found[0], atol=0.06 * largest)


def test_stresses_are_recovered_on_request_only() -> None:
    made = scenes.wall("quadrilateral", 2)
    answer = contact_app.solve({**made, "output": {"fields": ["displacement", "stress"]}})
    assert answer.nodal_stress is None
    assert not answer.solved.nodal


def test_an_answer_has_nodal_stresses_without_files_of_fields() -> None:
    made = scenes.wall("quadrilateral", 2)
    files, none = (contact_app.solve({**made, "output": {"xdmf": xdmf}}) for xdmf in (True, False))
    assert not none.solved.nodal  # a run that writes no fields does not recover them
    for name in ("nodal_stress", "nodal_von_mises"):
        np.testing.assert_array_equal(getattr(none, name), getattr(files, name))


@pytest.mark.mpi
def test_ranks_recover_the_same(tmp_path: Path) -> None:
    file = meshfiles.write(meshfiles.block("tetrahedron", 4), tmp_path / "block.msh")
    made = side_by_side("tetrahedron", file, 1)
    made |= {"output": {"vtu": True, "xdmf": False}, "decomposition": {"subdomains": 4}}
    summary_of(made, tmp_path, 2)
    found = meshio.read(tmp_path / "out2" / "solution.vtu")
    expected = np.where(found.points[:, 0] < 0.5 - 1e-9, SOFT, HARD) * STRETCH
    np.testing.assert_allclose(found.point_data["nodal_von_mises"], expected, rtol=1e-6)
    soft = found.point_data["nodal_von_mises_material_0"]
    on = found.points[:, 0] < 0.5 + 1e-9
    np.testing.assert_allclose(soft[on], SOFT * STRETCH, rtol=1e-6)
    assert np.isnan(soft[~on]).all()


@pytest.mark.parametrize("cell", CELLS)
def test_stress_is_exact_where_an_inclined_surface_sticks(cell: str, tmp_path: Path) -> None:
    """No traction is known on facets that stick: rounding errors of that must not count."""
    file = meshfiles.write(meshfiles.block(cell, 3), tmp_path / "block.msh")
    d, angle = scenes.dimension(cell), np.radians(23.0)
    axis = {"axis": [0.0, 0.0, 1.0]} if d == 3 else {}
    up = np.array([-np.sin(angle), np.cos(angle), 0.0])[:d]
    answer = contact_app.solve({
        "dimension": d,
        "bodies": [
            {"name": "block", "mesh": {"file": str(file), "rotate": {"angle": 23.0, **axis}},
             "material": {"young": 1e3, "poisson": 0.0}},
        ],
        "conditions": [{"on": "block.y+", "traction": (-2.0 * up).tolist()}],
        "contacts": [
            {"on": "block.y-", "friction": {"coulomb": 0.5},
             "obstacle": {"plane": {"point": [0.0] * d, "normal": up.tolist()}}},
        ],
        "solver": {"tolerance": 1e-10},
    })  # fmt: skip
    assert answer.nodal_stress is not None
    stress = -2.0 * np.outer(up, up)
    components = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]
    padded = np.zeros((3, 3))
    padded[:d, :d] = stress
    expected = [padded[ij] for ij in components]
    np.testing.assert_allclose(answer.nodal_stress, np.tile(expected, (len(answer.points), 1)),
                               atol=1e-6)  # fmt: skip
