"""Facets and nodes of a boundary of a body, in each subdomain of this rank."""

from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from contact_app.errors import ConfigurationError
from contact_app.scene.bodies import Body
from meshes import Subdomain
from meshes.arrays import Ints


def boundary_facets(subdomain: Subdomain, body: Body, boundary: str) -> NDArray[np.int32]:
    """Rows of the reference's facets on a boundary: those with all nodes on it."""
    if boundary not in body.boundaries:
        return subdomain.boundaries.get(boundary, np.zeros(0, np.int32))
    surface = surface_facets(subdomain, body)
    if len(surface) == 0:
        return surface
    points = subdomain.points()[subdomain.reference.facets[surface]]
    inside = body.boundaries[boundary](points.reshape(-1, 3)).reshape(points.shape[:2])
    return surface[inside.all(axis=1)]


def refuse_without_facet(place: str, body: Body, boundary: str) -> NoReturn:
    """Raise a ConfigurationError: the load at a place of the file is on no facet of a boundary."""
    raise ConfigurationError(
        f"{place}.on: no whole facet of the surface of {body.name} lies on {boundary}; a load "
        "needs facets all of whose nodes are on it"
    )


def surface_facets(subdomain: Subdomain, body: Body) -> NDArray[np.int32]:
    """Rows of the reference's facets on the surface of a body, cuts of symmetry not among them."""
    cuts = [subdomain.boundaries[name] for name in body.cuts if name in subdomain.boundaries]
    return np.setdiff1d(subdomain.exterior, np.concatenate(cuts)) if cuts else subdomain.exterior


def boundary_nodes(subdomain: Subdomain, body: Body, boundary: str) -> Ints:
    """Local surface nodes on a boundary."""
    if by_name := boundary not in body.boundaries:
        rows = boundary_facets(subdomain, body, boundary)
    else:
        rows = surface_facets(subdomain, body)
    if len(rows) == 0:  # most subdomains have none
        return np.zeros(0, np.int64)
    nodes: Ints = np.unique(subdomain.reference.facets[rows])
    return nodes if by_name else nodes[body.boundaries[boundary](subdomain.points()[nodes])]
