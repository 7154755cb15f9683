"""The command line of the scripts that draw meshes with Gmsh: shape after shape to a file.

Needs Gmsh's Python module (Debian: python3-gmsh; elsewhere: pip install gmsh), which nothing else
in this project needs.
"""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

import gmsh

HERE = Path(__file__).parent

Draw = Callable[[float], None]
"""A function that draws a shape and makes its mesh, with cells of a size."""

Shapes = Mapping[str, tuple[Draw, float, int]]
"""The function of each shape, with the size and the order of the cells of the shipped mesh."""


def draw_with(draw: Draw, size: float, order: int, file: Path) -> int:
    """Draw a shape by a function, write its mesh and return its number of nodes."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    gmsh.model.add(file.stem)
    draw(size)
    gmsh.model.mesh.setOrder(order)
    if order == 2:
        gmsh.model.mesh.optimize("HighOrder")
    gmsh.write(str(file))
    count = len(gmsh.model.mesh.getNodes()[0])
    gmsh.finalize()
    return count


def run(description: str, shapes: Shapes, fused: Mapping[str, Draw]) -> None:
    """Draw the shapes named on the command line, or all of them.

    Parameters
    ----------
    fused
        Functions that draw the bodies of a shape as one.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(shapes)}; all unless given")
    sizes = parser.add_mutually_exclusive_group()
    sizes.add_argument("--size", type=float, help="size of the cells, near contact if they grow")
    sizes.add_argument("--factor", type=float, default=1.0, help="multiple of the shape's own size")
    parser.add_argument("--order", type=int, choices=(1, 2), help="of the cells")
    if fused:
        parser.add_argument("--fused", action="store_true", help="all bodies as one, of order 1")
    parser.add_argument("--to", type=Path, default=HERE, help="directory to write to")
    arguments = parser.parse_args()
    arguments.to.mkdir(parents=True, exist_ok=True)
    for name in arguments.names or shapes:
        file = arguments.to / f"{name}.msh"
        draw, size, order = shapes[name]
        if fused and arguments.fused:
            if name not in fused:
                parser.error(f"{name} has no fused form; these have: {', '.join(fused)}")
            draw, order = fused[name], 1
        size = arguments.size or arguments.factor * size
        nodes = draw_with(draw, size, arguments.order or order, file)
        print(f"{file}: {nodes:,} nodes")
