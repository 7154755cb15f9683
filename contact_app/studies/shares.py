"""What one step of conjugate gradients on an active set is made of: K⁺, B and Bᵀ, projections, S.

``python -m contact_app.studies.shares`` prints the table of docs/benchmarks/scaling.md:
the paper's cube with `decomposition: auto`, and in subdomains far smaller than that would choose.
Milliseconds are the least of `REPEATS`, on one rank.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from contact_app.model.model import build_model
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.studies.bench import config
from solver.contact.row_kinds import RowKind
from solver.tfeti.derived import with_active
from solver.tfeti.dual import DualProblem
from solver.tfeti.preconditioner import DualPreconditioner
from solver.tfeti.winkler import winkler_contact

REPEATS = 20
CASES = (
    ("hexahedron", 20, "auto"),
    ("hexahedron", 40, "auto"),
    ("hexahedron", 60, "auto"),
    ("tetrahedron", 24, "auto"),
    ("hexahedron", 100, "auto"),
    ("hexahedron", 40, "{subdomains: [10, 10, 10]}"),
)


@dataclass(frozen=True)
class Shares:
    """Milliseconds of one application each.

    Attributes
    ----------
    operator
        F = B K⁺ Bᵀ as a whole, of which `inverse` is K⁺ and `constraints` B and Bᵀ.
    projection
        P: B and Bᵀ once more, G's kernels and one coarse solve, which is `coarse` alone.
    preconditioner
        B S Bᵀ with one projection.
    """

    subdomains: int
    unknowns: int
    operator: float
    inverse: float
    constraints: float
    projection: float
    coarse: float
    preconditioner: float

    @classmethod
    def of(cls, problem: DualProblem) -> Shares:
        """Measure them on the initial active set of a solve."""
        if problem.coarse is None:
            raise ValueError("one body in one subdomain has no coarse problem")
        touching = winkler_contact(problem)
        problem = with_active(problem, touching)
        coarse = problem.coarse
        assert coarse is not None
        rng = np.random.default_rng(0)
        x, u = rng.standard_normal(problem.size), rng.standard_normal(problem.B.columns)
        x[(problem.kinds == RowKind.SUPPORT) & ~touching] = 0.0
        alpha, beta = rng.standard_normal(coarse.kernels), np.empty(coarse.kernels)
        image, forces, free = np.empty_like(x), np.empty_like(u), np.ones(problem.size, bool)
        preconditioner = DualPreconditioner(problem, math.inf)

        def constraints() -> None:
            problem.B.apply_transpose(x, forces)
            problem.B.apply(u, image)

        return cls(
            subdomains=sum(c.members for c in problem.classes),
            unknowns=sum(c.members * c.unknowns for c in problem.classes),
            operator=_least(lambda: problem.F.apply(x, image)),
            inverse=_least(lambda: problem.F.solve_interface(u, forces)),
            constraints=_least(constraints),
            projection=_least(lambda: coarse.project(x, image)),
            coarse=_least(lambda: coarse.solve(alpha, beta)),
            preconditioner=_least(lambda: preconditioner.apply(x, free, image)),
        )


def _least(work: Callable[[], None]) -> float:
    """Milliseconds of the fastest of some repetitions."""
    work()
    taken = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        work()
        taken.append(time.perf_counter() - began)
    return 1e3 * min(taken)


def table() -> Iterator[str]:
    """Rows of the table."""
    yield (
        "| cells | subdomains | unknowns | F (ms) | of it K⁺ | of it B and Bᵀ | P (ms) "
        "| of it the coarse solve | preconditioner (ms) | P over F |"
    )
    yield "|---|" + "---:|" * 9
    for cell, n, decomposition in CASES:
        scene = build_scene(
            load(
                config(),
                [
                    f"bodies.0.mesh.box.cells=[{n},{n},{n}]",
                    f"bodies.0.mesh.box.cell={cell}",
                    f"decomposition={decomposition}",
                ],
            )
        )
        found = Shares.of(build_model(scene, MPI.COMM_SELF).problem)
        yield (
            f"| {n}³ {'bricks of tetrahedra' if cell == 'tetrahedron' else 'hexahedra'} "
            f"| {found.subdomains:,} | {found.unknowns:,} | {found.operator:.2f} "
            f"| {found.inverse:.2f} | {found.constraints:.2f} | {found.projection:.2f} "
            f"| {found.coarse:.2f} | {found.preconditioner:.2f} "
            f"| {found.projection / found.operator:.2f} |"
        )


if __name__ == "__main__":
    for row in table():
        print(row, flush=True)
