"""From two boundaries of a scene to contact rows, each of the rank that owns its node.

Every rank gathers the facets of both sides of a contact, and ranks share the integrals over their
overlaps. Then each rank has all rows and keeps those of the nodes it owns: a surface is small
compared with the bodies, and the answer does not depend on which rank holds which part of it.

Where the scene was cut at planes of symmetry, both sides are those of the whole: facets next to a
plane may meet facets beyond it. Nodes of the image about some of the planes have numbers of their
own there; entries of rows at these nodes are moved to the nodes of which they are images.
"""

from itertools import combinations

import numpy as np

from contact_app.errors import ConfigurationError
from contact_app.model.geometry import Geometry
from contact_app.model.planes import on_planes
from contact_app.scene.conditions import BodyContact, Tie
from meshes.contact_surface import Surface
from meshes.mortar import NEGLIGIBLE, MeanGaps
from solver.exchange import NodeExchange
from solver.problem.constraints.conditions import ContactEntries, ContactRows


def sides_of(geometry: Geometry, pair: BodyContact | Tie) -> tuple[Surface, Surface]:
    """Both surfaces of a pair of bodies, on all ranks (collective).

    Raises
    ------
    ConfigurationError
        A side has no facet.
    """
    sides = []
    for key, body, boundary in (
        ("on", pair.body, pair.boundary), ("against", pair.other, pair.other_boundary)
    ):  # fmt: skip
        side = geometry.boundary_surface(body, boundary)
        if side is None:
            raise ConfigurationError(
                f"{geometry.at(pair.source)}.{key}: no whole facet of the surface of "
                f"{geometry.bodies[body].name} lies on {boundary}; contact and ties between bodies "
                "need facets all of whose nodes are on it"
            )
        sides.append(side)
    return sides[0], sides[1]


def doubled_pairs(geometry: Geometry) -> list[str]:
    """Sentences on contacts of two bodies that share facets on both of them (collective)."""
    sentences = []
    for one, other in combinations(geometry.pairs, 2):
        if {one.body, one.other} == {other.body, other.other}:
            sides, others = sides_of(geometry, one), sides_of(geometry, other)
            order = 1 if one.body == other.body else -1
            if all(map(_have_common_facets, sides, others[::order])):
                sentences.append(
                    f"{other.source}: facets on both bodies belong to {one.source}, too: each of "
                    "the two contacts has a part of the pressure there, and its largest pressure "
                    "is too small; name these facets in one of them"
                )
    return sentences


def _have_common_facets(one: Surface, other: Surface) -> bool:
    """Whether two surfaces share a facet."""
    each = [np.unique(np.sort(side.nodes, axis=1), axis=0) for side in (one, other)]
    both = np.concatenate(each)
    return len(np.unique(both, axis=0)) < len(both)


def of_what_is_solved(geometry: Geometry, means: MeanGaps) -> MeanGaps:
    """Rows of the whole as rows of the solved part.

    A row about a node on a plane is that of the whole, and half its pressure's force is here.
    """
    mirrors, total = geometry.mirrors, geometry.partition.nodes
    original = means.nodes < total
    number = np.cumsum(original) - 1
    here = original[means.row]
    row, component = number[means.row[here]], means.component[here]
    of_image, node = np.divmod(means.node[here], total)
    value, points = means.value[here].copy(), means.entry_points[here]
    for k, mirror in enumerate(mirrors):
        mirrored = (of_image >> k) % 2 == 1
        value[mirrored & (component == mirror.axis)] *= -1.0
        points = np.where(mirrored[:, None], mirror.image(points), points)
    key = np.stack([row, node, component], axis=1)
    key, first, place = np.unique(key, axis=0, return_index=True, return_inverse=True)
    value = np.bincount(place.reshape(-1), value, minlength=len(key)).astype(np.float64)
    some = np.abs(value) > NEGLIGIBLE
    planes = on_planes(geometry.bodies, mirrors, means.points[original]).sum(axis=0)
    return MeanGaps(
        nodes=means.nodes[original],
        points=means.points[original],
        areas=means.areas[original] * 0.5**planes,
        gaps=means.gaps[original],
        normals=means.normals[original],
        moments=means.moments[original],
        row=key[some, 0],
        node=key[some, 1],
        component=key[some, 2],
        value=value[some],
        entry_points=points[first[some]],
    )


def owned_rows(exchange: NodeExchange, means: MeanGaps, source: int) -> ContactRows:
    """The mortar rows of the nodes this rank owns."""
    keep = (means.nodes >= exchange.first) & (means.nodes < exchange.last)
    every = ContactEntries(means.row, means.node, means.entry_points, means.component, means.value)
    return ContactRows(
        nodes=means.nodes[keep],
        points=means.points[keep],
        sources=np.full(int(keep.sum()), source),
        gaps=means.gaps[keep],
        normals=means.normals[keep],
        moments=means.moments[keep],
        areas=means.areas[keep],
        spread=np.ones(int(keep.sum())),
        entries=every.of_rows(keep),
    )
