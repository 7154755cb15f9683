import os
import subprocess
import sys

FACTOR = """
import os
import numpy as np
from scipy import sparse
from solver.factors import CholeskyFactor

line = sparse.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(13, 13))
one = sparse.diags([1.0, 4.0, 1.0], [-1, 0, 1], shape=(13, 13))
grid = sparse.kron(sparse.kron(line, one), one) + sparse.kron(sparse.kron(one, line), one)
matrix = (grid + sparse.kron(sparse.kron(one, one), line)).tocsr()
before = len(os.listdir("/proc/self/task"))
factor = CholeskyFactor(matrix)
x = factor.solve(np.ones((matrix.shape[0], 1)))
assert np.allclose(matrix @ x, 1.0)
print(len(os.listdir("/proc/self/task")) - before)
"""


def test_a_factor_starts_no_threads_of_its_own() -> None:
    # what BLAS and OpenMP are told otherwise stays out of it; CHOLMOD 3 would start three threads
    names = ("OMP_NUM_THREADS", "OMP_THREAD_LIMIT", "OMP_MAX_ACTIVE_LEVELS")
    kept = {name: value for name, value in os.environ.items() if name not in names}
    run = subprocess.run(
        [sys.executable, "-c", FACTOR],
        env={**kept, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.strip() == "0"
