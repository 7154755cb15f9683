"""A ball pressed on a rigid plane, from Python, beside the theory of Hertz (1882).

An eighth of the ball is modelled, since it looks the same from both sides: a quarter of the force
acts on its equator. Run it with ``python docs/guide/hertz_in_python.py``. Units: mm, N, MPa.
"""

from pathlib import Path

import numpy as np

import contact_app

RADIUS, FORCE, YOUNG, POISSON = 8.0, 1.0, 200.0, 0.3
MESH = Path(__file__).parents[2] / "meshes" / "samples" / "sphere_eighth.msh"

answer = contact_app.solve({
    "dimension": 3,
    "bodies": [{"name": "ball", "mesh": {"file": MESH},
                "material": {"young": YOUNG, "poisson": POISSON}}],
    "conditions": [
        {"on": "ball.x-", "displacement": [0, None, None]},
        {"on": "ball.y-", "displacement": [None, 0, None]},
        {"on": "ball.equator", "total_force": [0, 0, -FORCE / 4]},
    ],
    "contacts": [{"on": "ball.sphere",
                  "obstacle": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}}],
})  # fmt: skip

modulus = YOUNG / (1 - POISSON**2)
radius = (3 * FORCE * RADIUS / (4 * modulus)) ** (1 / 3)
peak = 3 * FORCE / (2 * np.pi * radius**2)
pushed = answer.contact_pressure > 0
reach = np.linalg.norm(answer.points[pushed, :2], axis=1).max()
print(f"certified: {answer.certificate.passed}")
print(f"force on a quarter: {answer.summary['contacts'][0]['force'][2]:.6f} ({FORCE / 4})")
print(f"largest pressure: {answer.contact_pressure.max():.3f} (Hertz {peak:.3f})")
print(f"contact radius: {reach:.3f} (Hertz {radius:.3f})")
