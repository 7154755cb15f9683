"""Reading rigid bodies of a scene file, with their displacements and loads."""

import numpy as np

from contact_app.scene.keys import Keys, Place, Vector
from contact_app.scene.obstacles import SHAPES, Obstacle, Sphere
from contact_app.scene.rigid import TURNS, RigidBody, RigidLoad, RigidMotion
from contact_app.scene.scene import Scene
from contact_app.scene.schema import bodies as b
from contact_app.scene.schema import conditions as c

RIGID_KEYS = ("displacement", "rotation", "total_force", "total_moment")


def read_rigid_bodies(keys: Keys) -> tuple[RigidBody, ...]:
    """The rigid bodies of the file, in its order."""
    return tuple(
        _body(keys, body, ("bodies", i))
        for i, body in enumerate(keys.configuration.bodies)
        if isinstance(body, b.RigidBody)
    )


def _body(keys: Keys, body: b.RigidBody, path: Place) -> RigidBody:
    several = len(body.rigid) > 1
    obstacles = tuple(
        read_obstacle(keys, obstacle, (*path, "rigid", *((k,) if several else ())))
        for k, obstacle in enumerate(body.rigid)
    )
    return RigidBody(body.name, obstacles, _reference(obstacles[0]))


def _reference(obstacle: Obstacle) -> Vector:
    """The centre of a sphere, the point of a plane or cylinder."""
    if isinstance(obstacle, Sphere):
        return obstacle.center
    point: Vector = obstacle.point  # type: ignore[attr-defined]
    return point


def read_obstacle(keys: Keys, entry: b.Obstacle, path: Place) -> Obstacle:
    """One obstacle of exactly one shape."""
    shapes = entry.known_keys()
    kinds = [key for key in shapes if getattr(entry, key) is not None]
    if len(kinds) != 1:
        keys.fail(
            path,
            f"has {' and '.join(kinds) or 'no shape'}; exactly one of {', '.join(shapes)} is "
            "allowed",
        )
    at, shape = (*path, kinds[0]), SHAPES[kinds[0]]
    if keys.dimension == 2 and shape.not_in_plane:
        keys.fail(at, shape.not_in_plane)
    fields = dict(getattr(entry, kinds[0]))
    for key, value in fields.items():
        if key in shape.directions:
            fields[key] = keys.direction(value, (*at, key))
        elif isinstance(value, list):
            fields[key] = keys.space(value, (*at, key), "a point")
    obstacle: Obstacle = shape(**fields)
    return obstacle


class RigidReader:
    """Reads conditions `in` a rigid body.

    Parameters
    ----------
    bodies
        The rigid bodies.
    """

    def __init__(self, keys: Keys, bodies: tuple[RigidBody, ...]) -> None:
        self.keys, self.bodies = keys, bodies
        self.names = [body.name for body in bodies]
        self._held: dict[tuple[int, int], str] = {}

    def condition(self, i: int, condition: c.Condition) -> RigidMotion | RigidLoad:
        """A displacement or load of a rigid body."""
        path: Place = ("conditions", i)
        name = condition.inside or ""
        body = self.names.index(name)
        kinds = [
            key
            for key in c.Condition.model_fields
            if key not in ("name", "inside") and getattr(condition, key) is not None
        ]
        for key in kinds:
            if key not in (*RIGID_KEYS, "at"):
                why = "stands beside `in`" if key == "on" else "has no meaning in a rigid body"
                self.keys.fail(
                    (*path, key),
                    f"{why}; {name} is rigid, and displacement, rotation, total_force and "
                    "total_moment are allowed",
                )
        moves = [key for key in kinds if key in RIGID_KEYS[:2]]
        loads = [key for key in kinds if key in RIGID_KEYS[2:]]
        if not moves and not loads:
            self.keys.fail(
                path,
                f"does nothing to {name}, which is rigid: give displacement and rotation, or "
                "total_force and total_moment",
            )
        if moves and (loads or "at" in kinds):
            key = (*loads, "at")[0]
            self.keys.fail(
                (*path, key),
                f"stands beside {moves[0]}: displacements and loads of a rigid body are separate "
                "conditions",
            )
        return self._motion(body, condition, path) if moves else self._load(body, condition, path)

    def _motion(self, body: int, condition: c.Condition, path: Place) -> RigidMotion:
        """A condition that holds or moves a rigid body; refuses components that are held twice."""
        keys, d = self.keys, self.keys.dimension
        displacement = condition.displacement
        if displacement is not None:
            keys.components(displacement, (*path, "displacement"))
        rotation = condition.rotation
        if rotation is not None and not isinstance(rotation, list):
            rotation = [rotation]
        if rotation is not None and len(rotation) != TURNS[d]:
            form = "one number, counter-clockwise" if d == 2 else "3 (null leaves one free)"
            keys.fail(
                (*path, "rotation"),
                f"has {len(rotation)} components; in {d}D it has {form}, in radians",
            )
        motion = RigidMotion(
            body,
            tuple(displacement or (None,) * d),
            tuple(rotation or (None,) * TURNS[d]),
            f"conditions[{path[1]}]",
        )
        key = "rotation" if displacement is None else "displacement"
        if all(value is None for value in motion.values):
            keys.fail((*path, key), "leaves every component free; give a number for one")
        for k, value in enumerate(motion.values):
            if value is None:
                continue
            if (body, k) in self._held:
                which = ("displacement", k) if k < d else ("rotation", k - d)
                keys.fail(
                    (*path, which[0]),
                    f"holds component {which[1]} of {self.names[body]}, which "
                    f"{self._held[body, k]} holds already",
                )
            self._held[body, k] = motion.source
        return motion

    def _load(self, body: int, condition: c.Condition, path: Place) -> RigidLoad:
        """A force and moment, transferred to the reference point."""
        keys = self.keys
        force = np.array(
            keys.space(
                condition.total_force or [0.0] * keys.dimension, (*path, "total_force"), "a force"
            )
        )
        moment = np.array(read_moment(keys, condition.total_moment, (*path, "total_moment")))
        if condition.at is not None:
            at = np.array(keys.space(condition.at, (*path, "at"), "a point"))
            moment = moment + np.cross(at - np.array(self.bodies[body].center), force)
        x, y, z = (float(v) for v in force)
        mx, my, mz = (float(v) for v in moment)
        return RigidLoad(body, (x, y, z), (mx, my, mz), f"conditions[{path[1]}]")


def read_moment(keys: Keys, value: list[float] | float | None, path: Place) -> Vector:
    """A moment in space; zero where none is given."""
    if value is None:
        return (0.0, 0.0, 0.0)
    if keys.dimension == 2:
        if isinstance(value, list):
            keys.fail(path, "is a list; in 2D a moment is one number, counter-clockwise")
        return (0.0, 0.0, value)
    if not isinstance(value, list):
        keys.fail(path, "is one number; in 3D a moment has 3 components")
    return keys.space(value, path, "a moment")


def refuse_with_rigid(keys: Keys, scene: Scene) -> None:
    """Refuse options that are not available in a scene with a rigid body."""
    if not scene.rigid.bodies:
        return
    name = scene.rigid.bodies[0].name
    if scene.guaranteed:
        keys.fail(
            ("certificate", "guaranteed"),
            f"is not available with rigid bodies, and {name} is one: the bound is for obstacles "
            f"that do not move; give {name} as an `obstacle` if it is held, or leave this out: "
            "the error of the mesh is estimated without it, too",
        )
