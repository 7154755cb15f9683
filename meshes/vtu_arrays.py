"""VTU files whose arrays are written as meshio reads them with any Python.

The arrays of a VTU file stand in its text, in base64, or behind it, raw or in base64. meshio 5.3.5
hands Python all that follows the beginning of an array and trusts it to end at the padding of
base64, which Python does no more since its releases of 2025 (3.13.5 of Debian 13). So each array is
put into the text, by itself and with one padding, before meshio sees the file.

Format: VTK's XML format, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html.
"""

import tempfile
from base64 import b64decode, b64encode
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import meshio

HEADERS = {"UInt32": 4, "UInt64": 8}
"""Bytes of a number before an array, by `header_type`."""


def read_vtu(path: Path) -> Any:
    """The mesh of a VTU file, by meshio; raises what that and the parser raise."""
    content = path.read_bytes()
    text = content.find(b"<AppendedData")
    if text < 0 and b" compressor=" in content[: content.find(b"<UnstructuredGrid")]:
        return meshio.read(path)
    if text < 0:
        root, behind, raw = ElementTree.fromstring(content), b"", False
    else:
        root = ElementTree.fromstring(content[:text] + b"</VTKFile>")
        begin = content.index(b"_", text) + 1
        raw = b'"raw"' in content[text:begin]
        behind = content[begin : content.rindex(b"</AppendedData>")]
    size = HEADERS[root.attrib.get("header_type", "UInt32")]
    order: Literal["little", "big"] = "little"
    if root.attrib.get("byte_order") == "BigEndian":
        order = "big"
    compressed = "compressor" in root.attrib
    arrays = list(root.iter("DataArray"))
    ends = sorted(int(a.attrib["offset"]) for a in arrays if "offset" in a.attrib) + [len(behind)]
    for array in arrays:
        if array.attrib["format"] == "appended":
            offset = int(array.attrib.pop("offset"))
            part = behind[offset : next(end for end in ends if end > offset)]
            array.set("format", "binary")
        elif array.attrib["format"] == "binary":
            part = (array.text or "").strip().encode()
        else:
            continue
        if raw and compressed:
            parts = int.from_bytes(part[:size], order)
            front = size * (3 + parts)
            lengths = [part[k : k + size] for k in range(3 * size, front, size)]
            end = front + sum(int.from_bytes(length, order) for length in lengths)
            array.text = (b64encode(part[:front]) + b64encode(part[front:end])).decode()
        elif raw:
            end = size + int.from_bytes(part[:size], order)
            array.text = b64encode(part[:end]).decode()
        else:
            array.text = part.strip().decode() if compressed else _joined(part.strip(), size)
    with tempfile.TemporaryDirectory() as directory:
        inline = Path(directory) / "inline.vtu"
        ElementTree.ElementTree(root).write(inline)
        return meshio.read(inline)


def _joined(part: bytes, size: int) -> str:
    """Base64 of a length and an array as one, also where the length was encoded by itself."""
    front = 4 * -(-size // 3)
    if part[front - 1 : front] != b"=":
        return part.decode()
    return b64encode(b64decode(part[:front]) + b64decode(part[front:])).decode()
