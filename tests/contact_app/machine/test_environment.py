"""The BLAS, releases and memory that a run reports."""

import subprocess
import sys

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.machine import environment

LIB = "/usr/lib/x86_64-linux-gnu"


@pytest.mark.parametrize(
    ("libraries", "name"),
    [
        ([f"{LIB}/blas/libblas.so.3.11.0", f"{LIB}/lapack/liblapack.so.3.11.0"], "reference BLAS"),
        ([f"{LIB}/libblas.so.3"], "reference BLAS"),
        ([f"{LIB}/openblas-pthread/libblas.so.3"], "OpenBLAS (pthread)"),
        (
            [
                f"{LIB}/openblas-pthread/libblas.so.3",
                f"{LIB}/openblas-pthread/libopenblasp-r0.3.21.so",
            ],
            "OpenBLAS 0.3.21 (pthread)",
        ),
        ([f"{LIB}/openblas-serial/libblas.so.3"], "OpenBLAS (serial)"),
        ([f"{LIB}/blis-openmp/libblas.so.3"], "BLIS (openmp)"),
        ([f"{LIB}/libmkl_rt.so"], "Intel MKL"),
        ([f"{LIB}/libm.so.6"], environment.UNKNOWN),
    ],
)
def test_names_the_blas_by_the_library_mapped(libraries: list[str], name: str) -> None:
    assert environment.blas_of([*libraries, f"{LIB}/libc.so.6"]) == name


def test_a_wheels_own_openblas_does_not_hide_the_slow_one() -> None:
    mapped = ["/venv/numpy.libs/libscipy_openblas64_-56d6093b.so", f"{LIB}/blas/libblas.so.3.11.0"]
    assert environment.blas_of(mapped) == environment.REFERENCE


def test_a_slow_blas_causes_a_warning_with_its_remedy() -> None:
    warning = environment.slow_blas_warning(environment.REFERENCE)
    assert warning is not None
    assert "libopenblas0-pthread" in warning
    assert environment.slow_blas_warning("OpenBLAS (pthread)") is None


def test_this_process_has_a_blas_and_the_summary_its_keys() -> None:
    made = environment.environment(MPI.COMM_WORLD)
    assert list(made) == ["blas", "dolfinx", "petsc", "ranks", "peak_rss_gb"]
    assert made["blas"] != environment.UNKNOWN
    assert str(made["petsc"]).startswith("3.")


def test_peak_memory_grows_with_allocations() -> None:
    before = environment.peak_rss_gb()
    held = np.ones(int((before + 0.2) * 1e9 / 8))
    assert environment.peak_rss_gb() >= held.nbytes * 1e-9 > before


def test_peak_memory_is_not_that_of_the_program_that_started_this_one() -> None:
    held = np.ones(300_000_000 // 8)
    code = "from contact_app.machine.environment import peak_rss_gb; print(peak_rss_gb())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 1e-9 * held.nbytes
