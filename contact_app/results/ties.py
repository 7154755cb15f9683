"""Tied pairs in ``summary.json``: what each carries, among the contacts of the file."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.model.model import Model
from contact_app.results.contact_side import ContactSide
from contact_app.results.pressure import boundary_shares, side_of
from contact_app.results.resultants import Resultant, joined
from contact_app.results.smoothed_pressure import smoothed_tractions
from contact_app.results.surface_nodes import SurfaceNodes
from contact_app.scene.conditions import ContactName, RigidTie, Tie
from meshes.arrays import Array, Ints, Mask
from solver.contact.solution import Solution
from solver.problem.constraints.conditions import ContactRows
from solver.tfeti.dual import DualProblem

WITHOUT = 1e-9
"""Share of the largest area of a node below which a node has none: vertices of triangles of degree
2, whose forces are not tractions."""


THIN = 0.05
"""Covered share of the area about a node of degree 1, over that of the node with the largest one,
below which its traction does not count among the largest ones. The other body then covers a narrow
strip beside its own edge, where tractions are singular and alternate. Blocks tied to plates at
random places had 0.7 to 4.7 times the largest traction of the scene with exchanged sides, and have
0.4 to 2.1 times it without such nodes; at degree 2, with all nodes, 0.5 to 1.2 times."""


def tie_records(model: Model, solution: Solution, surface: SurfaceNodes) -> list[dict[str, Any]]:
    """One record a tied pair, in the order of the file (collective).

    The force is that on the body of `on`, without that of contact at nodes that are tied to a rigid
    body, whose rows are about the rigid body; its moment about the mean of the nodes, by area;
    `max_pressure` is the largest traction, of any direction, but at nodes of which the other body
    covers a narrow strip; `max_smoothed_pressure` that of its means (`smoothed_pressure`).
    """
    problem, scene, comm = model.problem, model.scene, model.comm
    rows = problem.shared.tied
    multiplier = solution.multiplier[problem.tied] * rows.spread
    force = np.zeros((len(rows.nodes), 3))
    force[:, : scene.dimension] = multiplier[:, None] * rows.normals
    if scene.rigid_ties:
        force[:, : scene.dimension] -= _contact_at_tied_nodes(problem, solution)
    turn = multiplier[:, None] * rows.moments
    records = []
    for number, (tie, name) in enumerate(zip(scene.all_ties, scene.tie_names, strict=True)):
        of_tie = np.flatnonzero(rows.sources == number)
        x, f, area = rows.points[of_tie], force[of_tie], rows.areas[of_tie]
        if isinstance(tie, RigidTie):
            shares = boundary_shares(model.geometry, surface, tie)
            area = np.maximum(shares[np.searchsorted(surface.owned, rows.nodes[of_tie])], 0.0)
        # each node has a row for each component, of one area unless its function was given away
        nodes, at = np.unique(rows.nodes[of_tie], return_inverse=True)
        size = np.zeros(len(nodes))
        np.maximum.at(size, at.reshape(-1), area)
        tractions = np.zeros((len(nodes), 3))
        np.add.at(tractions, at.reshape(-1), f / np.maximum(area, 1e-300)[:, None])
        if isinstance(tie, Tie):
            side = side_of(model.geometry, surface, tie)
            tractions = _over_covered(side, rows.of(rows.sources == number), f, (nodes, tractions))
        some = size > WITHOUT * size.max(initial=0.0)
        if isinstance(tie, Tie) and side.degree == 1:
            some &= _is_covered(side, nodes, size)
        tractions = tractions[some]
        smoothed = smoothed_tractions(model.geometry, tie, nodes[some], tractions)
        peaks = [float(np.linalg.norm(t, axis=1).max(initial=0.0)) for t in (tractions, smoothed)]
        sums = np.concatenate([
            [area.sum(), size.sum(), len(nodes)], area @ x, f.sum(axis=0),
            (np.cross(x, f) + turn[of_tie]).sum(axis=0),
        ])  # fmt: skip
        weight, total, count, *rest = comm.allreduce(sums)
        weighted, resultant, moment = np.array(rest).reshape(3, 3)
        point = weighted / max(weight, 1e-300)
        whole_force = Resultant(resultant, moment - np.cross(point, resultant), point, total)
        records.append({
            "on": name.on, "with": name.against, **joined([whole_force], scene.dimension),
            "area": float(total), "max_pressure": comm.allreduce(peaks[0], op=MPI.MAX),
            "max_smoothed_pressure": comm.allreduce(peaks[1], op=MPI.MAX),
            "nodes": {"open": 0, "stick": int(count), "slip": 0},
        })  # fmt: skip
    return records


def _is_covered(side: ContactSide, nodes: Ints, areas: Array) -> Mask:
    """Mask (n,) of nodes beside which the other body covers more than a strip (collective).

    Parameters
    ----------
    nodes, areas : (n,)
        Nodes with rows, and their covered areas.
    """
    at, covered = np.searchsorted(side.owned, nodes), np.zeros(len(side.owned))
    covered[at] = areas
    share = side.share_of(covered)
    most = side.exchange.comm.allreduce(share.max(initial=0.0), op=MPI.MAX)
    return np.asarray(share[at] > THIN * most)


def _over_covered(
    side: ContactSide, rows: ContactRows, force: Array, at_nodes: tuple[Ints, Array]
) -> Array:
    """Tractions with means over covered parts in place of extrapolations, (n, 3) (collective).

    Parameters
    ----------
    rows, force : (k, 3)
        The rows of a tie of two bodies and their forces, along one axis each.
    at_nodes : (n,), (n, 3)
        Nodes with rows, and forces over areas.
    """
    nodes, tractions = at_nodes
    at = np.searchsorted(side.owned, nodes)
    result = tractions.copy()
    along, axes = rows.normals != 0.0, rows.normals.shape[1]
    columns = np.concatenate([along * rows.areas[:, None], along * force[:, :axes]], axis=1)
    sums = side.at_nodes(rows, columns)
    for i in range(axes):
        quotients = np.zeros((len(side.owned), 1))
        quotients[at, 0] = tractions[:, i]
        result[:, i] = side.with_means(sums[:, [i, axes + i]], quotients)[at, 0]
    return result


def _contact_at_tied_nodes(problem: DualProblem, solution: Solution) -> Array:
    """Force of contact rows on the component of a node of each tied row, (rows, d) (collective).

    That of rows that are written on the motion of the rigid body.
    """
    rows, contact, d = problem.shared.tied, problem.contact, problem.dimension
    moved = contact.replaced
    pressing = solution.multiplier[problem.inequality] * contact.spread
    parts = problem.comm.allgather(
        (moved.node * d + moved.component, -moved.value * pressing[moved.row])
    )
    place, value = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    distinct, at = np.unique(place, return_inverse=True)
    total = dict(zip(distinct.tolist(), np.bincount(at.reshape(-1), value).tolist(), strict=True))
    component = np.abs(rows.normals).argmax(axis=1)
    forces = np.array([total.get(key, 0.0) for key in (rows.nodes * d + component).tolist()])
    return np.where(rows.normals != 0.0, forces.reshape(-1, 1), 0.0)


def in_order_of_file(
    names: Sequence[ContactName], contacts: list[dict[str, Any]], ties: list[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Records of contacts and ties, as the list `contacts` of the scene has them.

    Parameters
    ----------
    names
        Of the contacts, then of the ties.
    """
    sources = [name.source for name in names]
    order = sorted(range(len(sources)), key=lambda k: (len(sources[k]), sources[k]))
    every = [*contacts, *ties]
    return [every[k] for k in order]
