"""One run of this application for a study, in a process of its own.

``python -m contact_app.studies.point SCENE.yaml`` solves and prints ``summary.json`` in one line;
nothing is written unless the fields at the nodes are asked for (``--fields FILE.npz``, one rank).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from mpi4py import MPI

from contact_app.configuration import load
from contact_app.refinement import solve_to_accuracy, with_levels
from contact_app.run import solve_scene
from contact_app.scene import build_scene


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
        nodes, bodies = solved.nodes, solved.model.scene.bodies
        np.savez(
            arguments.fields,
            points=nodes.points,
            displacement=nodes.displacement,
            pressure=nodes.contact_pressure,
            watched=~np.isnan(nodes.gap),
            first_node=solved.model.partition.first_node,
            degree=np.array([body.degree for body in bodies]),
        )
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(summary), flush=True)


if __name__ == "__main__":
    main()
