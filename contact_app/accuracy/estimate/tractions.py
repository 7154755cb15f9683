"""Known tractions on the surface of bodies, and corrections of stresses that satisfy them.

On the surface σ n is the given traction, and zero on free surfaces. In frictionless contact its
tangential part is zero. Where the body slides with friction of direction d, the tangential part is
-μ (n·σn) d by Coulomb's law and s d by Tresca's; where it sticks, the tangential part is unknown
(`touching`). At a node the known tractions of the facets around it are equations C σ = t for its
stress. A stress that violates them gets the smallest correction that satisfies them: σ becomes σ +
q - P σ with P = (CᵀC)⁺ CᵀC and q = (CᵀC)⁺ Cᵀt. Where the equations contradict each other, as at the
edge of a load, they are satisfied in the least-squares sense.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from contact_app.accuracy.estimate.patch_fits import WEAK, Copies
from contact_app.accuracy.estimate.patches import Cells
from contact_app.accuracy.estimate.touching import Touching
from contact_app.model.boundaries import boundary_facets
from contact_app.model.model import Model
from contact_app.scene.bodies import Body
from contact_app.scene.conditions import BodyContact, Contact, RigidTie, Tie
from meshes import Subdomain
from meshes.arrays import Array, Ints, Mask
from meshes.pseudo_inverses import pseudo_inverses

FAINT = 1e-3
"""Friction force of a node, relative to that of its facet, below which its direction is
meaningless."""

ROUNDING = 1e-12
"""Entry of CᵀC up to which it is a rounding error: the rows of C have lengths of about 1, or are
zero where nothing is known."""

SHEARS = ((0, 1), (1, 2), (0, 2))
"""Shear components of a stress in space; in the plane only the first."""


def tied_sides(ties: Sequence[Tie | RigidTie]) -> list[tuple[int, str]]:
    """Body and boundary of each tied side, where tractions are unknown."""
    sides = [(tie.body, tie.boundary) for tie in ties]
    return sides + [(tie.other, tie.other_boundary) for tie in ties if isinstance(tie, Tie)]


class Surface:
    """The surface nodes of a model's meshes, independent of loads (collective).

    Parameters
    ----------
    cells
        Of each class.
    """

    def __init__(self, model: Model, cells: Sequence[Cells]) -> None:
        self._cells = cells
        self._subdomains = list(zip(model.partition.subdomains, model.place, strict=True))
        nodes = [np.unique(c.element.reference.facets).astype(np.int64) for c in cells]
        self._nodes = nodes
        self._copies = copies = Copies(model, nodes)
        outside = np.zeros((copies.count, 1))
        for subdomain, (cls, column) in self._subdomains:
            copies.of_class(outside, cls)[self._facet_nodes(subdomain, cls), column] = 1.0
        self._exterior = np.flatnonzero(copies.scatter(copies.gather(outside))[:, 0])
        self._met = copies.some(self._exterior)
        places = [np.zeros(0, np.int64)]
        for subdomain, (cls, column) in self._subdomains:
            at = self._facet_nodes(subdomain, cls) * copies.shapes[cls][1]
            places.append(copies.starts[cls] + at + column)
        place = np.searchsorted(self._exterior, np.concatenate(places))
        self._sums = sparse.csr_matrix(
            (np.ones(len(place)), (place, np.arange(len(place)))),
            shape=(len(self._exterior), len(place)),
        )

    def _facet_nodes(self, subdomain: Subdomain, cls: int) -> Ints:
        """Positions of the exterior facets' nodes in the list of surface nodes, facet by facet."""
        facets = subdomain.reference.facets[subdomain.exterior]
        return np.searchsorted(self._nodes[cls], facets.ravel())

    def changes(self, model: Model, touching: Touching) -> Array:
        """P and q at copies of the nodes on the bodies' surfaces, (copies, s² + s) (collective).

        Parameters
        ----------
        model
            With the loads.
        """
        s = model.scene.dimension * (model.scene.dimension + 1) // 2
        equations = [np.zeros((0, s * s + s))]
        for subdomain, (cls, column) in self._subdomains:
            if len(subdomain.exterior):
                touch = OnSubdomain.of(touching, cls, column)
                equations.append(_equations(model, subdomain, self._cells[cls].normals, touch))
        sums = self._met.gather(self._sums @ np.concatenate(equations))
        prescribed = np.flatnonzero(np.abs(sums[:, : s * s]).max(axis=1) > ROUNDING)
        P, q = sums[prescribed, : s * s], sums[prescribed, s * s :]
        # nodes on one face or edge of a box have the same P
        inverse = pseudo_inverses(P.reshape(-1, s, s), WEAK)
        change = np.zeros_like(sums)
        change[prescribed, : s * s] = (inverse @ P.reshape(-1, s, s)).reshape(-1, s * s)
        change[prescribed, s * s :] = (inverse @ q[..., None])[..., 0]
        return self._met.scatter(change)

    def meet(self, changes: Array, recovered: Sequence[Array]) -> None:
        """Correct the stresses (nodes, members, components) of each class in place."""
        copies = self._copies
        for cls, (values, nodes) in enumerate(zip(recovered, self._nodes, strict=True)):
            s = values.shape[2]
            begin, end = np.searchsorted(self._exterior, copies.starts[cls : cls + 2])
            row, member = np.divmod(self._exterior[begin:end] - copies.starts[cls], values.shape[1])
            change, before = changes[begin:end], values[nodes[row], member]
            removed = change[:, : s * s].reshape(-1, s, s) @ before[..., None]
            values[nodes[row], member] = before - removed[..., 0] + change[:, s * s :]


