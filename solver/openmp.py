"""Restrict the OpenMP loops of other libraries to one thread.

CHOLMOD up to its version 3 gives the loops of a supernodal factorization four threads of OpenMP
regardless of ``OMP_NUM_THREADS``. The loops are short: on two cores the threads wait for each other
half of the time, and nearly all of the time where ranks share the cores. Products inside a factor
are BLAS's and keep its own threads.
"""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_openmp_thread() -> Iterator[None]:
    """Run GNU's OpenMP regions that begin inside on the calling thread alone."""
    try:
        openmp = ctypes.CDLL("libgomp.so.1")
    except OSError:  # then nothing here was made with it
        yield
        return
    levels = openmp.omp_get_max_active_levels()
    openmp.omp_set_max_active_levels(0)
    try:
        yield
    finally:
        openmp.omp_set_max_active_levels(levels)
