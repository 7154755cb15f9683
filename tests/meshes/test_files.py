"""Mesh files: what is read from each format, what is repaired and reported, what is refused."""

from pathlib import Path

import meshio
import numpy as np
import pytest
from mpi4py import MPI

from meshes import CellMesh, MeshError, decompose
from meshes.refine import refined
from meshes.repair import Placement, load_mesh
from tests import meshfiles
from tests.meshes.test_decompose import volume

CELLS = tuple(meshfiles.MESHIO)
N = {"triangle": 32, "quadrilateral": 16, "tetrahedron": 384, "hexahedron": 64}

# file name, meshio's format, options, whether groups of cells and of facets survive in it
FORMATS = {
    "gmsh 2.2": ("a.msh", "gmsh22", {"binary": False}),
    "gmsh 2.2 binary": ("a.msh", "gmsh22", {"binary": True}),
    "gmsh 4.1": ("a.msh", "gmsh", {"binary": False}),
    "gmsh 4.1 binary": ("a.msh", "gmsh", {"binary": True}),
    "vtu": ("a.vtu", None, {}),
    "vtk": ("a.vtk", None, {}),
    "xdmf": ("a.xdmf", None, {}),
}


def loaded(mesh: meshio.Mesh, directory: Path, cell: str, **options: object) -> CellMesh:
    path = meshfiles.write(mesh, directory / "part.msh")
    return load_mesh(path, meshfiles.dimension(cell), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("form", FORMATS)
def test_every_format_gives_the_same_mesh(cell: str, form: str, tmp_path: Path) -> None:
    name, file_format, options = FORMATS[form]
    d = meshfiles.dimension(cell)
    given = meshfiles.block(cell, 4)
    if file_format is None:  # formats without names: groups go by their numbers
        given.field_data = {}
        given.cell_data.pop("gmsh:geometrical")
    mesh = load_mesh(meshfiles.write(given, tmp_path / name, file_format, **options), d)
    assert (mesh.cell, mesh.dimension) == (cell, d)
    assert mesh.total_cells == N[cell]
    assert mesh.nodes == 5**d
    np.testing.assert_allclose(mesh.lower, 0.0, atol=1e-15)
    np.testing.assert_allclose(mesh.upper, 1.0)
    assert total_volume(mesh) == pytest.approx(1.0)
    soft, hard = ("soft", "hard") if file_format else ("1", "2")
    assert len(mesh.groups[soft]) == len(mesh.groups[hard]) == N[cell] // 2
    assert (mesh.points[mesh.cells[mesh.groups[soft]]][..., 0] < 0.5 + 1e-9).all()
    on_top = meshfiles_side(mesh, ("z+" if d == 3 else "y+") if file_format else str(10 + 2 * d))
    np.testing.assert_allclose(on_top[..., d - 1], 1.0)
    assert len(mesh.sides) == 2 * d
    assert sum(len(rows) for rows in mesh.sides.values()) == len(mesh.topology.facets)
    assert mesh.notes == ()


def total_volume(mesh: CellMesh) -> float:
    """By simplices from the first node of each cell through its facets (divergence theorem)."""
    x = mesh.points
    facets = x[mesh.topology.facets]
    inner = x[mesh.cells[mesh.topology.facet_cells]].mean(axis=1)
    if mesh.dimension == 2:
        edge = facets[:, 1] - facets[:, 0]
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        first = facets.mean(axis=1)
    else:
        parts = [facets[:, [0, i, i + 1]] for i in range(1, facets.shape[1] - 1)]
        facets = np.concatenate(parts)
        inner = np.concatenate([inner] * len(parts))
        normal = 0.5 * np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
        first = facets.mean(axis=1)
    outward = np.sign(np.einsum("ni,ni->n", normal, first - inner))
    return float(np.einsum("n,ni,ni->", outward, normal, first) / mesh.dimension)


def meshfiles_side(mesh: CellMesh, name: str) -> np.ndarray:
    """Corners of the facets of a group."""
    return mesh.points[mesh.topology.facets[mesh.sides[name]]]


@pytest.mark.parametrize(
    ("name", "options"), [("a.inp", {}), ("a.med", {}), ("a.mesh", {}), ("a.bdf", {})]
)
def test_other_formats_are_read(name: str, options: dict, tmp_path: Path) -> None:
    given = meshfiles.block("tetrahedron", 2)
    mesh = meshio.Mesh(given.points, given.cells[:1])
    if name == "a.inp":
        mesh.cell_sets = {"SOFT": [np.arange(10)]}
        mesh.point_sets = {"FOOT": np.flatnonzero(given.points[:, 2] < 1e-12)}
    read = load_mesh(meshfiles.write(mesh, tmp_path / name, None, **options), 3)
    assert read.total_cells == 48
    assert total_volume(read) == pytest.approx(1.0, rel=1e-5)
    if name == "a.inp":
        np.testing.assert_array_equal(read.groups["SOFT"], np.arange(10))
        np.testing.assert_allclose(meshfiles_side(read, "FOOT")[..., 2], 0.0)
        assert len(read.sides["FOOT"]) == 8


@pytest.mark.parametrize(("name", "key"), [("a.bdf", "nastran:ref"), ("a.vtk", "CellEntityIds")])
def test_numbers_of_cells_name_their_groups(name: str, key: str, tmp_path: Path) -> None:
    """Property numbers of Nastran and entities of Gmsh's VTK files: a file holds several bodies."""
    given = meshfiles.block("tetrahedron", 2)
    numbers = [np.repeat([3, 7], 24), np.full(len(given.cells[1].data), 5)]
    mesh = meshio.Mesh(given.points, given.cells[:2], cell_data={key: numbers})
    read = load_mesh(meshfiles.write(mesh, tmp_path / name, None), 3)
    np.testing.assert_array_equal(read.groups["7"], np.arange(24, 48))
    assert len(read.sides["5"]) > 0


def test_groups_of_med_have_their_names(tmp_path: Path) -> None:
    """MED gives each cell and node one family, which belongs to several groups."""
    given = meshfiles.block("tetrahedron", 2)
    numbers = [-np.asarray(tags) for tags in given.cell_data["gmsh:physical"]]
    foot = np.where(given.points[:, 2] < 1e-12, 5, 0)
    mesh = meshio.Mesh(given.points, given.cells, {"point_tags": foot}, {"cell_tags": numbers})
    mesh.cell_tags = {-1: ["soft", "all"], -2: ["hard", "all"], -11: ["left"]}
    mesh.point_tags = {5: ["foot"]}
    read = load_mesh(meshfiles.write(mesh, tmp_path / "a.med", None), 3)
    assert set(read.groups) == {"soft", "hard", "all"}
    assert len(read.groups["soft"]) + len(read.groups["hard"]) == len(read.groups["all"]) == 48
    np.testing.assert_allclose(meshfiles_side(read, "left")[..., 0], 0.0)
    np.testing.assert_allclose(meshfiles_side(read, "foot")[..., 2], 0.0)


@pytest.mark.parametrize("parts", [1, 2, 3, 7])
@pytest.mark.parametrize("cell", CELLS)
def test_any_number_of_subdomains_covers_it_once(cell: str, parts: int, tmp_path: Path) -> None:
    mesh = loaded(meshfiles.block(cell, 4), tmp_path, cell).tagged(("soft", "hard"))
    partition = decompose([mesh], parts, MPI.COMM_SELF)
    assert partition.count >= parts
    assert sum(len(s.reference.cells) for s in partition.subdomains) == mesh.total_cells
    exterior = 0
    for s in partition.subdomains:
        np.testing.assert_allclose(s.points()[:, : mesh.dimension], mesh.points[s.nodes])
        exterior += len(s.exterior)
        left = s.points()[s.reference.cells][..., 0].mean(axis=1) < 0.5
        np.testing.assert_array_equal(s.reference.tags, np.where(left, 0, 1))
        for name, rows in s.boundaries.items():
            x = s.points()[s.reference.facets[rows]][..., "xyz".index(name[0])]
            np.testing.assert_allclose(x, "-+".index(name[1]), atol=1e-12)
    assert exterior == len(mesh.topology.facets)
    if cell in ("triangle", "tetrahedron"):
        found = sum(volume(s.points(), s.reference.cells, cell) for s in partition.subdomains)
        assert found == pytest.approx(1.0)


def test_repeated_parts_share_one_reference(tmp_path: Path) -> None:
    """The same piece twice, apart from each other and of one material: one factor."""
    given = meshfiles.block("tetrahedron", 2)
    bodies = [
        load_mesh(
            meshfiles.write(given, tmp_path / "a.msh"), 3, Placement(0.7, translation=(x, 0.1, 0))
        )
        for x in (0.0, 1000.7)
    ]
    partition = decompose(bodies, None, MPI.COMM_SELF)
    assert len({id(s.reference) for s in partition.subdomains}) == 1
    other = [bodies[0].tagged(("soft", "hard")), bodies[1].tagged(("hard", "soft"))]
    partition = decompose(other, None, MPI.COMM_SELF)
    assert len({id(s.reference) for s in partition.subdomains}) == 2


def test_placement_scales_then_turns_then_moves(tmp_path: Path) -> None:
    path = meshfiles.write(meshfiles.block("hexahedron", 2), tmp_path / "a.msh")
    placed = Placement(scale=2.0, axis=(0, 0, 3), angle=90.0, translation=(10, 0, -1))
    mesh = load_mesh(path, 3, placed)
    np.testing.assert_allclose(mesh.lower, [8, 0, -1], atol=1e-14)
    np.testing.assert_allclose(mesh.upper, [10, 2, 1], atol=1e-14)
    np.testing.assert_allclose(meshfiles_side(mesh, "x+")[..., 1], 2.0)


@pytest.mark.parametrize(
    ("cell", "name"),
    [("triangle", "triangle6"), ("quadrilateral", "quad9"), ("tetrahedron", "tetra10"),
     ("hexahedron", "hexahedron20")],
)  # fmt: skip
def test_second_order_cells_keep_their_corners(cell: str, name: str, tmp_path: Path) -> None:
    """Midside nodes (here all one far point) are not used by degree 1, and it is said."""
    given = meshfiles.block(cell, 2)
    corners = given.cells[0].data
    count = {"triangle6": 3, "quad9": 5, "tetra10": 6, "hexahedron20": 12}[name]
    middle = np.full((len(corners), count), len(given.points))
    mesh = meshio.Mesh(
        np.vstack([given.points, [[9.0, 9.0, 0.0]]]),
        [meshio.CellBlock(name, np.column_stack([corners, middle]))],
    )
    path = meshfiles.write(mesh, tmp_path / "a.vtu", None)
    read = load_mesh(path, meshfiles.dimension(cell))
    assert total_volume(read) == pytest.approx(1.0)
    assert any("edges are straight" in note for note in read.notes)
    with pytest.raises(MeshError, match=r"folded by their curved edges.*the first is cell 1 of"):
        load_mesh(path, meshfiles.dimension(cell), degree=2)


@pytest.mark.parametrize("cell", CELLS)
def test_refinement_halves_every_edge(cell: str, tmp_path: Path) -> None:
    d = meshfiles.dimension(cell)
    given = loaded(meshfiles.block(cell, 2), tmp_path, cell).tagged(("soft", "hard"))
    mesh = refined(refined(given))
    assert mesh.nodes == 9**d
    assert mesh.total_cells == given.total_cells * 4**d
    assert total_volume(mesh) == pytest.approx(1.0)
    if cell in ("triangle", "tetrahedron"):
        axes = mesh.points[mesh.cells[:, 1:]] - mesh.points[mesh.cells[:, :1]]
        volumes = np.linalg.det(axes) / (2.0 if d == 2 else 6.0)
        assert volumes.min() > 0.0
        assert volumes.sum() == pytest.approx(1.0)
        parents = np.linalg.det(
            given.points[given.cells[:, 1:]] - given.points[given.cells[:, :1]]
        ) / (2.0 if d == 2 else 6.0)
        np.testing.assert_allclose(volumes, np.repeat(parents, 4**d) / 4**d)
    assert np.unique(mesh.cells).size == mesh.nodes
    assert not mesh.topology.crowded
    for name, rows in mesh.sides.items():
        assert len(rows) == len(given.sides[name]) * 4 ** (d - 1)
        x = meshfiles_side(mesh, name)[..., "xyz".index(name[0])]
        np.testing.assert_allclose(x, "-+".index(name[1]), atol=1e-12)
    assert sum(map(len, mesh.sides.values())) == len(mesh.topology.facets)
    left = mesh.points[mesh.cells][..., 0].mean(axis=1) < 0.5
    np.testing.assert_array_equal(mesh.tags, np.where(left, 0, 1))
    np.testing.assert_array_equal(mesh.groups["soft"], np.flatnonzero(left))


# --- repairs -----------------------------------------------------------------------------------


def test_unused_nodes_are_dropped_and_reported(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    given.points = np.vstack([[[7.0, 7.0, 0.0]], given.points, [[9.0, 9.0, 0.0]]])
    for block in given.cells:
        block.data = block.data + 1
    mesh = loaded(given, tmp_path, "triangle")
    assert mesh.nodes == 9
    assert mesh.upper == (1.0, 1.0)
    assert mesh.notes == ("2 nodes belong to no cell: dropped",)


@pytest.mark.parametrize("cell", CELLS)
def test_duplicate_nodes_are_merged_and_reported(cell: str, tmp_path: Path) -> None:
    """Every cell with nodes of its own, as some exporters write them."""
    given = meshfiles.block(cell, 2)
    cells = given.cells[0].data
    points = given.points[cells].reshape(-1, 3)
    points += 1e-13 * np.random.default_rng(0).uniform(-1, 1, points.shape) * (points != 0)
    torn = meshio.Mesh(points, [(given.cells[0].type, np.arange(cells.size).reshape(cells.shape))])
    mesh = load_mesh(meshfiles.write(torn, tmp_path / "a.vtu", None), meshfiles.dimension(cell))
    assert mesh.nodes == len(given.points)
    assert mesh.notes == (f"{cells.size - len(given.points)} nodes lie where another one does: "
                          "merged",)  # fmt: skip
    assert total_volume(mesh) == pytest.approx(1.0)


@pytest.mark.parametrize("cell", CELLS)
def test_cells_inside_out_are_turned_and_reported(cell: str, tmp_path: Path) -> None:
    given = meshfiles.block(cell, 2)
    mirror = {"triangle": [0, 2, 1], "quadrilateral": [0, 3, 2, 1], "tetrahedron": [1, 0, 2, 3],
              "hexahedron": [0, 3, 2, 1, 4, 7, 6, 5]}[cell]  # fmt: skip
    given.cells[0].data[::2] = given.cells[0].data[::2][:, mirror]
    mesh = loaded(given, tmp_path, cell)
    half = len(given.cells[0].data[::2])
    assert mesh.notes == (f"{half} cells were inside out (negative volume): turned",)
    corners = mesh.points[mesh.cells]
    last = {"triangle": 2, "quadrilateral": 3, "tetrahedron": 3, "hexahedron": 4}[cell]
    second = {"triangle": 1, "quadrilateral": 1, "tetrahedron": 2, "hexahedron": 3}[cell]
    axes = [1, second, last] if mesh.dimension == 3 else [1, last]
    assert (np.linalg.det(corners[:, axes] - corners[:, :1]) > 0).all()
    assert total_volume(mesh) == pytest.approx(1.0)


def test_a_clockwise_mesh_in_another_plane_of_z(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    given.points = given.points * [1, 1, 1] + [0, 0, 5.0]
    given.cells[0].data = given.cells[0].data[:, ::-1]
    mesh = loaded(given, tmp_path, "triangle")
    assert mesh.notes == (
        "the mesh lies at z = 5: taken to lie at z = 0",
        "8 cells were inside out (negative volume): turned",
    )


def test_cells_in_two_groups_are_written_twice_by_gmsh_2_2(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    both = meshio.Mesh(
        given.points,
        [*given.cells, given.cells[0]],
        cell_data={k: [*v, np.full(8, 7)] for k, v in given.cell_data.items()},
        field_data={**given.field_data, "all": np.array([7, 2])},
    )
    mesh = loaded(both, tmp_path, "triangle")
    assert mesh.total_cells == 8
    assert {name: len(rows) for name, rows in mesh.groups.items()} == {
        "soft": 4, "hard": 4, "all": 8,
    }  # fmt: skip
    assert mesh.notes == ()
    half = loaded(both, tmp_path, "triangle", groups=["soft"])
    assert {name: len(rows) for name, rows in half.groups.items()} == {
        "soft": 4, "hard": 0, "all": 4,
    }  # fmt: skip


def test_cells_given_twice_count_once_and_it_is_reported(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    twice = np.vstack([given.cells[0].data, given.cells[0].data[:3]])
    mesh = load_mesh(
        meshfiles.write(meshio.Mesh(given.points, [("triangle", twice)]), tmp_path / "a.vtu", None),
        2,
    )
    assert mesh.total_cells == 8
    assert mesh.notes == ("3 cells are given twice: counted once",)


def test_a_surface_and_a_volume_may_have_one_name(tmp_path: Path) -> None:
    path = meshfiles.write(meshfiles.block("triangle", 2), tmp_path / "a.msh", binary=False)
    path.write_text(path.read_text().replace('"x-"', '"soft"'))
    mesh = load_mesh(path, 2)
    assert len(mesh.groups["soft"]) == 4
    np.testing.assert_allclose(meshfiles_side(mesh, "soft")[..., 0], 0.0)


def test_facets_inside_the_body_are_left_out_and_reported(tmp_path: Path) -> None:
    given = meshfiles.block("quadrilateral", 2)
    points = given.points
    middle = np.flatnonzero(np.abs(points[:, 0] - 0.5) < 1e-12)
    middle = middle[np.argsort(points[middle, 1])]
    given.cells[1].data = np.vstack([given.cells[1].data, middle[:2], middle[1:]])
    for values in given.cell_data.values():
        values[1] = np.append(values[1], [11, 99])
    mesh = loaded(given, tmp_path, "quadrilateral")
    assert len(mesh.sides["x-"]) == 2
    assert "99" not in mesh.sides
    assert sorted(mesh.notes) == [
        "1 of 1 facets of the group '99' are not on the surface of the body: left out",
        "1 of 3 facets of the group 'x-' are not on the surface of the body: left out",
    ]


def test_one_file_may_hold_several_bodies(tmp_path: Path) -> None:
    """The halves as bodies: the facets between them are their surface."""
    path = meshfiles.write(meshfiles.block("hexahedron", 4), tmp_path / "a.msh")
    soft, hard = (load_mesh(path, 3, groups=[name]) for name in ("soft", "hard"))
    assert soft.total_cells == hard.total_cells == 32
    assert soft.upper == pytest.approx((0.5, 1, 1))
    assert "x+" not in soft.sides
    assert "x-" in soft.sides
    assert len(soft.topology.facets) == 64
    assert load_mesh(path, 3, groups=["soft", "hard"]).total_cells == 64


# --- refusals ----------------------------------------------------------------------------------


def refused(mesh: meshio.Mesh, directory: Path, cell: str, **options: object) -> str:
    with pytest.raises(MeshError) as caught:
        loaded(mesh, directory, cell, **options)
    return str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Readers print nothing where they fail."""
    cases = {
        "missing.msh": (None, "does not exist"),
        "empty.msh": ("", "is empty"),
        "words.msh": ("this is no mesh\n", "cannot be read as a mesh"),
        "cut.msh": ("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n9\n1 0 0 0\n", "cannot be read"),
        "part.xyz": ("1 2 3", "an ending no mesh format is known by; .msh"),
        "broken.vtu": ("<VTKFile", "cannot be read as a mesh"),
    }
    for name, (text, told) in cases.items():
        if text is not None:
            (tmp_path / name).write_text(text)
        with pytest.raises(MeshError, match=told):
            load_mesh(tmp_path / name, 3)
    with pytest.raises(MeshError, match="is not a file"):
        load_mesh(tmp_path, 3)
    assert capsys.readouterr() == ("", "")


def test_cells_and_groups_partly_without_a_group_in_4_1(tmp_path: Path) -> None:
    path = meshfiles.write(meshfiles.block("triangle", 2), tmp_path / "a.msh", "gmsh", binary=False)
    text = path.read_text()
    head, entities, rest = text.partition("$Entities\n")
    lines = rest.split("\n")
    lines[1] = " ".join([*lines[1].split()[:7], "0", "0"])  # the first line, of a side: no group
    path.write_text(head + entities + "\n".join(lines))
    with pytest.raises(MeshError, match="Mesh.SaveAll = 0"):
        load_mesh(path, 2)


def test_the_wrong_dimension(tmp_path: Path) -> None:
    flat = meshfiles.block("triangle", 2)
    solid = meshfiles.block("tetrahedron", 2)
    path = meshfiles.write(flat, tmp_path / "flat.msh")
    with pytest.raises(MeshError, match=r"8 triangle, 8 line, and none of dimension 3; allowed: "):
        load_mesh(path, 3)
    path = meshfiles.write(solid, tmp_path / "solid.msh")
    with pytest.raises(MeshError, match="have no place in a scene of dimension 2"):
        load_mesh(path, 2)
    flat.points[:, 2] = flat.points[:, 0]
    assert "reaches from z = 0 to 1" in refused(flat, tmp_path, "triangle")


def test_bodies_of_one_file_may_have_cells_of_their_own_type(tmp_path: Path) -> None:
    """Each is chosen by its group; a file with both was refused."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [3, 0], [2, 1]], float)
    cells = [("quad", [[0, 1, 2, 3]]), ("triangle", [[4, 5, 6]]), ("line", [[1, 0], [4, 5]])]
    mesh = meshio.Mesh(
        np.pad(points, ((0, 0), (0, 1))), cells,
        cell_data={name: [np.array([1]), np.array([2]), np.array([3, 4])]
                   for name in ("gmsh:physical", "gmsh:geometrical")},
        field_data={"a": np.array([1, 2]), "b": np.array([2, 2]), "foot": np.array([3, 1])},
    )  # fmt: skip
    path = meshfiles.write(mesh, tmp_path / "two.msh")
    square, corner = (load_mesh(path, 2, groups=[name]) for name in "ab")
    assert [total_volume(square), total_volume(corner)] == pytest.approx([1.0, 0.5])
    assert len(square.sides["foot"]) == 1
    with pytest.raises(MeshError, match="choose those of a body by `group`"):
        load_mesh(path, 2)


def test_mixed_cell_types(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    mesh = meshio.Mesh(given.points, [given.cells[0], ("quad", [[0, 1, 2, 3]])])
    told = refused(mesh, tmp_path, "triangle")
    assert "8 triangle, 1 quad; the cells of a body are of one type: triangle" in told
    points = np.vstack([np.eye(3), np.zeros((1, 3)), [[1, 1, 1], [0, 1, 1]]])
    wedge = meshio.Mesh(points, [("wedge", [[0, 1, 2, 3, 4, 5]])])
    assert "1 wedge; the cells of a body are of one type: tetra" in refused(
        wedge, tmp_path, "tetrahedron"
    )


@pytest.mark.parametrize("cell", CELLS)
def test_cells_without_volume(cell: str, tmp_path: Path) -> None:
    given = meshfiles.block(cell, 2)
    corners = given.cells[0].data[0]
    axis = meshfiles.dimension(cell) - 1
    given.points[corners, axis] = given.points[corners[0], axis]  # flattens it
    assert "without volume, or with a flat corner; the first is cell 1 of the file, at" in refused(
        given, tmp_path, cell
    )


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_folded_cells(cell: str, tmp_path: Path) -> None:
    given = meshfiles.block(cell, 2)
    given.cells[0].data[0, [0, 1]] = given.cells[0].data[0, [1, 0]]  # a bow tie
    assert f"has 1 {cell}s folded into themselves" in refused(given, tmp_path, cell)


def test_slender_cells_and_tiny_ones(tmp_path: Path) -> None:
    thin = meshfiles.block("quadrilateral", 2)
    thin.points[:, 1] *= 1e-5
    assert "times as long as wide" in refused(thin, tmp_path, "quadrilateral")
    small = Placement(scale=1e-16)
    given = meshfiles.block("quadrilateral", 2)
    assert "at least 1e-15 is allowed" in refused(given, tmp_path, "quadrilateral", placement=small)


@pytest.mark.parametrize("cell", CELLS)
def test_hanging_nodes(cell: str, tmp_path: Path) -> None:
    """Two blocks meshed apart, n = 2 beside n = 4: nodes of the finer hang on the coarser."""
    coarse, fine = meshfiles.block(cell, 2), meshfiles.block(cell, 4)
    mesh = meshio.Mesh(
        np.vstack([coarse.points, fine.points + [1.0, 0, 0]]),
        [(coarse.cells[0].type,
          np.vstack([coarse.cells[0].data, fine.cells[0].data + len(coarse.points)]))],
    )  # fmt: skip
    d = meshfiles.dimension(cell)
    told = refused(mesh, tmp_path, cell)
    assert f"has {5 ** (d - 1) - 3 ** (d - 1)} hanging nodes" in told
    assert "BooleanFragments" in told


def test_a_body_in_pieces(tmp_path: Path) -> None:
    """Two blocks that touch in an edge only: a hinge, and a body apart from another."""
    for shift in ([1.0, 1.0, 0.0], [5.0, 0.0, 0.0]):
        given = meshfiles.block("hexahedron", 2)
        mesh = meshio.Mesh(
            np.vstack([given.points, given.points + shift]),
            [("hexahedron", np.vstack([given.cells[0].data, given.cells[0].data + 27]))],
        )
        told = refused(mesh, tmp_path, "hexahedron")
        assert "falls into 2 pieces that share no facet, the smallest of 8 cells" in told


def test_a_group_in_pieces(tmp_path: Path) -> None:
    """Four pads of one group: another group is no remedy."""
    given = meshfiles.block("hexahedron", 2)
    points = np.vstack([given.points, given.points + [5.0, 0.0, 0.0]])
    cells = np.vstack([given.cells[0].data, given.cells[0].data + 27])
    tags = [np.ones(len(cells), int)]
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    names = {"pads": np.array([1, 3])}
    mesh = meshio.Mesh(points, [("hexahedron", cells)], cell_data=data, field_data=names)
    path = tmp_path / "pads.msh"
    meshio.gmsh.write(path, mesh, "2.2", binary=False)
    with pytest.raises(MeshError, match="pads holds them all: give each a physical group"):
        load_mesh(path, 3, groups=("pads",))


def test_broken_numbers(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    given.points[3, 0] = np.nan
    assert "not finite" in refused(given, tmp_path, "triangle")
    mesh = meshio.Mesh(np.zeros((3, 3)), [("triangle", [[0, 1, 7]])])
    path = tmp_path / "a.vtk"
    mesh.write(path, binary=False)
    with pytest.raises(MeshError, match="names a node the file does not define"):
        load_mesh(path, 2)


def test_unknown_groups(tmp_path: Path) -> None:
    given = meshfiles.block("triangle", 2)
    told = refused(given, tmp_path, "triangle", groups=["sofd"])
    assert told == "has no group of cells named 'sofd' (known: soft, hard)"
    mesh = loaded(given, tmp_path, "triangle")
    for groups, told in (
        (["soft"], "leaves 4 of 8 cells without a material"),
        (["soft", "hard", "x-"], "names the group 'x-'"),
        (["soft", "soft"], "gives 4 cells two materials"),
    ):
        with pytest.raises(MeshError, match=told):
            mesh.tagged(groups)
