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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from contact_app.accuracy.estimate.patch_fits import WEAK, Copies
from contact_app.accuracy.estimate.patches import Cells
from contact_app.accuracy.estimate.touching import Touching
from contact_app.model.geometry import Geometry
from contact_app.model.model import Model
from contact_app.scene.conditions import BodyContact, Contact, RigidTie, Tie
from meshes import Subdomain
from meshes.arrays import Array, Ints
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
        self._nodes = [np.unique(c.element.reference.facets).astype(np.int64) for c in cells]
        self._copies = copies = Copies(model, self._nodes)
        of_bodies: dict[int, list[_Part]] = {}
        for k, (subdomain, (cls, column)) in enumerate(
            zip(model.partition.subdomains, model.place.tolist(), strict=True)
        ):
            if len(subdomain.exterior):
                facets = subdomain.reference.facets[subdomain.exterior]
                part = _Part(k, subdomain, cls, column, facets)
                of_bodies.setdefault(subdomain.body, []).append(part)
        self._bodies = [_BodySurface(body, parts, cells) for body, parts in of_bodies.items()]
        places = [body.copies(copies, self._nodes) for body in self._bodies]
        outside = np.zeros((copies.count, 1))
        for place in places:
            outside[place] = 1.0
        self._exterior = np.flatnonzero(copies.scatter(copies.gather(outside))[:, 0])
        self._met = copies.some(self._exterior)
        self._places = [np.searchsorted(self._exterior, place) for place in places]

    def changes(self, model: Model, touching: Touching) -> Array:
        """P and q at copies of the nodes on the bodies' surfaces, (copies, s² + s) (collective).

        Parameters
        ----------
        model
            With the loads.
        """
        s = model.scene.dimension * (model.scene.dimension + 1) // 2
        sums = np.zeros((len(self._exterior), s * s + s))
        for body, places in zip(self._bodies, self._places, strict=True):
            _add_equations(sums, places, body.normals, _known_tractions(model, body, touching))
        sums = self._met.gather(sums)
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


class _Part(NamedTuple):
    """The surface facets of one subdomain, a member of a class."""

    number: int
    subdomain: Subdomain
    cls: int
    column: int
    facets: NDArray[np.int32]  # (facets, nodes)


class _BodySurface:
    """The facets on the surface of a body in the subdomains of this rank."""

    def __init__(self, body: int, parts: list[_Part], cells: Sequence[Cells]) -> None:
        self.body, self.parts = body, parts
        self.normals = np.concatenate([cells[p.cls].normals[p.subdomain.exterior] for p in parts])

    def copies(self, copies: Copies, nodes: Sequence[Ints]) -> Ints:
        """The copies of the nodes of facets, (facets, nodes).

        Parameters
        ----------
        nodes
            The surface nodes of each class.
        """
        result = []
        for part in self.parts:
            _, members = copies.shapes[part.cls]
            node = np.searchsorted(nodes[part.cls], part.facets)
            result.append(copies.starts[part.cls] + node * members + part.column)
        return np.concatenate(result)

    def at_nodes(self, by_class: Sequence[NDArray]) -> NDArray:
        """Values (nodes, members, …) of each class at the nodes of facets, (facets, nodes, …)."""
        return np.concatenate([by_class[part.cls][part.facets, part.column] for part in self.parts])

    def points(self) -> Array:
        """The nodes of facets, (facets, nodes, 3)."""
        return np.concatenate([part.subdomain.points()[part.facets] for part in self.parts])

    def rows_on(self, geometry: Geometry, boundary: str) -> Ints:
        """The facets on a boundary."""
        by_subdomain, rows, before = geometry.facets_of(self.body, boundary), [], 0
        for part in self.parts:
            if len(on := by_subdomain[part.number]):
                rows.append(before + np.flatnonzero(np.isin(part.subdomain.exterior, on)))
            before += len(part.facets)
        return np.concatenate([np.zeros(0, np.int64), *rows])


def _add_equations(
    sums: Array, places: Ints, normals: Array, tractions: tuple[Array, Array]
) -> None:
    """Add the normal equations CᵀC and Cᵀt of C σ = t at the nodes of facets, (n, s² + s).

    Parameters
    ----------
    places : (facets, nodes)
        Of the nodes among the n.
    tractions
        As `_known_tractions` gives them.
    """
    parts = tractions[0], normals, tractions[1]
    # one equation for all nodes of a facet where it is the same
    uniform = np.all([(a == a[:, :1]).all(axis=tuple(range(1, a.ndim))) for a in parts], axis=0)
    for rows, nodes in ((uniform, slice(1)), (~uniform, slice(None))):
        equations = _normal_equations(*(a[rows, nodes] for a in parts))
        at, size = places[rows], equations.shape[:2]
        number = np.broadcast_to(np.arange(size[0] * size[1]).reshape(size), at.shape)
        to_nodes = sparse.csr_matrix(
            (np.ones(at.size), (at.ravel(), number.ravel())), shape=(len(sums), size[0] * size[1])
        )
        sums += to_nodes @ equations.reshape(-1, sums.shape[1])


