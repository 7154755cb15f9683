"""Matrices in blocks of nodes, their largest eigenvalue, and the life of both."""

import weakref

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from solver.distributed import local_rows, petsc_rows
from solver.primal.blocks import in_blocks
from solver.primal.lanczos import largest_eigenvalue
from solver.primal.products import multiply, vectors_of
from tests.solver.lattices import lattice


def matrix() -> PETSc.Mat:
    """The stiffness of a lattice, in single entries of nodes with two unknowns."""
    K = lattice(30)[1]
    made = petsc_rows(MPI.COMM_SELF, sparse.csr_matrix(K + np.eye(len(K))), len(K))
    made.setBlockSize(2)
    return made


def test_the_largest_eigenvalue_is_estimated_to_a_tenth() -> None:
    K = matrix()
    flexibility = 1.0 / np.asarray(K.getDiagonal().getArray())
    root = np.sqrt(flexibility)[:, None]
    exact = np.linalg.eigvalsh(root * local_rows(K).toarray() * root.T)[-1]
    assert 0.9 * exact < largest_eigenvalue(in_blocks(K), flexibility) < 1.001 * exact


def test_blocks_multiply_as_single_entries() -> None:
    K = matrix()
    x = np.random.default_rng(0).standard_normal(K.getSize()[1])
    expected = multiply(K, x)
    assert in_blocks(K).getType() == "seqbaij"
    assert np.abs(multiply(in_blocks(K), x) - expected).max() < 1e-12 * np.abs(expected).max()


def test_blocks_and_vectors_are_freed_with_their_matrix() -> None:
    """Else each solve would leave a copy of the stiffness behind."""
    K = PETSc.Mat().createAIJ((6, 6), csr=(range(7), range(6), 6 * [2.0]), comm=PETSc.COMM_SELF)
    K.setBlockSize(2)
    made = in_blocks(K), *vectors_of(K)
    assert in_blocks(K) is made[0]
    assert vectors_of(K)[0] is made[1]
    left = [weakref.ref(value) for value in made]
    del made, K
    assert [value() for value in left] == [None] * 3
