"""Blocks made in turns by the ranks are those that one rank makes."""

from __future__ import annotations

import pytest

from tests.ranks import execute

SCRIPT = """
import numpy as np
from mpi4py import MPI
from solver.tfeti.subdomain.generalised_inverse import SymmetricInverse
from solver.tfeti.subdomain.kernels import fixing_nodes, orthonormal_kernel
from solver.tfeti.subdomain.sharing import made_together
from solver.tfeti.subdomain.reflections import find_symmetry
from tests.solver.tfeti.test_reflections import springs

points, K = springs((3, 2, 2))
R, symmetry = orthonormal_kernel(points, 3), find_symmetry(points, 3, K)
fixing = (fixing_nodes(points, 3)[:, None] * 3 + np.arange(3)).ravel()
interface = symmetry.split(symmetry.closure(np.flatnonzero(points[:, 0] == 0.0) * 3)).unknowns
blocks = []
for comm in (MPI.COMM_WORLD, None):
    block = SymmetricInverse(K, R, fixing, symmetry, comm).restricted(interface)
    blocks += [block, block.schur_complement(R[interface])]
for shared, own in zip(blocks[:2], blocks[2:]):
    for a, b in zip(shared.blocks, own.blocks):
        np.testing.assert_array_equal(a, b)

def fails():
    raise np.linalg.LinAlgError

try:
    made_together(MPI.COMM_WORLD, [lambda: np.zeros(2), fails], [(2,), (2,)])
except np.linalg.LinAlgError:
    print("told")
"""


@pytest.mark.mpi
def test_two_ranks_make_the_columns_of_one_rank_and_raise_the_same_error() -> None:
    assert execute(SCRIPT, ranks=2).count("told") == 2
