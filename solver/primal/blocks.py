"""Matrices in dense blocks of one node by one node.

Nodes have two or three unknowns, and couple with all unknowns of their neighbours. In blocks
(PETSc's BAIJ) a matrix has a ninth of the column numbers, and a product takes half the time.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from solver.tfeti.constraints.matrix import local_rows


def in_blocks(matrix: PETSc.Mat) -> PETSc.Mat:
    """The matrix in blocks of its block size, for products; made once (collective).

    The matrix itself where its blocks are single entries. Values that change later do not reach it.
    """
    made: PETSc.Mat | None = matrix.getAttr("blocks")
    if made is None:
        made = _in_blocks(matrix, matrix.getBlockSize())
        matrix.setAttr("blocks", made)
    return made


def _in_blocks(matrix: PETSc.Mat, d: int) -> PETSc.Mat:
    if d == 1:
        return matrix
    local = local_rows(matrix).tobsr((d, d))
    local.sort_indices()
    begins, places = (part.astype(PETSc.IntType) for part in (local.indptr, local.indices))
    values = np.ascontiguousarray(local.data)
    made = PETSc.Mat().createBAIJ(
        matrix.getSizes(), d, csr=(begins, places, values), comm=matrix.comm
    )
    made.assemble()
    return made
