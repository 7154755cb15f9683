"""Small scenes for the tests, written as the configuration a user would type.

A scene is a function of the cell type and the number of cells along an edge and returns the
configuration as a mapping; the last axis points up, so that one function serves 2D and 3D.
Lengths are about 1, Young's modulus is about 1000, displacements are a few hundredths.
"""

import copy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

Config = dict[str, Any]

CONFIGS = Path(__file__).parents[1] / "configs"

CELLS_3D, CELLS_2D = ("hexahedron", "tetrahedron"), ("quadrilateral", "triangle")


def dimension(cell: str) -> int:
    """Dimension of a cell type."""
    return 3 if cell in CELLS_3D else 2


def vector(cell: str, x: float | None, y: float | None, z: float | None) -> list[float | None]:
    """(x, y, z) in 3D and (x, z) in 2D: the last component is the vertical one."""
    return [x, y, z] if dimension(cell) == 3 else [x, z]


def up(cell: str) -> str:
    """Name of the top face of a box."""
    return "z+" if dimension(cell) == 3 else "y+"


def down(cell: str) -> str:
    """Name of the bottom face of a box."""
    return "z-" if dimension(cell) == 3 else "y-"


def block(
    cell: str,
    n: int,
    name: str = "block",
    lower: tuple[float, float, float] = (0.0, 0.0, 0.0),
    upper: tuple[float, float, float] = (1.0, 1.0, 1.0),
    young: float = 1000.0,
    poisson: float = 0.3,
    boundaries: dict[str, str] | None = None,
) -> Config:
    """A box of n cells along each edge."""
    low, up = vector(cell, *lower), vector(cell, *upper)
    body = box(name, up, [n] * dimension(cell), low, cell, young, poisson)
    if boundaries:
        body["boundaries"] = {key: {"where": where} for key, where in boundaries.items()}
    return body


def box(
    name: str,
    upper: Sequence[float | None],
    cells: Sequence[int],
    lower: Sequence[float | None] = (),
    cell: str = "",
    young: float = 1000.0,
    poisson: float = 0.3,
    **keys: Any,
) -> Config:
    """A body of a box in the coordinates of its own dimension, from the origin unless told."""
    mesh: Config = {"lower": list(lower) or [0] * len(upper), "upper": list(upper)}
    mesh |= {"cells": list(cells), **({"cell": cell} if cell else {})}
    material = {"young": young, "poisson": poisson}
    return {"name": name, "mesh": {"box": mesh}, "material": material, **keys}


def quadratic(made: Config) -> Config:
    """The same scene with every body of degree 2."""
    return {**made, "bodies": [{**body, "degree": 2} for body in made["bodies"]]}


def rollers(cell: str, sides: str = "-", body: str = "block", axes: str = "xyz") -> list[Config]:
    """Conditions that hold the sides of a body across some axes, each in its normal component."""
    d = dimension(cell)
    return [
        {"on": f"{body}.{axis}{side}", "displacement": [0.0 if k == i else None for k in range(d)]}
        for i, axis in enumerate(axes[:d])
        for side in sides
    ]


def on_floor(cell: str, body: str = "block", height: float = 0.0) -> Config:
    """The contact of the bottom of a body with a floor."""
    return {"on": f"{body}.{down(cell)}", "obstacle": plane(cell, (0, 0, height), (0, 0, 1))}


def on_top(cell: str, x: float, y: float, z: float) -> Config:
    """A traction on the top of the block."""
    return {"on": f"block.{up(cell)}", "traction": vector(cell, x, y, z)}


def weight(cell: str, x: float, y: float, z: float) -> Config:
    """A force per volume on the block."""
    return {"in": "block", "force": vector(cell, x, y, z)}


def ball(cell: str, center: tuple[float, float, float], radius: float, **hollow: bool) -> Config:
    """A sphere as obstacle, a circle in the plane."""
    return {"sphere": {"center": vector(cell, *center), "radius": radius, **hollow}}


