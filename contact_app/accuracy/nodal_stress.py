"""Stresses at nodes: those that the error estimate recovers, smooth within each material.

The stress of a finite-element answer jumps from cell to cell. The recovered stress σ*
(`accuracy.estimate.stress_recovery`) is continuous and closer to the true one. Bodies share no
nodes, so it jumps between them as it should. Where materials of one body meet, the true stress
jumps as well: there each material has a σ* of its own, fitted in its own cells, and a node on the
interface has one stress for each material. The common field holds the stress with the largest von
Mises stress; one field for each material gives the two sides.

The threshold for linear polynomials is stricter than in the estimate, which needs the mean of the
error and not its peak (`DETERMINED`). On regular meshes and at degree 2 both give the same stress.

In plane strain zz is ν (xx + yy) - E α T, in plane stress zero.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contact_app.accuracy.estimate.error_estimate import ErrorEstimator
from contact_app.model.model import Model
from contact_app.results.fields import NODAL_FIELDS
from contact_app.scene.material import Material, von_mises
from meshes.arrays import Array
from solver.contact.solution import Solution

DETERMINED = 0.15
"""Smallest determinant of a patch's moments (1 for a symmetric patch) for its own linear
polynomial; other vertices use polynomials extrapolated from neighbours. The cells at a surface lie
in nearly one layer where the mesh is distorted, and their small differences in depth do not
determine the slope. In bending of a block of 6³ hexahedra with nodes moved by a fifth of a cell,
the largest error at nodes is 76 % of the largest stress with the threshold of the estimate, 1e-4,
and 3 % with 0.01 to 0.3; of tetrahedra 49 %, 37 % with 0.01, 15 % with 0.15 and 0.3; of triangles
46 %, 46 % and 13 %."""


def nodal_stresses(model: Model, solution: Solution, estimator: ErrorEstimator) -> dict[str, Array]:
    """Fields at the nodes this rank owns that the scene requests, by name (collective).

    Returns
    -------
    ``nodal_stress`` (nodes, 6) as xx, yy, zz, xy, yz, xz and ``nodal_von_mises`` (nodes,); where a
    body has several materials also ``nodal_stress_material_0``, … by the numbers of the cell field
    ``material``, NaN away from the material. Empty if the scene requests neither.
    """
    requested = [name for name in NODAL_FIELDS if name in model.scene.output.fields]
    if not requested:
        return {}
    each = [patches.determined_from(DETERMINED) for patches in estimator.of_materials]
    sides = [_at_nodes(model, estimator.stresses(solution, p), k) for k, p in enumerate(each)]
    stresses = {"": _largest(sides)}
    if len(sides) > 1:
        stresses |= {f"_material_{k}": side for k, side in enumerate(sides)}
    fields = {}
    for name in requested:
        for suffix, stress in stresses.items():
            fields[name + suffix] = stress if name == "nodal_stress" else von_mises(stress)
    return fields


def _largest(sides: Sequence[Array]) -> Array:
    """At each node the stress with the largest von Mises stress."""
    if len(sides) == 1:
        return sides[0]
    largest, measure = sides[0].copy(), von_mises(sides[0])
    for side in sides[1:]:
        equivalent = von_mises(side)
        larger = ~(equivalent <= measure) & np.isfinite(equivalent)
        largest[larger], measure[larger] = side[larger], equivalent[larger]
    return largest


def _at_nodes(model: Model, recovered: Sequence[Array], material: int) -> Array:
    """σ* of a material at owned nodes, (nodes, 6); NaN at nodes without a cell of it."""
    exchange = model.node_exchange
    made_of_it: dict[int, NDArray[np.int32]] = {}
    copies = []
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        of_subdomain = recovered[cls][:, column]
        stress = np.full((len(of_subdomain), 6), np.nan)
        if cls not in made_of_it:
            made_of_it[cls] = np.unique(s.reference.cells[s.reference.tags == material])
        on = made_of_it[cls]
        if len(on):
            heat = model.temperatures[cls]
            rise = np.zeros(len(on)) if heat is None else heat[on, column]
            made_of = model.materials[cls][material]
            stress[on] = _six_components(of_subdomain[on], model.scene.plane, made_of, rise)
        copies.append(stress)
    arrived = exchange.to_owners(np.concatenate([np.zeros((0, 6)), *copies]))
    has_stress = np.isfinite(arrived[:, 0])
    stresses = np.full((exchange.last - exchange.first, 6), np.nan)
    stresses[exchange.nodes[has_stress] - exchange.first] = arrived[has_stress]
    return stresses


def _six_components(stress: Array, plane: str | None, material: Material, rise: Array) -> Array:
    """Components xx, yy, zz, xy, yz, xz of stresses (n, 3 or 6); rise is of temperature."""
    if stress.shape[1] == 6:
        return stress
    result = np.zeros((len(stress), 6))
    result[:, [0, 1, 3]] = stress
    result[:, 2] = material.stress_across(plane, stress[:, 0] + stress[:, 1], rise)
    return result
