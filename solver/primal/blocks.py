"""Matrices in dense blocks of one node by one node.

Nodes have two or three unknowns, and couple with all unknowns of their neighbours. In blocks
(PETSc's BAIJ) a matrix has a ninth of the column numbers, and a product takes half the time.
"""

import weakref
from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

from solver.primal.block_rows import BlockRows

_MADE: dict[tuple[int, str], Any] = {}
"""Results of `made_once`, by the identity of the matrix and a name."""


def made_once(matrix: PETSc.Mat, name: str, make: Callable[[], Any]) -> Any:
    """The result of the first call for a matrix and a name; freed with the matrix.

    An attribute of the matrix would outlive it: petsc4py 3.18 does not free attributes.
    """
    key = id(matrix), name
    if key not in _MADE:
        _MADE[key] = make()
        weakref.finalize(matrix, _MADE.pop, key).atexit = False
    return _MADE[key]


def in_blocks(matrix: PETSc.Mat) -> PETSc.Mat:
    """The matrix in blocks of its block size, for products; made once (collective).

    The matrix itself where its blocks are single entries. Values that change later do not reach it.
    """
    d = matrix.getBlockSize()
    return (
        matrix if d == 1 else made_once(matrix, "blocks", lambda: BlockRows.of(matrix).to_blocks())
    )


def keep_in_blocks(matrix: PETSc.Mat, rows: BlockRows) -> None:
    """Make the matrix of `in_blocks` from its rows in blocks (collective)."""
    made_once(matrix, "blocks", rows.to_blocks)


def petsc_blocks(rows: BlockRows) -> PETSc.Mat:
    """A square matrix for PETSc in blocks, whose rows `rows_in_blocks` returns (collective)."""
    matrix = rows.to_blocks() if rows.local.blocksize[0] > 1 else rows.to_petsc()
    made_once(matrix, "rows", lambda: rows)
    return matrix


def rows_in_blocks(matrix: PETSc.Mat) -> BlockRows:
    """The rows of a matrix of `petsc_blocks`; a copy of those of another matrix."""
    return _MADE.get((id(matrix), "rows")) or BlockRows.of(matrix)