def _normal_equations(prescribed: Array, normal: Array, load: Array) -> Array:
    """CᵀC and Cᵀt of K t = K load, t = σ n, (facets, nodes, s² + s)."""
    d = normal.shape[-1]
    s = d * (d + 1) // 2
    C = np.zeros((*normal.shape, s))
    for i in range(d):
        C[..., i, i] = normal[..., i]
    for row, (i, j) in enumerate(SHEARS[: s - d], d):
        C[..., i, row], C[..., j, row] = normal[..., j], normal[..., i]
    C = prescribed @ C
    t = prescribed @ load[..., None]
    transposed = np.swapaxes(C, -1, -2)
    squares = (transposed @ C).reshape(*normal.shape[:2], s * s)
    return np.concatenate([squares, (transposed @ t)[..., 0]], axis=-1)


def _known_tractions(
    model: Model, surface: _BodySurface, touching: Touching
) -> tuple[Array, Array]:
    """Linear maps K for the known part of the traction t at the nodes of facets: K t = K load.

    K is a projector that removes from t the unknown parts: the components that are held, the whole
    traction on tied boundaries, and the normal part where a node of the facet is in contact. Where
    the node slides with Coulomb friction, K also adds μ (n·t) d to the tangential part.

    Returns
    -------
    (facets, nodes, dimension, dimension) and (facets, nodes, dimension)
    """
    scene, normal, number = model.scene, surface.normals, surface.body
    d = normal.shape[-1]
    load = _given_tractions(model, surface)
    directions = np.broadcast_to(np.eye(d), (*normal.shape, d)).copy()
    pushed = surface.at_nodes(touching.pushed).any(axis=1)
    for contact in scene.touching:
        for boundary in _sides(contact, number):
            rows = surface.rows_on(model.geometry, boundary)
            n = normal[rows[pushed[rows]]]
            directions[rows[pushed[rows]]] = np.eye(d) - n[..., :, None] * n[..., None, :]
    _meet_friction(model.geometry, surface, touching, (directions, load))
    for body, boundary in tied_sides(scene.all_ties):
        if body == number:
            directions[surface.rows_on(model.geometry, boundary)] = 0.0
    for condition in scene.displacements:
        if condition.body == number:
            rows = surface.rows_on(model.geometry, condition.boundary)
            free = np.array([value is None for value in condition.values], float)
            directions[rows] = free[:, None] * directions[rows]
    return directions, load


def _given_tractions(model: Model, surface: _BodySurface) -> Array:
    """The loads at the nodes of facets, (facets, nodes, dimension)."""
    scene, normal, number = model.scene, surface.normals, surface.body
    load = np.zeros(normal.shape)
    for traction in scene.tractions:
        if traction.body == number:
            load[surface.rows_on(model.geometry, traction.boundary)] += traction.vector
    for pressure in scene.pressures:
        if pressure.body == number:
            rows = surface.rows_on(model.geometry, pressure.boundary)
            load[rows] -= pressure.value * normal[rows]
    for linear in model.linear:
        if linear.body == number:
            rows = surface.rows_on(model.geometry, linear.boundary)
            load[rows] += linear.at(surface.points()[rows], normal.shape[-1])
    return load


def _sides(touching: Contact | BodyContact, body: int) -> list[str]:
    """Boundaries of a body that belong to a contact."""
    sides = [(touching.body, touching.boundary)]
    if isinstance(touching, BodyContact):
        sides.append((touching.other, touching.other_boundary))
    return [boundary for of, boundary in sides if of == body]


def _meet_friction(
    geometry: Geometry, surface: _BodySurface, touching: Touching, prescribed: tuple[Array, Array]
) -> None:
    """Update the maps and values of known tractions in place where friction acts.

    The friction on a facet with a sticking node is unknown. Nodes without a friction force, as at
    the edge of the contact, get the direction of their facet.
    """
    (directions, load), normal, stuck = prescribed, surface.normals, []
    for friction in touching.friction:
        contact = geometry.touching[friction.contact]
        for boundary in _sides(contact, surface.body):
            rows = surface.rows_on(geometry, boundary)
            forces = surface.at_nodes(friction.forces)[rows]
            held = surface.at_nodes(friction.sticks)[rows].any(axis=1)
            stuck.append(rows[held])
            slides = ~held & forces.any(axis=(1, 2))
            along, rows = _directions(forces[slides], normal[rows[slides]]), rows[slides]
            load[rows] += contact.law.limit * along
            pressed = contact.law.coefficient * along
            directions[rows] += pressed[..., :, None] * normal[rows][..., None, :]
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
