"""Make the sample meshes with Gmsh: ``python meshes/samples/make.py [NAME …] [--size FACTOR]``.

Needs Gmsh's Python module (Debian: python3-gmsh; elsewhere: pip install gmsh), which nothing else
in this project does. Lengths are in millimetres.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import gmsh

HERE = Path(__file__).parent


def bracket(size: float) -> None:
    """A plate of steel with a hole and a bushing of bronze in it, in the plane: triangles."""
    occ = gmsh.model.occ
    plate = occ.addRectangle(0, 0, 0, 60, 30)
    hole = occ.addDisk(42, 15, 0, 8, 8)
    bushing = occ.addDisk(42, 15, 0, 8, 8)
    bore = occ.addDisk(42, 15, 0, 5, 5)
    occ.cut([(2, plate)], [(2, hole)])
    occ.cut([(2, bushing)], [(2, bore)])
    occ.fragment([(2, plate)], [(2, bushing)])
    occ.synchronize()
    surfaces = [tag for _, tag in gmsh.model.getEntities(2)]
    areas = {tag: occ.getMass(2, tag) for tag in surfaces}
    ring = min(areas, key=areas.__getitem__)
    gmsh.model.addPhysicalGroup(2, [t for t in surfaces if t != ring], name="steel")
    gmsh.model.addPhysicalGroup(2, [ring], name="bronze")
    sides = {"foot": (0, 0, 0, 30), "bottom": (0, 0, 60, 0), "top": (0, 30, 60, 30)}
    for name, (x0, y0, x1, y1) in sides.items():
        box = (x0 - 1e-3, y0 - 1e-3, -1, x1 + 1e-3, y1 + 1e-3, 1)
        found = [t for _, t in gmsh.model.getEntitiesInBoundingBox(*box, dim=1)]
        gmsh.model.addPhysicalGroup(1, found, name=name)
    box = (36.9, 9.9, -1, 47.1, 20.1, 1)
    inner = [t for _, t in gmsh.model.getEntitiesInBoundingBox(*box, dim=1)]
    gmsh.model.addPhysicalGroup(1, inner, name="bore")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 3.0 * size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 16 / size)
    gmsh.model.mesh.generate(2)
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)


def sphere_eighth(size: float) -> None:
    """An eighth of a ball of radius 8 that rests on z = 0 in the origin: tetrahedra.

    Fine about the point of contact (0.02 out to 0.4), then growing with the distance.
    """
    occ = gmsh.model.occ
    ball = occ.addSphere(0, 0, 8, 8, -1, angle1=-math.pi / 2, angle2=0.0, angle3=math.pi / 2)
    occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [ball], name="ball")
    for name, at in {"x-": (0, 3, 5), "y-": (3, 0, 5), "equator": (3, 3, 8)}.items():
        gmsh.model.addPhysicalGroup(2, [_surface_through(at)], name=name)
    flat = {_surface_through(at) for at in ((0, 3, 5), (3, 0, 5), (3, 3, 8))}
    curved = [t for _, t in gmsh.model.getBoundary([(3, ball)], oriented=False) if t not in flat]
    gmsh.model.addPhysicalGroup(2, curved, name="sphere")
    _refine((0, 0, 0), near=0.35, fine=0.02 * size, growth=0.12 * size, coarse=1.0 * size)
    gmsh.model.mesh.generate(3)


def _surface_through(point: tuple[float, float, float]) -> int:
    """The flat surface whose bounding box holds a point and is thin there."""
    for _, tag in gmsh.model.getEntities(2):
        box = gmsh.model.getBoundingBox(2, tag)
        thin = min(b - a for a, b in zip(box[:3], box[3:], strict=True)) < 1e-3
        inside = all(a - 1e-3 < v < b + 1e-3 for a, v, b in zip(box[:3], point, box[3:],
                                                                strict=True))  # fmt: skip
        if thin and inside:
            return tag
    raise LookupError(f"no flat surface through {point}")


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


SAMPLES: dict[str, Callable[[float], None]] = {"bracket": bracket, "sphere_eighth": sphere_eighth}


def main() -> None:
    """Make the samples named on the command line, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*SAMPLES, []], default=[])
    parser.add_argument("--size", type=float, default=1.0, help="factor of all cell sizes")
    parser.add_argument("--to", type=Path, default=HERE, help="directory to write to")
    given = parser.parse_args()
    for name in given.names or SAMPLES:
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add(name)
        SAMPLES[name](given.size)
        gmsh.write(str(given.to / f"{name}.msh"))
        gmsh.finalize()


if __name__ == "__main__":
    main()