def plane(cell: str, point: tuple[float, ...], normal: tuple[float, ...]) -> Config:
    """A plane obstacle; 3-vectors whose y is dropped in 2D."""
    return {"plane": {"point": vector(cell, *point), "normal": vector(cell, *normal)}}


def config(
    cell: str, bodies: list[Config], conditions: list[Config], contacts: list[Config]
) -> Config:
    """A configuration with the tests' tight tolerance."""
    made: Config = {
        "title": "test",
        "dimension": dimension(cell),
        "bodies": bodies,
        "conditions": conditions,
        "solver": {"tolerance": 1e-9},
    }
    if contacts:
        made["contacts"] = contacts
    return made


def clamp(cell: str, on: str) -> Config:
    """A displacement condition that holds every component."""
    return {"on": on, "displacement": vector(cell, 0.0, 0.0, 0.0)}


def column(cell: str, n: int, *loads: Config, **keys: object) -> Config:
    """A column between rollers on all sides, standing on a floor that it may leave."""
    sides = rollers(cell, "+-", axes="xy"[: dimension(cell) - 1])
    return config(cell, [block(cell, n) | keys], [*sides, *loads], [on_floor(cell)])


def confined_modulus(young: float, poisson: float) -> float:
    """Stress over strain of a column that cannot widen."""
    return young * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))


# --- scenes ------------------------------------------------------------------------------------


def wall(cell: str, n: int) -> Config:
    """The paper's cube: foot clamped, top loaded, right face beside a wall (held wall nodes)."""
    conditions = [clamp(cell, f"block.{down(cell)}"), on_top(cell, 0, 0, -50)]
    beside = {"on": "block.x+", "obstacle": plane(cell, (1, 0, 0), (-1, 0, 0))}
    return config(cell, [block(cell, n)], conditions, [beside])


def tilted_plane(cell: str, n: int) -> Config:
    """A cantilever that bends down onto a tilted plane some way below it."""
    slope = plane(cell, (1, 0, -0.01), (-0.05, 0.02, 1))
    conditions = [clamp(cell, "block.x-"), on_top(cell, 5, 0, -60)]
    contacts = [{"on": f"block.{down(cell)}", "obstacle": slope}]
    return config(cell, [block(cell, n)], conditions, contacts)


def sphere(cell: str, n: int) -> Config:
    """The foot is pushed up (non-zero displacement) until the top meets a sphere."""
    push = {"on": f"block.{down(cell)}", "displacement": vector(cell, 0.0, 0.0, 0.04)}
    above = {"on": f"block.{up(cell)}", "obstacle": ball(cell, (0.45, 0.55, 2.01), 1.0)}
    return config(cell, [block(cell, n)], [push], [above])


def hollow_sphere(cell: str, n: int) -> Config:
    """A block clamped on its left is pulled against the inside of a sphere around it."""
    body = block(cell, n, lower=(-0.5, -0.5, -0.5), upper=(0.5, 0.5, 0.5))
    cavity = ball(cell, (0.0, 0.0, 0.0), 0.89 if dimension(cell) == 3 else 0.72, hollow=True)
    contacts = [{"on": f"block.{face}", "obstacle": cavity} for face in (up(cell), "x+")]
    conditions = [clamp(cell, "block.x-"), on_top(cell, 40, 10, 60)]
    return config(cell, [body], conditions, copy.deepcopy(contacts))


def cylinder(cell: str, n: int) -> Config:
    """A block on a foundation is pressed against a roller above it (3D only)."""
    roller = {"cylinder": {"point": [0.4, 0, 2.505], "axis": [0.1, 1, 0], "radius": 1.5}}
    conditions = [clamp(cell, f"block.{down(cell)}"), weight(cell, 0, 0, 80)]
    contacts = [{"on": f"block.{up(cell)}", "obstacle": roller}]
    return config(cell, [block(cell, n)], conditions, contacts)


