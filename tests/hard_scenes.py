"""Scenes in the plane on which methods have a hard time."""

from typing import Any

from tests.scenes import Config


def pressed_box(box: Config, poisson: float, conditions: list[Any], contact: Config) -> Config:
    """A body in the plane with Young's modulus 1000 and one contact."""
    name = "body"
    material = {"young": 1000.0, "poisson": poisson}
    return {
        "title": "",
        "dimension": 2,
        "bodies": [{"name": name, "mesh": {"box": box}, "material": material}],
        "conditions": conditions,
        "contacts": [contact],
        "solver": {"tolerance": 1e-8},
    }


def wall(n: int = 16, poisson: float = 0.3) -> Config:
    """Foot clamped, top pressed, a wall at the right; locking near ν = 0.5."""
    box = {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "cells": [n, n], "cell": "quadrilateral"}
    conditions = [
        {"on": "body.y-", "displacement": [0.0, 0.0]},
        {"on": "body.y+", "traction": [0.0, -50.0]},
    ]
    plane = {"plane": {"point": [1.0, 0.0], "normal": [-1.0, 0.0]}}
    return pressed_box(box, poisson, conditions, {"on": "body.x+", "obstacle": plane})


def slender(ratio: float, cells: list[int]) -> Config:
    """A cantilever that bends down onto a plane some way below it."""
    upper = [1.0, 1.0 / ratio]
    box = {"lower": [0.0, 0.0], "upper": upper, "cells": cells, "cell": "quadrilateral"}
    conditions = [
        {"on": "body.x-", "displacement": [0.0, 0.0]},
        {"on": "body.y+", "pressure": 2000.0 / ratio**3},
    ]
    plane = {"plane": {"point": [0.0, -0.02], "normal": [0.0, 1.0]}}
    return pressed_box(box, 0.3, conditions, {"on": "body.y-", "obstacle": plane})
