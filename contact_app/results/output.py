"""The files of a run: XDMF for ParaView.

Ranks hand their share to rank 0 one after another, so no rank holds a field of the whole mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
    scene, found = model.scene, whole(model, nodes)
    wanted = scene.output.fields
    point_fields = {name: getattr(nodes, name) for name in POINT_FIELDS if name in wanted}
    cell_fields = {name: getattr(cells, name) for name in CELL_FIELDS if name in wanted}
    numbers = _numbers(model)
    cell_fields |= {name: values for name, values in numbers.items() if name in wanted}
    contacts = ContactsOfWhole(model, nodes, found)
    alone = contacts.overlapping() if "contact_pressure" in wanted else []

    def at_nodes(image: Image) -> dict[str, NDArray[np.float64]]:
        own = {name: image.field(name, values) for name, values in point_fields.items()}
        return own | {f"contact_pressure_{k + 1}": contacts.pressure(image, k) for k in alone}

    size = result_bytes(scene, found.nodes, found.cells, len(alone))
    write_grid(model, nodes, path, at_nodes, cell_fields, size)


def write_grid(
    model: Model,
    nodes: NodeFields,
    path: Path,
    at_nodes: Callable[[Image], Mapping[str, NDArray[np.float64]]],
    cell_fields: Mapping[str, NDArray[np.float64]],
    size: int = 0,
) -> None:
    """Write the mesh of the whole with fields (collective).

    Parameters
    ----------
    at_nodes
        Fields of an image at its nodes, (nodes, components).
    cell_fields
        In this rank's cells of what was solved.
    size
        Bytes of the file, where they are known.
    """
    scene, partition, comm, found = model.scene, model.partition, model.comm, whole(model, nodes)
    counts = np.diff(partition.first_cell)
    runs = [
        (cell_type_name(b.mesh.cell, b.degree), int(n))
        for b, n in zip(scene.bodies, counts, strict=True)
    ] * len(found.images)
    starts = partition.cell_starts
    first_cell = int(starts[0]) if len(starts) else 0
    writer = XDMFWriter(path, runs, found.nodes, found.cells, size) if comm.rank == 0 else None
    with writer or nullcontext():
        for number, image in enumerate(found.images):
            own = {name: values[image.new] for name, values in at_nodes(image).items()}
            points = image.points(nodes.points)[image.new]
            for start, (located, fields) in slabs(comm, image.first, points, own):
                assert writer is not None
                writer.points(start, located)
                for name, values in fields.items():
                    writer.point_data(name, start, values)
            own = {name: image.field(name, v) for name, v in cell_fields.items()}
            first = number * partition.cells + first_cell
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
