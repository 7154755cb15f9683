"""One part solved by one method: seconds of each stage (``single_run --stages``).

Seconds count from the mesh file to the solution, without start-up and
without later stages (error estimate, stresses, files):

``read``
    This application: the scene with its meshes, checked and repaired. PETSc's methods: meshio reads
    the files only.
``assembly``
    Everything up to the first iteration without the preconditioner. PETSc's methods: dolfinx makes
    the mesh and assembles stiffness, load and bounds; a first assembly, which compiles forms, is
    not counted.
``solve``
    Preconditioners and iterations.

Linear methods solve the part glued at its contacts: an unknown with a bound is held at its bound,
and one mesh goes through all bodies (``fused/`` beside their mesh, `contact_app.studies.fused`).
No other method of PETSc takes several bodies.
"""

import time
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

import meshes.repair  # noqa: F401 - the application imports it at its first use: part of start-up
import solver.primal.by_active_sets  # noqa: F401 - as above
from contact_app.machine.environment import peak_rss_gb
from contact_app.run.solve import solve_scene
from contact_app.scene.scene import Scene
from contact_app.scene.yaml_reader import read
from contact_app.studies.fused import fused_scene, mesh_of
from contact_app.studies.last_case import scene_of
from contact_app.studies.peers import METHODS, solve
from contact_app.studies.undecomposed import UnsuitableError, WholeSystem, assemble
from solver.contact.solution import Guess
from solver.driver import solve as solve_problem


def row_of(
    path: Path, overrides: Sequence[str], method: str, tolerance: float, once: bool = False
) -> dict[str, Any]:
    """The row of a part and a method, of `single_run.OWN_METHODS` or `peers.METHODS` (collective).

    Raises
    ------
    UnsuitableError
        The method cannot solve the scene.
    """
    if method in METHODS:
        row = peer(path, overrides, method, tolerance)
    else:
        row = application(path, overrides, method, tolerance, once)
    memory = float(MPI.COMM_WORLD.allreduce(peak_rss_gb()))
    return row | {"memory": memory, "ranks": MPI.COMM_WORLD.size}


class _Clock:
    """Wall and CPU seconds since its creation; CPU seconds are summed over ranks."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def seconds(self) -> tuple[float, float]:
        """Wall and CPU seconds (collective)."""
        wall, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        return wall, float(MPI.COMM_WORLD.allreduce(cpu))


def application(
    path: Path, overrides: Sequence[str], method: str, tolerance: float, once: bool = False
) -> dict[str, Any]:
    """Solve a scene with this application, and unless `once` again with the contact known."""
    changes = [*overrides, f"solver.method={method}", f"solver.tolerance={tolerance}"]
    clock = _Clock()
    scene = scene_of(path, changes, MPI.COMM_WORLD)
    reading, cpu_reading = clock.seconds()
    clock = _Clock()
    solved = solve_scene(scene, MPI.COMM_WORLD)
    whole, cpu = clock.seconds()
    stages, solution = solved.timings.seconds, solved.solution
    after = sum(stages.get(name, 0.0) for name in ("estimate", "output"))
    row = {
        "unknowns": solved.model.dofs,
        "used": solved.summary["solver"]["method"],
        "read": reading,
        "assembly": stages["setup"] + stages["assembly"] + stages["factorization"],
        "solve": stages["solve"],
        "seconds": reading + whole - after,
        "cpu": cpu_reading + cpu * (whole - after) / whole,
        "iterations": solution.counts.hessian,
        "converged": bool(solution.certificate.passed),
        "energy": solved.summary["solution"]["energy"],
    }
    if row["used"] == "primal" and not once:
        pressing = np.where(solution.multiplier > 0.0, solution.multiplier, 0.0)
        again = solve_problem(solved.model.problem, scene.solver, start=Guess(pressing))
        row["known"] = again.counts.hessian
    return row


def peer(path: Path, overrides: Sequence[str], method: str, tolerance: float) -> dict[str, Any]:
    """Solve a scene with a method of PETSc.

    Raises
    ------
    UnsuitableError
        The method cannot solve the scene.
    """
    meshes = [body["mesh"] for body in _bodies(path, overrides)]
    files = {path.parent / mesh["file"] for mesh in meshes if "file" in mesh}
    scene = scene_of(path, [*overrides, "solver.method=primal"])
    used = method
    if len(scene.bodies) > 1:
        if METHODS[method].contact:
            raise UnsuitableError(f"it has {len(scene.bodies)} bodies")
        fused = mesh_of(next(iter(files)))
        if not fused.is_file():
            raise UnsuitableError("no mesh through its bodies is drawn")
        files, used = {fused}, f"{method}, fused"
        scene = fused_scene(path, fused, scene.bodies[0].degree)
    return {"used": used, **_of_one_body(scene, method, tolerance, *_reading(files))}


def _reading(files: Collection[Path]) -> tuple[float, float]:
    """Wall and CPU seconds that meshio takes for some files."""
    clock = _Clock()
    for file in files:
        meshio.read(file)
    return clock.seconds()


def _of_one_body(
    scene: Scene, method: str, tolerance: float, reading: float, cpu_reading: float
) -> dict[str, Any]:
    """Solve a scene of one body with a method of PETSc."""
    comm = MPI.COMM_WORLD
    assemble(scene, comm, nodal=not METHODS[method].contact)
    clock = _Clock()
    change = None if METHODS[method].contact else hold_bounds
    row, _, _ = solve(scene, method, tolerance, comm, change)
    seconds, cpu = clock.seconds()
    return {
        "unknowns": row["dofs"],
        "read": reading,
        "assembly": seconds - row["solve_seconds"],
        "solve": row["solve_seconds"],
        "seconds": reading + seconds,
        "cpu": cpu_reading + cpu,
        "iterations": row["applications"],
        "converged": row["converged"],
        "energy": row["energy"],
    }


def hold_bounds(system: WholeSystem) -> None:
    """Hold unknowns with a bound at the bound, in place (collective).

    Without contact a part may have no support at all.
    """
    x = system.load.duplicate()
    upper, lower = system.upper.array, system.lower.array
    x.array[:] = np.where(upper < 1e300, upper, np.where(lower > -1e300, lower, 0.0))
    rows = np.unique(system.contact) + system.load.getOwnershipRange()[0]
    scale = system.matrix.getDiagonal().sum() / system.dofs
    system.matrix.zeroRowsColumns(rows.astype(PETSc.IntType), diag=scale, x=x, b=system.load)


def _bodies(path: Path, overrides: Sequence[str]) -> list[dict[str, Any]]:
    """The bodies of a file with the mesh files of overrides."""
    bodies: list[dict[str, Any]] = read(path)[0]["bodies"]
    for override in overrides:
        key, _, value = override.partition("=")
        parts = key.split(".")
        if parts[0] == "bodies" and parts[2:] == ["mesh", "file"]:
            bodies[int(parts[1])]["mesh"]["file"] = value
    return bodies
