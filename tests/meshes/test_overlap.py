"""Meshes whose cells overlap are refused with cell numbers; meshes that merely touch are not."""

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from meshes import CellMesh, MeshError
from meshes.cell_shape import folded_inside, warped
from meshes.crossing import (
    Boxes,
    ClosedSurface,
    meeting_each_other,
    points_in_boxes,
    triangle_crossings,
    winding,
)
from meshes.quadratic import VERTICES
from meshes.read import read_file
from meshes.repair import REVERSED, load_mesh
from meshes.unstructured import Topology
from tests import meshfiles

CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
PLANE = CELLS[:2]
SOLID = CELLS[2:]
SAMPLES = sorted((Path(__file__).parents[2] / "meshes" / "samples").rglob("*.msh"))


def loaded(mesh: meshio.Mesh, cell: str, folder: Path, degree: int = 1) -> CellMesh:
    path = meshfiles.write(mesh, folder / "a.vtu", None)
    return load_mesh(path, meshfiles.dimension(cell), degree=degree)


def refused(mesh: meshio.Mesh, cell: str, folder: Path, degree: int = 1) -> str:
    with pytest.raises(MeshError) as caught:
        loaded(mesh, cell, folder, degree)
    return str(caught.value)


# --- neighbours on one side of their facet -----------------------------------------------------


@pytest.mark.parametrize("cell", CELLS)
def test_a_node_pulled_through_its_cells(cell: str, tmp_path: Path) -> None:
    mesh = meshfiles.tangled(cell, 3)
    message = refused(mesh, cell, tmp_path)
    assert ("folded" if cell in ("quadrilateral", "hexahedron") else "same side") in message


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("tangled_square", "has 2 triangles that overlap their neighbours.* cell 37 of the file"),
        ("tangled_cube", "has 6 tetrahedrons that overlap their neighbours.* cell 10 of the file"),
        ("triangle_on_square", "has 1 triangles that overlap their neighbours.* cell 129 of the"),
    ],
)
def test_files_that_were_turned_and_solved(name: str, message: str) -> None:
    """Blocks whose cells were turned before anyone asked what they lay on; area 1.59 of 1."""
    path = Path(__file__).parents[1] / "data" / f"{name}.vtu"
    with pytest.raises(MeshError, match=message):
        load_mesh(path, 3 if name == "tangled_cube" else 2)


