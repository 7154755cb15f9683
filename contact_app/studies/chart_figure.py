"""The figure of a chart: seconds against errors of all points, frontiers as lines."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contact_app.studies.reference import QUANTITIES
from contact_app.studies.tables import plotting

APPLICATION = "contact-app"
"""Beginning of the names of this application's points."""


def is_application(row: dict[str, Any]) -> bool:
    """Whether a point is this application's."""
    return str(row["method"]).startswith(APPLICATION)


TITLES = {
    "energy": "relative error in energy norm",
    "displacement": "relative error of displacements (root mean square)",
    "pressure": "relative error of contact pressures (root mean square)",
}
REFINED = "D"
MARKERS = {"hexahedron": "s", "tetrahedron": "^", "quadrilateral": "s", "triangle": "^"}


def draw(rows: Sequence[dict[str, Any]], path: Path, title: str, sentence: str) -> None:
    """Seconds against each error: frontiers as lines, dominated points faint."""
    plt = plotting()
    colours = plt.get_cmap("tab10")
    groups = {APPLICATION: [r for r in rows if is_application(r)]}
    for row in rows:
        if not is_application(row):
            groups.setdefault(str(row["method"]), []).append(row)
    figure, panels = plt.subplots(1, 3, figsize=(15, 5.2), layout="constrained", sharex=True)
    for axes, quantity in zip(panels, QUANTITIES, strict=True):
        for number, (name, points) in enumerate(groups.items()):
            seconds = np.array([p["seconds"] for p in points], float)
            errors = np.array([p[f"error_{quantity}"] for p in points], float)
            best = frontier(seconds, errors)
            axes.plot(
                seconds[best], errors[best], color=colours(number), label=name,
                linewidth=2.5 if name == APPLICATION else 1.2,
                linestyle="-" if name == APPLICATION else "--",
            )  # fmt: skip
            for i, point in enumerate(points):
                degree = int(point["degree"])
                shape = REFINED if "accuracy" in point["method"] else MARKERS[str(point["cell"])]
                axes.plot(
                    seconds[i], errors[i], shape, color=colours(number),
                    alpha=0.9 if i in best else 0.18, markersize=4 + 2.5 * (degree - 1),
                    markeredgewidth=1.0, markerfacecolor="none" if degree == 2 else None,
                )  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("seconds from mesh to solution")
        axes.set_title(TITLES[quantity], fontsize=10)
        axes.grid(visible=True, which="both", alpha=0.25)
    panels[0].legend(fontsize=8)
    cells = dict.fromkeys(str(r["cell"]) for r in rows)
    shapes = ", ".join(f"{'■' if MARKERS[c] == 's' else '▲'} {c}" for c in cells)
    if any("accuracy" in row["method"] for row in rows):
        shapes += ", ◆ refined to an accuracy"
    hollow = "; hollow: degree 2" if any(int(r["degree"]) == 2 for r in rows) else ""
    figure.suptitle(f"{title} ({shapes}{hollow}; faint: beaten)\n{sentence}", fontsize=10)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def frontier(seconds: ArrayLike, errors: ArrayLike) -> list[int]:
    """Points of the frontier: no other point is at least as fast with a smaller error.

    Of points equal in both values only the first counts; points with a value that is not finite are
    left out.

    Returns
    -------
    list of int
        Their numbers, from the fastest to the most accurate.

    Examples
    --------
    >>> frontier([1, 2, 3, 4], [0.5, 0.2, 0.3, 0.1])
    [0, 1, 3]
    """
    t, e = np.asarray(seconds, float), np.asarray(errors, float)
    order = np.lexsort((np.arange(len(t)), e, t))
    result: list[int] = []
    best = np.inf
    for i in order[np.isfinite(t[order]) & np.isfinite(e[order])]:
        if e[i] < best:
            best = e[i]
            result.append(int(i))
    return result
