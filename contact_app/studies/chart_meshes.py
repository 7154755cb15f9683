"""Speed against accuracy on given meshes of one part, one directory for each mesh.

The same chart as with halved cells (`contact_app.studies.chart`), for parts whose shape halving
does not preserve. This application at both degrees and PETSc's contact solvers run on each mesh,
all with a rank on each core. At degree 2 PETSc's solvers bound the gaps at nodes, while this
application bounds averages of gaps around vertices. The reference has degree 2 on three meshes,
cells half as long from one to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from contact_app.errors import ConfigurationError
from contact_app.scene.scene import Scene
from contact_app.studies.chart import DEGREES, USUAL, Sweep, Variant
from contact_app.studies.last_case import scene_of
from contact_app.studies.parts_meshes import Meshes
from contact_app.studies.peers import METHODS

PEERS = ("tao-bnls", "tao-bntr", "snes-vi")
REFERENCES = 3


@dataclass(frozen=True)
class MeshVariant(Variant):
    """One way to run the scene on a mesh of a directory."""

    settings: tuple[str, ...] = ()
    """Changes of the scene's file; empty where the mesh does not matter."""
    mesh: str = ""
    """Name of the directory."""

    @property
    def kind(self) -> "MeshVariant":
        """Key of a series; if a run takes too long, finer meshes of its series are left out."""
        return replace(self, settings=(), mesh="")

    def overrides(self, scene: Scene, refine: Sequence[int] = ()) -> list[str]:
        """Changes of the scene's file."""
        return list(self.settings)

    def describe(self, scene: Scene) -> str:
        """A short description."""
        return f"{self.name}, degree {self.degree}, mesh {self.mesh}, {self.tolerance}"


def plan_meshes(
    config: Path,
    overrides: Sequence[str],
    meshes: Sequence[Path],
    references: Sequence[Path],
    largest: int = 250_000,
    peers: bool = True,
) -> Sweep:
    """Runs of a chart on meshes from coarse to fine.

    Parameters
    ----------
    meshes
        Directories with the mesh files of the scene, with the file names of the scene.
    references
        Three such directories; cells are half as long from one to the next.
    largest
        Largest number of unknowns of a mesh with a degree.

    Raises
    ------
    ConfigurationError
        The references are not three, a directory is missing, or no mesh is small enough.
    """
    if len(references) != REFERENCES:
        raise ConfigurationError(f"a chart of meshes needs {REFERENCES} references, coarse to fine")
    for directory in (*meshes, *references):
        if not directory.is_dir():
            raise ConfigurationError(f"{directory}: there is no such directory")
    scene = scene_of(config, overrides)
    left_out = []
    methods = [Variant(Fraction(1), "").method]
    if peers and len(scene.bodies) > 1:
        left_out.append("peers: they take scenes of one body")
    elif peers:
        methods += [name for name in PEERS if METHODS[name].contact]

    def variant(directory: Path, degree: int, method: str, tolerance: float) -> MeshVariant:
        settings = tuple(Meshes("", directory).overrides(config, degree))
        cell = scene.bodies[0].mesh.cell
        return MeshVariant(
            Fraction(1), cell, degree, tolerance, method, settings=settings, mesh=directory.name
        )

    variants = []
    for directory in meshes:
        bodies = scene_of(config, [*overrides, *Meshes("", directory).overrides(config, 1)]).bodies
        for degree in DEGREES:
            nodes = sum(body.mesh.nodes_of(degree) for body in bodies)
            if nodes * scene.dimension <= largest:
                variants += [variant(directory, degree, method, USUAL) for method in methods]
    if not variants:
        raise ConfigurationError(f"all meshes have more than {largest:,} degrees of freedom")
    finest = tuple(variant(place, 2, methods[0], min(1e-8, USUAL)) for place in references)
    return Sweep(scene, tuple(variants), finest, tuple(left_out), parallel=True)
