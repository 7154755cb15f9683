"""Files of a load history: one frame per increment, and the index of the frames.

The first frame of ``solution.xdmf`` has its numbers, and the mesh, in ``solution.h5``; those of
later ones are in ``solution-2.h5``, `solution-3.h5`, … Each file appears when it is complete, and
the index is rewritten after each: a killed run leaves its finished frames. ``solution.pvd`` names
the files ``solution-1.vtu``, ``solution-2.vtu``, … likewise.
"""

import re
from collections.abc import Sequence
from pathlib import Path

from contact_app.machine.atomic_file import atomic

GRID = re.compile(r'<Grid Name="solution" GridType="Uniform">.*?</Grid>', re.DOTALL)
"""A frame in the text that `xdmf_text` makes."""


class Series:
    """The frames written so far, on rank 0.

    Attributes
    ----------
    times
        Times of the frames, the next frame last.
    grids
        The text of each frame in an XDMF file.
    """

    def __init__(self) -> None:
        self.times: list[float] = []
        self.grids: list[str] = []

    @classmethod
    def resumed(cls, directory: Path, times: Sequence[float]) -> "Series":
        """The first frames, at these times, that an earlier run left in a directory."""
        series, text = cls(), directory / "solution.xdmf"
        series.times = list(times)
        if text.is_file():
            series.grids = GRID.findall(text.read_text(encoding="utf-8"))[: len(times)]
        return series

    def begin(self, time: float) -> None:
        """The next frame is that of a time."""
        self.times.append(time)

    @property
    def number(self) -> int:
        """Number of the next frame, from one."""
        return len(self.times)

    def numbers_of(self, text: Path) -> Path:
        """The file of the numbers of the next frame of an XDMF file."""
        if self.number == 1:
            return text.with_suffix(".h5")
        return text.with_name(f"{text.stem}-{self.number}.h5")

    def grid_of(self, collection: Path) -> Path:
        """The VTU file of the next frame."""
        return collection.with_name(f"{collection.stem}-{self.number}.vtu")

    def write_collection(self, collection: Path) -> None:
        """Write ``solution.pvd``, which puts the VTU files in order."""
        lines = [
            '<?xml version="1.0"?>',
            '<VTKFile type="Collection" version="1.0">',
            "<Collection>",
            *(
                f'<DataSet timestep="{time:.12g}" part="0" file="{collection.stem}-{number}.vtu"/>'
                for number, time in enumerate(self.times, start=1)
            ),
            "</Collection>",
            "</VTKFile>",
            "",
        ]
        with atomic(collection) as part:
            part.write_text("\n".join(lines), encoding="utf-8")


def xdmf_text(grids: Sequence[str]) -> str:
    """An XDMF file whose frames are some grids."""
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<Xdmf Version="3.0">',
        "<Domain>",
        '<Grid Name="results" GridType="Collection" CollectionType="Temporal">',
        *grids,
        "</Grid>",
        "</Domain>",
        "</Xdmf>",
        "",
    ]
    return "\n".join(lines)
