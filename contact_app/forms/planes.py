"""Planes of symmetry of forms: facets whose nodes are held along their normal alone, at zero.

The smoothed pressure and the number of facets across a contact count the mirror image there.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from contact_app.forms.boundary import exterior_facets
from contact_app.forms.model import FormModel
from contact_app.forms.results import Owners
from contact_app.forms.rows import held_values
from contact_app.model.planes import ON_PLANE

Plane = tuple[int, float]
"""Axis and place."""


def planes_of_contacts(model: FormModel, owners: Owners, bcs: Sequence[Any]) -> list[list[Plane]]:
    """Planes at which the mirror image of each contact goes on (collective).

    Every body of the contact has facets on the plane, and the contact has nodes there, all of which
    are held along its axis.

    Parameters
    ----------
    bcs
        Dirichlet conditions.
    """
    parts, comm = model.parts, model.parts.comm
    held, value = held_values(parts, bcs)
    at_zero = held & (value == 0.0)
    tolerance = ON_PLANE * float(model.bodies.lengths.max())
    body = owners.copies(model.bodies.of_node.astype(float)).astype(np.int64)
    outside, of_bodies = exterior_facets(parts), set[tuple[int, float, int]]()
    slides = at_zero[outside.copies].all(axis=1)
    for axis in range(parts.dimension):
        flat = np.ptp(outside.points[..., axis], axis=1) <= tolerance
        chosen = flat & slides[:, axis] & (slides.sum(axis=1) == 1)
        places = np.round(outside.points[chosen, 0, axis] / tolerance) * tolerance
        bodies = body[outside.copies[chosen, 0]]
        of_bodies |= {(axis, float(p), int(b)) for p, b in zip(places, bodies, strict=True)}
    of_bodies = set().union(*comm.allgather(of_bodies))
    planes = []
    for sides in model.sides:
        every = set().union(*(model.bodies_at(surface) for surface in sides.surfaces))
        copies = np.unique(sides.facets.copies)
        of_contact = []
        for axis, place in sorted({(axis, place) for axis, place, _ in of_bodies}):
            near = np.abs(parts.points[copies, axis] - place) <= 2.0 * tolerance
            free = near & ~at_zero[copies, axis]
            on, off = comm.allreduce(np.array([near.sum(), free.sum()]))
            if on and not off and every <= {b for *plane, b in of_bodies if plane == [axis, place]}:
                of_contact.append((axis, place))
        planes.append(of_contact)
    return planes
