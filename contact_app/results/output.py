"""Output of the fields of a run: XDMF for ParaView, VTU for other programs that read VTK formats.

Ranks send their share to rank 0 one after another, so no rank holds a field of the whole mesh.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.results.contacts import ContactsOfWhole
from contact_app.results.fields import CELL_FIELDS, POINT_FIELDS, CellFields, NodeFields, slabs
from contact_app.results.mirror import FullMesh, Image, full_mesh
from contact_app.results.result_size import components, file_names, wanted_fields
from contact_app.results.series import Series
from contact_app.results.vtu import VTUWriter
from contact_app.results.xdmf import GridWriter, XDMFWriter, cell_type_name
from meshes import Partition
from meshes.arrays import Array, Ints
from solver.exchange import NodeExchange


@dataclass(frozen=True, eq=False)
class Fields:
    """The fields of an answer on this rank."""

    nodes: NodeFields
    cells: CellFields
    nodal: Mapping[str, Array]
    """Stresses at the nodes this rank owns, by name."""


def write_fields(
    model: Model, fields: Fields, directory: Path, series: Series | None = None
) -> list[Path]:
    """Write the requested fields and files; return the paths (collective).

    Parameters
    ----------
    series
        Frames already in the files, and the time of this one.
    """
    files = [directory / name for name in file_names(model.scene.output)]
    if not files:
        return files
    nodes, cells, whole = fields.nodes, fields.cells, full_mesh(model.geometry, fields.nodes)
    wanted = wanted_fields(model.scene.output, model.scene.has_friction)
    point_fields = {name: getattr(nodes, name) for name in POINT_FIELDS if name in wanted}
    point_fields |= fields.nodal
    numbers = _numbers(model.partition)
    cell_fields_by_name = {"stress": cells.stress, "von_mises": cells.von_mises, **numbers}
    cell_fields = {name: cell_fields_by_name[name] for name in CELL_FIELDS if name in wanted}
    contacts = ContactsOfWhole(model, nodes, whole)
    alone = contacts.overlapping() if "contact_pressure" in wanted else []

    def at_nodes(image: Image) -> dict[str, Array]:
        of_image = {name: image.field(name, values) for name, values in point_fields.items()}
        return of_image | {f"contact_pressure_{k + 1}": contacts.pressure(image, k) for k in alone}

    write_grid(model, nodes, files, at_nodes, cell_fields, series)
    collections = [path.with_suffix(".pvd") for path in files if path.suffix == ".vtu" and series]
    for path in collections if model.comm.rank == 0 else ():
        assert series is not None
        series.write_collection(path)
    return [path for path in files if path.suffix != ".vtu" or not series] + collections


def write_grid(
    model: Model,
    nodes: NodeFields,
    files: Sequence[Path],
    at_nodes: Callable[[Image], Mapping[str, Array]],
    cell_fields: Mapping[str, Array],
    series: Series | None = None,
) -> None:
    """Write the mesh of the whole with fields (collective).

    Parameters
    ----------
    files
        Files to write with the same content: ``….xdmf`` or ``….vtu``.
    at_nodes
        Function that returns the fields of an image at its nodes, (nodes, components).
    cell_fields
        Fields in this rank's cells of the solved part.
    series
        As in `write_fields`.
    """
    partition, comm, whole = model.partition, model.comm, full_mesh(model.geometry, nodes)
    first_cell = int(partition.cell_starts[0]) if len(partition.cell_starts) else 0
    with ExitStack() as stack:
        writers: list[GridWriter] = []
        for number, image in enumerate(whole.images):
            of_image = {name: values[image.new] for name, values in at_nodes(image).items()}
            if comm.rank == 0 and not writers:
                names = tuple(of_image), tuple(cell_fields)
                opened = _writers(model.geometry, files, whole, names, series)
                writers = [stack.enter_context(writer) for writer in opened]
            points = image.points(nodes.points)[image.new]
            for start, (located, fields) in slabs(comm, image.first, points, of_image):
                for writer in writers:
                    writer.points(start, located)
                    for name, values in fields.items():
                        writer.point_data(name, start, values)
            of_image = {name: image.field(name, v) for name, v in cell_fields.items()}
            first = number * partition.cells + first_cell
            cells = cells_of(model.geometry, model.node_exchange, image)
            for start, (groups, fields) in slabs(comm, first, cells, of_image):
                starts = start + np.cumsum([0, *map(len, groups)])
                for writer in writers:
                    for name, values in fields.items():
                        writer.cell_data(name, start, values)
                    for begin, group in zip(starts, groups, strict=False):
                        writer.cells(int(begin), group)


def _writers(
    geometry: Geometry,
    files: Sequence[Path],
    whole: FullMesh,
    names: tuple[tuple[str, ...], tuple[str, ...]],
    series: Series | None,
) -> Iterator[GridWriter]:
    """The writer of each file; `names` has the fields at nodes and in cells."""
    counts = np.diff(geometry.partition.first_cell)
    runs = [
        (cell_type_name(b.mesh.cell, b.degree), int(n))
        for b, n in zip(geometry.bodies, counts, strict=True)
    ] * len(whole.images)
    at_nodes, at_cells = ({name: components(name) for name in part} for part in names)
    for path in files:
        if path.suffix == ".xdmf":
            yield XDMFWriter(path, runs, whole.nodes, at_nodes, at_cells, series)
        else:
            grid = series.grid_of(path) if series else path
            yield VTUWriter(grid, runs, whole.nodes, at_nodes, at_cells)


def _numbers(partition: Partition) -> dict[str, Array]:
    """Numbers, in the order of the file, of the body and the material of each cell of this rank."""
    subdomains = partition.subdomains
    tags = [s.reference.tags for s in subdomains]
    bodies = [np.full(len(local), s.body) for local, s in zip(tags, subdomains, strict=True)]
    none = [np.zeros(0)]
    return {"body": np.concatenate(none + bodies), "material": np.concatenate(none + tags)}


def cells_of(geometry: Geometry, exchange: NodeExchange, image: Image) -> list[Ints]:
    """Nodes of the image of this rank's cells, by body (collective)."""
    copies = exchange.from_owners(image.numbers[exchange.nodes - exchange.first])
    groups: dict[int, list[Ints]] = {}
    start = 0
    for s in geometry.partition.subdomains:
        body = geometry.bodies[s.body]
        nodes = copies[start : start + len(s.nodes)]
        cells = image.cells(s.reference.cells, body.mesh.cell, body.degree)
        groups.setdefault(s.body, []).append(nodes[cells])
        start += len(s.nodes)
    return [np.concatenate(groups[body]) for body in sorted(groups)]
