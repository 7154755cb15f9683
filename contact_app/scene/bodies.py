"""An elastic body: its mesh, its materials and the boundaries that have a name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from contact_app.scene.expressions import Expression
from contact_app.scene.material import Material

FACES = ("x-", "x+", "y-", "y+", "z-", "z+")
CELLS = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}
MOTION_NAMES = {2: ("x", "y", "rz"), 3: ("x", "y", "z", "rx", "ry", "rz")}
CELLS_PER_CUBE = {"tetrahedron": 6, "triangle": 2}


class BodyMesh(Protocol):
    """What anyone may ask of a body's mesh, wherever it comes from."""

    @property
    def dimension(self) -> int:
        """Number of axes."""

    @property
    def cell(self) -> str:
        """Cell type: triangle, quadrilateral, tetrahedron or hexahedron."""

    @property
    def lower(self) -> tuple[float, ...]:
        """Smallest coordinates."""

    @property
    def upper(self) -> tuple[float, ...]:
        """Largest coordinates."""

    @property
    def nodes(self) -> int:
        """Nodes."""

    @property
    def total_cells(self) -> int:
        """Cells."""

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Names of the parts of the surface the mesh itself knows."""

    @property
    def congruent(self) -> bool:
        """Whether `auto` cuts it into equal parts, which share one factor."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was repaired or left out, a sentence each."""

    def nodes_of(self, degree: int) -> int:
        """Nodes a displacement of a degree has."""

    def shape(self, degree: int) -> Any:
        """What `meshes.decompose` cuts, with the nodes of a degree."""

    def describe(self) -> str:
        """A phrase for reports."""

    def uncuttable(self, parts: tuple[int, ...], name: str) -> str:
        """Why the body of this name cannot be cut into so many parts; empty where it can."""


@dataclass(frozen=True)
class Box:
    """A box of equal cells between two corners."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cells: tuple[int, ...]
    cell: str

    congruent: ClassVar[bool] = True
    notes: ClassVar[tuple[str, ...]] = ()

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return len(self.cells)

    @property
    def nodes(self) -> int:
        """Nodes of the mesh."""
        return self.nodes_of(1)

    def nodes_of(self, degree: int) -> int:
        """Nodes a displacement of a degree has."""
        return math.prod(degree * n + 1 for n in self.cells)

    @property
    def total_cells(self) -> int:
        """Cells of the mesh."""
        return math.prod(self.cells) * CELLS_PER_CUBE.get(self.cell, 1)

    @property
    def boundaries(self) -> tuple[str, ...]:
        """The faces."""
        return FACES[: 2 * self.dimension]

    def shape(self, degree: int) -> Any:
        """The box as `meshes` knows it."""
        from meshes import BoxShape

        return BoxShape(self.lower, self.upper, self.cells, self.cell, degree)

    def describe(self) -> str:
        """A phrase for reports."""
        lower, upper = (", ".join(f"{v:g}" for v in p) for p in (self.lower, self.upper))
        cells = " x ".join(map(str, self.cells))
        unit = "cubes" if self.cell == "tetrahedron" else "cells"
        return f"box ({lower}) to ({upper}) of {cells} {unit} ({self.cell})"

    def uncuttable(self, parts: tuple[int, ...], name: str) -> str:
        """Why the body of this name cannot be cut into so many parts; empty where it can."""
        for axis, (part, cells) in enumerate(zip(parts, self.cells, strict=True)):
            if part > cells:
                where = f"along {'xyz'[axis]}, where {name} has {cells} cells"
                return f"asks for {part} sub-boxes {where}"
        return ""


@dataclass(frozen=True, eq=False)
class Body:
    """An elastic body.

    Attributes
    ----------
    materials
        By the number each cell of the mesh is tagged with; a box has one.
    boundaries
        Those defined by an expression.
    degree_given
        Whether the file names a degree or asks for what holds for degree 1 alone: else a run to an
        accuracy chooses one.
    cuts
        Boundaries at which it was cut from the rest of a symmetric body, whose surface has no part
        of them.
    hold
        Numbers of the rigid motions that are held in the mean, as `rigid_motions` counts them:
        along the axes, then about them.
    """

    name: str
    mesh: BodyMesh
    degree: int
    materials: tuple[Material, ...]
    boundaries: dict[str, Expression]
    degree_given: bool = True
    cuts: tuple[str, ...] = ()
    hold: tuple[int, ...] = ()

    @property
    def nodes(self) -> int:
        """Nodes of its displacement."""
        return self.mesh.nodes_of(self.degree)

    @property
    def expansion(self) -> float:
        """Largest coefficient of thermal expansion of its materials, in size."""
        return max(abs(material.expansion) for material in self.materials)

    @property
    def softest(self) -> float:
        """Smallest Young's modulus of its materials."""
        return min(material.young for material in self.materials)

    @property
    def mean_dilatation(self) -> bool:
        """Whether its change of volume is taken as the mean over each cell (B-bar)."""
        return any(material.mean_dilatation for material in self.materials)

    def nearly_incompressible(self, plane: str | None) -> bool:
        """Whether one of its materials is."""
        return any(material.nearly_incompressible(plane) for material in self.materials)

    @property
    def plain(self) -> bool:
        """Whether its cells are of first order and fully integrated: they lock."""
        return self.degree == 1 and not self.mean_dilatation
