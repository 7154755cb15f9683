"""What the method of a scene asks of its model."""

from __future__ import annotations

from mpi4py import MPI

from contact_app.scene.scene import Scene
from solver.tfeti.options import TotalFetiOptions


def is_undecomposed(scene: Scene) -> bool:
    """Whether the scene is solved for the displacements of bodies that are not cut."""
    return scene.solver.method == "primal"


def subdomains_of(scene: Scene, comm: MPI.Intracomm) -> None | int | tuple[int, ...]:
    """Subdomains as `meshes.decompose` takes them.

    A method for undecomposed bodies takes the fewest there can be: one for each body, and one for
    each rank.
    """
    asked = scene.decomposition.subdomains
    if asked is None and is_undecomposed(scene):
        return max(len(scene.bodies), comm.size)
    return asked


def feti_options(scene: Scene) -> TotalFetiOptions | None:
    """Whether subdomains are factored; None for the defaults."""
    return TotalFetiOptions(factored=False) if is_undecomposed(scene) else None