def hollow_cylinder(cell: str, n: int) -> Config:
    """A block held at one end in a pipe sags onto it (3D only)."""
    body = block(cell, n, lower=(-0.5, 0.0, -0.5), upper=(0.5, 1.0, 0.5))
    pipe = {"point": [0, 0, 0], "axis": [0, 2, 0], "radius": 0.71, "hollow": True}
    conditions = [clamp(cell, "block.y-"), weight(cell, 0, 0, -120)]
    contacts = [{"on": f"block.{down(cell)}", "obstacle": {"cylinder": pipe}}]
    return config(cell, [body], conditions, contacts)


def pushed(cell: str, n: int) -> Config:
    """The top is moved by a given displacement onto a floor with a gap; the normal has length 2."""
    push = {"on": f"block.{up(cell)}", "displacement": vector(cell, 0.01, 0.005, -0.03)}
    floor = {"on": f"block.{down(cell)}", "obstacle": plane(cell, (0, 0, -0.005), (0, 0, 2))}
    return config(cell, [block(cell, n)], [push], [floor])


def floating_in_corner(cell: str, n: int) -> Config:
    """A free body kept by nothing but the floor and the walls it is pushed against."""
    walls = [
        on_floor(cell, height=-0.001),
        {"on": "block.x-", "obstacle": plane(cell, (0, 0, 0), (1, 0, 0))},
    ]
    if dimension(cell) == 3:
        walls.append({"on": "block.y-", "obstacle": plane(cell, (0, -0.002, 0), (0, 1, 0))})
    side = {"on": "block.x+", "traction": vector(cell, -10, 0, -25)}
    conditions = [on_top(cell, 0, 0, -30), side, weight(cell, -2, -4, -8)]
    return config(cell, [block(cell, n)], conditions, walls)


