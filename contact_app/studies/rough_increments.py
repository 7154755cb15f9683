"""The friction traction of the roller by meshes and by numbers of increments.

    python -m contact_app.studies.rough_increments

The roller of `rough_scenes` is pressed in 1 to 32 increments on cells of `SIZES`, degree 1. The
table has differences of the friction traction over 0 ≤ x ≤ `friction_beside.END` in the root mean
square: between the two meshes, between a number of increments and the largest one, and between this
application and GetFEM on the finer mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from contact_app.studies.friction_beside import GETFEM, missing, relative, traction
from contact_app.studies.rough_getfem import Program
from contact_app.studies.rough_scenes import plain, solve

Array = NDArray[np.float64]

SIZES = (1.0, 0.5)
"""Sizes of cells, the coarser first."""

COUNTS = (1, 2, 4, 8, 16, 32)
"""Numbers of increments."""


def ours(size: float, increments: int) -> Array:
    """The traction of this application."""
    return traction(solve("roller", size, 1, increments)[0])


def theirs(size: float, increments: int) -> Array | None:
    """The traction of GetFEM; None if its iteration does not converge."""
    try:
        return traction(Program(plain("roller", size, 1, increments)).solve()[0])
    except RuntimeError:
        return None


def rows(sizes: Sequence[float] = SIZES, counts: Sequence[int] = COUNTS) -> Iterator[str]:
    """The table."""
    yield "| increments | between the meshes | to the most increments | to GetFEM |"
    yield "|---:|---:|---:|---:|"
    coarse, fine = ([ours(size, count) for count in counts] for size in sizes)
    for count, one, two in zip(counts, coarse, fine, strict=True):
        other = None if missing(GETFEM) else theirs(sizes[-1], count)
        words = [
            _percent(relative(two, one)),
            _percent(relative(fine[-1], two)) if count != counts[-1] else "",
            "" if other is None else _percent(relative(other, two)),
        ]
        yield f"| {count} | " + " | ".join(words) + " |"


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f} %"


if __name__ == "__main__":
    for line in rows():
        print(line, flush=True)
