"""The scene that a study solves if a file has load cases: the last case."""

from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene


def scene_of(path: Path, overrides: Sequence[str] = (), comm: MPI.Intracomm | None = None) -> Scene:
    """The scene of a file; with load cases its last case (collective if ranks are given)."""
    scene = build_scene(load(path, overrides), comm=comm)
    return scene.under(scene.cases[-1]) if scene.cases else scene
