"""Increments of a load history of forms: slip is measured from the displacement of the last one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_app.forms.model import FormModel
from contact_app.forms.results import Owners

Array = NDArray[np.float64]


def following(model: FormModel, displacement: Array) -> FormModel:
    """The model with slip measured from a displacement (collective).

    Motions that no force determines are the least from there.

    Parameters
    ----------
    displacement : (nodes, dimension)
        At the nodes of the space on this rank, including ghosts.
    """
    owned = Owners.of_parts(model).at(displacement[model.parts.blocks])
    copies = Owners.of_subdomains(model).copies(owned)
    begin = [np.zeros_like(forces) for forces in model.problem.forces]
    for number, (cls, column) in enumerate(model.place):
        begin[cls][:, column] = copies[model.subdomains.copies(number)].ravel()
    problem = model.problem.with_least_motion_from(begin).with_slip_from(begin)
    return replace(model, problem=problem)
