"""Make the sample meshes with Gmsh: ``python meshes/samples/make.py [NAME …] [--size SIZE]``.

The meshes in ``coarse``, which `contact-app verify` refines, are made with ``sphere_eighth --size
2.8``, ``disc_quarter`` and ``roller_on_block --size 4``, and ``ring_quarter --size 1 --order 1``.

``--order 2`` gives cells with nodes on their edges, which follow the round boundaries.

Lengths are in millimetres.
"""

import math

import gmsh
from drawing import Shapes, run  # type: ignore[import-not-found]


def bushing(size: float) -> None:
    """A plate of steel, clamped at its foot, with a bushing of bronze in it: triangles, 2D."""
    occ = gmsh.model.occ
    plate = occ.addRectangle(0, 0, 0, 60, 30)
    hole, ring = occ.addDisk(42, 15, 0, 8, 8), occ.addDisk(42, 15, 0, 8, 8)
    bore = occ.addDisk(42, 15, 0, 5, 5)
    occ.cut([(2, plate)], [(2, hole)])
    occ.cut([(2, ring)], [(2, bore)])
    occ.fragment([(2, plate)], [(2, ring)])
    occ.synchronize()
    areas = {tag: occ.getMass(2, tag) for _, tag in gmsh.model.getEntities(2)}
    inner = min(areas, key=areas.__getitem__)
    gmsh.model.addPhysicalGroup(2, [t for t in areas if t != inner], name="steel")
    gmsh.model.addPhysicalGroup(2, [inner], name="bronze")
    for name, box in {
        "foot": (0, 0, 0, 0, 30, 0),
        "top": (0, 30, 0, 60, 30, 0),
        "bore": (37, 10, 0, 47, 20, 0),
    }.items():
        gmsh.model.addPhysicalGroup(1, _within(1, box), name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 2.5 * size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 40 / size)
    gmsh.model.mesh.generate(2)


def bracket(size: float) -> None:
    """An L-shaped shelf bracket with a rounded corner, drawn from its profile: hexahedra."""
    geo = gmsh.model.geo
    corners = [(0, 0), (40, 0), (40, 6), (14, 6), (6, 14), (6, 50), (0, 50)]
    points = [geo.addPoint(x, 0, z) for x, z in corners]
    centre = geo.addPoint(14, 0, 14)
    lines = [geo.addLine(a, b) for a, b in zip(points, [*points[1:], points[0]], strict=True)]
    geo.remove([(1, lines[3])])
    lines[3] = geo.addCircleArc(points[3], centre, points[4])
    profile = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    layers = max(1, round(10 / size))
    geo.extrude([(2, profile)], 0, 30, 0, numElements=[layers], recombine=True)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(3, [1], name="bracket")
    for name, box in {
        "back": (0, 0, 0, 0, 30, 50),
        "seat": (14, 0, 6, 40, 30, 6),
        "top": (0, 0, 50, 6, 30, 50),
    }.items():
        gmsh.model.addPhysicalGroup(2, _within(2, box), name=name)
    for option, value in {"MeshSizeMax": 1.6 * size, "RecombineAll": 1, "Algorithm": 8,
                          "RecombinationAlgorithm": 3}.items():  # fmt: skip
        gmsh.option.setNumber(f"Mesh.{option}", value)
    gmsh.model.mesh.generate(3)


def disc_quarter(size: float) -> None:
    """A quarter of a disc of radius 50 that rests on y = 0 in the origin: quadrilaterals, 2D.

    Fine about the point of contact, then growing with the distance.
    """
    geo = gmsh.model.geo
    centre, south, east = (geo.addPoint(*p) for p in ((0, 50, 0), (0, 0, 0), (50, 50, 0)))
    lines = [geo.addCircleArc(south, centre, east), geo.addLine(east, centre),
             geo.addLine(centre, south)]  # fmt: skip
    disc = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [disc], name="disc")
    for name, line in zip(("rim", "equator", "x-"), lines, strict=True):
        gmsh.model.addPhysicalGroup(1, [line], name=name)
    _refine((0, 0, 0), near=4.0, fine=0.2 * size, growth=0.15 * size, coarse=5.0 * size)
    gmsh.option.setNumber("Mesh.RecombineAll", 1)
    gmsh.option.setNumber("Mesh.Algorithm", 8)
    gmsh.option.setNumber("Mesh.RecombinationAlgorithm", 3)
    gmsh.model.mesh.generate(2)


