"""Cost of the coarse problem for many subdomains: measured on cubes of 2³ cells each.

The size and pattern of an active set's G W Gᵀ depend only on the number of subdomains, not on their
cells. The study therefore uses the smallest subdomains that have nodes inside their faces. ``python
-m contact_app.studies.coarse`` prints the table of docs/benchmarks/scaling.md.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from contact_app.model.model import build_model
from contact_app.studies.cube import cube_scene


@dataclass(frozen=True)
class CoarseCost:
    """Cost of one coarse problem: seconds to factor and to solve, entries of G W Gᵀ."""

    subdomains: int
    unknowns: int
    entries: int
    factor: float
    solve: float


def measure(edge: int, comm: MPI.Intracomm = MPI.COMM_WORLD) -> CoarseCost:
    """Factor and solve the coarse problem of an active set of edge³ subdomains (collective)."""
    coarse = build_model(cube_scene(2 * edge, edge), comm).problem.coarse
    if coarse is None:
        raise ValueError("one subdomain has no coarse problem")
    began = time.perf_counter()
    again = coarse.weighted(np.ones(coarse.size))
    factor = time.perf_counter() - began
    rhs, out = np.ones(coarse.kernels), np.empty(coarse.kernels)
    again.solve(rhs, out)
    repeats = 20
    began = time.perf_counter()
    for _ in range(repeats):
        again.solve(rhs, out)
    solve = (time.perf_counter() - began) / repeats
    return CoarseCost(edge**3, comm.allreduce(coarse.kernels), again.entries, factor, solve)


if __name__ == "__main__":
    print("| subdomains | unknowns | entries of G W Gᵀ | factor (s) | solve (ms) |")
    print("|---|---|---|---|---|")
    for edge in (4, 6, 8, 10, 14, 18, 22):
        cost = measure(edge)
        if MPI.COMM_WORLD.rank == 0:
            print(
                f"| {cost.subdomains:,} | {cost.unknowns:,} | {cost.entries:,} | {cost.factor:.2f} "
                f"| {1e3 * cost.solve:.1f} |",
                flush=True,
            )
