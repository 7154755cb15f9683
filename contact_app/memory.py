"""What a mesh needs in memory, estimated before anything is allocated."""

from __future__ import annotations

BYTES_PER_DOF = 800.0
"""Meshes, vectors, fields and shared factors of congruent subdomains, measured with `run`."""

BASE_BYTES = 0.2e9


def needed_bytes(dofs: float) -> float:
    """Estimate for a scene of so many degrees of freedom."""
    return BASE_BYTES + BYTES_PER_DOF * dofs


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
