"""Make trial parts of one body: ``make_trials.py [NAME …] [--size FACTOR] [--to DIR]``.

The choice of a method is measured on them (docs/benchmarks/speed.md): bodies that bend, lift off,
are held by contact alone, have play or interference, or cells of unlike size. Each is a
triangulated profile, swept through layers and bent into shape; prisms are cut into tetrahedra, and
inner nodes are moved at random, so that no two subdomains are congruent. ``NAME.vtu`` and the scene
``NAME.yaml`` are written. ``--size`` is a factor on the default size of cells, with which bodies
have 15,000 to 40,000 unknowns of degree 1; ``--friction`` is Coulomb's coefficient at all contacts.
Needs NumPy and meshio. Lengths are in millimetres, stresses in MPa.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

MOVE = 0.15
"""Largest move of an inner node along each axis, in distances between nodes."""

GRADING = 3.7
"""Logarithm of the largest over the smallest cell of the graded block."""

FLOOR = "{plane: {point: [0, 0, 0], normal: [0, 0, 1]}}"
STEEL = "{young: 2.1e5, poisson: 0.3}"


@dataclass(frozen=True)
class Trial:
    """A part with the boundaries, conditions and contacts of its scene."""

    points: Array
    cells: Cells
    """Mesh, (nodes, 3) and (tetrahedra, 4)."""
    boundaries: dict[str, str]
    """Expressions in x, y, z, by name."""
    conditions: tuple[str, ...]
    contacts: tuple[str, ...]
    """Lines of the scene."""


def lifted_plate(size: float) -> Trial:
    """A plate 50 times as long as thick on a floor, one end lifted: it peels off row by row."""
    points, cells = box((200, 80, 4), (64, 26, 3), size)
    return Trial(
        points, cells, {"base": "z < 1e-6", "near": "x < 1e-6", "far": "x > 200 - 1e-6"},
        ("{in: body, force: [0, 0, -2e-3]}", "{on: body.near, displacement: [0, 0, null]}",
         "{on: body.far, displacement: [null, null, 0.5]}"),
        (f"{{on: body.base, obstacle: {FLOOR}}}",),
    )  # fmt: skip


def pressed_plate(size: float) -> Trial:
    """A square plate clamped along one edge, 0.05 above a floor, and pressed towards it."""
    points, cells = box((90, 90, 3), (42, 42, 3), size)
    points[:, 2] += 0.05
    return Trial(
        points, cells, {"base": "z < 0.05 + 1e-6", "edge": "x < 1e-6", "top": "z > 3.05 - 1e-6"},
        ("{on: body.edge, displacement: [0, 0, 0]}", "{on: body.top, traction: [0, 0, -0.02]}"),
        (f"{{on: body.base, obstacle: {FLOOR}}}",),
    )  # fmt: skip


def leaf_spring(size: float) -> Trial:
    """A flat arc on a floor that carries both its ends, pressed down amid its length."""
    length, rise, thick = 240.0, 8.0, 6.0
    points, cells = box((length, 30, thick), (96, 14, 4), size)
    radius = (length**2 / 4 + rise**2) / (2 * rise)
    angle = (points[:, 0] / length - 0.5) * 2 * np.arcsin(0.5 * length / radius)
    across = radius + points[:, 2] - 0.5 * thick
    lowest = float((radius - 0.5 * thick) * np.cos(np.arcsin(0.5 * length / radius)))
    bent = np.column_stack([across * np.sin(angle), points[:, 1], across * np.cos(angle) - lowest])
    inner, outer = radius - 0.5 * thick, radius + 0.5 * thick
    from_centre = f"sqrt(x**2 + (z + {lowest!r})**2)"
    return Trial(
        bent, cells,
        {"under": f"{from_centre} < {inner + 0.1 * size!r}", "middle": "abs(x) < 3 and z < 12",
         "crown": f"{from_centre} > {outer - 0.1 * size!r} and abs(x) < 15"},
        ("{on: body.middle, displacement: [0, 0, null]}",
         "{on: body.crown, total_force: [0, 0, -4000]}"),
        (f"{{on: body.under, obstacle: {FLOOR}}}",),
    )  # fmt: skip


def ribbed_panel(size: float) -> Trial:
    """A panel with three ribs on a floor, pressed at its middle and pulled up at a corner."""
    profile = grid(
        (80, 18), (40, 12), size,
        lambda y, z: (z < 4) | (abs(y - 10) < 3) | (abs(y - 40) < 3) | (abs(y - 70) < 3),
    )  # fmt: skip
    points, cells = swept(profile, layers(120, 40, size))
    points = points[:, [2, 0, 1]]
    return Trial(
        points, cells,
        {"base": "z < 1e-6", "foot": "x < 1e-6", "corner": "x > 100 and y > 60 and z > 3.9",
         "middle": "abs(x - 50) < 14 and abs(y - 40) < 14 and z > 3.9"},
        ("{on: body.foot, displacement: [0, 0, null]}",
         "{on: body.middle, total_force: [0, 0, -3000]}",
         "{on: body.corner, total_force: [0, 0, 250]}"),
        (f"{{on: body.base, obstacle: {FLOOR}}}",),
    )  # fmt: skip


def angle_bracket(size: float) -> Trial:
    """An angle bolted to a floor through its foot and pulled at its upright: its heel pries."""
    profile = grid((60, 60), (32, 32), size, lambda x, z: (z < 11) | (x < 11))
    points, cells = swept(profile, layers(50, 20, size))
    points = points[:, [0, 2, 1]]
    washer = "hypot(x - 36, y - 25) < 9"
    return Trial(
        points, cells,
        {"base": "z < 1e-6", "washer": f"{washer} and z > 5 and z < 12 and x > 12",
         "hole": f"{washer} and z < 1e-6", "top": "z > 60 - 1e-6"},
        ("{on: body.hole, displacement: [0, 0, null]}",
         "{on: body.washer, total_force: [0, 0, -12000]}",
         "{on: body.top, total_force: [1500, 300, 2500]}"),
        (f"{{on: body.base, obstacle: {FLOOR}}}",),
    )  # fmt: skip


def bar_in_vee(size: float) -> Trial:
    """A round bar in a vee of two planes, pressed amid its length, so that its ends rise."""
    points, cells = swept(disc(10.0, 9, size), layers(120, 36, size))
    points = points[:, [0, 2, 1]]
    root = "0.7071067811865476"
    planes = [
        f"{{on: body.skin, obstacle: {{plane: {{point: [0, 0, -14.142135623730951], "
        f"normal: [{sign}{root}, 0, {root}]}}}}}}"
        for sign in ("", "-")
    ]
    return Trial(
        points, cells,
        {"skin": f"hypot(x, z) > {10 - 0.1 * size!r} and z < -2", "end": "y < 1e-6",
         "saddle": f"hypot(x, z) > {10 - 0.1 * size!r} and z > 6 and abs(y - 60) < 10"},
        ("{on: body.end, displacement: [null, 0, null]}",
         "{on: body.saddle, displacement: [0, null, null]}",
         "{on: body.saddle, total_force: [0, 0, -9000]}"),
        tuple(planes),
    )  # fmt: skip


def cup_on_ball(size: float) -> Trial:
    """A shell, part of a hollow sphere, with play on a rigid ball and pressed along its rim."""
    flat, cells = swept(disc(1.0, 20, size), layers(4, 3, size))
    angle = np.hypot(flat[:, 0], flat[:, 1]) * np.deg2rad(70)
    turn = np.arctan2(flat[:, 1], flat[:, 0])
    radius = 30.05 + flat[:, 2]
    points = np.column_stack([
        radius * np.sin(angle) * np.cos(turn), radius * np.sin(angle) * np.sin(turn),
        radius * np.cos(angle),
    ])  # fmt: skip
    points[:, 2] -= 0.05
    distance = "sqrt(x**2 + y**2 + (z + 0.05)**2)"
    return Trial(
        points, cells,
        {"inside": f"{distance} < {30.05 + 0.1 * size!r}",
         "rim": f"hypot(x, y) > {np.sin(np.deg2rad(70)):.12f} * {distance} - {0.1 * size!r}"},
        ("{on: body.rim, displacement: [0, 0, null]}",
         "{on: body.rim, total_force: [0, 0, -15000]}"),
        ("{on: body.inside, obstacle: {sphere: {center: [0, 0, 0], radius: 30}}}",),
    )  # fmt: skip


def beam_on_rollers(size: float) -> Trial:
    """A slender beam that two rollers carry and a third presses: contact alone holds it."""
    points, cells = box((260, 10, 12), (150, 6, 7), size)
    rollers = [
        f"{{on: body.{side}, obstacle: {{cylinder: {{point: [{x}, 0, {z}], axis: [0, 1, 0], "
        "radius: 15}}}"
        for side, x, z in (("base", 40, -15), ("base", 220, -15), ("top", 110, 26.7))
    ]
    return Trial(
        points, cells,
        {"base": "z < 1e-6", "top": "z > 12 - 1e-6", "end": "x < 1e-6",
         "tip": "x > 255 and z > 12 - 1e-6"},
        ("{on: body.end, displacement: [0, 0, null]}",
         "{on: body.tip, total_force: [0, 0, -150]}"),
        tuple(rollers),
    )  # fmt: skip


def graded_block(size: float) -> Trial:
    """A block with cells forty times finer at an edge, where a ball presses it; its base slides."""
    profile = grid((1, 1), (26, 26), size)
    points, cells = swept(profile, layers(1, 12, size))
    points = points[:, [0, 2, 1]]
    graded = (np.exp(GRADING * points) - 1) / (np.exp(GRADING) - 1)
    points = graded * [40.0, 40.0, -30.0]
    return Trial(
        points, cells,
        {"top": "z > -1e-9", "foot": "z < -30 + 1e-6", "side": "x > 40 - 1e-6"},
        ("{on: body.foot, displacement: [0, 0, 0.02]}",),
        ("{on: body.top, obstacle: {sphere: {center: [0, 0, 60], radius: 60}}}",),
    )  # fmt: skip


def eye_on_pin(size: float) -> Trial:
    """Half an eye with play on a rigid pin, pulled at both its ends."""
    return _eye(size, 10.02, "{on: body.ends, total_force: [200, 0, -8000]}", 180.0)


def ring_on_shaft(size: float) -> Trial:
    """A ring pressed onto a rigid shaft that is 0.02 too thick, and pulled to one side."""
    return _eye(size, 9.98, "{on: body.outside, total_force: [0, 0, -9000]}", 360.0)


def _eye(size: float, inner: float, load: str, degrees: float) -> Trial:
    """A ring or a part of it about a shaft of radius 10."""
    outer, width = 18.0, 14.0
    around = 52 if degrees < 360.0 else 76
    profile = grid((degrees, outer - inner), (around, 9), size, closed=degrees >= 360.0)
    flat, cells = swept(profile, layers(width, 14, size))
    angle, radius = np.deg2rad(flat[:, 0]), inner + flat[:, 1]
    points = np.column_stack([radius * np.cos(angle), flat[:, 2], radius * np.sin(angle)])
    boundaries = {"bore": f"hypot(x, z) < {inner + 0.1 * size!r}", "face": "y < 1e-6",
                  "outside": f"hypot(x, z) > {outer - 0.1 * size!r} and z < -5"}  # fmt: skip
    if degrees < 360.0:
        boundaries |= {"ends": "abs(z) < 1e-6", "outside": f"hypot(x, z) > {outer - 0.1 * size!r}"}
    return Trial(
        points, cells, boundaries,
        ("{on: body.face, displacement: [null, 0, null]}", load),
        ("{on: body.bore, obstacle: {cylinder: {point: [0, 0, 0], axis: [0, 1, 0], "
         "radius: 10}}}",),
    )  # fmt: skip


@dataclass(frozen=True)
class Profile:
    """A triangulation of the plane: points (nodes, 2) and triangles (cells, 3)."""

    points: Array
    triangles: Cells


def count(at_size_one: float, size: float) -> int:
    """Number of cells along an edge, given the number for a size of one."""
    return max(1, round(at_size_one / size))


def grid(
    lengths: tuple[float, float],
    cells: tuple[int, int],
    size: float,
    keep: Callable[[Array, Array], NDArray[np.bool_]] | None = None,
    closed: bool = False,
) -> Profile:
    """A rectangle of cells, or only the cells whose centre `keep` accepts.

    Parameters
    ----------
    closed
        Whether its two ends along the first axis are joined.
    """
    nx, ny = (count(c, size) for c in cells)
    nx += nx % 2 if closed else 0  # a load on one side of an odd ring would turn it
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    if keep is not None:
        inside = keep(lengths[0] * (i + 0.5) / nx, lengths[1] * (j + 0.5) / ny)
        i, j = i[inside], j[inside]
    i, j = i.ravel(), j.ravel()
    following = (i + 1) % nx if closed else i + 1
    quads = np.column_stack([i * (ny + 1) + j, following * (ny + 1) + j,
                             following * (ny + 1) + j + 1, i * (ny + 1) + j + 1])  # fmt: skip
    odd = (i + j) % 2 == 1
    quads[odd] = np.roll(quads[odd], 1, axis=1)
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    x, y = np.meshgrid(np.arange(nx + 1) / nx, np.arange(ny + 1) / ny, indexing="ij")
    points = np.column_stack([lengths[0] * x.ravel(), lengths[1] * y.ravel()])
    steps = np.array([lengths[0] / nx, lengths[1] / ny])
    return _moved(_compact(points, triangles), steps)


def disc(radius: float, rings: int, size: float) -> Profile:
    """A disc of rings of triangles, six more in each."""
    rings = count(rings, size)
    points, first = [np.zeros((1, 2))], [0]
    for k in range(1, rings + 1):
        angle = 2 * np.pi * np.arange(6 * k) / (6 * k)
        points.append(radius * k / rings * np.column_stack([np.cos(angle), np.sin(angle)]))
        first.append(first[-1] + len(points[-2]))
    triangles = []
    for k in range(1, rings + 1):
        inner, outer = max(6 * (k - 1), 1), 6 * k
        for sector in range(6):
            for step in range(k):
                a = first[k] + (sector * k + step) % outer
                b = first[k] + (sector * k + step + 1) % outer
                c = first[k - 1] + (sector * (k - 1) + step) % inner
                triangles.append((a, b, c))
                if step < k - 1:
                    d = first[k - 1] + (sector * (k - 1) + step + 1) % inner
                    triangles.append((b, d, c))
    steps = np.full(2, radius / rings)
    return _moved(Profile(np.vstack(points), np.array(triangles)), steps)


def layers(length: float, cells: int, size: float) -> Array:
    """Heights of the layers that a profile is swept through."""
    return np.linspace(0.0, length, count(cells, size) + 1)


def swept(profile: Profile, heights: Array) -> tuple[Array, Cells]:
    """Points and tetrahedra of a profile swept along z; inner nodes are moved at random."""
    n, random = len(profile.points), np.random.default_rng(2)
    points = np.vstack([np.column_stack([profile.points, np.full(n, z)]) for z in heights])
    inner = np.ones(n, bool)
    inner[_edge_nodes(profile.triangles)] = False
    for k in range(1, len(heights) - 1):
        layer = points[k * n : (k + 1) * n]
        layer[inner, 2] += MOVE * (heights[1] - heights[0]) * random.uniform(-1, 1, inner.sum())
    a, b, c = np.sort(profile.triangles, axis=1).T
    prism = np.vstack([np.column_stack([a, b, c, c + n]), np.column_stack([a, b, b + n, c + n]),
                       np.column_stack([a, a + n, b + n, c + n])])  # fmt: skip
    return points, np.vstack([prism + k * n for k in range(len(heights) - 1)])


def box(
    lengths: tuple[float, float, float], cells: tuple[int, int, int], size: float
) -> tuple[Array, Cells]:
    """A box with a number of cells along each axis."""
    return swept(grid(lengths[:2], cells[:2], size), layers(lengths[2], cells[2], size))


def _edge_nodes(triangles: Cells) -> Cells:
    """Nodes on the edges of one triangle alone."""
    edges = np.sort(np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]))
    distinct, times = np.unique(edges, axis=0, return_counts=True)
    return np.unique(distinct[times == 1])


def _moved(profile: Profile, steps: Array) -> Profile:
    """The profile with its inner nodes moved at random."""
    points, random = profile.points.copy(), np.random.default_rng(1)
    inner = np.ones(len(points), bool)
    inner[_edge_nodes(profile.triangles)] = False
    points[inner] += MOVE * steps * random.uniform(-1, 1, (inner.sum(), 2))
    return Profile(points, profile.triangles)


def _compact(points: Array, cells: Cells) -> Profile:
    """Points and cells without the nodes that no cell has."""
    used, places = np.unique(cells, return_inverse=True)
    return Profile(points[used], places.reshape(cells.shape))


def turned(points: Array, cells: Cells) -> Cells:
    """Cells with positive volumes.

    Raises
    ------
    ValueError
        A cell is flat.
    """
    corners = points[cells]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    extent = np.ptp(points, axis=0).max()
    if np.abs(volume).min() < 1e-15 * extent**3:
        raise ValueError("a cell is flat")
    cells = cells.copy()
    inverted = volume < 0.0
    cells[inverted] = cells[inverted][:, [1, 0, 2, 3]]
    return cells


TRIALS: dict[str, Callable[[float], Trial]] = {
    function.__name__: function
    for function in (
        lifted_plate, pressed_plate, leaf_spring, ribbed_panel, angle_bracket, bar_in_vee,
        cup_on_ball, beam_on_rollers, graded_block, eye_on_pin, ring_on_shaft,
    )
}  # fmt: skip
"""The function that makes each part."""


def scene_of(name: str, trial: Trial) -> str:
    """The scene of a part as YAML."""
    lines = [f"title: trial part {name}", "dimension: 3", "bodies:", "  - name: body",
             f"    mesh: {{file: {name}.vtu}}", f"    material: {STEEL}", "    boundaries:",
             *(f"      {key}: {{where: \"{where}\"}}" for key, where in trial.boundaries.items()),
             "conditions:", *(f"  - {line}" for line in trial.conditions),
             "contacts:", *(f"  - {line}" for line in trial.contacts)]  # fmt: skip
    return "\n".join(lines) + "\n"


def write(name: str, size: float, directory: Path, friction: float | None = None) -> Path:
    """Make one part, perhaps with friction at all contacts, and return the path of its scene."""
    directory.mkdir(parents=True, exist_ok=True)
    trial = TRIALS[name](size)
    if friction is not None:
        law = f", friction: {{coulomb: {friction:g}}}}}"
        trial = replace(trial, contacts=tuple(line[:-1] + law for line in trial.contacts))
    cells = turned(trial.points, trial.cells)
    meshio.write(directory / f"{name}.vtu", meshio.Mesh(trial.points, [("tetra", cells)]))
    scene = directory / f"{name}.yaml"
    scene.write_text(scene_of(name, trial), encoding="utf-8")
    return scene


def main() -> None:
    """Make the parts named on the command line, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(TRIALS)}; all unless given")
    parser.add_argument("--size", type=float, default=1.0, help="of cells over the part's own")
    parser.add_argument("--to", type=Path, default=Path("trials"), help="directory to write to")
    parser.add_argument("--friction", type=float, help="coefficient at all contacts")
    arguments = parser.parse_args()
    for name in arguments.names or TRIALS:
        scene = write(name, arguments.size, arguments.to, arguments.friction)
        nodes = len(meshio.read(scene.with_suffix(".vtu")).points)
        print(f"{scene}: {nodes:,} nodes")


if __name__ == "__main__":
    main()
