"""Draw the parts of the tutorials with Gmsh: ``make_parts.py [NAME …] [--size LENGTH] [--to DIR]``.

The meshes in this directory are as coarse as a tutorial allows. ``--size`` is the size of cells
near contact, and ``--factor`` gives it as a multiple of the default size of the part. ``--order 2``
gives cells with nodes on their edges, which follow the round boundaries. ``--fused`` draws the
bodies of a part as one. Lengths are in millimetres.
"""

import math
from collections.abc import Sequence
from functools import partial

import gmsh
from drawing import Shapes, run  # type: ignore[import-not-found]

Box = tuple[float, float, float, float, float, float]


def pin_in_lug(size: float, fused: bool = False) -> None:
    """A lug of thickness 10 with an eye of radius 10.02 on a pin of radius 10."""
    radius = 10.0 if fused else 10.02
    occ = gmsh.model.occ
    eye = occ.addCylinder(0, -5, 0, 0, 10, 0, 20)
    shank = occ.addBox(-60, -5, -15, 60, 10, 30)
    (body, _) = occ.fuse([(3, eye)], [(3, shank)])
    hole = occ.addCylinder(0, -5, 0, 0, 10, 0, radius)
    (rest, _) = occ.cut(body, [(3, hole)])
    lug = rest[0][1]
    pin = occ.addCylinder(0, -9, 0, 0, 18, 0, 10)
    if fused:
        lug, pin = fuse(lug, pin)
    occ.synchronize()
    bore = cylindrical(lug, radius, 1)
    name_groups(3, {"lug": [lug], "pin": [pin]})
    name_groups(2, {
        "bore": bore, "shaft": cylindrical(pin, 10.0, 1), "pull": flat(lug, 0, -60),
        "ends": flat(pin, 1, -9) + flat(pin, 1, 9),
    })  # fmt: skip
    make_mesh([near(bore, size, 4 * size, 0.5, 25)])


def bolted_flange(size: float, fused: bool = False) -> None:
    """Two T-stubs, flange on flange, with two bolt holes each; washers of radius 11 about them."""
    upper, lower = _stub(1), _stub(-1)
    if fused:
        upper, lower = fuse(upper, lower)
    gmsh.model.occ.synchronize()
    drop_loose_faces()
    name_groups(3, {"upper": [upper], "lower": [lower]})
    under, over = flat(upper, 2, 0), flat(lower, 2, 0)
    name_groups(2, {
        "under": under, "over": over, "pull": flat(upper, 2, 52), "foot": flat(lower, 2, -52),
        "upper_washers": as_wide(flat(upper, 2, 12), 22.0),
        "lower_washers": as_wide(flat(lower, 2, -12), 22.0),
    })  # fmt: skip
    make_mesh([near(under, size, 2.5 * size, 4, 40), near(over, 1.25 * size, 2.5 * size, 4, 40)])


def ball_in_grooves(size: float, fused: bool = False) -> None:
    """A ball of radius 5 between two blocks with a groove of radius 5.2 along y in each.

    Fine where Hertz's ellipses of contact are, long along x and narrow along y. Fused, the ball
    is 0.01 larger and loses what overlaps: ellipses of half axes 1.61 and 0.32 are shared.
    """
    occ = gmsh.model.occ
    lower, upper = _race(-1), _race(1)
    ball = occ.addSphere(0, 0, 0, 5.01 if fused else 5)
    if fused:
        races = [(3, lower), (3, upper)]
        rest, _ = occ.cut([(3, ball)], races, removeTool=False)
        lower, upper, ball = fuse(lower, upper, rest[0][1])
    occ.synchronize()
    name_groups(3, {"ball": [ball], "lower": [lower], "upper": [upper]})
    name_groups(2, {
        "skin": surfaces(ball), "lower_groove": cylindrical(lower, 5.2, 1, (0, 0, 0.2)),
        "upper_groove": cylindrical(upper, 5.2, 1, (0, 0, -0.2)), "foot": flat(lower, 2, -9),
        "top": flat(upper, 2, 9),
    })  # fmt: skip
    make_mesh([in_box((-1.75, -0.32, z - 0.3, 1.75, 0.32, z + 0.3), size, 1.6) for z in (-5, 5)])


