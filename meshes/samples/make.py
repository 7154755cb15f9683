"""Make the sample meshes with Gmsh: ``python meshes/samples/make.py [NAME …] [--size FACTOR]``.

Needs Gmsh's Python module (Debian: python3-gmsh; elsewhere: pip install gmsh), which nothing else
in this project does. Lengths are in millimetres.
"""

from __future__ import annotations

import argparse
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


SAMPLES: dict[str, Callable[[float], None]] = {"bracket": bracket}


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
