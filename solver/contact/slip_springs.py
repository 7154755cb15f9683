"""Springs along the slip of sliding points that lock.

A body that is wedged in has contact forces that grow with its slip. With given friction forces the
fixed point over slip limits multiplies their error by about -μ over the slope α of the wedge. With
the share θ of the friction s as a spring of stiffness θ s / |w|, |w| the slip before, friction
grows with the slip, as the contact forces do, and the factor becomes

    -(1 - θ) (μ/α) / (1 + θ μ/α).

The set stays symmetric: along its slip a point has the given force (1 - θ) s and the spring. At the
slip before, both together are s, so the answer is the same.
"""

from dataclasses import replace

import numpy as np

from solver.backend import Statuses
from solver.contact.friction_points import FrictionPoints
from solver.vectors import Array, Mask


def with_springs(
    points: FrictionPoints, statuses: Statuses, slides: Mask, compliance: Array, share: float
) -> Statuses:
    """The statuses with springs along the slip of sliding points.

    Parameters
    ----------
    slides, compliance : (points,), (points,)
        Points that slide, and the compliance of their springs, slip over force.
    share
        Share of the friction that the springs carry at the slip before.
    """
    assert statuses.tractions is not None
    some = slides & (compliance > 0.0) & ~statuses.active[points.rows[points.first]]
    first = points.first[some]
    rows = points.rows[first]
    active, tractions = statuses.active.copy(), statuses.tractions.copy()
    all_compliance = np.zeros(len(active))
    if statuses.compliance is not None:
        all_compliance[:] = statuses.compliance
    active[rows] = True
    tractions[rows] *= 1.0 - share
    all_compliance[rows] = compliance[some] * points.spread[first] ** 2
    return replace(
        statuses, active=active, tractions=tractions, compliance=all_compliance, springs=some
    )
