"""The memory that a scene needs, estimated before anything is allocated.

Peak memory of a run, fitted to the resident size of runs of the cube with 10³ to 120³ hexahedra,
decomposed and as one subdomain, to within a factor of two:

    0.2 GB + 0.15 kB · unknowns + 0.9 kB · rows of B + factors.

A sparse Cholesky factor of n unknowns, with temporary memory, takes 270 bytes · n^(4/3) in space
and 60 bytes · n log₂ n in the plane, plus 0.35 MB for its class. Congruent subdomains share one
factor. If the answer is evaluated on the surface alone, there are no fields at all nodes and cells,
and an unknown takes 0.05 kB (measured at 81,812,703).
"""

import contextlib
import ctypes
import math
import resource
from pathlib import Path

BASE_BYTES = 0.2e9
BYTES_PER_DOF = 150.0
BYTES_PER_ROW = 900.0
BYTES_PER_CLASS = 0.35e6
"""Memory of a class, fitted to runs of cubes and scenes (docs/benchmarks/speed.md)."""

SMALL_BYTES = 0.5e9
"""Resident memory of a process up to which it keeps what it has freed."""

CONTROL_GROUPS = Path("/sys/fs/cgroup")

ROWS_PER_DOF = 0.25
"""Rows of B per unknown by default: for subdomains of about 1000 nodes."""


def needed_bytes(
    dofs: float, rows: float | None = None, factors: tuple[tuple[float, int], ...] = ()
) -> float:
    """Estimated memory of a scene in bytes.

    Parameters
    ----------
    dofs
        Undecomposed degrees of freedom.
    rows
        Rows of B; a share of `dofs` by default.
    factors
        Unknowns and dimension of each subdomain with a separate factor.
    """
    rows = ROWS_PER_DOF * dofs if rows is None else rows
    factored = sum(factor_bytes(unknowns, dimension) for unknowns, dimension in factors)
    return BASE_BYTES + BYTES_PER_DOF * dofs + BYTES_PER_ROW * rows + factored


def factor_bytes(unknowns: float, dimension: int) -> float:
    """Memory of one sparse factor, and of the class that has it."""
    if dimension == 3:
        return BYTES_PER_CLASS + float(270.0 * unknowns ** (4.0 / 3.0))
    return BYTES_PER_CLASS + 60.0 * unknowns * math.log2(max(unknowns, 2.0))


def give_back() -> None:
    """Return freed memory to the system; glibc would keep freed blocks of moderate size.

    Building a model frees several times the memory that it keeps. A small process keeps the memory:
    asking the system for it again takes a twentieth of the time of a part of 30,000 unknowns.
    """
    if 1024.0 * _field(Path("/proc/self/status"), "VmRSS:") < SMALL_BYTES:
        return
    with contextlib.suppress(OSError, AttributeError):  # another C library: nothing to do
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def available_bytes() -> float:
    """Memory that this process may still take, in bytes; infinite if unknown.

    The least of: free memory of the machine, the limit of a container or service manager (control
    groups, version 2 or 1), and the limit on address space (``ulimit -v``).
    """
    return min(_machine(), control_group(), _address_space())


def _machine() -> float:
    return 1024.0 * _field(Path("/proc/meminfo"), "MemAvailable:")


def _address_space() -> float:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return math.inf
    used = 1024.0 * _field(Path("/proc/self/status"), "VmSize:")
    return max(limit - (used if math.isfinite(used) else 0.0), 0.0)


def control_group(root: Path = CONTROL_GROUPS, process: Path = Path("/proc/self/cgroup")) -> float:
    """The memory that the control groups of this process still allow."""
    least = math.inf
    for line in _text(process).splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        base, limit, used = (
            (root / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes")
            if controllers
            else (root, "memory.max", "memory.current")
        )
        group = base / path.strip("/")
        for here in (group, *group.parents):
            allowed, used_bytes = _text(here / limit).strip(), _text(here / used).strip()
            if allowed.isdigit() and used_bytes.isdigit():
                cached = _field(here / "memory.stat", "inactive_file")  # freed when needed
                cached = cached if math.isfinite(cached) else 0.0
                least = min(least, max(float(allowed) - float(used_bytes) + cached, 0.0))
            if here == base:
                break
    return least


def _field(path: Path, name: str) -> float:
    """Number after a word at the start of a line; infinite if there is none."""
    for line in _text(path).splitlines():
        words = line.split()
        if len(words) > 1 and words[0] == name:
            return float(words[1])
    return math.inf


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
