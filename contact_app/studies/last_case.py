"""The scene that a study solves where a file has load cases: its last one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mpi4py import MPI

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene


def scene_of(path: Path, overrides: Sequence[str] = (), comm: MPI.Intracomm | None = None) -> Scene:
    """A scene; with load cases its last one (collective where ranks are given)."""
    scene = build_scene(load(path, overrides), comm=comm)
    return scene.under(scene.cases[-1]) if scene.cases else scene
