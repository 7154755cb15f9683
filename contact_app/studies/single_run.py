"""One run of this application for a study, in a process of its own.

``python -m contact_app.studies.single_run SCENE.yaml`` solves and prints ``summary.json`` in one
line; nothing is written unless the fields at the nodes are asked for (``--fields FILE.npz``, one
rank).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.refine.levels import with_levels
from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.boundaries import facets_of
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.studies.reference import Fields


def fields_of(solved: SolvedScene) -> Fields:
    """The answer at the nodes of all bodies, with their cells (one rank)."""
    nodes, model = solved.nodes, solved.model
    scene, partition = model.scene, model.partition
    cells, tags, facets = [], [], []
    for b in range(len(scene.bodies)):
        first = partition.first_node[b]
        mine = [s for s in partition.subdomains if s.body == b]
        cells.append(np.concatenate([s.nodes[s.reference.cells] for s in mine]) - first)
        tags.append(np.concatenate([s.reference.tags for s in mine]))
        touching = [np.zeros((0, mine[0].reference.facets.shape[1]), np.int64)]
        for contact in scene.touching:
            if contact.body == b:
                chosen = facets_of(scene, partition, b, contact.boundary)
                touching += [
                    s.nodes[s.reference.facets[rows]] - first
                    for s, rows in zip(partition.subdomains, chosen, strict=True)
                    if len(rows)
                ]
        facets.append(np.concatenate(touching))
    return Fields(
        points=nodes.points,
        displacement=nodes.displacement,
        pressure=nodes.contact_pressure,
        watched=~np.isnan(nodes.gap),
        first_node=partition.first_node,
        degree=np.array([body.degree for body in scene.bodies]),
        cell=np.array([body.mesh.cell for body in scene.bodies]),
        cells=cells,
        tags=tags,
        facets=facets,
    )


def main() -> None:
    """Run a scene and print its summary."""
    parser = argparse.ArgumentParser()
    parser.add_argument("config", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    parser.add_argument("--fields", type=Path)
    arguments = parser.parse_args()
    scene = build_scene(load(arguments.config, arguments.overrides))
    if scene.accuracy is None:
        solved = solve_scene(scene)
        summary = solved.summary
    else:
        refined = solve_to_accuracy(scene, solve_scene)
        solved = refined.solved
        summary = with_levels(solved.summary, refined)
    if arguments.fields:
        fields_of(solved).save(arguments.fields)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(summary), flush=True)


if __name__ == "__main__":
    main()
