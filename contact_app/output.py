"""The files of a run: XDMF for ParaView.

Ranks hand their share to rank 0 one after another, so no rank holds a field of the whole mesh.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from contact_app.fields import slabs
from contact_app.xdmf import XDMFWriter, cell_type_name

if TYPE_CHECKING:
    from contact_app.run import SolvedScene

POINT_FIELDS = ("displacement", "contact_pressure", "gap")
CELL_FIELDS = ("stress", "von_mises")


def write_xdmf(solved: SolvedScene, path: Path) -> None:
    """Write the fields the scene asks for (collective)."""
    model, nodes, cells = solved.model, solved.nodes, solved.cells
    scene, partition, comm = model.scene, model.partition, model.comm
    wanted = scene.output.fields
    bodies = np.array([s.body for s in partition.subdomains])
    by_body = [
        np.concatenate([c for c, b in zip(cells.cells, bodies, strict=True) if b == body])
        for body in np.unique(bodies)
    ]
    point_fields = {name: getattr(nodes, name) for name in POINT_FIELDS if name in wanted}
    cell_fields = {name: getattr(cells, name) for name in CELL_FIELDS if name in wanted}
    node_slabs = slabs(comm, nodes.first, nodes.points, point_fields)
    cell_slabs = slabs(comm, cells.first, by_body, cell_fields)
    if comm.rank:
        for generator in (node_slabs, cell_slabs):
            for _ in generator:
                pass
        return
    sizes = np.diff(partition.first_cell)
    runs = [
        (cell_type_name(b.mesh.cell, b.degree), int(n))
        for b, n in zip(scene.bodies, sizes, strict=True)
    ]
    with XDMFWriter(path, runs, partition.nodes, partition.cells) as writer:
        for start, (points, fields) in node_slabs:
            writer.points(start, points)
            for name, values in fields.items():
                writer.point_data(name, start, values)
        for start, (groups, fields) in cell_slabs:
            for name, values in fields.items():
                writer.cell_data(name, start, values)
            for group in groups:
                writer.cells(start, group)
                start += len(group)
