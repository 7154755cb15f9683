"""Cost of `ContactProblem` compared with a scene on the same mesh.

``python -m contact_app.studies.forms_beside_scenes [CELLS]`` presses a cube beside a rigid wall,
CELLS bricks along each edge (28 unless given) cut into tetrahedra whose inner nodes are moved at
random. It prints processor seconds by turns, so that other work on the machine does not count: of
the form, of a second solve of the same form, of the scene by its default method and by multigrid.
Forms compiled before are not counted, nor is the mesh of dolfinx; a scene reads its mesh from a
file and estimates the error of the mesh, too. A second table is of degree 2 on half as many cells
along an edge, a third of the bricks themselves, a regular mesh, of which both take congruent
sub-boxes. Under ``mpirun`` there is this one alone, with the
processor seconds of all ranks.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.forms import Contact, ContactProblem
from contact_app.run.answer import solve
from contact_app.scene.obstacles import Plane
from contact_app.studies.perturbed import perturbed_cube, write_cube
from meshes import dolfinx_compat

TURNS = 3

YOUNG, POISSON, PRESSURE = 2e5, 0.33, 465.0


def bricks(cells: int) -> Any:
    """A regular mesh of the unit cube."""
    kind = dolfinx.mesh.CellType.hexahedron
    return dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, cells, cells, cells, kind)


def form_problem(mesh: Any, degree: int = 1) -> ContactProblem:
    """The cube as forms."""
    V = dolfinx_compat.vector_space(mesh, degree, 3)

    def facets(axis: int, place: float) -> NDArray[np.int32]:
        return dolfinx.mesh.locate_entities_boundary(
            mesh, 2, lambda x: np.isclose(x[axis], place)
        )  # fmt: skip

    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    lam = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON)
    strain, test = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    stress = lam * ufl.tr(strain) * ufl.Identity(3) + YOUNG / (1 + POISSON) * strain
    top = dolfinx_compat.meshtags(mesh, 2, facets(2, 1.0), 1)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=top)
    push = fem.Constant(mesh, np.array([0.0, 0.0, -PRESSURE]))
    foot = fem.locate_dofs_topological(V, 2, facets(2, 0.0))
    wall = Contact(
        dolfinx_compat.meshtags(mesh, 2, facets(0, 1.0), 1), 1, Plane((1, 0, 0), (-1, 0, 0))
    )
    return ContactProblem(
        ufl.inner(stress, test) * ufl.dx(metadata={"quadrature_degree": 2}),
        ufl.inner(push, v) * ds(1),
        [fem.dirichletbc(np.zeros(3), foot, V)],
        [wall],
    )


def scene_of(mesh: dict[str, Any], method: str, degree: int = 1) -> dict[str, Any]:
    """The cube as a scene, with the body's `mesh`."""
    sides = {"foot": "z < 1e-9", "top": "z > 1 - 1e-9", "wall": "x > 1 - 1e-9"}
    plane = {"point": [1, 0, 0], "normal": [-1, 0, 0]}
    return {
        "dimension": 3,
        "bodies": [{
            "name": "cube", "mesh": mesh, "degree": degree,
            "material": {"young": YOUNG, "poisson": POISSON},
            "boundaries": {name: {"where": where} for name, where in sides.items()},
        }],
        "conditions": [{"on": "cube.foot", "displacement": [0, 0, 0]},
                       {"on": "cube.top", "traction": [0, 0, -PRESSURE]}],
        "contacts": [{"on": "cube.wall", "obstacle": {"plane": plane}}],
        "solver": {"method": method},
    }  # fmt: skip


def measure(cells: int, turns: int = TURNS, degree: int = 1) -> dict[str, dict[str, float]]:
    """Processor seconds (the fewest of some turns), operator applications and energies.

    On one rank.
    """
    cube = perturbed_cube(cells)
    mesh = dolfinx_compat.create_mesh(cube.cells, cube.points, cube.cell)
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "cube.vtu"
        write_cube(file, cells)
        return _by_turns(form_problem(mesh, degree), {"file": file}, turns, degree)


def measure_quadratic(cells: int, turns: int = TURNS) -> dict[str, dict[str, float]]:
    """The mesh of degree 2 with half as many cells along an edge."""
    return measure(cells // 2, turns, degree=2)


def measure_bricks(cells: int, turns: int = TURNS) -> dict[str, dict[str, float]]:
    """The case of a regular mesh (collective)."""
    box = {"lower": [0, 0, 0], "upper": [1, 1, 1], "cells": [cells] * 3}
    return _by_turns(form_problem(bricks(cells)), {"box": box}, turns)


def _by_turns(
    problem: ContactProblem, mesh: dict[str, Any], turns: int, degree: int = 1
) -> dict[str, dict[str, float]]:
    def solved(made: ContactProblem) -> dict[str, Any]:
        made.solve()
        return made.summary

    def anew() -> dict[str, Any]:
        return solved(ContactProblem(problem.a, problem.L, problem.bcs, problem.contacts))

    ways: dict[str, Callable[[], dict[str, Any]]] = {
        "form": anew,
        "form, solved again": lambda: solved(problem),
        "scene": lambda: solve(scene_of(mesh, "auto", degree)).summary,
        "scene, multigrid": lambda: solve(scene_of(mesh, "primal", degree)).summary,
    }
    found: dict[str, dict[str, float]] = {}
    for way in ways.values():
        way()  # compiles what is missing
    for _ in range(turns):
        for name, way in ways.items():
            began = time.process_time()
            summary = way()
            spent = MPI.COMM_WORLD.allreduce(time.process_time() - began)
            before = found.get(name, {}).get("seconds", np.inf)
            found[name] = {
                "seconds": min(spent, before),
                "applications": summary["solver"]["hessian_multiplications"],
                "energy": summary["solution"]["energy"],
                "dofs": summary["mesh"]["dofs"],
            }
    return found


def main() -> None:
    """Print three tables, or one under mpirun."""
    cells = int(sys.argv[1]) if len(sys.argv) > 1 else 28
    comm = MPI.COMM_WORLD
    tables = {
        "tetrahedra": measure,
        "quadratic tetrahedra": measure_quadratic,
        "bricks": measure_bricks,
    }
    for title in tables if comm.size == 1 else ("bricks",):
        found = tables[title](cells)
        if comm.rank == 0:
            print(_as_text(title, found), flush=True)


def _as_text(title: str, found: dict[str, dict[str, float]]) -> str:
    lines = [f"{title:20s} {'unknowns':>9s} {'seconds':>8s} {'applications':>12s} {'energy':>16s}"]
    for name, row in found.items():
        lines.append(
            f"{name:20s} {row['dofs']:9,.0f} {row['seconds']:8.2f} "
            f"{row['applications']:12.0f} {row['energy']:16.10g}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
