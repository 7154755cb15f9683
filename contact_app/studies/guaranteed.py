"""The guaranteed bound compared with the error and its estimate.

    python -m contact_app.studies.guaranteed

The error is 2 (J(u_h) - J(u)) as in `effectivity`, J(u) extrapolated from the three finest meshes;
the bound does not use it. The effectivity of the bound is proved to be at least 1. Seconds are
those of the whole solve and of the bound alone.
"""

import time
from collections.abc import Iterator

from mpi4py import MPI

from contact_app.accuracy.guarantee.guarantee import guarantee
from contact_app.run.solve import solve_scene
from contact_app.studies.effectivity import TOLERANCE, Case, aitken

CASES = (
    Case("paper_cube", "hexahedron", (5, 10, 20, 40), True),
    Case("paper_cube", "tetrahedron", (5, 10, 20), True),
    Case("flat_punch", "quadrilateral", (8, 16, 32, 64, 128), True),
    Case("flat_punch", "triangle", (8, 16, 32, 64, 128), True),
    Case("cantilever", "quadrilateral", (8, 16, 32, 64, 128), True),
    Case("cantilever", "triangle", (8, 16, 32, 64, 128), True),
)


def table(cases: tuple[Case, ...] = CASES) -> Iterator[str]:
    """Rows of a table for a page."""
    yield (
        "| scene | cell | cells | unknowns | error | estimate | guaranteed bound | bound / error | "
        "residual of equilibrium | seconds of the solve | of the bound |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for case in cases:
        rows = []
        for cells in case.meshes:
            begin = time.perf_counter()
            scene = case.scene_of(cells, f"solver.tolerance={TOLERANCE}")
            solved = solve_scene(scene, MPI.COMM_SELF)
            middle = time.perf_counter()
            bound = guarantee(solved.model, solved.solution)
            seconds = (middle - begin, time.perf_counter() - middle)
            energy = float(solved.summary["solution"]["energy"])
            estimate = solved.accuracy.discretisation
            rows.append((cells, solved.model.dofs, energy, estimate, bound, seconds))
        reference = aitken([energy for _, _, energy, *_ in rows])
        for cells, dofs, energy, estimate, bound, seconds in rows:
            if bound.bound is None:
                raise RuntimeError(f"{case.scene}: {bound}")
            error = (2.0 * (energy - reference)) ** 0.5 / bound.norm
            yield (
                f"| {case.scene} | {case.cell} | {cells} | {dofs:,} | {100 * error:.2f} % | "
                f"{100 * estimate:.2f} % | {100 * bound.bound:.2f} % | {bound.bound / error:.2f} | "
                f"{bound.residual:.0e} | {seconds[0]:.2f} | {seconds[1]:.2f} |"
            )


if __name__ == "__main__":
    for line in table():
        print(line, flush=True)
