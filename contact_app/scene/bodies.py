"""An elastic body: its mesh, its materials and its named boundaries."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from contact_app.scene.expressions import Expression
from contact_app.scene.material import Material

if TYPE_CHECKING:
    from meshes import CellMesh  # imports dolfinx

FACES = ("x-", "x+", "y-", "y+", "z-", "z+")
CELLS = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}
MOTION_NAMES = {2: ("x", "y", "rz"), 3: ("x", "y", "z", "rx", "ry", "rz")}
CELLS_PER_CUBE = {"tetrahedron": 6, "triangle": 2}


@dataclass(frozen=True)
class Box:
    """A box of equal cells between two corners."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cells: tuple[int, ...]
    cell: str

    congruent: ClassVar[bool] = True
    notes: ClassVar[tuple[str, ...]] = ()
    groups: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    inner: ClassVar[Mapping[str, Any]] = MappingProxyType({})

    @property
    def fingerprint(self) -> str:
        """A text that other boxes do not have."""
        return repr(self)

    @property
    def dimension(self) -> int:
        """Number of axes."""
        return len(self.cells)

    @property
    def size(self) -> float:
        """Area or volume."""
        return math.prod(b - a for a, b in zip(self.lower, self.upper, strict=True))

    @property
    def nodes(self) -> int:
        """Number of nodes of the mesh."""
        return self.nodes_of(1)

    def nodes_of(self, degree: int) -> int:
        """Number of nodes of a displacement of a degree."""
        return math.prod(degree * n + 1 for n in self.cells)

    @property
    def total_cells(self) -> int:
        """Number of cells of the mesh."""
        return math.prod(self.cells) * CELLS_PER_CUBE.get(self.cell, 1)

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Names of the faces of the box."""
        return FACES[: 2 * self.dimension]

    def shape(self, degree: int) -> Any:
        """The box as a shape of `meshes`."""
        from meshes import BoxShape

        return BoxShape(self.lower, self.upper, self.cells, self.cell, degree)

    def describe(self) -> str:
        """A phrase for reports."""
        lower, upper = (", ".join(f"{v:g}" for v in p) for p in (self.lower, self.upper))
        cells = " x ".join(map(str, self.cells))
        unit = "cubes" if self.cell == "tetrahedron" else "cells"
        return f"box ({lower}) to ({upper}) of {cells} {unit} ({self.cell})"

    def uncuttable(self, parts: tuple[int, ...], name: str) -> str:
        """Message why the body of this name cannot be cut into so many parts; empty if it can."""
        for axis, (part, cells) in enumerate(zip(parts, self.cells, strict=True)):
            if part > cells:
                where = f"along {'xyz'[axis]}, where {name} has {cells} cells"
                return f"requests {part} sub-boxes {where}"
        return ""


BodyMesh: TypeAlias = "Box | CellMesh"
"""The mesh of a body, of a box or from a file."""


@dataclass(frozen=True, eq=False)
class Body:
    """An elastic body."""

    name: str
    mesh: BodyMesh
    degree: int
    materials: tuple[Material, ...]
    """Materials by the tags of cells; a box has one material."""
    boundaries: dict[str, Expression]
    """Boundaries defined by an expression."""
    degree_given: bool = True
    """Whether the scene fixes the degree, by the key `degree` or by an option of degree 1.
    Otherwise a run to an accuracy chooses the degree."""
    cuts: tuple[str, ...] = ()
    """Boundaries made by cutting a symmetric body; they are not on the surface of the whole
    body."""
    hold: tuple[int, ...] = ()
    """Numbers of the rigid motions that are held in the mean: translations along the axes, then
    rotations about them, as in `rigid_motions`."""

    @property
    def nodes(self) -> int:
        """Number of nodes of its displacement."""
        return self.mesh.nodes_of(self.degree)

    @property
    def expansion(self) -> float:
        """Largest magnitude of the coefficients of thermal expansion of its materials."""
        return max(abs(material.expansion) for material in self.materials)

    @property
    def softest(self) -> float:
        """Smallest Young's modulus of its materials."""
        return min(material.young for material in self.materials)

    @property
    def mean_dilatation(self) -> bool:
        """Whether the change of volume is averaged over each cell (B-bar)."""
        return any(material.mean_dilatation for material in self.materials)

    def nearly_incompressible(self, plane: str | None) -> bool:
        """Whether one of its materials is nearly incompressible."""
        return any(material.nearly_incompressible(plane) for material in self.materials)

    @property
    def plain(self) -> bool:
        """Whether its cells are of first order and fully integrated, so that they lock."""
        return self.degree == 1 and not self.mean_dilatation
