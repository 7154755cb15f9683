"""Gmsh's files in text, which meshio gets in binary.

meshio reads the numbers of a text in eight times the time of NumPy. For a part of 30,000 unknowns
the difference is a twentieth of a run.

Format 4.1: https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format. What this module does not know
(other versions, parametric nodes, data at nodes, a damaged text) meshio reads itself.
"""

import tempfile
import warnings
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray

FORMAT = b"$MeshFormat\n4.1 %d 8\n"
"""Beginning of a file; the number is 0 for text and 1 for binary."""

CELLS = {
    1: ("line", 2), 2: ("triangle", 3), 3: ("quad", 4), 4: ("tetra", 4), 5: ("hexahedron", 8),
    8: ("line3", 3), 9: ("triangle6", 6), 10: ("quad9", 9), 11: ("tetra10", 10),
    12: ("hexahedron27", 27), 15: ("vertex", 1), 16: ("quad8", 8), 17: ("hexahedron20", 20),
}  # fmt: skip
"""Name, as meshio has it, and nodes of a cell by the number of its type."""

TAG, COUNT, PLACE = np.int32, np.uint64, np.float64
"""Types of numbers in binary."""


def read_gmsh(path: Path) -> Any:
    """The mesh of a file of Gmsh, by meshio; raises what that raises."""
    binary = in_binary(path.read_bytes())
    if binary is None:
        return meshio.read(path)
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / path.name
        file.write_bytes(binary)
        return meshio.read(file)


def in_binary(text: bytes) -> bytes | None:
    """The groups, entities, nodes and cells of a file in text; None if meshio has to read it."""
    if not text.startswith(FORMAT % 0) or b"Data\n" in text:
        return None
    names, entities, nodes, cells = (
        _content(text, name) for name in ("PhysicalNames", "Entities", "Nodes", "Elements")
    )
    parts = {"PhysicalNames": names}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy warns of what is no number
            parts["Entities"] = entities and _entities(_Numbers(entities, np.float64))
            parts["Nodes"] = _nodes(_Numbers(nodes or b"", np.float64))
            parts["Elements"] = _cells(_Numbers(cells or b"", np.int64))
    except (Warning, ValueError, KeyError):
        return None
    one = np.array([1], TAG).tobytes()
    result = [FORMAT % 1, one, b"\n$EndMeshFormat\n"]
    for name, part in parts.items():
        if part is not None:
            result += [f"${name}\n".encode(), part, f"\n$End{name}\n".encode()]
    return b"".join(result)


def _content(text: bytes, name: str) -> bytes | None:
    """The lines of a section; None without it."""
    begin = text.find(f"\n${name}\n".encode())
    end = text.find(f"\n$End{name}".encode(), begin)
    return None if begin < 0 or end < 0 else text[begin + len(name) + 3 : end]


class _Numbers:
    """The numbers of a section, which are taken one group after another."""

    def __init__(self, text: bytes, kind: type) -> None:
        self._values: NDArray = np.fromstring(text, kind, sep=" ")  # type: ignore[call-overload]
        self._at, self._parts = 0, list[bytes]()

    def take(self, count: int, kind: type) -> list[int]:
        """Take so many numbers, of this type in binary; return the first four as integers."""
        part = self._values[self._at : self._at + count]
        if len(part) < count:
            raise ValueError("the section ends too early")
        self._at += count
        self._parts.append(part.astype(kind).tobytes())
        return [int(value) for value in part[:4]]

    def end(self) -> bytes:
        """All that was taken, in binary."""
        if self._at < len(self._values):
            raise ValueError("the section does not end")
        return b"".join(self._parts)


def _entities(numbers: _Numbers) -> bytes:
    for dimension, count in enumerate(numbers.take(4, COUNT)):
        for _ in range(count):
            numbers.take(1, TAG)
            numbers.take(6 if dimension else 3, PLACE)
            for _ in range(2 if dimension else 1):  # physical groups, and bounding entities
                numbers.take(numbers.take(1, COUNT)[0], TAG)
    return numbers.end()


def _nodes(numbers: _Numbers) -> bytes:
    for _ in range(numbers.take(4, COUNT)[0]):
        if numbers.take(3, TAG)[2]:
            raise ValueError("nodes are parametric")
        count = numbers.take(1, COUNT)[0]
        numbers.take(count, COUNT)
        numbers.take(3 * count, PLACE)
    return numbers.end()


def _cells(numbers: _Numbers) -> bytes:
    for _ in range(numbers.take(4, COUNT)[0]):
        kind = numbers.take(3, TAG)[2]
        numbers.take(numbers.take(1, COUNT)[0] * (1 + CELLS[kind][1]), COUNT)
    return numbers.end()
