"""The sides of the contacts of forms: tagged facets, gathered once from all ranks.

The surfaces of a contact and its mortar means follow from the mesh, the tags and the contact alone.
A second solve with new loads takes them from the first one.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from contact_app.forms.boundary import Facets, gathered_surface, surface_facets
from contact_app.forms.checks import check_facets
from contact_app.forms.contacts import Contact, values_of
from contact_app.forms.parts import Parts
from meshes.contact_surface import Surface
from meshes.facing import SurfacesApartError
from meshes.mortar import MeanGaps, mean_gaps


@dataclass(frozen=True, eq=False)
class Sides:
    """The sides of a contact."""

    facets: Facets
    """Facets of `tag` on this rank."""
    surfaces: tuple[Surface, ...]
    """The facets of all ranks, and for a pair those of `against`."""
    gaps: MeanGaps | None = None
    """Mortar means of the gap of a pair, without its interference; None for an obstacle."""


def sides_of(parts: Parts, contact: Contact, number: int) -> Sides:
    """The sides of a contact (collective).

    Raises
    ------
    ValueError
        A side has no facets, or the sides of a pair do not face each other.
    """
    at = f"contacts[{number}]"
    facets = _tagged(parts, contact, contact.tag, at)
    on = gathered_surface(parts, facets)
    if contact.against is None:
        return Sides(facets, (on,))
    against = gathered_surface(parts, _tagged(parts, contact, contact.against, f"{at}.against"))
    one, other = (side.smooth() if contact.round else side for side in (on, against))
    try:
        gaps = mean_gaps(one, other, parts.comm)
    except SurfacesApartError as error:
        raise ValueError(f"{at}: {error}") from error
    return Sides(facets, (on, against), gaps)


def _tagged(parts: Parts, contact: Contact, tag: Any, at: str) -> Facets:
    """The facets of one side of a contact; refuses a tag without any (collective)."""
    for value in values_of(tag):
        tagged = int((np.asarray(contact.facet_tags.values) == value).sum())
        outside = len(surface_facets(parts, contact.facet_tags, (value,)).copies)
        check_facets(parts.comm, (tagged, outside), at, value)
    return surface_facets(parts, contact.facet_tags, values_of(tag))
