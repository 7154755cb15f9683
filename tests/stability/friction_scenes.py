"""Random scenes with friction: obstacles, pairs, both degrees, and nodes in two contacts."""

from typing import Any

import numpy as np

from tests import scenes

COEFFICIENTS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
"""μ up to which the issue asks for one answer."""

KINDS = ("floor", "ball", "edge", "room", "pair", "pair and wall")


def friction_scene(seed: int, variant: int = 0) -> tuple[scenes.Config, int]:
    """The scene of a seed, and the number of its subdomains.

    Variants are the same scene in other units and other subdomains.
    """
    random = np.random.default_rng([seed, 25])
    kind = str(random.choice(KINDS))
    cell = str(random.choice(["quadrilateral", "triangle", "hexahedron", "tetrahedron"]))
    flat = scenes.dimension(cell) == 2
    n = int(random.integers(3, 7)) if flat else int(random.integers(2, 4))
    made = (_pair if kind.startswith("pair") else _block)(random, kind, cell, n)
    vertical = "y" if flat else "z"
    if flat and random.random() < 0.25:
        for body in made["bodies"]:
            body["degree"] = 2
    if variant:
        random = np.random.default_rng([seed, 25, variant])
    length = float(10.0 ** random.integers(-3, 4))
    _in_units(made, length, float(10.0 ** random.integers(-4, 5)))
    side = made["bodies"][-1].get("boundaries", {}).get("side")
    if side is not None:  # without the nodes that are moved, which would enter the wall
        side["where"] = f"x > {0.799 * length!r} and {vertical} < {1.199 * length!r}"
    return made, int(random.integers(1, 6))


def history_scene(seed: int, variant: int = 0) -> tuple[scenes.Config, int]:
    """The scene of a seed under a load history, and the number of its subdomains.

    The components of its load, or of what moves it, are conditions of their own: the vertical one
    begins, then one or two at a time go up, back or to the other side.
    """
    made, subdomains = friction_scene(seed, variant)
    random = np.random.default_rng([seed, 26])
    conditions = [c for c in made["conditions"] if _named(c)]
    others = [c for c in made["conditions"] if not _named(c)]
    names = {"press"}
    for k, condition in enumerate(conditions):
        for part in _components(condition, "" if k == 0 else f" {k + 1}"):
            names.add(part["name"])
            others.append(part)
    sideways = sorted(names - {"press"})
    steps: list[dict[str, Any]] = [{"press": 1.0}]
    side = 1.0
    for _ in range(int(random.integers(2, 5))):
        moved = [str(n) for n in random.permutation(sideways)[: int(random.integers(1, 3))]]
        side = -side if random.random() < 0.6 else side
        step = {name: side * float(random.uniform(0.4, 1.5)) for name in moved}
        if random.random() < 0.4:
            step["press"] = float(random.choice([0.0, 0.5, 0.8, 1.3]))
        steps.append({**step, "increments": int(random.integers(1, 3))})
    return {**made, "conditions": others, "steps": steps}, subdomains


def _named(condition: scenes.Config) -> bool:
    """Whether a condition has values that a history can change."""
    values = condition.get("traction") or condition.get("displacement") or []
    return any(values)


def _components(condition: scenes.Config, ending: str) -> list[scenes.Config]:
    """A condition as one for each component, named after its direction."""
    key = "traction" if "traction" in condition else "displacement"
    values, none = condition[key], 0.0 if key == "traction" else None
    names = ["push", *["aside"][: len(values) - 2], "press"]
    return [
        {"name": name + ending, "on": condition["on"], key: [x if j == i else none for j, x in
         enumerate(values)]}
        for i, name in enumerate(names)
    ]  # fmt: skip


def at_factors(made: scenes.Config, factors: dict[str, float]) -> scenes.Config:
    """The scene without steps, its named conditions at these factors."""
    result = {key: value for key, value in made.items() if key != "steps"}
    result["conditions"] = []
    for condition in made["conditions"]:
        bare = {key: value for key, value in condition.items() if key != "name"}
        factor = factors.get(condition["name"], 0.0) if "name" in condition else 1.0
        for key in ("traction", "displacement"):
            if key in bare:
                bare[key] = [None if x is None else factor * x for x in bare[key]]
        result["conditions"].append(bare)
    return result


def _law(random: Any) -> dict[str, float]:
    """Coulomb's law twice as often as Tresca's."""
    if random.random() < 0.34:
        return {"tresca": float(random.uniform(1.0, 30.0))}
    return {"coulomb": float(random.choice(COEFFICIENTS))}


