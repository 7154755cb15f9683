"""One run of a study: this application or a method of PETSc in a process of its own.

    python -m contact_app.studies.single_run SCENE.yaml [--method METHOD] [--set KEY=VALUE …]
        [--tolerance T] [--petsc KEY=VALUE …] [--fields FILE.npz] [--stages [--once]]

Solves the scene and prints one line of JSON. By this application it is ``summary.json`` with the
processor seconds of the first rank, imports left out; method and tolerance are those of the scene
unless METHOD is one of `OWN_METHODS`. By one of `peers.METHODS` it is its row. With ``--stages`` it
is the row of `part_run` for either. ``--fields`` writes the fields at the nodes. A scene with load
cases is solved with its last case.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from contact_app.accuracy.refine.levels import with_levels
from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.model import Model
from contact_app.run.solve import solve_scene
from contact_app.studies.last_case import scene_of
from contact_app.studies.peer_fields import fields_of_peer
from contact_app.studies.peers import METHODS, solve
from contact_app.studies.reference import Fields

OWN_METHODS = ("primal", "active-set", "auto")
"""Methods of this application."""


def fields_of(solved: SolvedScene) -> Fields | None:
    """The solution at the nodes of all bodies, with their cells; on rank 0 only (collective)."""
    nodes, model = solved.nodes, solved.model
    at_nodes = nodes.points, nodes.displacement, nodes.contact_pressure, ~np.isnan(nodes.gap)
    gathered = model.comm.gather(
        (at_nodes, [_cells(model, b) for b in range(len(model.scene.bodies))])
    )
    if gathered is None:
        return None
    points, displacement, pressure, watched = (
        np.concatenate(part) for part in zip(*(rank[0] for rank in gathered), strict=True)
    )
    bodies = [
        [
            np.concatenate(part)
            for part in zip(*(rank[1][b] for rank in gathered if len(rank[1][b])), strict=True)
        ]
        for b in range(len(model.scene.bodies))
    ]
    cells, tags, facets = (list(part) for part in zip(*bodies, strict=True))
    return Fields(
        points=points,
        displacement=displacement,
        pressure=pressure,
        watched=watched,
        first_node=model.partition.first_node,
        degree=np.array([body.degree for body in model.scene.bodies]),
        cell=np.array([body.mesh.cell for body in model.scene.bodies]),
        cells=cells,
        tags=tags,
        facets=facets,
    )


def _cells(model: Model, body: int) -> tuple[NDArray, ...]:
    """Cells of a body on this rank, their tags and its contact facets; empty where it has none."""
    partition, first = model.partition, model.partition.first_node[body]
    of_body = [s for s in partition.subdomains if s.body == body]
    if not of_body:
        return ()
    cells = np.concatenate([s.nodes[s.reference.cells] for s in of_body]) - first
    tags = np.concatenate([s.reference.tags for s in of_body])
    touching = [np.zeros((0, of_body[0].reference.facets.shape[1]), np.int64)]
    for contact in model.scene.touching:
        if contact.body == body:
            chosen = model.geometry.facets_of(body, contact.boundary)
            touching += [
                s.nodes[s.reference.facets[rows]] - first
                for s, rows in zip(partition.subdomains, chosen, strict=True)
                if len(rows)
            ]
    return cells, tags, np.concatenate(touching)


def application(path: Path, overrides: Sequence[str]) -> tuple[dict[str, Any], SolvedScene]:
    """Summary and answer of this application (collective)."""
    began = time.process_time()
    scene = scene_of(path, overrides)
    if scene.accuracy is None:
        solved = solve_scene(scene)
        summary = solved.summary
    else:
        refined = solve_to_accuracy(scene, solve_scene)
        solved = refined.solved
        summary = with_levels(solved.summary, refined)
    return {**summary, "processor_seconds": time.process_time() - began}, solved


def main() -> None:
    """Run a scene and print its summary or row."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--method", choices=(*OWN_METHODS, *METHODS))
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    parser.add_argument("--tolerance", type=float, default=1e-8, help="of --method")
    parser.add_argument("--petsc", action="append", default=[], help="KEY=VALUE")
    parser.add_argument("--fields", type=Path, help="file for the fields at the nodes")
    parser.add_argument("--stages", action="store_true", help="seconds from the file, by stages")
    parser.add_argument("--once", action="store_true", help="no solve with the contact known")
    arguments = parser.parse_args()
    method, tolerance, overrides = arguments.method, arguments.tolerance, arguments.overrides
    if arguments.stages and method is None:
        parser.error("--stages needs a --method")
    for pair in arguments.petsc:
        PETSc.Options().setValue(*pair.split("=", 1))
    fields = None
    if arguments.stages:
        from contact_app.studies.part_run import row_of

        row = row_of(arguments.scene, overrides, method, tolerance, arguments.once)
    elif method in METHODS:
        scene = scene_of(arguments.scene, overrides)
        row, system, x = solve(scene, method, tolerance, nodal=True)
        if arguments.fields:
            fields = fields_of_peer(scene, system, x)
    else:
        if method is not None:
            overrides += [f"solver.method={method}", f"solver.tolerance={tolerance}"]
        row, solved = application(arguments.scene, overrides)
        if arguments.fields:
            fields = fields_of(solved)
    if fields is not None:
        fields.save(arguments.fields)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
