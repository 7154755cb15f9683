"""Sections: planes through a body, or inner surfaces, at which the force between sides is computed.

A whole cell belongs to the side of the middle of its vertices. So the surface between the sides
follows faces of cells next to the plane. Area and centroid are those of the plane itself.

Where the scene was cut at planes of symmetry, the body of the whole scene consists of mirror images
of the solved part, and the image of the plane cuts each.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from contact_app.errors import ConfigurationError
from contact_app.model.geometry import Geometry
from contact_app.model.inner_surfaces import locate_inner_surface
from contact_app.model.planes import subsets
from contact_app.scene.bodies import Body
from contact_app.scene.scene import InnerSection, Mirror, Section
from meshes import Subdomain
from meshes.arrays import Array, Ints, Mask
from meshes.plane_cut import ON_PLANE, cut, simplices
from meshes.quadratic import VERTICES


@dataclass(frozen=True, eq=False)
class SectionPiece:
    """A section of the solved body, for one of its mirror images."""

    name: str
    body: int
    """The body that is solved."""
    mirrors: tuple[Mirror, ...]
    """The planes of the image."""
    behind: tuple[Mask | None, ...]
    """For each subdomain of this rank, mask (cells,) of the cells of the body behind the section;
    None for other bodies."""
    area: float
    """Area of the cut; in 2D its length."""
    centre: Array  # (3,)
    """Centroid of the cut; a point of the plane if the cut is empty."""


def locate_sections(
    geometry: Geometry, sections: Sequence[Section | InnerSection]
) -> tuple[SectionPiece, ...]:
    """The pieces of all sections (collective).

    Raises
    ------
    ConfigurationError
        A plane leaves no cell of its body on one of its sides, or an inner surface does not divide
        its body.
    """
    pieces: list[SectionPiece] = []
    for section in sections:
        if isinstance(section, Section):
            pieces += _pieces(geometry, section)
        else:
            pieces.append(_on_surface(geometry, section))
    return tuple(pieces)


def _on_surface(geometry: Geometry, section: InnerSection) -> SectionPiece:
    """The piece of an inner surface; such a scene is not cut at planes of symmetry."""
    surface = locate_inner_surface(geometry, section)
    name, body = section.name, section.body
    return SectionPiece(name, body, (), surface.behind, surface.area, surface.centre)


def _pieces(geometry: Geometry, section: Section) -> list[SectionPiece]:
    """The pieces of a plane section in the solved part, one for each mirror image of the plane."""
    pieces, counts = [], np.zeros(2, np.int64)
    for mirrors in _images(geometry.bodies, geometry.mirrors, section):
        point, normal = np.array(section.point), np.array(section.normal)
        for mirror in mirrors:
            point, normal = mirror.image(point), mirror.image(normal)
            normal[mirror.axis] -= 2.0 * mirror.at
        normal = normal / np.linalg.norm(normal)
        piece, sides = _piece(geometry, section, mirrors, (point, normal))
        pieces.append(piece)
        counts += sides
    if not counts.all():
        side, other = ("in front of", "behind") if counts[0] == 0 else ("behind", "in front of")
        raise ConfigurationError(
            f"{geometry.at('output')}.sections.{section.name}: the middles of all cells of "
            f"{section.of} lie {side} the plane (its normal points to the front), none {other} "
            "it; put the plane through the body, at least half a cell from its end"
        )
    return pieces


def _images(
    bodies: Sequence[Body], mirrors: Sequence[Mirror], section: Section
) -> list[tuple[Mirror, ...]]:
    """The planes of each mirror image of the solved body that is part of the whole body."""
    body = bodies[section.body].mesh
    ends = np.array([(b.mesh.lower, b.mesh.upper) for b in bodies])
    near = 1e-6 * float(np.ptp(ends, axis=(0, 1)).max())
    through = [m for m in mirrors if abs(body.upper[m.axis] - m.at) <= near]
    across = tuple(m for m in mirrors if m.axis in section.across)
    chosen = [across + tuple(through[k] for k in subset) for subset in subsets(len(through))]
    return [tuple(sorted(images, key=mirrors.index)) for images in chosen]


def _piece(
    geometry: Geometry, section: Section, mirrors: tuple[Mirror, ...], plane: tuple[Array, Array]
) -> tuple[SectionPiece, Ints]:
    """A piece, and the numbers of cells behind and in front of its plane (collective)."""
    point, normal = plane
    partition, mesh = geometry.partition, geometry.bodies[section.body].mesh
    size = float(np.ptp([mesh.lower, mesh.upper], axis=0).max())
    behind: list[Mask | None] = []
    sums = np.zeros(6)
    for s in partition.subdomains:
        if s.body != section.body:
            behind.append(None)
            continue
        heights = (s.points() - point) @ normal
        heights[np.abs(heights) <= ON_PLANE * size] = 0.0
        cells = s.reference.cells
        middles = heights[cells[:, : VERTICES[s.reference.cell]]].mean(axis=1)
        side = middles <= ON_PLANE * size
        behind.append(side)
        area, first = _cut(s, heights, point)
        sums += [side.sum(), (~side).sum(), area, *first]
    count_behind, count_front, area, *first = partition.comm.allreduce(sums)
    centre = point + np.array(first) / area if area > 0.0 else point
    piece = SectionPiece(section.name, section.body, mirrors, tuple(behind), float(area), centre)
    return piece, np.array([count_behind, count_front], np.int64)


def _cut(s: Subdomain, heights: Array, point: Array) -> tuple[float, Array]:
    """Area of the cut in a subdomain, and ∫ (x - point) ds over it."""
    reference = s.reference
    low, high = heights[reference.cells].min(axis=1), heights[reference.cells].max(axis=1)
    cells = reference.cells[(low < 0.0) & (high >= 0.0)]
    pieces = simplices(reference.cell, reference.curved)
    return cut((s.points() - point)[cells], pieces, heights[cells])
