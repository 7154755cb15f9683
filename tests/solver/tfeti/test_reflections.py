"""Reflections of a subdomain and the inverse they split."""

from itertools import product

import numpy as np
import pytest
from scipy import sparse

from solver.tfeti.subdomain.generalised_inverse import (
    GeneralisedInverse,
    SymmetricBlock,
    SymmetricInverse,
)
from solver.tfeti.subdomain.kernels import fixing_nodes, orthonormal_kernel
from solver.tfeti.subdomain.reflections import find_symmetry


def springs(
    cells: tuple[int, ...],
    strength: np.ndarray | None = None,
    spacing: tuple[float, ...] = (1.0, 0.7, 1.3),
) -> tuple:
    """A lattice of points, each tied by springs to all its neighbours, across diagonals too."""
    d = len(cells)
    index = np.array(list(product(*(range(n + 1) for n in cells))))
    points = np.zeros((len(index), 3))
    points[:, :d] = index * np.array(spacing)[:d]
    pairs = [
        (i, j)
        for i in range(len(index))
        for j in range(i)
        if np.abs(index[i] - index[j]).max() == 1
    ]
    K = np.zeros((len(index) * d,) * 2)
    for i, j in pairs:
        along = (points[i] - points[j])[:d]
        stretch = np.zeros(len(K))
        stretch[i * d : (i + 1) * d], stretch[j * d : (j + 1) * d] = along, -along
        weight = 1.0 if strength is None else strength[i] * strength[j]
        K += weight * np.outer(stretch, stretch) / (along @ along)
    return points, sparse.csr_matrix(K)


@pytest.mark.parametrize("cells", [(2, 2), (3, 2), (2, 2, 2), (3, 2, 1)])
def test_reflections_are_found_and_leave_the_stiffness_alone(cells: tuple[int, ...]) -> None:
    points, K = springs(cells)
    symmetry = find_symmetry(points, len(cells), K)
    assert symmetry is not None
    assert symmetry.order == 2 ** len(cells)
    for image, sign in zip(symmetry.images, symmetry.signs, strict=True):
        S = sparse.coo_matrix((sign.astype(float), (image, np.arange(len(image)))), K.shape).tocsr()
        assert abs(S @ K @ S.T - K).max() < 1e-12


@pytest.mark.parametrize(("mirror", "signs"), [(False, [1, -1]), (True, [-1, -1])])
def test_only_the_reflections_of_the_stiffness_count(mirror: bool, signs: list[int]) -> None:
    """A lattice stiffer on one side keeps a mirror, one stiffer off a diagonal the point mirror.

    So does Kuhn's cut of a cube into tetrahedra.
    """
    points, _ = springs((2, 2))
    off = np.abs(points[:, 0] / 2.0 + points[:, 1] / 1.4 - 1.0)
    _, K = springs((2, 2), 1.0 + (off if mirror else points[:, 0]))
    symmetry = find_symmetry(points, 2, K)
    assert symmetry is not None
    assert symmetry.order == 2
    np.testing.assert_array_equal(symmetry.signs[1][:2], signs)


def test_a_body_without_symmetry_has_no_reflections() -> None:
    points, _ = springs((2, 2))
    _, K = springs((2, 2), np.random.default_rng(0).uniform(1.0, 2.0, len(points)))
    assert find_symmetry(points, 2, K) is None
    moved = points + np.array([[0.1, 0.0, 0.0]]) * (np.arange(len(points)) == 0)[:, None]
    assert find_symmetry(moved, 2, springs((2, 2))[1]) is None


@pytest.mark.parametrize("cells", [(3, 2), (2, 2, 2), (3, 2, 2)])
def test_the_split_is_orthogonal_complete_and_splits_the_stiffness(cells: tuple[int, ...]) -> None:
    points, K = springs(cells)
    symmetry = find_symmetry(points, len(cells), K)
    assert symmetry is not None
    split = symmetry.split(np.arange(K.shape[0]))
    assert sum(split.sizes) == K.shape[0]
    bases = split.bases(K.shape[0])
    together = sparse.hstack(bases).toarray()
    gram = together.T @ together
    np.testing.assert_array_equal(gram, np.diag(np.diag(gram)))
    np.testing.assert_array_equal(np.diag(gram), np.concatenate([o[1] for o in split.orbits]))
    for a, b in product(range(symmetry.order), repeat=2):
        if a != b:
            assert abs(bases[a].T @ K @ bases[b]).max() < 1e-12