def pillow_block(size: float) -> None:
    """A bearing block with a bore of radius 16, bolted to the floor through two holes."""
    occ = gmsh.model.occ
    base = occ.addBox(-60, -20, 0, 120, 40, 15)
    boss = occ.addCylinder(0, -20, 45, 0, 40, 0, 30)
    neck = occ.addBox(-30, -20, 10, 60, 40, 35)
    (body, _) = occ.fuse([(3, base)], [(3, boss), (3, neck)])
    bolts = [occ.addCylinder(x, 0, 0, 0, 0, 20, 5.5) for x in (-47, 47)]
    halves = []
    for z in (29, 45):  # the load acts on one of them
        bore, side = occ.addCylinder(0, -20, 45, 0, 40, 0, 16), occ.addBox(-20, -20, z, 40, 40, 16)
        (half, _) = occ.intersect([(3, bore)], [(3, side)])
        halves += half
    (body, _) = occ.cut(body, [*halves, *((3, bolt) for bolt in bolts)])
    discs = [(2, occ.addDisk(x, 0, 15, 10, 10)) for x in (-47, 47)]
    (pieces, _) = occ.fragment(body, discs)
    block = next(tag for dimension, tag in pieces if dimension == 3)
    occ.synchronize()
    drop_loose_faces()
    bottom, lining = flat(block, 2, 0), cylindrical(block, 16, 1, (0, 0, 45))
    heights = {face: gmsh.model.occ.getCenterOfMass(2, face)[2] for face in lining}
    name_groups(3, {"block": [block]})
    name_groups(2, {
        "base": bottom, "crown": [f for f, z in heights.items() if z > 45.0],
        "sole": [f for f, z in heights.items() if z < 45.0],
        "holes": [f for x in (-47, 47) for f in cylindrical(block, 5.5, 2, (x, 0, 0))],
        "washers": as_wide(flat(block, 2, 15), 20.0),
    })  # fmt: skip
    make_mesh([near(bottom, size, 2 * size, 5, 40)])


def hub_on_shaft(size: float, fused: bool = False) -> None:
    """A hub with four holes and a bore of radius 19.98 on a shaft of radius 20."""
    radius = 20.0 if fused else 19.98
    occ = gmsh.model.occ
    shaft = occ.addCylinder(0, 0, -40, 0, 0, 80, 20)
    hub = occ.addCylinder(0, 0, -15, 0, 0, 30, 40)
    places = [
        (31 * math.cos(a), 31 * math.sin(a)) for a in (0, 0.5 * math.pi, math.pi, 1.5 * math.pi)
    ]
    tools = [occ.addCylinder(x, y, -15, 0, 0, 30, 4) for x, y in places]
    tools.append(occ.addCylinder(0, 0, -15, 0, 0, 30, radius))
    (rest, _) = occ.cut([(3, hub)], [(3, tool) for tool in tools])
    hub = rest[0][1]
    if fused:
        hub, shaft = fuse(hub, shaft)
    occ.synchronize()
    bore = cylindrical(hub, radius, 2)
    holes = [f for x, y in places for f in cylindrical(hub, 4, 2, (x, y, 0))]
    name_groups(3, {"hub": [hub], "shaft": [shaft]})
    name_groups(2, {
        "bore": bore, "seat": cylindrical(shaft, 20, 2), "end": flat(shaft, 2, -40), "holes": holes,
    })  # fmt: skip
    make_mesh([near(bore, size, 3 * size, 0.5, 25), near(holes, min(size, 2.5), 3 * size, 0.3, 14)])


def fuse(*volumes: int) -> list[int]:
    """Fuse volumes along common faces, so that one mesh goes through all."""
    first, *others = [(3, volume) for volume in volumes]
    _, pieces = gmsh.model.occ.fragment([first], others)
    return [piece[0][1] for piece in pieces]


def _stub(side: int) -> int:
    """A T-stub above (1) or below (-1) the plane z = 0."""
    occ = gmsh.model.occ
    flange = occ.addBox(-50, -30, min(0, 12 * side), 100, 60, 12)
    web = occ.addBox(-5, -30, 12 if side > 0 else -52, 10, 60, 40)
    (body, _) = occ.fuse([(3, flange)], [(3, web)])
    holes = [(3, occ.addCylinder(x, 0, 0, 0, 0, 12 * side, 6)) for x in (-30, 30)]
    (body, _) = occ.cut(body, holes)
    discs = [(2, occ.addDisk(x, 0, 12 * side, 11, 11)) for x in (-30, 30)]
    (pieces, _) = occ.fragment(body, discs)
    return next(tag for dimension, tag in pieces if dimension == 3)


def _race(side: int) -> int:
    """A block with a groove above (1) or below (-1) the ball."""
    occ = gmsh.model.occ
    block = occ.addBox(-6, -6, 3.5 if side > 0 else -9, 12, 12, 5.5)
    groove = occ.addCylinder(0, -7, -0.2 * side, 0, 14, 0, 5.2)
    (rest, _) = occ.cut([(3, block)], [(3, groove)])
    return rest[0][1]