def _block(random: Any, kind: str, cell: str, n: int) -> scenes.Config:
    """A block held at one face, before one to three obstacles."""
    block = scenes.block(cell, n, poisson=float(random.uniform(0.0, 0.45)))
    down, up = scenes.down(cell), scenes.up(cell)
    gap = float(random.choice([0.0, 0.0, 0.005, 0.02]))
    tilt = float(random.uniform(-0.1, 0.1)) if random.random() < 0.5 else 0.0
    floor = scenes.plane(cell, (0.5, 0.5, -gap), (tilt, 0.5 * tilt, 1.0))
    if kind == "ball":
        center = scenes.vector(cell, *(random.uniform(0.3, 0.7, 2)), -1.0 - gap)
        floor = {"sphere": {"center": center, "radius": 1.0}}
    contacts = [{"on": f"block.{down}", "obstacle": floor, "friction": _law(random)}]
    sides = {"edge": 1, "room": 2}.get(kind, 0)
    walls = [("x+", (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))]
    if scenes.dimension(cell) == 3:
        walls.append(("y+", (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)))
    for face, point, normal in walls[:sides]:
        away = float(random.choice([0.0, 0.002, 0.01]))
        at = tuple(p - away * q for p, q in zip(point, normal, strict=True))
        wall = scenes.plane(cell, at, normal)
        contacts.append({"on": f"block.{face}", "obstacle": wall, "friction": _law(random)})
    load = [float(x) for x in random.uniform([-40, -40, -80], [60, 60, 10])]
    push = [float(x) for x in random.uniform([-0.02, -0.02, -0.04], [0.03, 0.03, 0.0])]
    held = scenes.clamp(cell, "block.x-")
    if not sides and random.random() < 0.3:  # the top is moved
        conditions = [{"on": f"block.{up}", "displacement": scenes.vector(cell, *push)}]
    else:
        conditions = [held, {"on": f"block.{up}", "traction": scenes.vector(cell, *load)}]
    return scenes.config(cell, [block], conditions, contacts)


def _pair(random: Any, kind: str, cell: str, n: int) -> scenes.Config:
    """A block on another one whose mesh it does not match, pushed or pulled aside.

    They touch: across a gap the slips have the turn of the normal in them, see `meshes.ties`, which
    the reference does not know.
    """
    flat, down, up = scenes.dimension(cell) == 2, scenes.down(cell), scenes.up(cell)
    n = n if flat else min(n, 3)
    bodies = [
        scenes.block(cell, n, "lower", upper=(1, 1, 0.5), young=float(random.uniform(300, 3000))),
        scenes.block(
            cell, max(n - 1, 2), "upper", (0.1, 0.1, 0.5), (0.8, 0.9, 1.2),
            young=float(random.uniform(300, 3000)),
        ),
    ]  # fmt: skip
    top = [float(x) for x in random.uniform([-0.03, -0.03, -0.04], [0.03, 0.03, -0.005])]
    conditions = [
        scenes.clamp(cell, f"lower.{down}"),
        {"on": f"upper.{up}", "displacement": scenes.vector(cell, *top)},
    ]
    if random.random() < 0.3:
        side = [float(x) for x in random.uniform(-20.0, 20.0, 3)]
        conditions.append({"on": "upper.x-", "traction": scenes.vector(cell, *side)})
    contacts = [{"on": f"upper.{down}", "against": f"lower.{up}", "friction": _law(random)}]
    if kind == "pair and wall":
        wall = scenes.plane(cell, (0.8 + float(random.choice([0.0, 0.005])), 0, 0), (-1, 0, 0))
        bodies[1]["boundaries"] = {"side": {}}
        contacts.append({"on": "upper.side", "obstacle": wall, "friction": _law(random)})
    return scenes.config(cell, bodies, conditions, contacts)


def _in_units(made: scenes.Config, length: float, stress: float) -> None:
    """Multiply all lengths and stresses."""
    for body in made["bodies"]:
        box = body["mesh"]["box"]
        for key in ("lower", "upper"):
            box[key] = [length * float(x) for x in box[key]]
        body["material"]["young"] *= stress
    for condition in made["conditions"]:
        for key, factor in (("displacement", length), ("traction", stress)):
            if key in condition:
                condition[key] = [None if x is None else factor * x for x in condition[key]]
    for contact in made["contacts"]:
        obstacle = contact.get("obstacle", {})
        for data in obstacle.values():
            for key in ("point", "center"):
                if key in data:
                    data[key] = [length * float(x) for x in data[key]]
            if "radius" in data:
                data["radius"] *= length
        if "tresca" in contact["friction"]:
            contact["friction"]["tresca"] *= stress