@dataclass(frozen=True, eq=False)
class OnSubdomain:
    """Contact at the nodes of one subdomain."""

    pushed: Mask  # (nodes,)
    friction: tuple[tuple[int, Mask, Array], ...]
    """Number, sticking nodes (nodes,) and forces (nodes, dimension) of contacts with friction."""

    @classmethod
    def of(cls, touching: Touching, number: int, column: int) -> "OnSubdomain":
        """Contact of one member of a class."""
        friction = tuple(
            (rows.contact, rows.sticks[number][:, column], rows.forces[number][:, column])
            for rows in touching.friction
        )
        return cls(touching.pushed[number][:, column], friction)


def _equations(model: Model, subdomain: Subdomain, normals: Array, touch: OnSubdomain) -> Array:
    """Normal equations of the known tractions at the nodes of surface facets, (n, s² + s).

    Each row holds CᵀC and Cᵀt of C σ = t.

    Parameters
    ----------
    normals : (facets, nodes, dimension)
        Normals of the reference's facets.
    """
    prescribed, load = _known_tractions(model, subdomain, normals, touch)
    parts = [a[subdomain.exterior] for a in (prescribed, normals, load)]
    count, d = parts[1].shape[1:]
    uniform = all(bool((a == a[:, :1]).all()) for a in parts)
    if uniform:  # one equation for all nodes of a facet
        parts = [a[:, :1] for a in parts]
    prescribed, normal, load = parts
    s = d * (d + 1) // 2
    C = np.zeros((*normal.shape, s))
    for i in range(d):
        C[..., i, i] = normal[..., i]
    for row, (i, j) in enumerate(SHEARS[: s - d], d):
        C[..., i, row], C[..., j, row] = normal[..., j], normal[..., i]
    C = prescribed @ C
    t = prescribed @ load[..., None]
    transposed = np.swapaxes(C, -1, -2)
    squares = (transposed @ C).reshape(-1, s * s)
    right = (transposed @ t).reshape(-1, s)
    equations = np.concatenate([squares, right], axis=1)
    return np.repeat(equations, count, axis=0) if uniform else equations


