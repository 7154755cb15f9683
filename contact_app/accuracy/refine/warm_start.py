"""Initial multipliers on the next mesh from the solution on the last one.

The unknowns of the solver are forces of constraint rows: of contact, of held nodes and of gluing.
They differ between meshes and decompositions, while tractions do not. The tractions of the last
solution are known at its nodes:

- the contact pressure, and with friction the tangential traction, which also decides the initial
sticking and sliding points on the next mesh; - the traction on held boundaries, i.e. the reactions
of nodes over their share of the boundary, which includes the singularity of a clamped edge; -
inside a body, where subdomains of the next mesh may meet, the traction of the recovered stress:
since this is continuous, both sides get opposite tractions.

The tractions are interpolated to the next mesh and integrated against its shape functions. As rows
are orthonormal, B maps the forces to multipliers. The multipliers need not be in equilibrium; the
solver corrects that. Their error in energy norm is about that of the mesh they come from.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contact_app.accuracy.estimate.patches import Cells
from contact_app.accuracy.estimate.point_values import PointValues
from contact_app.accuracy.estimate.tractions import SHEARS
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.model.boundaries import boundary_facets
from contact_app.model.facets import moments
from contact_app.model.model import Model
from contact_app.results.pressure import boundary_shares
from contact_app.results.surface_nodes import SurfaceNodes
from meshes import Subdomain
from solver.contact.solution import Guess
from solver.tfeti.dual_operator import interface_slices

Array = NDArray[np.float64]

INSIDE = 0.51
"""Level at which the interpolated indicator of contact (1 at nodes in contact, 0 at others) ends
the contact: half-way between nodes. The interpolated pressure is positive as far as the next
node."""

NONE = 1e-12
"""Share of a boundary, relative to the largest share, that counts as zero."""


class LastLevel:
    """Tractions of a solved mesh; construction and calls are collective.

    Parameters
    ----------
    values
        At nodes: recovered stress, friction traction if there is friction, traction on held
        boundaries, contact pressure.
    """

    def __init__(self, values: PointValues) -> None:
        self._values = values

    @classmethod
    def of(cls, solved: SolvedScene) -> LastLevel:
        """The tractions of an answer."""
        model = solved.model
        parts = (
            solved.estimator.stresses(solved.solution, solved.estimator.recovery.patches),
            _friction(solved),
            _reactions(solved),
            _pressures(solved),
        )
        return cls(
            PointValues(model, [np.concatenate(v, axis=2) for v in zip(*parts, strict=True)])
        )

    def on(self, model: Model) -> Guess:
        """Multipliers on another mesh of the scene; none is tensile."""
        problem, contact = model.problem, model.problem.contact
        multiplier = np.zeros(problem.size)
        if problem.coarse is not None:
            problem.B.apply(self._forces(model), multiplier)
        body = np.array([touching.body for touching in model.scene.touching], np.int64)
        at, areas = self._values.at(contact.points, body[contact.sources]), _areas(model)
        pressure, pressed = at[:, -2:].T
        force = np.where(pressed > INSIDE, np.maximum(pressure, 0.0), 0.0) * areas
        multiplier[problem.inequality] = force / contact.spread
        if problem.friction.acts:  # contact laws cut it to its limits
            friction, d = problem.shared.friction, model.scene.dimension
            rows, place = friction.rows, friction.places(contact)
            along = np.einsum("ki,ki->k", at[place, -2 - 2 * d : -2 - d], rows.normals[:, :d])
            multiplier[problem.tangential] = along * areas[place] / rows.spread
        return Guess(multiplier)

    def _forces(self, model: Model) -> Array:
        """Bᵀ λ of gluing and held rows, an interface vector."""
        problem, d = model.problem, model.scene.dimension
        subdomains = model.partition.subdomains
        chosen, nodes = [], []
        for s in subdomains:
            held = _held(model, s)
            inner = np.ones(len(held), bool)
            inner[s.exterior] = False
            rows = np.flatnonzero(inner | held.any(axis=1))
            chosen.append((rows, inner[rows], held[rows]))
            nodes.append(np.unique(s.reference.facets[rows]))
        points = [s.points()[n] for s, n in zip(subdomains, nodes, strict=True)]
        bodies = [np.full(len(n), s.body) for s, n in zip(subdomains, nodes, strict=True)]
        numbers = [s.nodes[n] for s, n in zip(subdomains, nodes, strict=True)]
        # values at a node that subdomains share are requested once
        _, one, back = np.unique(
            np.concatenate([np.zeros(0, np.int64), *numbers]),
            return_index=True,
            return_inverse=True,
        )
        interpolated = self._values.at(
            np.concatenate([np.zeros((0, 3)), *points])[one],
            np.concatenate([np.zeros(0, np.int64), *bodies])[one],
        )[back.reshape(-1)]
        of_subdomains = np.split(interpolated, np.cumsum([len(n) for n in nodes])[:-1])
        made: dict[int, tuple[Array, Array]] = {}
        result = np.zeros(problem.B.columns)
        slices = interface_slices(problem.classes)
        for s, (cls, column), (rows, inner, held), facet_nodes, values in zip(
            subdomains, model.place, chosen, nodes, of_subdomains, strict=True
        ):
            if id(s.reference) not in made:
                x = s.reference.points[s.reference.facets]
                made[id(s.reference)] = Cells(model.elements[cls]).normals, moments(x, d)
            normals, weights = (of_facets[rows] for of_facets in made[id(s.reference)])
            facets = s.reference.facets[rows]
            at_facets = values[np.searchsorted(facet_nodes, facets)]
            traction = _tractions(at_facets, normals) * inner[:, None, None]
            traction += at_facets[..., -2 - d : -2] * held[:, None]
            force = np.zeros((len(s.reference.points), d))
            np.add.at(
                force, facets, np.einsum("fjk,fji->fki", weights, traction[:, : weights.shape[1]])
            )
            of_class = problem.classes[cls]
            values = result[slices[cls]].reshape(of_class.members, -1)
            values[column] = -force.ravel()[of_class.interface]
        return result


def _tractions(values: Array, normals: Array) -> Array:
    """σ n at the nodes of facets, (facets, nodes, d); values begin with the stress."""
    d = normals.shape[2]
    result = values[..., :d] * normals
    for row, (i, j) in enumerate(SHEARS[: d * (d - 1) // 2], d):
        result[..., i] += values[..., row] * normals[..., j]
        result[..., j] += values[..., row] * normals[..., i]
    return result


def _held(model: Model, subdomain: Subdomain) -> Array:
    """1 for the components in which a condition holds each facet, (facets, d), else 0."""
    scene = model.scene
    result = np.zeros((len(subdomain.reference.facets), scene.dimension))
    for condition in scene.displacements:
        if condition.body == subdomain.body:
            rows = boundary_facets(subdomain, scene.bodies[subdomain.body], condition.boundary)
            held = np.array([value is not None for value in condition.values], float)
            result[rows] = np.maximum(result[rows], held[: scene.dimension])
    return result


def _reactions(solved: SolvedScene) -> list[Array]:
    """Traction on held boundaries, at nodes: (nodes, members, d) of each class."""
    model, problem = solved.model, solved.model.problem
    d, exchange = model.scene.dimension, model.node_exchange
    contact = problem.constraint_forces(
        np.where(problem.conditional, solved.solution.multiplier, 0.0)
    )
    missing = []
    for cls, part, load, u in zip(
        problem.classes, interface_slices(problem.classes), problem.forces,
        solved.solution.displacements, strict=True,
    ):  # fmt: skip
        left = cls.stiffness @ u - load
        left[cls.interface] += contact[part].reshape(cls.members, -1).T
        missing.append(left)
    copies = []
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        held = _held(model, s)
        rows = np.flatnonzero(held.any(axis=1))
        facets, share = s.reference.facets[rows], np.zeros((len(s.nodes), d))
        weights = moments(s.reference.points[facets], d).sum(axis=1)
        np.add.at(share, facets, weights[..., None] * held[rows][:, None])
        copies.append(np.concatenate([missing[cls][:, column].reshape(-1, d), share], axis=1))
    arrived = exchange.to_owners(np.concatenate([np.zeros((0, 2 * d)), *copies]))
    sums = np.zeros((exchange.last - exchange.first, 2 * d))
    np.add.at(sums, exchange.nodes - exchange.first, arrived)
    force, share = sums[:, :d], sums[:, d:]
    some = share > NONE * share.max(initial=0.0)
    return _spread(model, np.divide(force, share, out=np.zeros_like(force), where=some))


def _friction(solved: SolvedScene) -> list[Array]:
    """Friction traction at nodes, (nodes, members, d) of each class, or (…, 0) without friction."""
    traction = solved.nodes.friction_traction
    return _spread(solved.model, traction[:, : traction.shape[1] * solved.model.scene.has_friction])


def _pressures(solved: SolvedScene) -> list[Array]:
    """Contact pressure and indicator of contact (1 or 0), (nodes, members, 2) of each class."""
    pressure = solved.nodes.contact_pressure
    return _spread(solved.model, np.column_stack([pressure, pressure > 0.0]))


def _spread(model: Model, values: Array) -> list[Array]:
    """Distribute values (owned, width) of nodes to (nodes, members, width) of each class."""
    exchange = model.node_exchange
    copies = exchange.from_owners(values[exchange.nodes - exchange.first])
    result = [
        np.zeros((cls.unknowns // model.scene.dimension, cls.members, values.shape[1]))
        for cls in model.elastic(model.problem.classes)
    ]
    at = 0
    for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
        result[cls][:, column] = copies[at : at + len(s.nodes)]
        at += len(s.nodes)
    return result


def _areas(model: Model) -> Array:
    """Area of each contact row on which its pressure acts: its own, or the share of its node."""
    contact, surface = model.problem.contact, SurfaceNodes.of(model)
    at = np.searchsorted(surface.owned, contact.nodes)
    areas = contact.areas.copy()
    for i, touching in enumerate(model.scene.touching):
        shares = boundary_shares(model, surface, touching)
        unknown = (contact.sources == i) & np.isnan(contact.areas)
        areas[unknown] = shares[at[unknown]]
    return areas