def _within(dimension: int, box: tuple[float, float, float, float, float, float]) -> list[int]:
    """Entities inside a box."""
    lower, upper = [v - 1e-3 for v in box[:3]], [v + 1e-3 for v in box[3:]]
    entities = gmsh.model.getEntitiesInBoundingBox(*lower, *upper, dimension)
    return [tag for _, tag in entities]


def sphere_eighth(size: float) -> None:
    """An eighth of a ball of radius 8 that rests on z = 0 in the origin: tetrahedra.

    Fine about the point of contact (0.02 out to 0.4), then growing with the distance.
    """
    occ = gmsh.model.occ
    ball = occ.addSphere(0, 0, 8, 8, -1, angle1=-math.pi / 2, angle2=0.0, angle3=math.pi / 2)
    occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [ball], name="ball")
    flat = {
        "x-": _within(2, (0, 0, 0, 0, 8, 8)),
        "y-": _within(2, (0, 0, 0, 8, 0, 8)),
        "equator": _within(2, (0, 0, 8, 8, 8, 8)),
    }
    for name, surfaces in flat.items():
        gmsh.model.addPhysicalGroup(2, surfaces, name=name)
    curved = {tag for _, tag in gmsh.model.getEntities(2)}.difference(*flat.values())
    gmsh.model.addPhysicalGroup(2, list(curved), name="sphere")
    _refine((0, 0, 0), near=0.35, fine=0.02 * size, growth=0.12 * size, coarse=1.0 * size)
    gmsh.model.mesh.generate(3)


def _refine(
    at: tuple[float, float, float], near: float, fine: float, growth: float, coarse: float
) -> None:
    """Cells of size `fine` within `near` of a point, then growing with the distance."""
    x, y, z = at
    distance = f"Sqrt((x-{x})^2+(y-{y})^2+(z-{z})^2)"
    field = gmsh.model.mesh.field
    number = field.add("MathEval")
    field.setString(number, "F", f"Min({coarse}, {fine}+{growth}*Max(0, {distance}-{near}))")
    field.setAsBackgroundMesh(number)
    for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)


def roller_on_block(size: float) -> None:
    """Half of a roller of radius 50 on a block, both in the plane: triangles that do not match.

    The roller is cut at its axis, where the load spreads; cells are a fifteenth of the half width
    of contact, 6.2, and grow with the distance from it.
    """
    geo = gmsh.model.geo
    fine, far = 0.4 * size, 16.0 * size

    def loop(corners: list[tuple[float, float, float]], middle: int | None) -> list[int]:
        """Lines from corner to corner (x, y, cell size); the first two are arcs about `middle`."""
        points = [geo.addPoint(x, y, 0, h) for x, y, h in corners]
        lines = []
        for k, start in enumerate(points):
            end = points[(k + 1) % len(points)]
            arc = middle is not None and k < 2
            lines.append(geo.addCircleArc(start, middle, end) if arc else geo.addLine(start, end))
        return lines

    x = 15.0
    arc_end = (x, 50 - (50**2 - x**2) ** 0.5)
    centre = geo.addPoint(0, 50, 0)
    roller = loop([(0, 0, fine), (*arc_end, 5 * fine), (50, 50, far), (0, 50, far)], centre)
    block = loop(
        [(0, 0, 1.3 * fine), (x, 0, 6 * fine), (100, 0, far), (100, -100, far), (0, -100, far)],
        None,
    )
    for name, lines in (("roller", roller), ("block", block)):
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.synchronize()
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
    groups = {
        "face": [roller[0], block[0]],
        "axis": [roller[3], block[4]],
        "top": [roller[2]],
        "foot": [block[3]],
    }
    for name, lines in groups.items():
        gmsh.model.addPhysicalGroup(1, lines, name=name)
    field = gmsh.model.mesh.field
    field.add("MathEval", 1)
    field.setString(1, "F", f"{fine} + {0.2 * size} * Max(0, Sqrt(x*x + y*y) - 7)")
    field.setAsBackgroundMesh(1)
    gmsh.model.mesh.generate(2)