def test_the_first_tangled_triangle_is_named(tmp_path: Path) -> None:
    """Four triangles about a node that is moved out of the square: one is turned by that."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1.7, 0.5, 0]])
    cells = np.array([[0, 1, 4], [3, 0, 4], [1, 2, 4], [2, 3, 4]])
    mesh = meshfiles.of_cells("triangle", points, cells)
    message = refused(mesh, "triangle", tmp_path)
    assert message.startswith("has 1 triangles that overlap their neighbours")
    assert "the first is cell 3 of the file, at (1.23333, 0.5), over cell 1 of the file" in message
    # the same cells listed the other way round, and each other one
    for rows in (slice(None), slice(None, None, 2)):
        turned = cells.copy()
        turned[rows] = turned[rows, ::-1]
        again = refused(meshfiles.of_cells("triangle", points, turned), "triangle", tmp_path)
        assert "has 1 triangles that overlap" in again
        assert "the first is cell 3 of the file" in again


@pytest.mark.parametrize("cell", SOLID)
def test_all_cells_of_a_reversed_half(cell: str, tmp_path: Path) -> None:
    """A block folded over: the upper half lies on the lower one."""
    points, cells = meshfiles.lattice(cell, (2, 2, 4))
    points[:, 2] = np.where(points[:, 2] > 0.5, 0.97 - 0.9 * points[:, 2], points[:, 2])
    message = refused(meshfiles.of_cells(cell, points, cells), cell, tmp_path)
    assert f"{cell}s that overlap their neighbours: they lie on the same side of a face" in message


def test_a_band_with_one_side(tmp_path: Path) -> None:
    """A Möbius strip of triangles, pressed flat."""
    n = 12
    angle = 2.0 * np.pi * np.arange(n) / n
    wide = 1.0 + 0.3 * np.array([-1.0, 1.0])[:, None] * np.cos(0.5 * angle + 0.1)
    points = np.zeros((2 * n, 3))
    points[:, 0] = (wide * np.cos(angle)).T.ravel()
    points[:, 1] = (wide * np.sin(angle)).T.ravel()
    cells = []
    for k in range(n):
        a, b = 2 * k, 2 * k + 1
        c, d = (2 * k + 2, 2 * k + 3) if k + 1 < n else (1, 0)
        cells += [[a, b, c], [b, d, c]]
    message = refused(meshfiles.of_cells("triangle", points, np.array(cells)), "triangle", tmp_path)
    assert "same side of an edge" in message
    assert "Möbius" in message


def test_a_facet_of_three_cells_is_named(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0.2, 0.5, 0]], float)
    cells = np.array([[0, 1, 2], [0, 3, 1], [0, 1, 4]])
    message = refused(meshfiles.of_cells("triangle", points, cells), "triangle", tmp_path)
    assert "its cells overlap" in message
    assert "the cells 1, 2, 3 of the file" in message


@pytest.mark.parametrize("cell", CELLS)
def test_any_order_of_nodes_is_turned(cell: str, tmp_path: Path) -> None:
    """A repaired mesh stays repaired: half of the cells are listed the other way round."""
    mesh = meshfiles.block(cell, 4)
    cells = mesh.cells[0].data
    half = np.random.default_rng(5).permutation(len(cells))[: len(cells) // 2]
    cells[half] = cells[half][:, list(REVERSED[cell])]
    read = loaded(meshfiles.of_cells(cell, mesh.points, cells), cell, tmp_path)
    assert any("were inside out" in note for note in read.notes)


def test_a_hexahedron_folded_inside(tmp_path: Path) -> None:
    """Its Jacobian is 0.08 or more at every corner, and negative between them."""
    points = np.array(
        [[0.54, 0, 0], [1.54, -0.54, 0.54], [1.54, 1, -0.54], [0, 0.46, 0.54],
         [-0.54, 0.54, 1], [1, 0, 1.54], [0.46, 1.54, 1], [0.54, 1.54, 0.46]]
    )  # fmt: skip
    mesh = meshfiles.of_cells("hexahedron", points, np.arange(8)[None])
    message = refused(mesh, "hexahedron", tmp_path)
    assert "has 1 hexahedrons folded inside: their Jacobian is positive at their corners" in message


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_warped_hexahedra_are_looked_at_inside(seed: int) -> None:
    """Cells that are not sampled have a positive Jacobian everywhere."""
    random = np.random.default_rng(seed)
    cube = meshfiles.lattice("hexahedron", (1, 1, 1))
    points = cube[0][None] + random.uniform(0.0, 0.5) * random.uniform(-1, 1, (200, 8, 3))
    cells = (8 * np.arange(200)[:, None] + cube[1]).astype(np.int64)
    places = points.reshape(-1, 3)
    folded = folded_inside(places, cells, "hexahedron", 1)
    assert not (folded & ~warped(places, cells)).any()


# --- the surface crosses itself ----------------------------------------------------------------


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("turns", [1.3, 2.4])
def test_a_spiral_wider_than_its_pitch(cell: str, turns: float, tmp_path: Path) -> None:
    message = refused(meshfiles.spiral(cell, turns, 0.4, 0.25), cell, tmp_path)
    assert (
        "on the surface of the body cross those of others" in message or "in other cells" in message
    )
    narrow = meshfiles.spiral(cell, turns, 0.2, 0.25)
    assert loaded(narrow, cell, tmp_path).total_cells == len(narrow.cells[0].data)


@pytest.mark.parametrize("cell", SOLID)
def test_a_helix_higher_than_its_pitch(cell: str, tmp_path: Path) -> None:
    """The boundaries cross in nothing but the end faces; cells lie within others."""
    message = refused(meshfiles.spiral(cell, 2.2, 0.4, 0.0, 0.3), cell, tmp_path)
    assert "of the file" in message
    loaded(meshfiles.spiral(cell, 2.2, 0.28, 0.0, 0.3), cell, tmp_path)


@pytest.mark.parametrize("cell", CELLS)
def test_a_path_that_crosses_itself(cell: str, tmp_path: Path) -> None:
    message = refused(meshfiles.loop(cell, far=False), cell, tmp_path)
    assert "on the surface of the body cross those of others" in message
    if cell in SOLID:
        loaded(meshfiles.loop(cell, far=True), cell, tmp_path)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("beyond", [0.3, 1e-2, 0.0, -1e-4])
def test_a_ring_closed_over_itself(cell: str, beyond: float, tmp_path: Path) -> None:
    """Its end overlaps its start by a part of a cell, closes the ring, or leaves a slit."""
    mesh = meshfiles.spiral(cell, 1.0 + beyond / 24, 0.3, 0.0)
    if beyond <= 0.0:
        assert loaded(mesh, cell, tmp_path).total_cells == len(mesh.cells[0].data)
        return
    message = refused(mesh, cell, tmp_path)
    assert "in other cells" in message or "cross those of others" in message or "hanging" in message


def test_the_cells_that_cross_are_named(tmp_path: Path) -> None:
    """A bent strip of five cells whose end lies across its start."""
    corners = np.array([[0, 0], [4, 0], [4, 3], [1, 3], [1.3, -1]], float)
    wide = np.array([[0, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [-0.5, 0.0]])
    points = np.pad(np.concatenate([corners + wide, corners - wide]), ((0, 0), (0, 1)))
    cells = np.array([[k, k + 1, k + 6, k + 5] for k in range(4)])
    mesh = meshfiles.of_cells("quadrilateral", points, cells)
    message = refused(mesh, "quadrilateral", tmp_path)
    assert "has 2 quadrilaterals whose edges on the surface of the body cross" in message
    assert "the first is cell 1 of the file" in message
    assert "crossed by cell 4 of the file" in message
    assert "bodies of their own" in message


# --- cells within others -----------------------------------------------------------------------


def test_two_sheets_about_a_slit(tmp_path: Path) -> None:
    """No facets cross and all cells are oriented alike: only the winding number sees it."""
    mesh = meshfiles.two_sheets()
    x = mesh.points[mesh.cells[0].data][:, :, :2]
    a, b = x[:, 2] - x[:, 0], x[:, 3] - x[:, 1]
    assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0.0).all()
    message = refused(mesh, "quadrilateral", tmp_path)
    assert "quadrilaterals that lie in other cells" in message
    triangles = mesh.cells[0].data[:, [(0, 1, 2), (0, 2, 3)]].reshape(-1, 3)
    message = refused(meshfiles.of_cells("triangle", mesh.points, triangles), "triangle", tmp_path)
    assert "triangles that lie in other cells" in message


def test_two_sheets_in_a_ring(tmp_path: Path) -> None:
    """Turned about an axis, the sheets bound two tubes that are nowhere near one another."""
    flat, count = meshfiles.two_sheets(), 40
    n, angle = len(flat.points), 2.0 * np.pi * np.arange(count) / count
    radius, height = flat.points[:, 0] + 4.0, flat.points[:, 1]
    points = [np.stack([radius * np.cos(a), radius * np.sin(a), height], axis=1) for a in angle]
    sheets = [flat.cells[0].data + k * n for k in range(count)]
    cells = np.concatenate([np.hstack([sheets[k - 1], sheets[k]]) for k in range(count)])
    cells = cells[:, meshfiles.TETRAHEDRA].reshape(-1, 4)
    mesh = meshfiles.of_cells("tetrahedron", np.concatenate(points), cells)
    message = refused(mesh, "tetrahedron", tmp_path)
    assert "tetrahedrons that lie in other cells" in message
    assert int(message.split()[1]) > 16 * count  # not only those behind one facet


# --- curved edges ------------------------------------------------------------------------------


def bulging(
    cell: str, name: str, gap: float, left: float, right: float, slide: float = 0.0
) -> meshio.Mesh:
    """Two prongs; nodes amid the edges of either side of the gap moved to the right.

    The nodes of the right prong are moved upwards by `slide`, so that they face edges.
    """

    def shape(x: np.ndarray) -> np.ndarray:
        y = x.copy()
        amid = np.sin(np.pi * x[:, 1]) ** 2 + np.sin(2.0 * np.pi * x[:, 2]) ** 2
        amid = np.minimum(amid, 1.0) * (x[:, 1] > 1.01)
        y[:, 0] += left * amid * (np.abs(x[:, 0] - 1.0) < 1e-9)
        y[:, 0] += right * amid * (np.abs(x[:, 0] - 1.0 - gap) < 1e-9)
        y[:, 1] += slide * (x[:, 0] > 1.0 + 0.5 * gap) * (x[:, 1] - 1.0) * (x[:, 1] > 1.0)
        return y

    return meshfiles.second_order(meshfiles.pitchfork(cell, gap, high=4), cell, name, shape)


@pytest.mark.parametrize("cell", CELLS)
def test_curved_edges_across_a_gap(cell: str, tmp_path: Path) -> None:
    """A gap of 0.1: edges bulge by 0.2 into the other prong; with straight edges they do not."""
    name = meshfiles.SECOND[cell][-1]
    mesh = bulging(cell, name, 0.1, 0.2, 0.0)
    message = refused(mesh, cell, tmp_path, degree=2)
    assert "cross those of others" in message
    assert loaded(mesh, cell, tmp_path, degree=1).middles is None


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize(
    ("gap", "left", "right", "slide"),
    [(0.1, 0.07, 0.0, 0.0), (0.1, 0.2, 0.2, 0.0), (1e-3, 0.15, 0.15, 0.0), (0.03, -0.2, 0.0, 0.1)],
)
def test_curved_gaps_are_fine(
    cell: str, gap: float, left: float, right: float, slide: float, tmp_path: Path
) -> None:
    """Bulges that are less than the gap, or on both sides of it, however narrow it is."""
    mesh = bulging(cell, meshfiles.SECOND[cell][-1], gap, left, right, slide)
    assert loaded(mesh, cell, tmp_path, degree=2).middles is not None


def test_the_middle_of_a_patch_may_lie_across_a_gap(tmp_path: Path) -> None:
    """Edges that bulge by 0.08: the middle of a quadratic triangle does by 4/3 of that, 0.107."""
    mesh = bulging("tetrahedron", "tetra10", 0.1, 0.08, 0.0)
    message = refused(mesh, "tetrahedron", tmp_path, degree=2)
    assert "cross those of others" in message or "in other cells" in message


@pytest.mark.parametrize("cell", CELLS)
def test_a_spiral_of_curved_cells(cell: str, tmp_path: Path) -> None:
    """Six cells a turn: their chords are far from the arcs, the arcs are not from one another."""
    points, cells = meshfiles.lattice(cell, (12, 1, 1))

    def wound(width: float) -> meshio.Mesh:
        def shape(x: np.ndarray) -> np.ndarray:
            angle, radius = 4.0 * np.pi * x[:, 0], 1.0 + 0.5 * x[:, 0] + width * x[:, 1]
            return np.column_stack([radius * np.cos(angle), radius * np.sin(angle),
                                    0.2 * x[:, 2]])  # fmt: skip

        flat = meshfiles.of_cells(cell, points, cells)
        return meshfiles.second_order(flat, cell, meshfiles.SECOND[cell][-1], shape)

    assert loaded(wound(0.22), cell, tmp_path, degree=2).middles is not None
    message = refused(wound(0.3), cell, tmp_path, degree=2)
    assert "cross those of others" in message or "in other cells" in message


# --- what is legal -----------------------------------------------------------------------------


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("gap", [0.3, 1e-3, 2e-4])
def test_combs_with_narrow_gaps(cell: str, gap: float, tmp_path: Path) -> None:
    mesh = meshfiles.pitchfork(cell, gap, prongs=5)
    assert loaded(mesh, cell, tmp_path).total_cells == len(mesh.cells[0].data)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("thin", [1e-1, 1e-3])
def test_thin_walls_that_face_each_other(cell: str, thin: float, tmp_path: Path) -> None:
    """Prongs of 1e-3 of their length, as far from one another."""
    mesh = meshfiles.pitchfork(cell, 1.0, prongs=3)
    mesh.points[:, 0] *= thin
    assert loaded(mesh, cell, tmp_path).total_cells == len(mesh.cells[0].data)
    mesh.points[mesh.points[:, 1] > 2.5, 0] *= -1.0  # the ends cross over: inside out
    assert "same side" in refused(mesh, cell, tmp_path) or "folded" in refused(mesh, cell, tmp_path)


@pytest.mark.parametrize("cell", CELLS)
def test_graded_meshes(cell: str, tmp_path: Path) -> None:
    """Cells of 1 beside cells of 1e-3, towards a corner, and wound up."""
    points, cells = meshfiles.lattice(cell, (12,) * 3)
    d = meshfiles.dimension(cell)
    points[:, :d] = (1e3 ** points[:, :d] - 1.0) / 999.0
    graded = meshfiles.of_cells(cell, points, cells)
    assert loaded(graded, cell, tmp_path).total_cells == len(cells)
    angle, radius = 6.0 * points[:, 0], 1.0 + points[:, 1]
    bent = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), points[:, 2]])
    assert loaded(meshfiles.of_cells(cell, bent, cells), cell, tmp_path).total_cells == len(cells)
    bent[:, 0] *= np.where(angle > 5.5, 1.2, 1.0)
    bent[:, :2] = (radius * np.array([np.cos(1.2 * angle), np.sin(1.2 * angle)])).T
    message = refused(meshfiles.of_cells(cell, bent, cells), cell, tmp_path)
    assert "of the file" in message or "hanging" in message


@pytest.mark.parametrize("path", SAMPLES, ids=lambda p: "-".join(p.parts[-2:]))
@pytest.mark.parametrize("degree", [1, 2])
def test_samples_are_accepted(path: Path, degree: int) -> None:
    for dimension in (3, 2):
        try:
            groups = list(read_file(path, dimension).cell_groups)
        except MeshError:
            continue
        for group in groups:
            assert load_mesh(path, dimension, groups=[group], degree=degree).total_cells > 0
        return
    pytest.fail("no cells")


def smooth(seed: int, d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Waves of a displacement whose gradient is 0.3 at most, after a rotation and a stretch."""
    random = np.random.default_rng(seed)
    waves = random.integers(-2, 3, (4, d)) * np.pi
    heights = random.normal(size=(4, d))
    slope = np.linalg.norm(heights, axis=1) @ np.linalg.norm(waves, axis=1)
    frame = np.linalg.qr(random.normal(size=(d, d)))[0] * random.uniform(0.05, 1.0, d)
    return waves, heights * 0.3 / max(slope, 1e-9), frame


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), cell=st.sampled_from(CELLS), degree=st.sampled_from([1, 2]))
def test_smooth_invertible_maps_are_accepted(
    seed: int, cell: str, degree: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    d = meshfiles.dimension(cell)
    points, cells = meshfiles.lattice(cell, (4,) * d)
    waves, heights, frame = smooth(seed, d)

    def shape(x: np.ndarray) -> np.ndarray:
        y = x.copy()
        y[:, :d] = (x[:, :d] + np.sin(x[:, :d] @ waves.T + seed) @ heights) @ frame.T
        return y

    mesh = meshfiles.of_cells(cell, points, cells)
    if degree == 2:
        mesh = meshfiles.second_order(mesh, cell, meshfiles.SECOND[cell][-1], shape)
    else:
        mesh.points = shape(mesh.points)
    folder = tmp_path_factory.mktemp("maps")
    assert loaded(mesh, cell, folder, degree).total_cells == len(cells)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), cell=st.sampled_from(CELLS))
