"""Where the estimate of a single answer cannot be trusted: warnings of the certificate.

A stress recovered on a few cells is fitted to samples that all carry the same error: in bending
first-order cells answer too stiffly by a factor, and the estimate, relative to that stiff answer,
says a third where the error is twice the answer. Nothing on such a mesh tells; another mesh does,
which a run to an accuracy solves (`contact_app.accuracy.agreement`). For a run on one mesh there is
this warning.
"""

from __future__ import annotations

from contact_app.scene.bodies import Body, Box
from contact_app.scene.scene import Scene

FEWEST = 4
"""Cells along an edge, times the degree, below which estimates are not trusted: on the plane random
scenes of docs/guide/accuracy.md with fewer the error is up to 6 times the estimate."""

SMALL = 0.1
"""Estimated relative error below which the estimate on a few cells is trusted: stresses are nearly
those that the cells have."""


def few_cells(scene: Scene, estimate: float) -> list[str]:
    """Warnings of bodies whose cells are too few for the estimate of their error.

    Parameters
    ----------
    estimate
        Relative error of the mesh as estimated, NaN where nothing is.
    """
    if scene.accuracy is not None or not estimate > SMALL:
        return []
    warnings = []
    for body in scene.bodies:
        few = _few_axes(body)
        if len(few) >= scene.dimension - 1:  # a plate may have a single layer
            counts = " and ".join(f"{n} along {axis}" for axis, n in few.items())
            warnings.append(
                f"{body.name}: its cells are few, {counts}: so few may answer far too stiffly in "
                f"bending and near ν = 0.5 (they lock), and the estimated error of the mesh, "
                f"{100.0 * estimate:.2g} %, may be far too small; use at least "
                f"{FEWEST // body.degree} along every edge, or accuracy: to refine until two "
                "meshes agree"
            )
    return warnings


def _few_axes(body: Body) -> dict[str, int]:
    """Cells along the edges of a box that have too few; of a half as of the whole."""
    if not isinstance(body.mesh, Box):
        return {}
    mirrored = {cut[0] for cut in body.cuts}
    counts = {
        axis: n * (2 if axis in mirrored else 1)
        for axis, n in zip("xyz", body.mesh.cells, strict=False)
    }
    return {axis: n for axis, n in counts.items() if n * body.degree < FEWEST}
