"""Warnings of the certificate where the estimate from a single mesh cannot be trusted.

A stress recovered on few cells is fitted to samples that all have the same error. In bending,
first-order cells are too stiff by a factor, and the estimate, relative to this stiff solution, may
be one third where the error is twice the solution. The mesh itself gives no sign of this; another
mesh does, and a run to an accuracy solves one (`contact_app.accuracy.agreement`). A run on one mesh
gives this warning.
"""

from collections.abc import Sequence

from contact_app.results.percent import percent
from contact_app.scene.bodies import Body, Box

FEWEST = 4
"""Cells along an edge, times the degree, below which estimates are not trusted. On plane random
scenes with fewer cells (docs/benchmarks/accuracy.md) the error is up to 6 times the estimate."""

SMALL = 0.1
"""Estimated relative error below which an estimate on few cells is trusted: the cells then
represent the stresses well."""


def few_cells(bodies: Sequence[Body], estimate: float) -> list[str]:
    """Warnings of bodies whose cells are too few for the estimate of their error.

    Parameters
    ----------
    estimate
        Estimated relative error of the mesh; NaN without an estimate.
    """
    if not estimate > SMALL:
        return []
    warnings = []
    for body in bodies:
        few = _few_axes(body)
        if len(few) >= body.mesh.dimension - 1:  # a plate may have a single layer
            counts = " and ".join(f"{n} along {axis}" for axis, n in few.items())
            warnings.append(
                f"{body.name}: its cells are few, {counts}: so few may be far too stiff in "
                f"bending and near ν = 0.5 (they lock), and the estimated error of the mesh, "
                f"{percent(estimate)}, may be far too small; use at least "
                f"{FEWEST // body.degree} along every edge, or accuracy: to refine until two "
                "meshes agree"
            )
    return warnings


def _few_axes(body: Body) -> dict[str, int]:
    """Edges of a box with too few cells; a symmetric half counts as the whole."""
    if not isinstance(body.mesh, Box):
        return {}
    mirrored = {cut[0] for cut in body.cuts}
    counts = {
        axis: n * (2 if axis in mirrored else 1)
        for axis, n in zip("xyz", body.mesh.cells, strict=False)
    }
    return {axis: n for axis, n in counts.items() if n * body.degree < FEWEST}