def test_overlapping_meshes_are_refused(
    seed: int, cell: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    mesh = meshfiles.overlapping(cell, seed)
    assert refused(mesh, cell, tmp_path_factory.mktemp("overlaps"))


# --- the parts of the test ---------------------------------------------------------------------


def boxes_of_all_sizes(count: int, dimension: int) -> Boxes:
    """Boxes whose sides have lengths over three powers of ten."""
    random = np.random.default_rng(count)
    lower = random.uniform(size=(count, dimension))
    return Boxes(lower, lower + 10.0 ** random.uniform(-3.0, 0.0, lower.shape))


@pytest.mark.parametrize(("dimension", "flat"), [(1, None), (2, None), (3, None), (3, 0), (3, 2)])
def test_points_are_found_in_boxes_of_all_sizes(dimension: int, flat: int | None) -> None:
    """Points in space, at corners of boxes and at one place, and in a plane across an axis."""
    boxes = boxes_of_all_sizes(300, dimension)
    x = np.random.default_rng(5).uniform(-0.2, 1.2, (500, dimension))
    x[:50] = boxes.lower[:50]
    x[50:60] = x[60]
    if flat is not None:
        x[:, flat] = 0.7
    within = (x[:, None] >= boxes.lower).all(axis=2) & (x[:, None] <= boxes.upper).all(axis=2)
    pairs = np.concatenate([np.stack(pair, axis=1) for pair in points_in_boxes(x, boxes)])
    assert within.sum() > 50
    np.testing.assert_array_equal(pairs[np.lexsort(pairs.T[::-1])], np.argwhere(within))


@dataclass(frozen=True)
class Part:
    """Stands for one of several ranks."""

    rank: int
    size: int


@pytest.mark.parametrize("ranks", [1, 3, 400])
def test_boxes_of_all_sizes_meet_as_they_do_pair_by_pair(ranks: int) -> None:
    boxes = boxes_of_all_sizes(300, 3)
    found = [np.stack(pair, axis=1) for rank in range(ranks)
             for pair in meeting_each_other(boxes, Part(rank, ranks))]  # fmt: skip
    pairs = np.sort(np.concatenate(found), axis=1)
    touch = (boxes.lower[:, None] <= boxes.upper).all(axis=2)
    touch = np.triu(touch & touch.T, 1)
    assert touch.sum() > 100
    np.testing.assert_array_equal(pairs[np.lexsort(pairs.T[::-1])], np.argwhere(touch))


def test_triangles_cross_where_distances_change_sign() -> None:
    """All pairs of random triangles: one crosses another if points of it are on its two sides."""
    random = np.random.default_rng(6)
    places = np.repeat(random.uniform(size=(90, 1, 3)), 3, axis=1)
    places = (places + 0.2 * random.normal(size=(90, 3, 3))).reshape(-1, 3)
    triangles = np.arange(270).reshape(-1, 3)
    none = np.zeros(90)
    surface = ClosedSurface(places, triangles, none, none)
    pairs, doubtful = triangle_crossings(surface, MPI.COMM_SELF)
    assert doubtful[pairs].all()
    got = {tuple(sorted(pair)) for pair in pairs.tolist()}
    x = places[triangles]
    wanted = set()
    for i in range(90):
        for j in range(i):
            for a, b in ((x[i], x[j]), (x[j], x[i])):
                for k in range(3):  # solve p + s (q - p) = b₀ + t u + r v
                    p, q = a[k], a[(k + 1) % 3]
                    s, t, r = np.linalg.solve(np.stack([p - q, b[1] - b[0], b[2] - b[0]], 1),
                                              p - b[0])  # fmt: skip
                    if 0 < s < 1 and t > 0 and r > 0 and t + r < 1:
                        wanted.add((j, i))
    assert len(wanted) > 50
    assert got == wanted


@pytest.mark.parametrize("slit", [0.0, 1e-5, 0.1])
def test_facets_are_in_doubt_where_they_may_touch(slit: float) -> None:
    """Two blocks: beside a narrow slit the facets of both sides are in doubt, no others are."""
    points, cells = meshfiles.lattice("tetrahedron", (3, 3, 3))
    facets = Topology.of(cells, "tetrahedron").facets
    places = np.concatenate([points, points + [1.0 + slit, 0.0, 0.0]])
    triangles = np.concatenate([facets, facets + len(points)])
    touch, exact = np.full(len(triangles), 1e-4), np.zeros(len(triangles))
    _, doubtful = triangle_crossings(ClosedSurface(places, triangles, touch, exact), MPI.COMM_SELF)
    away = np.abs(places[triangles][:, :, 0] - 1.0 - 0.5 * slit)
    beside = (away <= slit).all(axis=1)
    if slit < 0.1:
        assert doubtful[beside].all()
        assert doubtful.sum() > beside.sum()  # the others that meet the edges of the slit
        assert not doubtful[(away > 0.1).all(axis=1)].any()
    else:
        assert not doubtful.any()


def test_facets_about_a_node_of_two_blocks_are_in_doubt() -> None:
    points, cells = meshfiles.lattice("tetrahedron", (3, 3, 3))
    facets = Topology.of(cells, "tetrahedron").facets
    first, last = np.argmax(points.sum(axis=1)), np.argmin(points.sum(axis=1))
    places = np.concatenate([points, points + 1.0])
    other = facets + len(points)
    other[other == last + len(points)] = first
    triangles = np.concatenate([facets, other])
    none = np.zeros(len(triangles))
    _, doubtful = triangle_crossings(ClosedSurface(places, triangles, none, none), MPI.COMM_SELF)
    np.testing.assert_array_equal(doubtful, (triangles == first).any(axis=1))


@pytest.mark.parametrize("cell", CELLS)
def test_winding_numbers_are_numbers_of_cells(cell: str) -> None:
    """Winding numbers of a band that covers places twice, compared with the cells that contain the
    points."""
    mesh = meshfiles.spiral(cell, 1.6, 0.4, 0.2)
    d = meshfiles.dimension(cell)
    points, cells = mesh.points[:, :d], mesh.cells[0].data
    if cell in ("quadrilateral", "hexahedron"):  # prisms over quadrilaterals with straight edges
        split = {"quadrilateral": [(0, 1, 2), (0, 2, 3)], "hexahedron": meshfiles.TETRAHEDRA}[cell]
        cells = cells[:, split].reshape(-1, d + 1)
    sign = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) > 0
    cells[~sign] = cells[~sign][:, [1, 0, *range(2, d + 1)]]
    simplex = ("triangle", "tetrahedron")[d - 2]
    facets = Topology.of(cells, simplex).facets
    none = np.zeros(len(facets))
    x = np.random.default_rng(2).uniform(-2.0, 2.0, (3000, 3))[:, :d]
    if d == 3:
        x[:, 2] = x[:, 2] * 0.2 + 0.2
    w = winding(x, ClosedSurface(points, facets, none, none))
    corner = points[cells]
    inverse = np.linalg.inv(corner[:, 1:] - corner[:, :1])
    weights = np.einsum("pci,cij->pcj", x[:, None] - corner[:, 0], inverse)
    within = (weights > 0).all(axis=2) & (weights.sum(axis=2) < 1)
    np.testing.assert_array_equal(w, within.sum(axis=1))
    assert (w == 2).sum() > 20