def two_bodies(cell: str, n: int) -> Config:
    """A clamped soft body beside a stiff free one in a corner."""
    soft = block(cell, n, name="soft", young=500.0, poisson=0.4)
    stiff = block(
        cell, max(n // 2, 1), name="stiff", lower=(2, 0.1, 0.2), upper=(3, 0.9, 1.0), young=4000.0
    )
    first = wall(cell, n)
    corner = floating_in_corner(cell, n)
    conditions = [
        *(_renamed(c, "block", "soft") for c in first["conditions"]),
        *(_renamed(c, "block", "stiff") for c in corner["conditions"]),
    ]
    contacts = [
        *(_renamed(c, "block", "soft") for c in first["contacts"]),
        on_floor(cell, "stiff", 0.19),
        {"on": "stiff.x-", "obstacle": plane(cell, (2, 0, 0), (1, 0, 0))},
    ]
    if dimension(cell) == 3:
        contacts.append({"on": "stiff.y-", "obstacle": plane(cell, (0, 0.08, 0), (0, 1, 0))})
    return config(cell, [soft, stiff], conditions, contacts)


def _renamed(item: Config, old: str, new: str) -> Config:
    renamed = copy.deepcopy(item)
    for key in ("on", "in"):
        if key in renamed:
            renamed[key] = renamed[key].replace(old, new)
    return renamed


def rollers_and_floor(cell: str, n: int) -> Config:
    """Nodes that are held in one component and in contact in the other."""
    sides = rollers(cell, axes="xy"[: dimension(cell) - 1])
    pressures = [{"on": f"block.{up(cell)}", "pressure": 40}, {"on": "block.x+", "pressure": 15}]
    return config(cell, [block(cell, n)], [*sides, *pressures], [on_floor(cell)])


def moved_rollers_on_a_slope(cell: str, n: int) -> Config:
    """Nodes with one component moved by a condition, the other kept by an oblique plane."""
    made = rollers_and_floor(cell, n)
    made["conditions"][0]["displacement"] = vector(cell, 0.02, None, None)
    made["conditions"][-1]["pressure"] = 5
    made["contacts"][0]["obstacle"] = plane(cell, (0, 0, 0), (0.3, 0, 1))
    return made


def two_planes(cell: str, n: int) -> Config:
    """A clamped block that is pressed into a wedge: nodes of an edge lie on two planes."""
    conditions = [clamp(cell, "block.x-"), on_top(cell, 30, 0, -80)]
    beside = {"on": "block.x+", "obstacle": plane(cell, (1.004, 0, 0), (-1, 0, 0))}
    return config(cell, [block(cell, n)], conditions, [on_floor(cell, height=-0.002), beside])


def duplicate_obstacles(cell: str, n: int) -> Config:
    """The same plane three times on one boundary, the last time slightly turned."""
    made = wall(cell, n)
    made["contacts"] = [
        *made["contacts"],
        copy.deepcopy(made["contacts"][0]),
        {"on": "block.x+", "obstacle": plane(cell, (1, 0, 0), (-1, 0, 0.001))},
    ]
    return made


def sliding(cell: str, n: int) -> Config:
    """A block pressed straight down on a frictionless floor: free to slide."""
    conditions = [on_top(cell, 0, 0, -50), weight(cell, 0, 0, -20)]
    return config(cell, [block(cell, n)], conditions, [on_floor(cell)])


def rolling_in_hollow_sphere(cell: str, n: int) -> Config:
    """A free block at the bottom of a hollow sphere, which may turn about its centre."""
    body = block(cell, n, lower=(-0.5, -0.5, -0.5), upper=(0.5, 0.5, 0.5))
    cavity = ball(cell, (0.0, 0.0, 0.0), 0.9, hollow=True)
    contacts = [{"on": f"block.{down(cell)}", "obstacle": cavity}]
    return config(cell, [body], [weight(cell, 0, 0, -20)], contacts)


def heavy(cell: str, n: int) -> Config:
    """Body force only, a boundary given by an expression and an obstacle under half the foot."""
    vertical = "z" if dimension(cell) == 3 else "y"
    body = block(
        cell, n, boundaries={"near": f"{vertical} < 1e-9 and x > 0.45", "back": "x < 1e-9"}
    )
    return config(
        cell,
        [body],
        [clamp(cell, "block.back"), weight(cell, 0, 0, -90)],
        [{"on": "block.near", "obstacle": plane(cell, (0, 0, -0.004), (0, 0, 1))}],
    )


def initially_penetrating(cell: str, n: int) -> Config:
    """An obstacle that starts inside the body must push it out."""
    made = wall(cell, n)
    made["conditions"][0] = clamp(cell, "block.x-")
    made["contacts"][0]["obstacle"] = plane(cell, (0.99, 0, 0), (-1, 0, 0.05))
    return made


def far_obstacle(cell: str, n: int) -> Config:
    """A clamped block that never reaches its obstacle."""
    made = wall(cell, n)
    made["contacts"][0]["obstacle"] = plane(cell, (1.5, 0, 0), (-1, 0, 0))
    return made


def bar(cell: str, n: int) -> Config:
    """EA = L = F = 1 and ν = 0, pulled over a gap of 0.4 against a wall."""
    pull = {"on": "block.x+", "traction": vector(cell, 1, 0, 0)}
    beside = {"on": "block.x+", "obstacle": plane(cell, (1.4, 0, 0), (-1, 0, 0))}
    body = block(cell, n, young=1.0, poisson=0.0)
    return config(cell, [body], [clamp(cell, "block.x-"), pull], [beside])


def patch(cell: str, n: int, assumption: str = "strain") -> Config:
    """A block between rollers, pressed on a frictionless floor: stress is q everywhere."""
    made = rollers_and_floor(cell, n)
    young, poisson = (900.0, 0.25) if dimension(cell) == 3 else (2.1e5, 0.3)
    made["bodies"][0]["material"] = {"young": young, "poisson": poisson}
    made["conditions"] = [c for c in made["conditions"] if "pressure" not in c]
    made["conditions"].append({"on": f"block.{up(cell)}", "pressure": 100})
    if dimension(cell) == 2:
        made["dimension"] = f"plane_{assumption}"
    return made


def no_contacts(cell: str, n: int) -> Config:
    """Linear elasticity: no obstacle at all."""
    made = wall(cell, n)
    del made["contacts"]
    return made


ALL: dict[str, Callable[[str, int], Config]] = {
    made.__name__: made
    for made in (
        wall,
        tilted_plane,
        sphere,
        hollow_sphere,
        cylinder,
        hollow_cylinder,
        pushed,
        floating_in_corner,
        two_bodies,
        rollers_and_floor,
        moved_rollers_on_a_slope,
        two_planes,
        duplicate_obstacles,
        sliding,
        rolling_in_hollow_sphere,
        heavy,
        initially_penetrating,
        far_obstacle,
        no_contacts,
    )
}
ONLY_3D = ("cylinder", "hollow_cylinder")
SLIDING = ("sliding", "rolling_in_hollow_sphere")
"""Scenes whose displacement is unique up to a rigid motion only."""


def scaled(made: Config, factor: float) -> Config:
    """The same scene under loads multiplied by a factor."""
    made = copy.deepcopy(made)
    for item in made["conditions"]:
        for key in ("traction", "force"):
            if key in item:
                item[key] = [factor * value for value in item[key]]
        if "pressure" in item:
            item["pressure"] *= factor
    return made


def changed(made: Config, changes: Config) -> Config:
    """The same with other values at some places, such as `bodies.0.name`."""
    made = copy.deepcopy(made)
    for path, value in changes.items():
        place: Any = made
        *way, last = [int(part) if part.isdigit() else part for part in path.split(".")]
        for part in way:
            place = place[part]
        if isinstance(place, list) and last == len(place):
            place.append(value)
        else:
            place[last] = value
    return made


def lifted_strip(length: float, cells: list[int], degree: int = 1, **solver: Any) -> Config:
    """A strip of thickness one; its weight lays it on a floor, from which one end is lifted."""
    body = box("strip", [length, 1], cells, young=1e5, degree=degree)
    floor = {"on": "strip.y-", "obstacle": {"plane": {"point": [0, 0], "normal": [0, 1]}}}
    held = {"on": "strip.x-", "displacement": [0, 0.02]}
    made = config("quadrilateral", [body], [{"in": "strip", "force": [0, -1e-3]}, held], [floor])
    return {**made, "solver": {"tolerance": 1e-8, **solver}}


def slender(ratio: float, cells: list[int]) -> Config:
    """A cantilever that bends down onto a plane some way below it."""
    held = {"on": "body.x-", "displacement": [0.0, 0.0]}
    load = {"on": "body.y+", "pressure": 2000.0 / ratio**3}
    floor = {"on": "body.y-", "obstacle": {"plane": {"point": [0.0, -0.02], "normal": [0.0, 1.0]}}}
    made = config("quadrilateral", [box("body", [1.0, 1.0 / ratio], cells)], [held, load], [floor])
    return {**made, "solver": {"tolerance": 1e-8}}


# --- from configuration to scene ---------------------------------------------------------------


def read(scene: Path | str, overrides: Sequence[str] = ()) -> Any:
    """The scene of a file, or the shipped scene of a name."""
    from contact_app.scene.build import build_scene
    from contact_app.scene.configuration import load

    file = CONFIGS / f"{scene}.yaml" if isinstance(scene, str) else scene
    return build_scene(load(file, overrides))


def write(made: Config, path: Path) -> Path:
    """Write a configuration as the YAML file a user would have."""
    path.write_text(yaml.safe_dump(made, sort_keys=False))
    return path


def build(
    made: Config, subdomains: int | list[int] | None = None, memory: float | None = None
) -> Any:
    """The scene of a configuration, split into the given subdomains, within bytes of memory."""
    from contact_app.scene.build import build_scene
    from contact_app.scene.configuration import Configuration

    made = copy.deepcopy(made)
    if subdomains is not None:
        made["decomposition"] = {"subdomains": subdomains}
    return build_scene(Configuration.model_validate(made), memory=memory)


def problem(
    made: Config, subdomains: int | list[int] | None = None, comm: Any = None, **options: Any
) -> Any:
    """The problem of a configuration, on one rank unless a communicator is given."""
    from mpi4py import MPI

    from contact_app.model.model import build_model

    return build_model(build(made, subdomains), comm or MPI.COMM_SELF, **options).problem
