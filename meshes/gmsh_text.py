"""Mesh files of Gmsh's format 4.1 in text, read section by section.

meshio reads the numbers of a text one by one, which takes five times as long. So the sections that
all such files have, of simplices, quadrilaterals and hexahedra, are read here, and meshio reads all
other files, and those with errors, on which it reports.

Format: https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format.
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import DTypeLike, NDArray

TYPES: dict[int, tuple[str, tuple[int, ...]]] = {
    1: ("line", (0, 1)),
    2: ("triangle", (0, 1, 2)),
    3: ("quad", (0, 1, 2, 3)),
    4: ("tetra", (0, 1, 2, 3)),
    5: ("hexahedron", (0, 1, 2, 3, 4, 5, 6, 7)),
    8: ("line3", (0, 1, 2)),
    9: ("triangle6", (0, 1, 2, 3, 4, 5)),
    11: ("tetra10", (0, 1, 2, 3, 4, 5, 6, 7, 9, 8)),
    15: ("vertex", (0,)),
}
"""meshio's name of each type of cell, and its nodes in the order of VTK."""


def read_msh(path: Path) -> Any:
    """The mesh of a file, with its physical groups as sets of cells; raises what meshio raises."""
    text = path.read_bytes()
    if text.startswith(b"$MeshFormat\n4.1 0 ") and b"\n$Comments" not in text:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # numpy warns of text that is no number
                return _mesh(text, physical_names(path))
        except (ArithmeticError, LookupError, ValueError, Warning):
            pass
    return meshio.read(path)


def _mesh(text: bytes, names: dict[tuple[int, int], str]) -> meshio.Mesh:
    """The mesh of a text; raises an error of some kind where a section is not as it should be."""
    physical, nodes = _physical_tags(text), _numbers(text, b"Nodes", np.float64)
    tags, points, at = [], [], 4
    for _ in range(int(nodes[0])):
        parametric, count = (int(x) for x in nodes[at + 2 : at + 4])
        if parametric:
            raise ValueError("nodes have parameters on their surface")
        end = at + 4 + 4 * count
        tags.append(nodes[at + 4 : at + 4 + count].astype(np.int64))
        points.append(nodes[at + 4 + count : end].reshape(count, 3))
        at = end
    number = np.concatenate(tags)
    place = np.full(number.max() + 1, -1)
    place[number] = np.arange(len(number))
    elements, cells, at = _numbers(text, b"Elements", np.int64), [], 4
    if elements.min(initial=0) < 0:
        raise ValueError("a node has a negative number")
    blocks = int(elements[0])
    sets: dict[str, list[NDArray]] = {
        name: [np.zeros(0, np.int64)] * blocks for name in names.values()
    }
    grouped = set()
    for block in range(blocks):
        dimension, entity, kind, count = (int(x) for x in elements[at : at + 4])
        name, order = TYPES[kind]
        end = at + 4 + (1 + len(order)) * count
        cells.append((name, place[elements[at + 4 : end].reshape(count, -1)[:, 1:]][:, order]))
        for tag in (tags_of := physical.get((dimension, entity), [])):
            group = names.get((tag, dimension), str(tag))
            of_block = sets.setdefault(group, [np.zeros(0, np.int64)] * blocks)
            of_block[block] = np.arange(count)
        grouped.add(bool(tags_of))
        at = end
    if len(grouped) != 1:
        raise ValueError("some cells are in groups and some in none, which meshio refuses")
    return meshio.Mesh(np.concatenate(points), cells, cell_sets=sets)


def _numbers(text: bytes, name: bytes, kind: DTypeLike) -> NDArray:
    """The numbers of a section."""
    begin = text.index(b"\n$" + name + b"\n") + len(name) + 3
    return np.fromstring(text[begin : text.index(b"$End" + name, begin)], kind, sep=" ")


def _physical_tags(text: bytes) -> dict[tuple[int, int], list[int]]:
    """Numbers of the physical groups of each entity (dimension, tag)."""
    if b"\n$Entities\n" not in text:
        return {}
    values, at = _numbers(text, b"Entities", np.float64), 4
    groups = {}
    for dimension in range(4):
        for _ in range(int(values[dimension])):
            first = at + (5 if dimension == 0 else 8)
            end = first + int(values[first - 1])
            groups[dimension, int(values[at])] = [abs(int(x)) for x in values[first:end]]
            at = end if dimension == 0 else end + 1 + int(values[end])
    return groups


def physical_names(path: Path) -> dict[tuple[int, int], str]:
    """Names of the physical groups of a file of Gmsh, in text or not, by number and dimension.

    meshio keeps one group for each name, but Gmsh allows a surface and a volume of one name.
    """
    names: dict[tuple[int, int], str] = {}
    if path.suffix != ".msh":
        return names
    with path.open("rb") as file:
        for line in file:
            if line.strip() == b"$PhysicalNames":
                break
            if line.strip() in (b"$Nodes", b"$Entities"):
                return names
        for line in file:
            match = re.match(r'\s*(\d+)\s+(\d+)\s+"(.*)"\s*$', line.decode(errors="replace"))
            if match:
                names[int(match[2]), int(match[1])] = match[3]
            elif line.startswith(b"$"):
                break
    return names
