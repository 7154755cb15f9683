"""The environment of a run: BLAS, releases of dolfinx and PETSc, ranks, memory.

Debian's packages keep the reference BLAS unless OpenBLAS is installed, and a dense product is then
a hundred times slower. numpy may bring a BLAS of its own, so the BLAS of PETSc is found among the
libraries mapped into this process.
"""

import re
import resource
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from mpi4py import MPI

REFERENCE = "reference BLAS"
UNKNOWN = "unknown"

#: Name of the BLAS by patterns of the paths of mapped libraries; the first match counts.
_FLAVOURS = (
    (r"/openblas-(pthread|openmp|serial)/", "OpenBLAS ({0})"),
    (r"/lib(?:scipy_)?openblas", "OpenBLAS"),
    (r"/libmkl_", "Intel MKL"),
    (r"/blis-(pthread|openmp|serial)/", "BLIS ({0})"),
    (r"/libblis", "BLIS"),
    (r"/atlas/", "ATLAS"),
    (r"/(?:blas/)?libblas\.so", REFERENCE),
)
_OPENBLAS_RELEASE = re.compile(r"/libopenblas[a-z]*-r([0-9.]+)\.so")


def blas_of(libraries: Iterable[str]) -> str:
    """Name the BLAS among the paths of mapped libraries.

    >>> blas_of(["/usr/lib/x86_64-linux-gnu/blas/libblas.so.3.11.0"])
    'reference BLAS'
    >>> blas_of(["/usr/lib/x86_64-linux-gnu/openblas-pthread/libblas.so.3"])
    'OpenBLAS (pthread)'
    """
    # A wheel's own copy (numpy.libs/…) serves that package, not PETSc.
    paths = [path for path in libraries if ".libs/" not in path]
    for pattern, name in _FLAVOURS:
        for path in paths:
            if match := re.search(pattern, path):
                release = next(filter(None, map(_OPENBLAS_RELEASE.search, paths)), None)
                if release and name.startswith("OpenBLAS"):
                    name = name.replace("OpenBLAS", f"OpenBLAS {release[1]}")
                return name.format(*match.groups())
    return UNKNOWN


@cache
def blas() -> str:
    """BLAS that PETSc uses in this process, such as ``OpenBLAS 0.3.21 (pthread)``."""
    from petsc4py import PETSc  # noqa: F401  (maps the libraries)

    try:
        maps = Path("/proc/self/maps").read_text()
    except OSError:
        return UNKNOWN
    # address, permissions, offset, device, inode, path
    rows = (line.split(maxsplit=5) for line in maps.splitlines())
    return blas_of(dict.fromkeys(row[5] for row in rows if len(row) == 6))


def slow_blas_warning(name: str | None = None) -> str | None:
    """Warning if the slow reference BLAS is in use, otherwise None.

    Parameters
    ----------
    name
        Name of the BLAS as from `blas`, which is the default.
    """
    if (blas() if name is None else name) != REFERENCE:
        return None
    return (
        "PETSc uses the reference BLAS, which is about a hundred times slower than OpenBLAS: "
        "install libopenblas0-pthread, or start through ./contact, which does."
    )


def peak_rss_gb(comm: MPI.Comm = MPI.COMM_SELF) -> float:
    """Largest memory that a rank of `comm` has held so far, in GB (collective)."""
    # the kernel's count since this program began; ru_maxrss includes the program that started it
    try:
        mark = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    except OSError:
        mark = None
    kibibytes = int(mark[1]) if mark else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(comm.allreduce(kibibytes * 1024e-9, op=MPI.MAX))


def environment(comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, str | int | float]:
    """``environment`` of ``summary.json`` (collective)."""
    import dolfinx
    from petsc4py import PETSc

    return {
        "blas": blas(),
        "dolfinx": str(dolfinx.__version__),
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "ranks": comm.size,
        "peak_rss_gb": round(peak_rss_gb(comm), 3),
    }
