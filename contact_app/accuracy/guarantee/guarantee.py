"""A guaranteed bound of the error of mesh and solver together, by a stress in equilibrium.

For the energy J(v) = ½ a(v,v) - l(v) on the admissible set K = {v = u_D on D, v·n ≤ g on C} and any
stress σ with div σ + f = 0, σn = t where loaded or free, and on C no shear and a pressure p ≥ 0,
every û in K obeys

    ½ ‖û - u‖² ≤ J(û) - J(u) ≤ J(û) + J*(σ)
                = ½ ∫ (σ - C ε(û)) : C⁻¹ : (σ - C ε(û)) dx + ∫_C p (g - û·n) ds

(W. Prager & J. L. Synge, Quart. Appl. Math. 5, 1947, the contact taken into the dual problem). Both
terms of the last line are non-negative: they are summed without cancellation, and by a quadrature
that is exact. û is the admissible displacement near the solution that the certificate uses; σ comes
from `equilibrated`. Only rounding errors are left: the residual that they leave in equilibrium is
measured by the norm of the correction it would need, and this norm is added.

It holds for the scene as it is modelled: small strain, loads and conditions on whole facets,
obstacles flat and parallel to the face they meet, where gaps at nodes are gaps everywhere; other
scenes are refused (`box_surface`).

The stress of a body is computed on rank 0, which holds its grid; all other data stay on the ranks
of the cells.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.estimate.patches import Cells
from contact_app.accuracy.estimate.stress_recovery import (
    apply,
    at_cells,
    strain_of_gradient,
    stress_operator,
)
from contact_app.accuracy.estimate.tractions import SHEARS
from contact_app.accuracy.guarantee.box_surface import BoxSurface, FacetsOnFace
from contact_app.accuracy.guarantee.equilibrated import AdmissibleStress, NoAdmissibleStressError
from contact_app.machine.ranks import on_first
from contact_app.model.model import Model
from contact_app.results.report import at_most
from meshes import Subdomain
from solver.contact.solution import Solution
from solver.problem.duality_gap import nearest_admissible
from solver.problem.least_motion import with_supports_at
from solver.vectors import Array, Ints, Mask, largest_magnitude

RULE = 4
"""Degree of the quadrature along each axis: integrands are squares of quadratic functions."""

TOUCHES = 1e-9
"""Gap, relative to the largest displacement, that counts as closed."""

STRAINLESS = 1e-18
"""a(u,u) relative to Σ K_ii u_i² below which strains are rounding errors of a rigid motion."""

ROUNDED = 1e-12
"""Penetration and jumps of û, relative to the largest displacement, that count as rounding
errors."""


@dataclass(frozen=True)
class Guarantee:
    """The guaranteed bound of an answer."""

    bound: float | None
    """Bound of ‖û - u‖ relative to ‖û‖ (energy norms); None if there is no bound."""
    missing: str = ""
    """The reason why there is no bound."""
    norm: float = 0.0
    """‖û‖ itself."""
    residual: float = 0.0
    """Largest unbalanced force of a cell, relative to the largest sum of magnitudes of its
    terms."""
    steps: int = 0
    """Conjugate gradient steps spent on the stresses."""

    def __str__(self) -> str:
        if self.bound is None:
            return f"no error is guaranteed: {self.missing}"
        return (
            f"the error of mesh and solver together is at most {at_most(self.bound)} in energy "
            f"norm, guaranteed by a stress in equilibrium to {self.residual:.1g} ({self.steps} "
            "conjugate gradient steps)"
        )


def guarantee(model: Model, solution: Solution) -> Guarantee:
    """Bound the error of an answer (collective)."""
    try:
        return _Answer(model, solution).guarantee()
    except NoAdmissibleStressError as error:
        return Guarantee(None, str(error))


def with_guarantee(summary: dict[str, Any], result: Guarantee) -> dict[str, Any]:
    """`summary.json` with the guaranteed bound."""
    certificate = summary["certificate"]
    if result.missing:
        certificate = {**certificate, "warnings": [*certificate["warnings"], str(result)]}
    accuracy = {**summary["accuracy"], "guaranteed": result.bound}
    return {**summary, "accuracy": accuracy, "certificate": certificate}


class _Piece(NamedTuple):
    """A subdomain, the class and column of its vectors, and the places of its cells."""

    subdomain: Subdomain
    cls: int
    column: int
    places: Ints


class _Batch(NamedTuple):
    """C ε(û) in cells of a piece: (cells,), (cells, points, d or components), (cells, points)."""

    piece: _Piece
    rows: Ints
    points: Array
    stress: Array
    weight: Array


class _Answer:
    """An answer's admissible neighbour û on the grids of its bodies (all methods collective)."""

    def __init__(self, model: Model, solution: Solution) -> None:
        self.comm, self.dimension = model.comm, model.scene.dimension
        self.problem = with_supports_at(model.problem, solution.displacements)
        self.size = solution.measures.displacement
        self.bodies = [
            BoxSurface(model.scene, model.partition, b) for b in range(len(model.scene.bodies))
        ]
        made = {id(element): Cells(element) for element in model.elements}
        self.cells = [made[id(element)] for element in model.elements]
        self.pairs = SHEARS[: 2 * self.dimension - 3]
        self.stiff = [
            sum(materials[0].elasticity(model.scene.plane, self.dimension))
            @ strain_of_gradient(self.dimension)
            for materials in model.materials
        ]
        self.pieces = []
        for s, (cls, column) in zip(model.partition.subdomains, model.place, strict=True):
            centres = s.points()[self.cells[cls].nodes].mean(axis=1)
            places = self.bodies[s.body].cells_at(centres)
            self.pieces.append(_Piece(s, int(cls), int(column), places))
        interface = nearest_admissible(self.problem, solution.multiplier, solution.displacements)
        self._refuse_jumps(interface)
        self.displacements = []
        for cls, part, u in zip(
            self.problem.classes, self.problem.slices, solution.displacements,
            strict=True,
        ):  # fmt: skip
            admissible = u.copy()
            admissible[cls.interface] = interface[part].reshape(cls.members, -1).T
            self.displacements.append(admissible)

    def _refuse_jumps(self, interface: Array) -> None:
        """Refuse û if it jumps between subdomains or from prescribed displacements.

        Raises
        ------
        NoAdmissibleStressError
            û is not admissible.
        """
        jumps = (self.problem.residual(interface) / self.problem.spread)[~self.problem.inequality]
        largest = largest_magnitude(self.comm, jumps)
        if largest > ROUNDED * self.size:
            raise NoAdmissibleStressError(
                f"the answer jumps by {largest:.3g} between subdomains or at held nodes"
            )

    def guarantee(self) -> Guarantee:
        """The bound."""
        touching = [self._touching(number) for number in range(len(self.bodies))]
        energies, means = self._energies(), self._means()
        of_bodies = [
            self._admissible_stress(*args)
            for args in zip(self.bodies, means, touching, energies, strict=True)
        ]  # fmt: skip
        square, norm = self._distances(of_bodies)
        square += 2.0 * max(self._open_work(of_bodies), 0.0)
        slip = sum(one.slip**2 for one in of_bodies) ** 0.5
        if norm <= (rounding := STRAINLESS * self._scale()):
            if square + slip**2 <= rounding:
                return Guarantee(0.0)
            raise NoAdmissibleStressError("nothing is strained that an error could be relative to")
        bound = (square**0.5 + slip) / norm**0.5
        residual = max(one.residual for one in of_bodies)
        return Guarantee(bound, "", norm**0.5, residual, sum(one.steps for one in of_bodies))

    def _scale(self) -> float:
        """Σ K_ii u_i², a scale in comparison with which rounding errors of strains are small."""
        parts = zip(self.problem.classes, self.displacements, strict=True)
        energy = sum(float(np.sum(cls.stiffness.diagonal()[:, None] * u**2)) for cls, u in parts)
        return float(self.comm.allreduce(energy))

    def _energies(self) -> list[float]:
        """J(û) of each body."""
        energies = np.zeros(len(self.bodies))
        by_class = [
            np.einsum("nm,nm->m", u, 0.5 * (cls.stiffness @ u) - load)
            for cls, u, load in zip(
                self.problem.classes, self.displacements, self.problem.forces, strict=True
            )
        ]
        for piece in self.pieces:
            energies[piece.subdomain.body] += by_class[piece.cls][piece.column]
        return [float(v) for v in self.comm.allreduce(energies)]

    def _stresses(self, rule: int) -> Iterator[_Batch]:
        """C ε(û) at the points of a rule, batch by batch of one piece each."""
        members: dict[tuple[int, int], _Piece] = {(p.cls, p.column): p for p in self.pieces}
        for number, cells in enumerate(self.cells):
            table, u = cells.table(rule), self.displacements[number]
            field = u.reshape(len(cells.places), self.dimension, -1).swapaxes(1, 2)
            for rows, shape, part in cells.batches(u.shape[1], len(table.weights)):
                gradients, volume = cells.gradients(shape, table)
                operator = stress_operator(gradients, self.stiff[number])
                stress = apply(operator, at_cells(field[:, part], cells.nodes[rows]))
                stress = stress.reshape(*stress.shape[:2], len(table.weights), -1)
                weight = np.broadcast_to(table.weights * volume, stress.shape[1:3])
                corners = cells.places[cells.geometry[rows]]
                points = np.einsum("qg,cgi->cqi", table.places, corners)
                for column, of_subdomain in enumerate(stress, part.start):
                    piece = members[number, column]
                    moved = points + piece.subdomain.translation[: self.dimension]
                    yield _Batch(piece, rows, moved, of_subdomain, weight)

    def _means(self) -> list[Array]:
        """Means of C ε(û) over the cells of each grid, components as its stresses have them.

        Complete on rank 0; other ranks have the means of their own cells.
        """
        d = self.dimension
        count = d + len(self.pairs)
        sums = [np.zeros((int(np.prod(body.cells)), count + 1)) for body in self.bodies]
        for piece, rows, _, stress, weight in self._stresses(1):
            number = piece.subdomain.body
            flat = np.ravel_multi_index(tuple(piece.places[rows].T), self.bodies[number].cells)
            values = np.einsum("cq,cqs->cs", weight, stress)
            values = np.column_stack([values, weight.sum(axis=1)])
            np.add.at(sums[number], flat, values)
        result = []
        for body, part in zip(self.bodies, sums, strict=True):
            order = [*range(d), *(d + self.pairs.index(pair) for pair in body.stresses.space.pairs)]
            total = self.comm.reduce(part)
            total = part if total is None else total
            means = total[:, order] / np.where(total[:, -1:] > 0.0, total[:, -1:], 1.0)
            result.append(means.reshape(*body.cells, count))
        return result

    def _admissible_stress(
        self, body: BoxSurface, means: Array, touching: list[Mask], energy: float
    ) -> AdmissibleStress:
        """A stress for a body, on all ranks.

        Raises
        ------
        NoAdmissibleStressError
            No stress is in equilibrium with the data.
        """

        def search() -> AdmissibleStress:
            start = body.stresses.space.from_means(means)
            return body.stresses.search(start, touching, energy)

        return on_first(self.comm, search)

    def _slacks(self, number: int) -> Iterator[tuple[FacetsOnFace, Array]]:
        """Facets of this rank that obstacles oppose, and g - û·n at their nodes."""
        body = self.bodies[number]
        pressed = [body.pressed(face) for face in range(2 * self.dimension)]
        for piece in self.pieces:
            s = piece.subdomain
            if s.body != number:
                continue
            for on in body.facets_on_faces(s, s.exterior):
                opposed = pressed[on.face][on.place]
                if not opposed.any():
                    continue
                axis, sign, _ = body.side(on.face)
                place, rows = tuple(k[opposed] for k in on.place), on.rows[opposed]
                u = self.displacements[piece.cls][axis :: self.dimension, piece.column]
                gap = body.faces[on.face].gap[place]
                slack = gap[:, None] - sign * u[s.reference.facets[rows]]
                yield FacetsOnFace(on.face, rows, place, on.share), slack

    def _touching(self, number: int) -> list[Mask]:
        """Facets of the grid that touch with a node, face by face.

        Raises
        ------
        NoAdmissibleStressError
            û is not admissible.
        """
        result = [np.zeros(face.contact.shape, bool) for face in self.bodies[number].faces]
        deepest = 0.0
        for on, slack in self._slacks(number):
            deepest = max(deepest, -float(slack.min()))
            closed = (slack <= TOUCHES * self.size).any(axis=1)
            np.maximum.at(result[on.face], on.place, closed)
        deepest = self.comm.allreduce(deepest, op=MPI.MAX)
        if deepest > ROUNDED * self.size:
            raise NoAdmissibleStressError(f"the answer crosses an obstacle by {deepest:.3g}")
        return [self.comm.allreduce(part * 1) > 0 for part in result]

    def _distances(self, of_bodies: list[AdmissibleStress]) -> tuple[float, float]:
        """∫ (σ - C ε(û)) : C⁻¹ : (σ - C ε(û)) and a(û, û)."""
        sums = np.zeros(2)
        for piece, rows, points, stress, weight in self._stresses(RULE):
            number = piece.subdomain.body
            body, place = self.bodies[number], piece.places[rows]
            lower = np.stack([x[place[:, k]] for k, x in enumerate(body.axes)], axis=1)
            upper = np.stack([x[place[:, k] + 1] for k, x in enumerate(body.axes)], axis=1)
            local = (points - lower[:, None]) / (upper - lower)[:, None]
            error = of_bodies[number].stress.at(place, local, self.pairs) - stress
            for k, field in enumerate((error, stress)):
                sums[k] += np.vdot(weight[..., None] * field @ body.compliance, field)
        square, norm = self.comm.allreduce(sums)
        return float(square), float(norm)

    def _open_work(self, of_bodies: list[AdmissibleStress]) -> float:
        """∫ p (g - û·n) over the contact."""
        total = 0.0
        for number, (body, one) in enumerate(zip(self.bodies, of_bodies, strict=True)):
            for on, slack in self._slacks(number):
                across = [np.diff(x) for k, x in enumerate(body.axes) if k != on.face // 2]
                area = on.share * np.prod(
                    [h[place] for h, place in zip(across, on.place, strict=True)], axis=0
                )
                total += float((area * one.pressures[on.face][on.place]) @ slack.mean(axis=1))
        return float(self.comm.allreduce(total))
