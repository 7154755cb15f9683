"""The files of a run: XDMF for ParaView.

Ranks hand their share to rank 0 one after another, so no rank holds a field of the whole mesh.
"""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contact_app.model.model import Model
from contact_app.results.contacts import ContactsOfWhole
from contact_app.results.fields import CellFields, NodeFields, slabs
from contact_app.results.mirror import Image, whole
from contact_app.results.result_size import result_bytes
from contact_app.results.xdmf import XDMFWriter, cell_type_name

POINT_FIELDS = ("displacement", "contact_pressure", "gap")
CELL_FIELDS = ("stress", "von_mises")


def write_xdmf(model: Model, nodes: NodeFields, cells: CellFields, path: Path) -> None:
    """Write the fields the scene asks for (collective)."""
    scene, partition, comm = model.scene, model.partition, model.comm
    found = whole(model, nodes)
    wanted = scene.output.fields
    point_fields = {name: getattr(nodes, name) for name in POINT_FIELDS if name in wanted}
    cell_fields = {name: getattr(cells, name) for name in CELL_FIELDS if name in wanted}
    numbers = _numbers(model)
    cell_fields |= {name: values for name, values in numbers.items() if name in wanted}
    contacts = ContactsOfWhole(model, nodes, found)
    alone = contacts.overlapping() if "contact_pressure" in wanted else []
    sizes = np.diff(partition.first_cell)
    runs = [
        (cell_type_name(b.mesh.cell, b.degree), int(n))
        for b, n in zip(scene.bodies, sizes, strict=True)
    ] * len(found.images)
    writer = None
    if comm.rank == 0:
        size = result_bytes(scene, found.nodes, found.cells, len(alone))
        writer = XDMFWriter(path, runs, found.nodes, found.cells, size)
    with writer or nullcontext():
        for number, image in enumerate(found.images):
            own = {name: image.field(name, v)[image.new] for name, v in point_fields.items()}
            points = image.points(nodes.points)[image.new]
            for start, (located, fields) in slabs(comm, image.first, points, own):
                assert writer is not None
                writer.points(start, located)
                for name, values in fields.items():
                    writer.point_data(name, start, values)
            for contact in alone:
                pressure = contacts.pressure(image, contact)[image.new]
                for start, (values,) in slabs(comm, image.first, pressure):
                    assert writer is not None
                    writer.point_data(f"contact_pressure_{contact + 1}", start, values)
            first = number * partition.cells + cells.first
            own = {name: image.field(name, v) for name, v in cell_fields.items()}
            for start, (groups, fields) in slabs(comm, first, _cells(model, image), own):
                assert writer is not None
                for name, values in fields.items():
                    writer.cell_data(name, start, values)
                for group in groups:
                    writer.cells(start, group)
                    start += len(group)


def _numbers(model: Model) -> dict[str, NDArray[np.float64]]:
    """Number of the body and of its material of each cell of this rank, as the file counts them."""
    subdomains = model.partition.subdomains
    tags = [s.reference.tags for s in subdomains]
    bodies = [np.full(len(own), s.body) for own, s in zip(tags, subdomains, strict=True)]
    none = [np.zeros(0)]
    return {"body": np.concatenate(none + bodies), "material": np.concatenate(none + tags)}


def _cells(model: Model, image: Image) -> list[NDArray[np.int64]]:
    """Nodes of the image of this rank's cells, by body (collective)."""
    exchange, partition = model.node_exchange, model.partition
    copies = exchange.from_owners(image.numbers[exchange.nodes - exchange.first])
    groups: dict[int, list[NDArray[np.int64]]] = {}
    start = 0
    for s in partition.subdomains:
        body = model.scene.bodies[s.body]
        nodes = copies[start : start + len(s.nodes)]
        cells = image.cells(s.reference.cells, body.mesh.cell, body.degree)
        groups.setdefault(s.body, []).append(nodes[cells])
        start += len(s.nodes)
    return [np.concatenate(groups[body]) for body in sorted(groups)]
