"""K⁺ and kernels of floating subdomains."""

import numpy as np
import pytest
from scipy import sparse

from solver.factors import CholeskyFactor
from solver.rigid_motions import MOTIONS, rigid_motions
from solver.tfeti.subdomain.generalised_inverse import DenseFactor, GeneralisedInverse
from solver.tfeti.subdomain.kernels import check_kernel, fixing_nodes, orthonormal_kernel


def truss(dimension: int, seed: int = 0) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Points and stiffness of springs between all pairs of random points: floats freely."""
    points = np.zeros((9, 3))
    points[:, :dimension] = np.random.default_rng(seed).uniform(size=(9, dimension))
    K = np.zeros((9 * dimension,) * 2)
    for i in range(9):
        for j in range(i):
            along = (points[i] - points[j])[:dimension]
            stretch = np.zeros(9 * dimension)
            stretch[i * dimension : (i + 1) * dimension] = along
            stretch[j * dimension : (j + 1) * dimension] = -along
            K += np.outer(stretch, stretch) / (along @ along)
    return points, sparse.csr_matrix(K)


def inverse_of(dimension: int) -> tuple[np.ndarray, np.ndarray, GeneralisedInverse]:
    points, K = truss(dimension)
    R = orthonormal_kernel(points, dimension)
    nodes = fixing_nodes(points, dimension)
    fixing = (nodes[:, None] * dimension + np.arange(dimension)).ravel()
    return K.toarray(), R, GeneralisedInverse(K, R, fixing)


@pytest.mark.parametrize("dimension", [2, 3])
def test_kernel_is_orthonormal_and_costs_no_energy(dimension: int) -> None:
    points, K = truss(dimension)
    R = orthonormal_kernel(points, dimension)
    assert R.shape == (9 * dimension, MOTIONS[dimension])
    np.testing.assert_allclose(R.T @ R, np.eye(R.shape[1]), atol=1e-13)
    check_kernel(K, R)
    K[0, 0] += 1.0
    with pytest.raises(ValueError, match="resists a rigid motion"):
        check_kernel(K.tocsr(), R)


@pytest.mark.parametrize("dimension", [2, 3])
def test_generalised_inverse_is_exact(dimension: int) -> None:
    """K K⁺ K = K, whatever the regularisation on the fixing nodes."""
    K, R, inverse = inverse_of(dimension)
    np.testing.assert_allclose(K @ inverse.solve(K) @ K, K @ K, atol=1e-11)
    load = np.random.default_rng(1).normal(size=(len(K), 3))
    load -= R @ (R.T @ load)
    np.testing.assert_allclose(K @ inverse.solve(load), load, atol=1e-12)


def test_restricted_block_is_part_of_the_inverse() -> None:
    K, _, inverse = inverse_of(3)
    unknowns = np.array([1, 5, 20])
    full = inverse.solve(np.eye(len(K)))
    block = inverse.restricted(unknowns)
    np.testing.assert_allclose(block.matrix, full[np.ix_(unknowns, unknowns)])


def test_a_second_mechanism_is_refused() -> None:
    """Two springs pulled apart: more zero-energy modes than the rigid motions of one body."""
    points, K = truss(2)
    both = sparse.block_diag([K, K]).tocsr()
    points = np.vstack([points, points + [3.0, 0.0, 0.0]])
    R = orthonormal_kernel(points, 2)
    fixing = (fixing_nodes(points, 2)[:, None] * 2 + np.arange(2)).ravel()
    with pytest.raises(ArithmeticError, match="zero-energy"):
        inverse = GeneralisedInverse(both, R, fixing)
        load = np.zeros((len(points) * 2, 1))
        load[-1], load[-3] = 1.0, -1.0
        if np.abs(both @ inverse.solve(load) - load).max() > 1e-6:
            raise ArithmeticError("zero-energy modes went unseen by the factor")


@pytest.mark.parametrize("dimension", [2, 3])
def test_rigid_motions_have_antisymmetric_gradients(dimension: int) -> None:
    points = np.zeros((4, 3))
    points[1:, :] = np.eye(3)
    motions = rigid_motions(points, dimension, np.zeros(3), 2.0)
    for motion in np.moveaxis(motions, -1, 0):
        gradient = (motion[1 : dimension + 1] - motion[0]).T
        np.testing.assert_allclose(gradient + gradient.T, 0, atol=1e-15)


def test_fixing_nodes_of_a_box_are_corners_far_apart() -> None:
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 4)] * 3), axis=-1).reshape(-1, 3)
    x = grid[fixing_nodes(grid, 3)]
    assert len(x) == 3
    area = 0.5 * np.linalg.norm(np.cross(x[1] - x[0], x[2] - x[0]))
    assert area > 0.5


@pytest.mark.parametrize("chosen", [[], [3, 0, 11], list(range(12))])
def test_a_factor_has_the_inverse_between_some_unknowns(chosen: list[int]) -> None:
    half = np.random.default_rng(3).normal(size=(12, 12))
    A = half @ half.T + np.eye(12)
    block = CholeskyFactor(sparse.csr_matrix(A)).restricted(np.array(chosen, np.int64))
    np.testing.assert_allclose(block, np.linalg.inv(A)[np.ix_(chosen, chosen)], atol=1e-12)


def test_dense_factors_are_those_of_sparse_ones() -> None:
    """Solutions and the inverse between some unknowns; an indefinite matrix has no factor."""
    matrix = truss(3)[1] + sparse.identity(27)
    some, loads = np.array([20, 3, 11]), np.asfortranarray(np.random.default_rng(1).random((27, 4)))
    dense, other = DenseFactor(matrix), CholeskyFactor(matrix)
    np.testing.assert_allclose(dense.solve(loads), other.solve(loads), atol=1e-13)
    np.testing.assert_allclose(dense.restricted(some), other.restricted(some), atol=1e-13)
    with pytest.raises(ArithmeticError, match="no Cholesky factor"):
        DenseFactor(matrix - 2.0 * sparse.identity(27)).restricted(some)
