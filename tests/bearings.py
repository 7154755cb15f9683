"""Half a bearing: balls or rollers between two half rings, held by nothing but their contacts."""

from pathlib import Path

import numpy as np

from tests import meshfiles, scenes

RADIUS, PITCH, GROOVE, THICK = 4.0, 20.0, 4.3, 3.0


def ball(x: np.ndarray) -> np.ndarray:
    """The unit block (n, 3) as a ball of radius one about the origin; a disc in the plane."""
    squares = (2.0 * x - 1.0) ** 2 * (x != 0.0).any(axis=0)
    scaled = np.empty_like(x)
    for k in range(3):
        a, b = squares[:, (k + 1) % 3], squares[:, (k + 2) % 3]
        scaled[:, k] = (2.0 * x[:, k] - 1.0) * np.sqrt(1.0 - a / 2.0 - b / 2.0 + a * b / 3.0)
    return np.where((x != 0.0).any(axis=0), scaled, 0.0)


def ring(x: np.ndarray, side: float) -> np.ndarray:
    """The unit block as half a ring below the origin, its race on x- towards the balls.

    Parameters
    ----------
    side
        1 outside of the balls, -1 inside.
    """
    across = 1.4 * RADIUS * (x[:, 2] - 0.5) * (x[:, 2] != 0.0).any()
    race = np.sqrt(GROOVE**2 - across**2) - (GROOVE - RADIUS)
    radius = PITCH + side * (race + (RADIUS + THICK - race) * x[:, 0])
    angle = np.pi * (1.0 + x[:, 1])
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), across])


def half_bearing(
    directory: Path, cell: str, balls: int, counts: tuple[int, int], traction: float = 5.0
) -> scenes.Config:
    """A scene of two half rings and balls between them; the outer ring is held, the inner loaded.

    Parameters
    ----------
    counts
        Cells along the edges of a ring and of a ball.
    """
    d = scenes.dimension(cell)
    bodies = []

    def add(name: str, mesh: object, boundaries: dict[str, dict[str, str]]) -> None:
        file = str(meshfiles.write(mesh, directory / f"{name}.msh"))
        steel = {"young": 2.1e5, "poisson": 0.3}
        bodies.append({"name": name, "mesh": {"file": file}, "material": steel,
                       "boundaries": boundaries})  # fmt: skip

    for name, side in (("outer", 1.0), ("inner", -1.0)):
        mesh = meshfiles.block(cell, counts[0], 0.0)
        mesh.points = ring(mesh.points, side)
        add(name, mesh, {})
    contacts = []
    for k in range(balls):
        angle = np.pi * (1.0 + (k + 0.5) / balls)
        mesh = meshfiles.block(cell, counts[1], 0.0)
        centre = PITCH * np.array([np.cos(angle), np.sin(angle), 0.0])
        mesh.points = RADIUS * ball(mesh.points) + centre
        add(f"ball{k}", mesh, {"skin": {"where": "x > -1e9"}})
        contacts += [
            {"on": f"ball{k}.skin", "against": f"{race}.x-", "round": True}
            for race in ("outer", "inner")
        ]
    conditions = [
        {"on": "outer.x+", "displacement": [0.0] * d},
        {"on": "inner.x+", "traction": [0.0, -traction, 0.0][:d]},
    ]
    return {"dimension": d, "bodies": bodies, "conditions": conditions, "contacts": contacts}
