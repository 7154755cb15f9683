"""The same answer and the same counts on 1, 2 and 3 ranks."""

from pathlib import Path

import numpy as np
import pytest

from tests.ranks import execute

SCRIPT = """
import sys
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from solver import MPRGP, SMALBE, BoxQP, NotFiniteError, QPError, UnboundedError

comm = MPI.COMM_WORLD
n, m = 60, 4
A = PETSc.Mat().createAIJ((n, n), nnz=3, comm=comm)
C = PETSc.Mat().createAIJ((m, n), nnz=n, comm=comm)
first, last = A.getOwnershipRange()
for i in range(first, last):
    A.setValue(i, i, 2.05)
    for j in (i - 1, i + 1):
        if 0 <= j < n:
            A.setValue(i, j, -1.0)
for i in range(*C.getOwnershipRange()):
    for j in range(i, n, m):
        C.setValue(i, j, 1.0 + 0.1 * np.cos(j))
A.assemble()
C.assemble()
i = np.arange(first, last)
b = A.createVecLeft()
b.setArray(np.sin(0.7 * i))
qp = BoxQP(A, b, lower=-0.3, upper=np.where(i % 5 == 0, np.inf, 0.4))
lines = []
for expansion in ("projcg-safe", "projcg", "fixed", "gfgr-opt"):
    result = MPRGP(expansion, rtol=1e-11).solve(qp)
    lines.append((result.counts, np.concatenate(comm.allgather(result.x.getArray()))))
result = SMALBE(MPRGP(rtol=1e-10)).solve(qp, C)
assert result.converged, result.reason
lines.append((result.counts, np.concatenate(comm.allgather(result.x.getArray()))))

# errors are raised on every rank, so that none waits for another
bad = b.copy()
if first <= n - 1 < last:
    bad.setValue(n - 1, np.nan)
bad.assemble()
for attempt, error, text in (
    (lambda: BoxQP(A, bad), NotFiniteError, f"component {n - 1}"),
    (lambda: BoxQP(A, b, np.where(i == n - 1, 1.0, 0.0), 0.5), QPError, f"component {n - 1}"),
):
    try:
        attempt()
    except error as raised:
        assert text in str(raised), str(raised)
    else:
        raise AssertionError("no error")
flat = PETSc.Mat().createAIJ((n, n), nnz=1, comm=comm)
for k in range(first, last):
    flat.setValue(k, k, 0.0 if k == n - 2 else 1.0)
flat.assemble()
try:
    MPRGP().solve(BoxQP(flat, b))
except UnboundedError as raised:
    assert raised.component == n - 2
else:
    raise AssertionError("no error")
if comm.rank == 0:
    np.set_printoptions(precision=12, threshold=10_000)
    counts = [list(vars(c).values()) for c, _ in lines]
    np.savez(sys.argv[1], x=[x for _, x in lines], counts=counts)
"""


def run(ranks: int, directory: Path) -> dict[str, np.ndarray]:
    out = directory / f"{ranks}.npz"
    execute(SCRIPT, str(out), ranks=ranks)
    with np.load(out) as found:
        return dict(found)


@pytest.mark.mpi
def test_ranks_do_not_change_the_answer(tmp_path):
    one = run(1, tmp_path)
    for ranks in (2, 3):
        several = run(ranks, tmp_path)
        np.testing.assert_allclose(several["x"], one["x"], atol=1e-9)
        difference = np.abs(several["counts"] - one["counts"])[:, :5]
        assert difference[:-1].max() == 0
        assert difference[-1].max() <= 2  # SMALBE: many CG steps amplify rounding
