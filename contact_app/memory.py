"""What a scene needs in memory, estimated before anything is allocated.

Peak memory of a run, fitted to the resident size of runs of the cube with 10³ to 60³ hexahedra,
decomposed and as one subdomain, to within a factor of two:

    0.2 GB + 0.6 kB · unknowns + 2.4 kB · rows of B + factors,

a sparse Cholesky factor of n unknowns and what is made on the way taking 270 bytes · n^(4/3) in
space and 60 bytes · n log₂ n in the plane. Congruent subdomains share one factor.
"""

from __future__ import annotations

import math

BASE_BYTES = 0.2e9
BYTES_PER_DOF = 600.0
BYTES_PER_ROW = 2400.0

ROWS_PER_DOF = 0.25
"""Rows of B per unknown where nothing better is known: subdomains of about 1000 nodes."""


def needed_bytes(
    dofs: float, rows: float | None = None, factors: tuple[tuple[float, int], ...] = ()
) -> float:
    """Estimate for a scene.

    Parameters
    ----------
    dofs
        Undecomposed degrees of freedom.
    rows
        Rows of B; a share of `dofs` unless given.
    factors
        Unknowns and dimension of each subdomain that has a factor of its own.
    """
    rows = ROWS_PER_DOF * dofs if rows is None else rows
    factored = sum(factor_bytes(unknowns, dimension) for unknowns, dimension in factors)
    return BASE_BYTES + BYTES_PER_DOF * dofs + BYTES_PER_ROW * rows + factored


def factor_bytes(unknowns: float, dimension: int) -> float:
    """Memory of one sparse factor."""
    if dimension == 3:
        return float(270.0 * unknowns ** (4.0 / 3.0))
    return 60.0 * unknowns * math.log2(max(unknowns, 2.0))


def available_bytes() -> float:
    """Memory the machine has left; infinite where that cannot be known."""
    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return float(line.split()[1]) * 1024.0
    except OSError:
        pass
    return float("inf")
