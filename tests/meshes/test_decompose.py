"""Decompositions: every cell once, shared nodes at one place, kernels that are rigid motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from meshes import BoxShape, Partition, decompose, graph, versions

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
    sizes = np.bincount(graph.bisected(centres, parts))
    assert len(sizes) == parts
    assert np.ptp(sizes) <= 4
    first = graph.bisected(centres, 2)  # across the longest extent
    assert centres[first == 0, 1].max() <= centres[first == 1, 1].min()
    assert sorted(graph.bisected(centres[:7], 7)) == list(range(7))


def test_graded_meshes_are_cut_along_their_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    even = BoxShape((0.0,) * 3, (1.0,) * 3, (4, 4, 4), "tetrahedron").cell_mesh()
    asked: list[int] = []
    scotch = versions.scotch_parts
    monkeypatch.setattr(versions, "scotch_parts", lambda g, n: asked.append(n) or scotch(g, n))
    assert len(graph.split_by_graph(even, 5)) == 5
    assert not asked
    graded = replace(even, points=even.points**3)
    assert len(graph.split_by_graph(graded, 5)) >= 5
    assert asked == [5]


def test_what_breaks_off_a_part_is_split_or_given_away() -> None:
    """A row of 20 cells; part 1 is in three pieces of 8, 1 and 4 cells, part 2 has one cell."""
    part = np.repeat([1, 0, 1, 0, 1, 2], [8, 3, 1, 3, 4, 1])
    pairs = np.stack([np.arange(19), np.arange(1, 20)], axis=1)
    label = graph.facet_connected_parts(pairs, part, 3)
    pieces = [np.flatnonzero(label == k).tolist() for k in range(label.max() + 1)]
    assert sorted(pieces) == [
        list(range(8)), [8, 9, 10, 11], [12, 13, 14], list(range(15, 19)), [19],
    ]  # fmt: skip
