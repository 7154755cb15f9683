"""The decomposition chosen for the user."""

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.decomposition import choose_split, groups_of, seconds
from meshes import decompose
from meshes.box import BoxShape


def box(cells: tuple[int, ...], cell: str = "hexahedron", degree: int = 1) -> BoxShape:
    """Cells of edge 1."""
    return BoxShape((0.0,) * len(cells), tuple(map(float, cells)), cells, cell, degree)


@pytest.mark.parametrize("cells", [(20, 20, 20), (30, 30, 30), (7, 50, 13), (200, 90)])
def test_sub_boxes_are_near_cubes_and_enough(cells: tuple[int, ...]) -> None:
    shape = box(cells, "hexahedron" if len(cells) == 3 else "quadrilateral")
    split = choose_split(shape)
    assert np.prod(split) > 1
    edges = np.array(cells) / np.array(split)
    assert edges.max() <= 3.0 * edges.min()
    assert np.prod(choose_split(shape, at_least=50)) >= 50


def test_congruent_sub_boxes_are_preferred() -> None:
    """23 is a prime: whatever is done there are eight shapes; 24 need not have any but one."""
    split = choose_split(box((24, 24, 24)))
    assert np.prod(split) > 1
    assert not np.any(np.array((24, 24, 24)) % split)


def test_of_like_splits_several_boxes_take_the_one_with_fewer_subdomains() -> None:
    shape = box((48, 48, 48))
    fine, coarse = (6, 6, 6), (4, 4, 4)
    assert seconds(shape, fine) == pytest.approx(seconds(shape, coarse), rel=0.02)
    assert choose_split(shape, single=False) == coarse
    # these have parts of 5 and 6 cells, as cubes of 29 cells in 5 × 5 × 5, and share their factors
    assert choose_split(box((23, 23, 23)), single=False) == coarse


def test_small_and_slender_boxes_stay_whole() -> None:
    assert choose_split(box((2, 2, 4))) == (1, 1, 1)
    assert choose_split(box((300, 4, 4))) == (1, 1, 1)
    assert np.prod(choose_split(box((2, 2, 4)), at_least=3)) >= 3
    assert np.prod(choose_split(box((1, 1, 2)), at_least=3)) == 2


def test_no_neighbouring_split_is_cheaper_by_the_model() -> None:
    shape = box((40, 40, 20))
    best = choose_split(shape)
    for axis in range(3):
        for factor in (0.5, 2.0):
            other = list(best)
            other[axis] = max(1, int(best[axis] * factor))
            assert seconds(shape, best) <= 1.05 * seconds(shape, tuple(other))


@pytest.mark.parametrize(
    ("cells", "cell", "degree", "split"),
    [
        ((6, 4, 5), "hexahedron", 1, (3, 2, 2)),
        ((7, 5), "triangle", 1, (3, 2)),
        ((4, 4, 2), "tetrahedron", 2, (2, 2, 1)),
    ],
)
def test_the_reported_model_is_the_built_model(
    cells: tuple[int, ...], cell: str, degree: int, split: tuple[int, ...]
) -> None:
    shape = box(cells, cell, degree)
    made = decompose([shape], split, MPI.COMM_SELF).subdomains
    d = len(cells)
    found: dict[tuple[int, int], int] = {}
    for s in made:
        surface = len(np.unique(s.reference.facets))
        size = d * len(s.reference.points), d * surface
        found[size] = found.get(size, 0) + 1
    told: dict[tuple[int, int], int] = {}
    for g in groups_of(shape, split):
        told[g.unknowns, g.interface] = told.get((g.unknowns, g.interface), 0) + g.members
    assert told == found