def _known_tractions(
    model: Model, subdomain: Subdomain, normal: Array, touch: OnSubdomain
) -> tuple[Array, Array]:
    """Linear maps K for the known part of the traction t at the nodes of facets: K t = K load.

    K is a projector that removes from t the unknown parts: the components that are held, the whole
    traction on tied boundaries, and the normal part where a node of the facet is in contact. Where
    the node slides with Coulomb friction, K also adds μ (n·t) d to the tangential part.

    Returns
    -------
    (facets, nodes, dimension, dimension) and (facets, nodes, dimension)
    """
    scene, d, number = model.scene, normal.shape[-1], subdomain.body

    def rows_on(boundary: str) -> NDArray[np.int32]:
        return boundary_facets(subdomain, scene.bodies[number], boundary)

    load = _given_tractions(model, subdomain, normal)
    directions = np.broadcast_to(np.eye(d), (*normal.shape, d)).copy()
    pushed = touch.pushed[subdomain.reference.facets].any(axis=1)
    for touching in scene.touching:
        for boundary in _sides(touching, number):
            rows = rows_on(boundary)
            n = normal[rows[pushed[rows]]]
            directions[rows[pushed[rows]]] = np.eye(d) - n[..., :, None] * n[..., None, :]
    _meet_friction(scene.bodies, scene.touching, subdomain, normal, touch, (directions, load))
    for body, boundary in tied_sides(scene.all_ties):
        if body == number:
            directions[rows_on(boundary)] = 0.0
    for condition in scene.displacements:
        if condition.body == number:
            rows = rows_on(condition.boundary)
            free = np.array([value is None for value in condition.values], float)
            directions[rows] = free[:, None] * directions[rows]
    return directions, load


def _given_tractions(model: Model, subdomain: Subdomain, normal: Array) -> Array:
    """The loads at the nodes of facets, (facets, nodes, dimension)."""
    scene, d, number = model.scene, normal.shape[-1], subdomain.body
    load = np.zeros(normal.shape)
    for traction in scene.tractions:
        if traction.body == number:
            load[boundary_facets(subdomain, scene.bodies[number], traction.boundary)] += (
                traction.vector
            )
    for pressure in scene.pressures:
        if pressure.body == number:
            rows = boundary_facets(subdomain, scene.bodies[number], pressure.boundary)
            load[rows] -= pressure.value * normal[rows]
    for linear in model.linear:
        if linear.body == number:
            rows = boundary_facets(subdomain, scene.bodies[number], linear.boundary)
            load[rows] += linear.at(subdomain.points()[subdomain.reference.facets[rows]], d)
    return load


def _sides(touching: Contact | BodyContact, body: int) -> list[str]:
    """Boundaries of a body that belong to a contact."""
    sides = [(touching.body, touching.boundary)]
    if isinstance(touching, BodyContact):
        sides.append((touching.other, touching.other_boundary))
    return [boundary for of, boundary in sides if of == body]


def _meet_friction(
    bodies: Sequence[Body],
    touching: Sequence[Contact | BodyContact],
    subdomain: Subdomain,
    normal: Array,
    touch: OnSubdomain,
    prescribed: tuple[Array, Array],
) -> None:
    """Update the maps and values of known tractions in place where friction acts.

    The friction on a facet with a sticking node is unknown. Nodes without a friction force, as at
    the edge of the contact, get the direction of their facet.
    """
    directions, load = prescribed
    facets, stuck = subdomain.reference.facets, []
    for number, sticks, forces in touch.friction:
        contact = touching[number]
        for boundary in _sides(contact, subdomain.body):
            rows = boundary_facets(subdomain, bodies[subdomain.body], boundary)
            held = sticks[facets[rows]].any(axis=1)
            stuck.append(rows[held])
            slides = rows[~held & forces[facets[rows]].any(axis=(1, 2))]
            along = _directions(forces[facets[slides]], normal[slides])
            load[slides] += contact.law.limit * along
            pressed = contact.law.coefficient * along
            directions[slides] += pressed[..., :, None] * normal[slides][..., None, :]
    for rows in stuck:
        n = normal[rows]
        directions[rows] = n[..., :, None] * (n[..., None, :] @ directions[rows])


def _directions(forces: Array, normal: Array) -> Array:
    """Unit vectors of friction forces at the nodes of facets, (facets, nodes, dimension).

    Some nodes get the direction of their facet: those with a force of nearly zero, as at the
    vertices of triangles of degree 2, and those with a force opposite to that of the facet, as at
    the edge of the contact of a pair.
    """
    along = forces - np.einsum("fki,fki->fk", forces, normal)[..., None] * normal
    mean = along.sum(axis=1, keepdims=True)
    with_it = np.einsum("fki,fki->fk", along, np.broadcast_to(mean, along.shape))
    least = FAINT * np.einsum("fki,fki->f", mean, mean)
    chosen = np.where((with_it > least[:, None])[..., None], along, mean)
    size = np.linalg.norm(chosen, axis=2, keepdims=True)
    return np.divide(chosen, size, out=np.zeros_like(chosen), where=size > 0.0)
