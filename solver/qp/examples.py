"""Small problems on which expansion strategies fail, for tests and the table of stability."""

import math

import numpy as np

from solver.qp.box_qp import BoxQP
from solver.vectors import Vector


def figure_1() -> tuple[BoxQP, Vector]:
    """The situation of the paper's Figure 1: the projected CG step raises the cost.

    A narrow valley, tilted by 20°, leads from x0 down to a minimum below the line y = 0 that
    bounds the feasible set. The CG step follows the valley to its end; projected, it lands high
    on the valley's wall. The solution is near the point where the valley meets the line.

    Returns
    -------
    qp : BoxQP
        Two variables; the second is at least 0.
    x0 : (2,)
    """
    angle = math.radians(20.0)
    axes = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    hessian = axes @ np.diag([1.0, 100.0]) @ axes.T
    minimum = np.array([-2.5, -1.0])
    return BoxQP(hessian, hessian @ minimum, lower=[-np.inf, 0.0]), minimum + 4.0 * axes[:, 0]


def cycling_problem() -> BoxQP:
    """Three variables on which plain ``projcg``, from zero, repeats seven steps for ever.

    The Hessian is positive definite with condition number 9.8e3; every other strategy converges.
    """
    hessian = [[2417.9, 3850.9, 1674.8], [3850.9, 6414.1, 2841.1], [1674.8, 2841.1, 1269.0]]
    return BoxQP(hessian, [2066.3, 3763.1, 1724.8], [0.0, -1.3, -0.6], [0.4, 0.7, 0.9])