def test_coordinates_are_products_with_the_bases_and_back() -> None:
    points, K = springs((3, 2, 2))
    symmetry = find_symmetry(points, 3, K)
    assert symmetry is not None
    chosen = symmetry.closure(np.flatnonzero(points[:, 1] == points[:, 1].max()) * 3 + 1)
    split = symmetry.split(chosen)
    np.testing.assert_array_equal(np.sort(split.unknowns), chosen)
    x = np.random.default_rng(0).normal(size=(5, len(chosen)))
    full = np.zeros((K.shape[0], 5))
    full[split.unknowns] = x.T
    bases = split.bases(K.shape[0])
    coordinates = split.forward(x)
    parts = [coordinates[:, place] for place in split.places]
    for V, part in zip(bases, parts, strict=True):
        np.testing.assert_allclose(part.T, V.T @ full, atol=1e-14)
    out = np.empty_like(x)
    split.backward(coordinates, out)
    expected = sum(V @ part.T for V, part in zip(bases, parts, strict=True))
    np.testing.assert_allclose(out.T, expected[split.unknowns], atol=1e-14)


@pytest.mark.parametrize("cells", [(3, 2), (2, 2, 2), (3, 2, 2)])
def test_split_inverse_is_the_inverse(cells: tuple[int, ...]) -> None:
    d = len(cells)
    points, K = springs(cells)
    R = orthonormal_kernel(points, d)
    fixing = (fixing_nodes(points, d)[:, None] * d + np.arange(d)).ravel()
    symmetry = find_symmetry(points, d, K)
    assert symmetry is not None
    split = SymmetricInverse(K, R, fixing, symmetry)
    plain = GeneralisedInverse(K, R, symmetry.closure(fixing))
    load = np.asfortranarray(np.random.default_rng(1).normal(size=(K.shape[0], 300)))
    np.testing.assert_allclose(split.solve(load), plain.solve(load), atol=1e-10)

    touched = np.flatnonzero(points[:, 0] == 0.0) * d
    interface = symmetry.split(symmetry.closure(touched)).unknowns
    assert len(interface) == 2 * len(touched)
    block, whole = split.restricted(interface), plain.restricted(interface).matrix
    assert isinstance(block, SymmetricBlock)
    assert sum(b.nbytes for b in block.blocks) <= 0.6 * whole.nbytes
    x = np.random.default_rng(2).normal(size=(150, len(interface)))
    y = np.empty_like(x)
    block.apply(x, y)
    np.testing.assert_allclose(y, x @ whole, atol=1e-10)


@pytest.mark.parametrize("cells", [(3, 2), (3, 2, 2)])
def test_the_schur_complement_comes_from_the_inverse(cells: tuple[int, ...]) -> None:
    """Split and whole, it is K relaxed inside, also where inner nodes are the fixed ones."""
    d = len(cells)
    points, K = springs(cells)
    R = orthonormal_kernel(points, d)
    symmetry = find_symmetry(points, d, K)
    assert symmetry is not None
    fixing = (fixing_nodes(points, d)[:, None] * d + np.arange(d)).ravel()
    end = (points[:, 0] == 0.0) | (points[:, 0] == points[:, 0].max())
    interface = symmetry.split(np.repeat(end, d).nonzero()[0]).unknowns
    inside = np.setdiff1d(np.arange(K.shape[0]), interface)
    A = K.toarray()
    coupling = A[np.ix_(inside, interface)]
    relaxed = A[np.ix_(interface, interface)] - coupling.T @ np.linalg.solve(
        A[np.ix_(inside, inside)], coupling
    )
    for where in (fixing, inside):
        whole = GeneralisedInverse(K, R, where).restricted(interface)
        split = SymmetricInverse(K, R, where, symmetry).restricted(interface)
        for block in (whole, split):
            found = np.empty_like(relaxed)
            block.schur_complement.apply(np.eye(len(relaxed)), found)
            np.testing.assert_allclose(found, relaxed, atol=1e-6 * np.abs(relaxed).max())


def test_averaging_removes_asymmetry() -> None:
    points, K = springs((3, 2, 1))
    symmetry = find_symmetry(points, 3, K)
    assert symmetry is not None
    noise = 1e-3 * np.random.default_rng(3).normal(size=K.shape) * (K.toarray() != 0)
    mean = symmetry.average((K + sparse.csr_matrix(noise + noise.T)).tocsr())
    assert abs(mean - K).max() > 1e-5
    for image, sign in zip(symmetry.images, symmetry.signs, strict=True):
        S = sparse.coo_matrix((sign.astype(float), (image, np.arange(len(image)))), K.shape).tocsr()
        assert abs(S @ mean @ S.T - mean).max() < 1e-15 * abs(K).max()