def drop_loose_faces() -> None:
    """Remove faces that belong to no volume: the parts of the washers' discs over the holes."""
    for face in gmsh.model.getEntities(2):
        if not len(gmsh.model.getAdjacencies(*face)[0]):
            gmsh.model.removeEntities([face], recursive=True)


def surfaces(volume: int) -> list[int]:
    """Faces of a volume."""
    return [abs(tag) for _, tag in gmsh.model.getBoundary([(3, volume)], oriented=False)]


def cylindrical(
    volume: int, radius: float, axis: int, centre: Sequence[float] = (0.0, 0.0, 0.0)
) -> list[int]:
    """Faces of a volume on a cylinder about a line along an axis."""
    faces = []
    for face in surfaces(volume):
        if gmsh.model.getType(2, face) == "Cylinder":
            lower, upper = gmsh.model.getParametrizationBounds(2, face)
            middle = [0.5 * (a + b) for a, b in zip(lower, upper, strict=True)]
            away = [
                x - c for x, c in zip(gmsh.model.getValue(2, face, middle), centre, strict=True)
            ]
            away[axis] = 0.0
            if abs(math.hypot(*away) - radius) < 1e-6:
                faces.append(face)
    return faces


def flat(volume: int, axis: int, at: float) -> list[int]:
    """Faces of a volume in a plane across an axis."""
    boxes = {face: gmsh.model.getBoundingBox(2, face) for face in surfaces(volume)}
    return [
        f for f, box in boxes.items() if max(abs(box[axis] - at), abs(box[axis + 3] - at)) < 1e-4
    ]


def as_wide(faces: list[int], width: float) -> list[int]:
    """The faces with a given width along x."""
    boxes = {face: gmsh.model.getBoundingBox(2, face) for face in faces}
    return [face for face, box in boxes.items() if abs(box[3] - box[0] - width) < 0.1]


def name_groups(dimension: int, groups: dict[str, list[int]]) -> None:
    """Make physical groups (raises ValueError for an empty one).

    Faces between two volumes are not part of a boundary.
    """
    for name, tags in groups.items():
        if not tags:
            raise ValueError(f"no face of the part is its {name}")
        outer = [t for t in tags if dimension == 3 or len(gmsh.model.getAdjacencies(2, t)[0]) == 1]
        if outer:
            gmsh.model.addPhysicalGroup(dimension, outer, name=name)


def near(faces: list[int], fine: float, coarse: float, begin: float, end: float) -> int:
    """Mesh size field that grows with the distance from some faces, between two distances."""
    field = gmsh.model.mesh.field
    distance, sizes = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance, "SurfacesList", faces)
    field.setNumber(distance, "Sampling", 60)
    options = {"InField": distance, "SizeMin": fine, "SizeMax": coarse, "DistMin": begin,
               "DistMax": end}  # fmt: skip
    for key, value in options.items():
        field.setNumber(sizes, key, value)
    return sizes


def in_box(box: Box, fine: float, coarse: float) -> int:
    """Mesh size field: one size inside a box, another away from it."""
    field = gmsh.model.mesh.field
    sizes = field.add("Box")
    names = ("XMin", "YMin", "ZMin", "XMax", "YMax", "ZMax")
    options = dict(zip(names, box, strict=True)) | {"VIn": fine, "VOut": coarse, "Thickness": 5}
    for key, value in options.items():
        field.setNumber(sizes, key, value)
    return sizes


def make_mesh(fields: list[int]) -> None:
    """Make the mesh with the smallest size of several fields."""
    smallest = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(smallest, "FieldsList", fields)
    gmsh.model.mesh.field.setAsBackgroundMesh(smallest)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.option.setNumber("Mesh.Algorithm3D", 10)
    gmsh.model.mesh.generate(3)


PARTS: Shapes = {
    "ball_in_grooves": (ball_in_grooves, 0.2, 1),
    "bolted_flange": (bolted_flange, 5.5, 1),
    "hub_on_shaft": (hub_on_shaft, 6.0, 2),
    "pillow_block": (pillow_block, 5.0, 1),
    "pin_in_lug": (pin_in_lug, 2.5, 2),
}
"""The function that draws each part, with default size near contact and default order."""

FUSED = {
    "ball_in_grooves": partial(ball_in_grooves, fused=True),
    "bolted_flange": partial(bolted_flange, fused=True),
    "hub_on_shaft": partial(hub_on_shaft, fused=True),
    "pin_in_lug": partial(pin_in_lug, fused=True),
}
"""Parts that can be drawn as one body, without play and with one mesh through both."""


if __name__ == "__main__":
    run(__doc__, PARTS, FUSED)
