"""VTU written, read back by meshio, equals what was handed over, and what the XDMF holds."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from contact_app.errors import CouldNotRunError
from contact_app.machine import disk
from contact_app.results.plot.stored import read as read_xdmf
from contact_app.results.vtu import VTUWriter
from contact_app.results.xdmf import CELL_TYPES
from contact_app.run.run import run
from tests import scenes
from tests.contact_app.results.test_xdmf import MESHIO, separate_cells
from tests.scenes_on_ranks import summary_of

POINT_FIELDS = {"displacement": 3, "gap": 1}
CELL_FIELDS = {"stress": 9}


@pytest.mark.parametrize("slab", [2, 100])
def test_read_back_equals_the_written_values(slab: int, tmp_path: Path) -> None:
    """Cells of all types in one file."""
    rng = np.random.default_rng(3)
    parts = {kind: separate_cells(kind, 3, rng) for kind in CELL_TYPES}
    sizes = [len(points) for points, _ in parts.values()]
    first = np.cumsum([0, *sizes])
    n = int(first[-1])
    gap, moved = rng.normal(size=n), rng.normal(size=(n, 3))
    stress = rng.normal(size=(24, 6))
    path = tmp_path / "solution.vtu"
    runs = [(kind, 3) for kind in CELL_TYPES]
    with VTUWriter(path, runs, n, POINT_FIELDS, CELL_FIELDS) as file:
        for number, (points, cells) in enumerate(parts.values()):
            file.points(first[number], points)
            for at in range(0, 3, slab):
                file.cells(3 * number + at, cells[at : at + slab] + first[number])
                rows = slice(3 * number + at, 3 * number + min(at + slab, 3))
                file.cell_data("stress", rows.start, stress[rows])
        for at in range(0, n, slab):
            file.point_data("gap", at, gap[at : at + slab])
            file.point_data("displacement", at, moved[at : at + slab])
    assert [p.name for p in tmp_path.iterdir()] == ["solution.vtu"]
    assert b'type="Int32" Name="connectivity"' in path.read_bytes()
    found = meshio.read(path)
    assert [block.type for block in found.cells] == [MESHIO.get(k, k) for k in CELL_TYPES]
    for number, (block, (points, cells)) in enumerate(
        zip(found.cells, parts.values(), strict=True)
    ):
        np.testing.assert_array_equal(block.data, cells + first[number])
        here = found.points[first[number] : first[number + 1]]
        np.testing.assert_array_equal(here[:, : points.shape[1]], points)
    np.testing.assert_array_equal(found.point_data["gap"], gap)
    np.testing.assert_array_equal(found.point_data["displacement"], moved)
    full = np.concatenate(found.cell_data["stress"])
    np.testing.assert_array_equal(full[:, [0, 4, 8, 1, 5, 2]], stress)
    np.testing.assert_array_equal(full[:, [3, 7, 6]], full[:, [1, 5, 2]])


def test_a_full_disk_leaves_no_file_and_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int, size: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(disk, "reserve", full)
    with (
        pytest.raises(CouldNotRunError, match=r"solution\.vtu needs"),
        VTUWriter(tmp_path / "solution.vtu", [("triangle", 1)], 3, {}, {}),
    ):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_both_files_hold_the_same(cell: str, degree: int, tmp_path: Path) -> None:
    made = scenes.wall(cell, 2)
    made["bodies"][0]["degree"] = degree
    made["output"] = {"vtu": True}
    made["symmetry"] = "allow"
    assert run(scenes.read(scenes.write(made, tmp_path / "s.yaml")), tmp_path / "out") == 0
    stored, found = (read_xdmf(tmp_path / "out"), meshio.read(tmp_path / "out" / "solution.vtu"))
    np.testing.assert_array_equal(found.points, stored.points)
    (cells,) = stored.cells.values()
    np.testing.assert_array_equal(found.cells[0].data, cells)
    assert set(found.point_data) == set(stored.point_data)
    assert set(found.cell_data) == set(stored.cell_data)
    for name, values in stored.point_data.items():
        np.testing.assert_array_equal(found.point_data[name].reshape(values.shape), values)
    for name, values in stored.cell_data.items():
        np.testing.assert_array_equal(found.cell_data[name][0].reshape(values.shape), values)


@pytest.mark.mpi
def test_ranks_write_the_same(tmp_path: Path) -> None:
    made = scenes.two_bodies("hexahedron", 2)
    made["output"] = {"vtu": True, "xdmf": False}
    made["decomposition"] = {"subdomains": 4}
    fields = []
    for ranks in (1, 2):
        summary_of(made, tmp_path, ranks)
        out = tmp_path / f"out{ranks}"
        assert not (out / "solution.xdmf").exists()
        found = meshio.read(out / "solution.vtu")
        order = np.lexsort(np.round(found.points, 9).T)
        assert len(found.cells[0].data) == 9
        fields.append({name: v[order] for name, v in found.point_data.items()})
    assert set(fields[0]) >= {"displacement", "nodal_stress", "contact_pressure"}
    for name, values in fields[0].items():
        size = np.nanmax(np.abs(values), initial=1e-3)
        np.testing.assert_allclose(fields[1][name], values, atol=1e-8 * size, rtol=1e-8)
