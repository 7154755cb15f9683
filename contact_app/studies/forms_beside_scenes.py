"""Cost of `ContactProblem` compared with a scene on the same mesh.

``python -m contact_app.studies.forms_beside_scenes [CELLS]`` presses a cube beside a rigid wall,
CELLS bricks along each edge (28 unless given) cut into tetrahedra whose inner nodes are moved at
random. It prints processor seconds of the form, of a second solve of the same form, and of the
scene by its default method and by multigrid. The runs take turns, so that other work on the machine
affects all of them alike. The compilation of forms and the creation of dolfinx's mesh are not
counted; a scene in addition reads its mesh from a file and estimates the error of the mesh. Further
tables have degree 2 and half as many cells along an edge; friction at the wall; and the bricks
themselves, a regular mesh that both cut into congruent sub-boxes, without and with friction. Under
``mpirun`` only the last two are printed, with the processor seconds of all ranks.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
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
from contact_app.studies.perturbed import perturbed_box, write_box
from meshes import dolfinx_compat

TURNS = 3

YOUNG, POISSON, PRESSURE = 2e5, 0.33, 465.0

FRICTION = {"coulomb": 0.3}


def form_problem(
    mesh: Any, degree: int = 1, friction: dict[str, float] | None = None
) -> ContactProblem:
    """The cube as forms."""
    V = dolfinx_compat.vector_space(mesh, degree, 3)
    foot = fem.locate_dofs_topological(V, 2, _facets(mesh, 2, 0.0))
    wall = dolfinx_compat.meshtags(mesh, 2, _facets(mesh, 0, 1.0), 1)
    contact = Contact(wall, 1, Plane((1, 0, 0), (-1, 0, 0)), friction=friction)
    bcs = [fem.dirichletbc(np.zeros(3), foot, V)]
    return ContactProblem(*_forms(V), bcs, [contact])


def _facets(mesh: Any, axis: int, place: float) -> NDArray[np.int32]:
    """Facets of the surface on a plane."""
    d = mesh.topology.dim
    return np.asarray(
        dolfinx.mesh.locate_entities_boundary(mesh, d - 1, lambda x: np.isclose(x[axis], place))
    )


def _forms(V: Any) -> tuple[Any, Any]:
    """Elasticity, and a traction on the top."""
    mesh = V.mesh
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    lam = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON)
    strain, test = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    stress = lam * ufl.tr(strain) * ufl.Identity(3) + YOUNG / (1 + POISSON) * strain
    tags = dolfinx_compat.meshtags(mesh, 2, _facets(mesh, 2, 1.0), 1)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    load = ufl.inner(fem.Constant(mesh, np.array((0.0, 0.0, -PRESSURE))), v) * ds(1)
    return ufl.inner(stress, test) * ufl.dx(metadata={"quadrature_degree": 2}), load


def scene_of(
    mesh: dict[str, Any], degree: int = 1, friction: dict[str, float] | None = None
) -> dict[str, Any]:
    """The cube as a scene, with the body's `mesh`."""
    sides = {"foot": "z < 1e-9", "top": "z > 1 - 1e-9", "wall": "x > 1 - 1e-9"}
    plane = {"point": [1, 0, 0], "normal": [-1, 0, 0]}
    rough = {} if friction is None else {"friction": friction}
    return {
        "dimension": 3,
        "bodies": [{
            "name": "cube", "mesh": mesh, "degree": degree,
            "material": {"young": YOUNG, "poisson": POISSON},
            "boundaries": {side: {"where": where} for side, where in sides.items()},
        }],
        "conditions": [{"on": "cube.foot", "displacement": [0, 0, 0]},
                       {"on": "cube.top", "traction": [0, 0, -PRESSURE]}],
        "contacts": [{"on": "cube.wall", "obstacle": {"plane": plane}, **rough}],
    }  # fmt: skip


def measure(
    cells: int, turns: int = TURNS, degree: int = 1, friction: dict[str, float] | None = None
) -> dict[str, dict[str, float]]:
    """Processor seconds (the minimum over all turns), operator applications and energies.

    This runs on one rank.
    """
    cube = perturbed_box(cells)
    mesh = dolfinx_compat.create_mesh(cube.cells, cube.points, cube.cell)
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "cube.vtu"
        write_box(file, cells)
        scene = scene_of({"file": file}, degree, friction)
        return _by_turns(form_problem(mesh, degree, friction), scene, turns)


def measure_bricks(
    cells: int, turns: int = TURNS, friction: dict[str, float] | None = None
) -> dict[str, dict[str, float]]:
    """The case of a regular mesh (collective)."""
    box = {"lower": [0, 0, 0], "upper": [1, 1, 1], "cells": [cells] * 3}
    kind = dolfinx.mesh.CellType.hexahedron
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_WORLD, cells, cells, cells, kind)
    scene = scene_of({"box": box}, friction=friction)
    return _by_turns(form_problem(mesh, friction=friction), scene, turns)


def _by_turns(
    problem: ContactProblem, scene: dict[str, Any], turns: int
) -> dict[str, dict[str, float]]:
    def solved(made: ContactProblem) -> dict[str, Any]:
        made.solve()
        return made.summary

    parts = problem.a, problem.L, problem.bcs, problem.contacts
    ways: dict[str, Callable[[], dict[str, Any]]] = {
        "form": lambda: solved(ContactProblem(*parts)),
        "form, solved again": lambda: solved(problem),
        "scene": lambda: solve(scene).summary,
        "scene, multigrid": lambda: solve(scene | {"solver": {"method": "primal"}}).summary,
    }
    results: dict[str, dict[str, float]] = {}
    for way in ways.values():
        way()  # compiles the forms
    for _ in range(turns):
        for name, way in ways.items():
            began = time.process_time()
            summary = way()
            spent = MPI.COMM_WORLD.allreduce(time.process_time() - began)
            before = results.get(name, {}).get("seconds", np.inf)
            results[name] = {
                "seconds": min(spent, before),
                "applications": summary["solver"]["hessian_multiplications"],
                "energy": summary["solution"]["energy"],
                "dofs": summary["mesh"]["dofs"],
            }
    return results


def main() -> None:
    """Print all tables, or those of bricks under mpirun."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cells", type=int, nargs="?", default=28, help="along each edge")
    cells = parser.parse_args().cells
    bricks = {
        "bricks": partial(measure_bricks, cells),
        "bricks, friction": partial(measure_bricks, cells, friction=FRICTION),
    }
    tetrahedra = {
        "tetrahedra": partial(measure, cells),
        "quadratic tetrahedra": partial(measure, cells // 2, degree=2),
        "tetrahedra, friction": partial(measure, cells, friction=FRICTION),
    }
    comm = MPI.COMM_WORLD
    for title, table in (bricks if comm.size > 1 else tetrahedra | bricks).items():
        results = table()
        if comm.rank == 0:
            print(_as_text(title, results), flush=True)


def _as_text(title: str, results: dict[str, dict[str, float]]) -> str:
    lines = [f"{title:20s} {'unknowns':>9s} {'seconds':>8s} {'applications':>12s} {'energy':>16s}"]
    for name, row in results.items():
        lines.append(
            f"{name:20s} {row['dofs']:9,.0f} {row['seconds']:8.2f} "
            f"{row['applications']:12.0f} {row['energy']:16.10g}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
