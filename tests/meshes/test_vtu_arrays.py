"""VTU files with arrays in all the ways that VTK's writers have, read with any Python."""

import zlib
from base64 import b64encode
from pathlib import Path

import numpy as np
import pytest

from meshes.repair import load_mesh

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.4, 0.6, 0]])
CELLS = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int64)
ARRAYS = {
    "Points": ("Float64", POINTS, 'NumberOfComponents="3"'),
    "connectivity": ("Int64", CELLS, ""),
    "offsets": ("Int64", np.arange(3, 13, 3), ""),
    "types": ("UInt8", np.full(4, 5, np.uint8), ""),
}


def block(values: np.ndarray, header: type, compressed: bool) -> tuple[bytes, bytes]:
    """The header of an array, and the array."""
    data = np.ascontiguousarray(values).tobytes()
    if not compressed:
        return np.array([len(data)], header).tobytes(), data
    parts = [data[:40], data[40:]] if len(data) > 40 else [data]
    packed = [zlib.compress(part) for part in parts]
    last = len(parts[-1]) if len(parts) > 1 else 0
    front = [len(parts), max(len(parts[0]), 1), last, *map(len, packed)]
    return np.array(front, header).tobytes(), b"".join(packed)


def written(path: Path, header: str, encoding: str, compressed: bool) -> Path:
    """A mesh of four triangles.

    Parameters
    ----------
    encoding
        ``inline``, ``together`` (with its length in one base64 string), ``appended`` or ``raw``.
    """
    tags, behind = {}, b""
    for name, (kind, values, more) in ARRAYS.items():
        number = np.uint64 if header == "UInt64" else np.uint32
        front, data = block(values, number, compressed)
        text, where = b"", "binary"
        if encoding == "inline":
            text = b64encode(front) + b64encode(data)
        elif encoding == "together":
            text = b64encode(front + data)
        else:
            where = f'appended" offset="{len(behind)}'
            behind += front + data if encoding == "raw" else b64encode(front) + b64encode(data)
        tags[name] = (
            f'<DataArray type="{kind}" Name="{name}" {more} format="{where}">{text.decode()}'
            "</DataArray>"
        )
    cells = "".join(tags[name] for name in ("connectivity", "offsets", "types"))
    compressor = 'compressor="vtkZLibDataCompressor"' if compressed else ""
    kind = "raw" if encoding == "raw" else "base64"
    begin = (
        f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        f'header_type="{header}" {compressor}><UnstructuredGrid><Piece NumberOfPoints="5" '
        f'NumberOfCells="4"><Points>{tags["Points"]}</Points><Cells>{cells}</Cells></Piece>'
        f"</UnstructuredGrid>"
    )
    appended = f'<AppendedData encoding="{kind}">\n_'.encode() + behind + b"\n</AppendedData>"
    path.write_bytes(begin.encode() + (appended if behind else b"") + b"</VTKFile>")
    return path


@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize(
    ("encoding", "compressed"),
    [("inline", False), ("together", False), ("appended", False), ("raw", False),
     ("inline", True), ("appended", True), ("raw", True)],
)  # fmt: skip
def test_all_ways_to_write_arrays_are_read(
    header: str, encoding: str, compressed: bool, tmp_path: Path
) -> None:
    mesh = load_mesh(written(tmp_path / "a.vtu", header, encoding, compressed), 2)
    np.testing.assert_array_equal(mesh.points[:, :2], POINTS[:, :2])
    assert len(mesh.cells) == 4