@pytest.mark.parametrize("cell", CELLS)
def test_points_that_lie_in_no_cell(cell: str) -> None:
    """Also where the box of a cell contains them."""
    from meshes.overlap import CheckedBody, containing

    points, cells = meshfiles.lattice(cell, (2, 2, 2))
    d = meshfiles.dimension(cell)
    turned = points[:, :d] @ np.linalg.qr(np.random.default_rng(0).normal(size=(d, d)))[0]
    body = CheckedBody(turned, cells, cell, Topology.of(cells, cell), None, np.arange(len(cells)))
    centres = turned[cells].mean(axis=1)
    row, found = containing(body, centres)
    np.testing.assert_array_equal(row, found)
    np.testing.assert_array_equal(np.unique(row), np.arange(len(cells)))
    corner = np.array([turned.min(axis=0)]) + 1e-3
    assert len(containing(body, corner)[0]) == 0


def test_vertices_come_first() -> None:
    """The reference cell of `meshes.chords` has its vertices in VTK's order."""
    from meshes.chords import reference_vertices
    from meshes.subdomains import vtk_shapes

    for cell in CELLS:
        values = vtk_shapes(cell, 1, reference_vertices(cell))[0]
        np.testing.assert_allclose(values, np.eye(VERTICES[cell]), atol=1e-12)
