"""Lines of `check` on rigid bodies and their conditions."""

from __future__ import annotations

from contact_app.scene.rigid import RigidLoad, RigidMotion
from contact_app.scene.scene import Scene

TURNS = {2: ("rotation",), 3: ("rotation x", "rotation y", "rotation z")}


def rigid_lines(scene: Scene) -> list[str]:
    """One line per body with its shapes below it, and one line per condition."""
    lines, d = [], scene.dimension
    for body in scene.rigid_bodies:
        at = ", ".join(f"{v:g}" for v in body.center[:d])
        lines.append(f"body {body.name}: rigid, moves and turns about ({at}); small rotations")
        lines += [f"  {shape.describe(d)}" for shape in body.obstacles]
    for motion in scene.rigid_motions:
        names = ("x", "y", "z")[:d] + TURNS[d]
        held = ", ".join(
            f"{name} = {value:g}"
            for name, value in zip(names, motion.values, strict=True)
            if value is not None
        )
        lines.append(f"{_name(motion)}: {scene.rigid_bodies[motion.body].name} moved by {held}")
    for load in scene.rigid_loads:
        force, moment = (", ".join(f"{v:g}" for v in part) for part in (load.force, load.moment))
        lines.append(
            f"{_name(load)}: {scene.rigid_bodies[load.body].name} under a force ({force}) and a "
            f"moment ({moment})"
        )
    return lines


def _name(condition: RigidMotion | RigidLoad) -> str:
    return f"{condition.source} ({condition.name})" if condition.name else condition.source