def ring_quarter(size: float) -> None:
    """A quarter of a ring of radii 10 and 20 about the origin: quadrilaterals in rows, 2D."""
    geo = gmsh.model.geo
    centre, *ends = (geo.addPoint(*p, 0) for p in ((0, 0), (10, 0), (20, 0), (0, 20), (0, 10)))
    lines = [geo.addLine(ends[0], ends[1]), geo.addCircleArc(ends[1], centre, ends[2]),
             geo.addLine(ends[2], ends[3]), geo.addCircleArc(ends[3], centre, ends[0])]  # fmt: skip
    ring = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    across = max(1, round(2 / size))
    for k, line in enumerate(lines):
        geo.mesh.setTransfiniteCurve(line, (across if k % 2 == 0 else 2 * across) + 1)
    geo.mesh.setTransfiniteSurface(ring)
    geo.mesh.setRecombine(2, ring)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [ring], name="ring")
    for name, line in zip(("y-", "outer", "x-", "inner"), lines, strict=True):
        gmsh.model.addPhysicalGroup(1, [line], name=name)
    gmsh.model.mesh.generate(2)


def shaft_and_hub(size: float) -> None:
    """Quarters of a shaft of radius 10 and of a hub of radii 10 and 20: quadrilaterals, 2D.

    The hub's cells are in rows and do not match those of the shaft.
    """
    geo = gmsh.model.geo
    middle, east, north = (geo.addPoint(*p, 0) for p in ((0, 0), (10, 0), (0, 10)))
    shaft = [geo.addLine(middle, east), geo.addCircleArc(east, middle, north),
             geo.addLine(north, middle)]  # fmt: skip
    disc = geo.addPlaneSurface([geo.addCurveLoop(shaft)])
    ends = [geo.addPoint(*p, 0) for p in ((10, 0), (20, 0), (0, 20), (0, 10))]
    hub = [geo.addLine(ends[0], ends[1]), geo.addCircleArc(ends[1], middle, ends[2]),
           geo.addLine(ends[2], ends[3]), geo.addCircleArc(ends[3], middle, ends[0])]  # fmt: skip
    ring = geo.addPlaneSurface([geo.addCurveLoop(hub)])
    across = max(1, round(3 / size))
    for k, line in enumerate(hub):
        geo.mesh.setTransfiniteCurve(line, (across if k % 2 == 0 else 3 * across) + 1)
    geo.mesh.setTransfiniteCurve(shaft[1], 2 * across + 1)
    geo.mesh.setTransfiniteSurface(ring)
    geo.mesh.setRecombine(2, ring)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [disc], name="shaft")
    gmsh.model.addPhysicalGroup(2, [ring], name="hub")
    groups = {"skin": [shaft[1]], "bore": [hub[3]], "outside": [hub[1]], "x-": [shaft[2], hub[2]],
              "y-": [shaft[0], hub[0]]}  # fmt: skip
    for name, lines in groups.items():
        gmsh.model.addPhysicalGroup(1, lines, name=name)
    for option, value in {"MeshSizeMax": 10 / across * 1.5, "RecombineAll": 1, "Algorithm": 8,
                          "RecombinationAlgorithm": 3}.items():  # fmt: skip
        gmsh.option.setNumber(f"Mesh.{option}", value)
    gmsh.model.mesh.generate(2)


SAMPLES: Shapes = {
    "bushing": (bushing, 1.0, 1),
    "bracket": (bracket, 1.0, 1),
    "disc_quarter": (disc_quarter, 1.0, 1),
    "ring_quarter": (ring_quarter, 0.5, 2),
    "roller_on_block": (roller_on_block, 1.0, 1),
    "shaft_and_hub": (shaft_and_hub, 0.5, 2),
    "sphere_eighth": (sphere_eighth, 2.0, 1),
}
"""The function that draws each sample, with size and order of the mesh in this directory."""


if __name__ == "__main__":
    run(__doc__, SAMPLES, {})
