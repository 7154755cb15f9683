"""Section forces: the force of the part of a body in front of a section on the part behind it.

The nodal forces K_A u of the cells A behind the plane have no resultant: a rigid motion strains no
cell. At nodes of A alone they are those of all cells, f + c, the loads and the forces of supports
and contacts; at nodes of both sides the other side adds its part. So the force of the other side is

    S = -Σ_A f_A - Σ_i w_i c_i,     c = K u - f,

over the loads f_A on the cells and facets of A, and over the nodes of A. The share w_i of a force
of support or contact is 1 at nodes of A alone; at nodes of both sides, where the cut meets a
support or a contact, it is the share that facets of A have in the surface around the node. The
moment about the centroid of the cut is the sum of the moments of the same nodal forces. S is in
balance with loads, reactions and contact forces to round-off, and the forces of the two sides on
each other are opposite.

Where no load acts on the cells that the plane cuts, S is that of the plane itself; otherwise the
loads on parts of these cells belong to the side of their middle.

On planes of symmetry the force across the plane is an internal force of the whole and is left out.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_app.model.assembly import Element
from contact_app.model.boundaries import surface_facets
from contact_app.model.facets import moments
from contact_app.model.loads import Loads, subdomain_load
from contact_app.model.model import Model
from contact_app.model.planes import on_planes
from contact_app.model.sections import SectionPiece
from contact_app.results.fields import NodeFields
from contact_app.results.mirror import full_mesh
from contact_app.results.resultants import Resultant, joined
from meshes import Subdomain
from meshes.arrays import Array, Mask
from solver.contact.solution import Solution


def section_records(model: Model, solution: Solution, nodes: NodeFields) -> dict[str, Any]:
    """`sections` of ``summary.json``, by name (collective)."""
    images = {image.mirrors: image for image in full_mesh(model.geometry, nodes).images}
    outer = _outer_forces(model, solution, nodes)
    pieces: dict[str, list[Resultant]] = {}
    for piece in model.sections:
        of_piece = _resultant(model, piece, nodes, outer)
        pieces.setdefault(piece.name, []).append(of_piece.image(images[piece.mirrors]))
    return {
        name: {
            **joined(pieces_of_section, model.scene.dimension),
            "area": float(sum(piece.weight for piece in pieces_of_section)),
        }
        for name, pieces_of_section in pieces.items()
    }


def _outer_forces(model: Model, solution: Solution, nodes: NodeFields) -> Array:
    """Forces of supports and contacts at the nodes this rank owns, (nodes, 3) (collective)."""
    d, exchange, problem = model.scene.dimension, model.node_exchange, model.problem
    by_class = [
        cls.stiffness @ u - f
        for cls, u, f in zip(problem.classes, solution.displacements, problem.forces, strict=True)
    ]
    copies = [by_class[cls][:, column].reshape(-1, d) for cls, column in model.place]
    arrived = exchange.to_owners(np.concatenate([np.zeros((0, d)), *copies]))
    result, place = np.zeros((len(nodes.points), 3)), exchange.nodes - exchange.first
    for i in range(d):
        result[:, i] = np.bincount(place, arrived[:, i], minlength=len(result))
    on = on_planes(model.scene.bodies, model.scene.mirrors, nodes.points)
    for mirror, on_plane in zip(model.scene.mirrors, on, strict=True):
        result[on_plane, mirror.axis] = 0.0
    return result


def _resultant(model: Model, piece: SectionPiece, nodes: NodeFields, outer: Array) -> Resultant:
    """Force and moment on the part behind the plane, about the centroid of the cut."""
    pushed = outer * _shares(model, piece)[:, None]
    arms = nodes.points - piece.centre
    sums = np.concatenate([pushed.sum(axis=0), np.cross(arms, pushed).sum(axis=0)])
    for number, s in enumerate(model.partition.subdomains):
        load = _load_behind(model, piece, number)
        if load is not None:
            arm = s.points() - piece.centre
            sums += np.concatenate([load.sum(axis=0), np.cross(arm, load).sum(axis=0)])
    force, moment = -model.comm.allreduce(sums).reshape(2, 3)
    return Resultant(force, moment, piece.centre, piece.area)


def _shares(model: Model, piece: SectionPiece) -> Array:
    """Share of each owned node that lies behind the plane, (nodes,) (collective)."""
    exchange = model.node_exchange
    copies = [np.zeros((0, 4))]
    for s, behind in zip(model.partition.subdomains, piece.behind, strict=True):
        shares = np.zeros((len(s.nodes), 4))
        if behind is not None:
            shares[s.reference.cells[behind], 0] = 1.0
            shares[s.reference.cells[~behind], 1] = 1.0
            rows = surface_facets(s, model.scene.bodies[s.body])
            facets = s.reference.facets[rows]
            area = moments(s.reference.points[facets], model.scene.dimension).sum(axis=(1, 2))
            side = np.where(behind[s.reference.facet_cells[rows]], 2, 3)
            np.add.at(shares, (facets, side[:, None]), area[:, None])
        copies.append(shares)
    arrived, place = exchange.to_owners(np.concatenate(copies)), exchange.nodes - exchange.first
    size = exchange.last - exchange.first
    cells_behind, cells_before, behind_area, before_area = (
        np.bincount(place, column, minlength=size) for column in arrived.T
    )
    surface = behind_area + before_area
    share = np.divide(behind_area, surface, out=np.full(size, 0.5), where=surface > 0.0)
    return np.where(cells_behind == 0.0, 0.0, np.where(cells_before == 0.0, 1.0, share))


def _load_behind(model: Model, piece: SectionPiece, number: int) -> Array | None:
    """Nodal loads on the cells of a subdomain behind the plane, (nodes, 3); None where none is."""
    s, behind, d = model.partition.subdomains[number], piece.behind[number], model.scene.dimension
    cls, column = model.place[number]
    load = model.problem.forces[cls][:, column]
    if behind is None or not behind.any() or not load.any():
        return None
    if not behind.all():
        part = _part(s, behind)
        element = Element(part.reference, d, np.flatnonzero(behind).astype(np.int32))
        body = model.scene.bodies[part.body]
        load_of_part = subdomain_load(body, part, element, Loads.of(model.scene), model.linear)
        if load_of_part is None:
            return None
        load = load_of_part
    return np.pad(load.reshape(-1, d), ((0, 0), (0, 3 - d)))


def _part(s: Subdomain, behind: Mask) -> Subdomain:
    """The subdomain reduced to some of its cells."""

    def rows_of_part(rows: NDArray[np.int32]) -> NDArray[np.int32]:
        return rows[behind[s.reference.facet_cells[rows]]]

    return replace(
        s,
        reference=replace(s.reference),
        exterior=rows_of_part(s.exterior),
        boundaries={name: rows_of_part(rows) for name, rows in s.boundaries.items()},
    )
