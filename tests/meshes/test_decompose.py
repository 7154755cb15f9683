"""Decompositions: every cell once, shared nodes at one place, kernels that are rigid motions."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from meshes import BoxShape, Partition, decompose, dolfinx_compat, graph
from meshes.box_cells import BoxCells, Cells
from meshes.load_balance import balanced_runs
from meshes.unstructured import CellMesh, Topology
from tests.ranks import execute

BOXES = {
    "hexahedron": BoxShape((0.0, -1.0, 2.0), (1.0, 1.0, 2.5), (5, 6, 3), "hexahedron"),
    "tetrahedron": BoxShape((0.0, -1.0, 2.0), (1.0, 1.0, 2.5), (5, 6, 3), "tetrahedron"),
    "quadrilateral": BoxShape((0.0, -1.0), (1.0, 1.0), (5, 6), "quadrilateral"),
    "triangle": BoxShape((0.0, -1.0), (1.0, 1.0), (5, 6), "triangle"),
}


def cut(box: BoxShape, subdomains: None | int | tuple[int, ...]) -> Partition:
    return decompose([box], subdomains, MPI.COMM_SELF)


def volume(points: np.ndarray, cells: np.ndarray, cell: str) -> float:
    """Sum of cell volumes by splitting off simplices or by box edges."""
    x = points[cells]
    if cell == "tetrahedron":
        edges = x[:, 1:] - x[:, :1]
        return float(np.abs(np.linalg.det(edges)).sum() / 6.0)
    if cell == "triangle":
        a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
        return float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2.0)
    dimension = 3 if cell == "hexahedron" else 2
    return float(np.ptp(x, axis=1)[:, :dimension].prod(axis=1).sum())


@pytest.mark.parametrize("cell", BOXES)
@pytest.mark.parametrize("wish", ["auto", "split", "uneven", "graph"])
def test_a_decomposition_covers_the_body_once(cell: str, wish: str) -> None:
    box = BOXES[cell]
    d = box.dimension
    wishes = {"auto": None, "split": (2,) * d, "uneven": (3, 4, 2)[:d], "graph": 7}
    partition = cut(box, wishes[wish])
    assert partition.nodes == box.nodes
    assert sum(len(s.reference.cells) for s in partition.subdomains) == box.total_cells
    total = sum(volume(s.points(), s.reference.cells, cell) for s in partition.subdomains)
    assert total == pytest.approx(float(np.prod(np.subtract(box.upper, box.lower))))

    place = np.full((partition.nodes, 3), np.nan)
    for s in partition.subdomains:
        known = ~np.isnan(place[s.nodes, 0])
        np.testing.assert_allclose(place[s.nodes][known], s.points()[known], atol=1e-14)
        place[s.nodes] = s.points()
    assert not np.isnan(place).any()


@pytest.mark.parametrize("cell", BOXES)
@pytest.mark.parametrize("wish", [(2, 2, 2), 5], ids=["split", "graph"])
def test_faces_of_the_box_are_known_by_name(cell: str, wish: int | tuple[int, ...]) -> None:
    box = BOXES[cell]
    d = box.dimension
    partition = cut(box, wish[:d] if isinstance(wish, tuple) else wish)
    for axis in range(d):
        for end, value in (("-", box.lower[axis]), ("+", box.upper[axis])):
            name = "xyz"[axis] + end
            count = 0
            for s in partition.subdomains:
                rows = s.boundaries.get(name, [])
                x = s.points()[s.reference.facets[rows]][..., axis]
                np.testing.assert_allclose(x, value, atol=1e-13)
                count += len(rows)
            across = np.prod([n for a, n in enumerate(box.cells) if a != axis])
            assert count == across * (2 if cell == "tetrahedron" else 1)
    exterior = sum(len(s.exterior) for s in partition.subdomains)
    named = sum(len(r) for s in partition.subdomains for r in s.boundaries.values())
    assert exterior == named


def test_congruent_subdomains_share_one_mesh() -> None:
    partition = cut(BoxShape((0.0,) * 3, (1.0,) * 3, (6, 6, 6), "hexahedron"), (3, 3, 3))
    assert partition.count == 27
    assert len({id(s.reference) for s in partition.subdomains}) == 1


def test_equal_bodies_share_one_mesh() -> None:
    boxes = [
        BoxShape((x, 0.0, 0.0), (x + 1.0, 1.0, 1.0), (4, 4, 4), "tetrahedron") for x in (0.0, 5.0)
    ]
    partition = decompose(boxes, (2, 2, 2), MPI.COMM_SELF)
    assert len({id(s.reference) for s in partition.subdomains}) == 1
    assert list(partition.subdomains_of_body) == [8, 8]


@pytest.mark.parametrize("parts", [2, 13, 40])
@pytest.mark.parametrize("cell", ["tetrahedron", "quadrilateral"])
def test_parts_hang_together_through_facets(cell: str, parts: int) -> None:
    """Pieces joined by an edge or corner only would have more zero-energy modes."""
    partition = cut(BOXES[cell], min(parts, 25))
    for s in partition.subdomains:
        cells = np.sort(s.reference.cells, axis=1)
        nodes = {frozenset(c): i for i, c in enumerate(cells.tolist())}
        need = {"tetrahedron": 3, "quadrilateral": 2}[cell]
        reached, front = {0}, [0]
        sets = [set(c) for c in nodes]
        while front:
            i = front.pop()
            for j in set(range(len(sets))) - reached:
                if len(sets[i] & sets[j]) >= need:
                    reached.add(j)
                    front.append(j)
        assert len(reached) == len(sets)


def test_more_subdomains_than_cells_is_refused() -> None:
    with pytest.raises(ValueError, match="only 3 cells"):
        cut(BOXES["hexahedron"], (1, 1, 4))
    with pytest.raises(ValueError, match="only 30 cells"):
        cut(BOXES["quadrilateral"], 31)


@pytest.mark.parametrize("parts", [2, 3, 7, 20])
def test_planes_cut_equal_parts(parts: int) -> None:
    centres = np.random.default_rng(1).random((1000, 3)) * (1.0, 5.0, 2.0)
    rows = graph.bisected(centres.T, parts, range(parts))
    assert sorted(np.concatenate(list(rows.values()))) == list(range(1000))
    sizes = [len(inside) for inside in rows.values()]
    assert len(sizes) == parts
    assert np.ptp(sizes) <= 4
    first = graph.bisected(centres.T, 2, range(2))  # across the longest extent
    assert centres[first[0], 1].max() <= centres[first[1], 1].min()
    few = graph.bisected(centres[:7].T, 7, range(7))
    assert sorted(np.concatenate(list(few.values()))) == list(range(7))
    for part in range(parts):  # whoever looks for it finds the same
        found = graph.bisected(centres.T, parts, range(part, part + 1))
        assert list(found) == [part]
        np.testing.assert_array_equal(found[part], rows[part])


def test_graded_meshes_are_cut_along_their_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    even = BoxShape((0.0,) * 3, (1.0,) * 3, (4, 4, 4), "tetrahedron").cell_mesh()
    asked: list[int] = []
    scotch = dolfinx_compat.scotch_parts
    monkeypatch.setattr(
        dolfinx_compat, "scotch_parts", lambda g, n: asked.append(n) or scotch(g, n)
    )
    assert decompose([even], 5, MPI.COMM_SELF).count == 5
    assert not asked
    graded = replace(even, points=even.points**3)
    assert decompose([graded], 5, MPI.COMM_SELF).count >= 5
    assert asked == [5]


def test_pieces_cut_off_from_a_part_are_split_or_joined_to_a_neighbour() -> None:
    """A row of 20 cells; part 1 is in three pieces of 8, 1 and 4 cells, part 2 has one cell."""
    row = BoxCells(BoxShape((0.0, 0.0), (20.0, 1.0), (20, 1), "quadrilateral"))
    part = np.repeat([1, 0, 1, 0, 1, 2], [8, 3, 1, 3, 4, 1]).astype(np.int32)
    piece, of_part = graph.through_facets(row, graph.rows_of(part, range(3)))
    np.testing.assert_array_equal(of_part, [0, 0, 1, 1, 1, 2])
    np.testing.assert_array_equal(of_part[piece], part)
    label = graph.without_crumbs(row, piece, of_part, 3)
    pieces = [np.flatnonzero(label == k).tolist() for k in range(label.max() + 1)]
    assert sorted(pieces) == [
        list(range(8)), [8, 9, 10, 11], [12, 13, 14], list(range(15, 19)), [19],
    ]  # fmt: skip


def prongs(cell: str) -> CellMesh:
    """Two long prongs on a short base: a plane across both leaves two pieces on its far side."""
    whole = BoxShape((0.0, 0.0), (9.0, 5.0), (9, 5), cell).cell_mesh()
    x, y = whole.points[whole.cells].mean(axis=1).T
    cells = whole.cells[(x < 2.0) | (y < 1.0) | (y > 3.0)]
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, whole.cells.shape[1])
    return CellMesh(
        cell, whole.points[used], cells, Topology.of(cells, cell), {}, {},
        (np.arange(len(cells)) % 3).astype(np.int32),
    )  # fmt: skip


def graded() -> CellMesh:
    even = BoxShape((0.0,) * 3, (1.0,) * 3, (5, 4, 4), "tetrahedron").cell_mesh()
    return replace(even, points=even.points**3)


@pytest.mark.parametrize("ranks", [1, 2, 3, 7])
def test_ranks_get_as_many_subdomains_unless_work_differs(ranks: int) -> None:
    alike = balanced_runs([(n, 10) for n in range(17)], ranks)
    assert alike == [17 * rank // ranks for rank in range(ranks + 1)]
    assert balanced_runs([("one", 10)] * 17, ranks) == alike


def test_classes_count_once_on_a_rank() -> None:
    subdomains = [(n, 10) for n in range(10)] + [("a", 10)] * 10 + [("b", 10)] * 10
    first, middle, last = balanced_runs(subdomains, 2)
    assert (first, last) == (0, 30)
    assert middle == 9
    assert balanced_runs([(0, 1), (1, 1), (2, 1000)], 3) == [0, 1, 2, 3]
    assert balanced_runs([(0, 1000), (1, 500), (2, 500), (3, 500)], 2) == [0, 1, 4]


CUTS: dict[str, tuple[list, None | int | tuple[int, ...]]] = {
    "box": ([BOXES["tetrahedron"]], 13),
    "box of degree 2": ([replace(BOXES["triangle"], degree=2)], 7),
    "graded": ([graded()], 6),
    "torn between others": ([BOXES["triangle"], prongs("triangle"), BOXES["quadrilateral"]], 16),
    "beside a regular split": ([prongs("quadrilateral"), BOXES["quadrilateral"]], (2, 1)),
}


def test_parts_that_fall_into_pieces_are_more_subdomains() -> None:
    shapes, subdomains = CUTS["beside a regular split"]
    counts = decompose(shapes, subdomains, MPI.COMM_SELF).subdomains_of_body
    assert counts == (3, 2)


def compare_with_one_rank() -> None:
    """Each rank holds its share of what one rank would cut; run below by mpirun."""
    comm = MPI.COMM_WORLD
    for name, (shapes, subdomains) in CUTS.items():
        here = decompose(shapes, subdomains, comm)
        alone = decompose(shapes, subdomains, MPI.COMM_SELF)
        assert here.count == alone.count, name
        assert here.subdomains_of_body == alone.subdomains_of_body, name
        numbers = [s.number for s in here.subdomains]
        assert sum(comm.allgather(numbers), []) == list(range(alone.count)), name
        for start, s in zip(here.cell_starts, here.subdomains, strict=True):
            t = alone.subdomains[s.number]
            assert (s.body, start) == (t.body, alone.cell_starts[s.number]), name
            np.testing.assert_array_equal(s.nodes, t.nodes)
            np.testing.assert_array_equal(s.nodes[s.reference.cells], t.nodes[t.reference.cells])
            np.testing.assert_array_equal(s.reference.tags, t.reference.tags)
            np.testing.assert_allclose(s.points(), t.points(), rtol=0, atol=1e-14)
            np.testing.assert_array_equal(s.exterior, t.exterior)
            assert s.boundaries.keys() == t.boundaries.keys(), name
            for side, rows in s.boundaries.items():
                np.testing.assert_array_equal(rows, t.boundaries[side])


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_several_ranks_cut_the_subdomains_of_one_rank(ranks: int) -> None:
    program = "from tests.meshes.test_decompose import compare_with_one_rank as c; c(); print('ok')"
    assert execute(program, ranks=ranks).count("ok") == ranks


@pytest.mark.parametrize("cell", BOXES)
@pytest.mark.parametrize("degree", [1, 2])
def test_cells_of_a_box_are_known_by_arithmetic(cell: str, degree: int) -> None:
    box = replace(BOXES[cell], degree=degree)
    found, listed = BoxCells(box), box.cell_mesh()
    every = np.arange(listed.total_cells)
    np.testing.assert_array_equal(found.nodes_at(every), listed.cells)
    np.testing.assert_array_equal(found.points_at(np.arange(listed.nodes)), listed.points)
    centres = listed.centres()
    assert centres is not None
    np.testing.assert_allclose(found.centres(), centres, rtol=0, atol=1e-6)
    label = np.random.default_rng(2).integers(-1, 2, listed.total_cells)

    def alike(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a == b) & (a >= 0)

    def pairs(cells: Cells) -> set[frozenset[int]]:
        return {frozenset(p) for p in np.stack(cells.neighbours(label, alike), axis=1).tolist()}

    assert pairs(found) == pairs(listed)
    own, theirs = found.skin(label == 0), listed.skin(label == 0)
    np.testing.assert_array_equal(own.cells, theirs.cells)
    np.testing.assert_array_equal(own.facets, theirs.facets)
    assert own.sides.keys() == theirs.sides.keys()
    for name, on in own.sides.items():
        np.testing.assert_array_equal(on, theirs.sides[name])
