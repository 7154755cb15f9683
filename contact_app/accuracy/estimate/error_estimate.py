"""The error of an answer against the continuum: of the mesh, of the solver, and of both.

The mesh. A stress σ* recovered from that of the answer is closer to the true one, and estimates
the error in energy norm,

    η² = Σ_K ∫_K (σ* - σ_h) : C⁻¹ : (σ* - σ_h) dx

(Zienkiewicz & Zhu, *A simple error estimator and adaptive procedure for practical engineering
analysis*, IJNME 24, 1987). In quadrilaterals and hexahedra σ_h is most accurate at the samples that
σ* is fitted to, and the misfit of σ* at the samples measures the error of σ* itself: near
singularities both have errors of the same size. The distance then contains the errors of σ_h and of
σ*, and half the square of its part at the samples, Π(σ* - σ_h), is left out:

    η² = Σ_K ∫_K |σ* - σ_h|² - ½ |Π(σ* - σ_h)|² dx   in the norm of C⁻¹.

Where stresses are smooth the misfit is of higher order. It is an estimate, not a bound;
docs/benchmarks/accuracy.md compares it with known errors.

The solver. The duality gap bounds the distance from the exact solution u_h on the mesh to the
admissible û that the answer stands for, ½ ‖û - u_h‖² ≤ J(û) - J(u_h) ≤ gap. It assumes K u = f - Bᵀ
λ. The residual of this equation and the rounding errors of u are added: an estimate, not a bound,
reported as `round_off`.

Both. Energies add up, J(û) - J(u) = (J(û) - J(u_h)) + (J(u_h) - J(u)), and with them the squares.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from contact_app.accuracy.estimate.patches import Table
from contact_app.accuracy.estimate.stress_recovery import Patches, StressRecovery, apply, at_cells
from contact_app.accuracy.estimate.touching import touching_nodes
from contact_app.model.model import Model
from meshes.arrays import Array, Ints
from solver.contact.solution import Accuracy, Solution
from solver.problem.sizes import SIZES

_Distance = tuple[Ints, slice, Array, Array]

MISFIT = 0.5
"""Share of the squared misfit at samples that is the recovery's own error."""


@dataclass(frozen=True, eq=False)
class _Recovered:
    """An answer, its elastic displacements, the changes that meet its tractions, and σ*."""

    solution: Solution
    elastic: Sequence[Array]
    changes: Array
    sides: list[list[Array]]
    """σ* at the nodes of each class, by material."""

    @property
    def by_class(self) -> list[list[Array]]:
        """σ* at the nodes of each class: one for each material."""
        return [list(of_class) for of_class in zip(*self.sides, strict=True)]

    def is_of(self, other: Solution) -> bool:
        """Whether the recovery belongs to the same multipliers and displacements."""
        solution = self.solution
        return (
            solution.multiplier is other.multiplier
            and solution.displacements is other.displacements
        )


class ErrorEstimator:
    """Estimates the errors of answers to one model; using it is collective.

    Parameters
    ----------
    patches
        Patches of the model's meshes, if known from another load case.
    """

    def __init__(self, model: Model, patches: Patches | None = None) -> None:
        self.model = model
        self._patches = patches
        self._last: _Recovered | None = None

    @cached_property
    def recovery(self) -> StressRecovery:
        """The recovery of stresses on this model (collective)."""
        return StressRecovery(self.model, self._patches)

    @cached_property
    def of_materials(self) -> list[Patches]:
        """Patches in the cells of each material: the true stress jumps where materials meet."""
        patches = self.recovery.patches
        count = max(len(materials) for materials in self.model.materials)
        if count == 1:
            return [patches]
        return [Patches.of(self.model, k, patches.surface) for k in range(count)]

    def stresses(self, solution: Solution, patches: Patches) -> list[Array]:
        """σ* of an answer at nodes, (nodes, members, components) of each class (collective).

        Parameters
        ----------
        patches
            Of the model's meshes: those of a material, or others.
        """
        recovered = self._recovered(solution)
        for of_material, stresses in zip(self.of_materials, recovered.sides, strict=True):
            if of_material is patches:
                return stresses
        return self._meeting(patches, recovered.changes, recovered.elastic)

    def _recovered(self, solution: Solution) -> _Recovered:
        """The recovery of an answer in the cells of each material; the last one is stored."""
        if self._last is None or not self._last.is_of(solution):
            touching = touching_nodes(self.model.geometry, self.model.problem, solution)
            elastic = self.model.elastic(solution.displacements)
            changes = self.recovery.patches.surface.changes(self.model, touching)
            sides = [self._meeting(patches, changes, elastic) for patches in self.of_materials]
            self._last = _Recovered(solution, elastic, changes, sides)
        return self._last

    def _meeting(self, patches: Patches, changes: Array, elastic: Sequence[Array]) -> list[Array]:
        return StressRecovery(self.model, patches).meeting(changes, elastic)

    def accuracy(self, solution: Solution) -> Accuracy:
        """The errors of an answer."""
        return accuracy_of(self.squares(solution), solution)

    def squares(self, solution: Solution) -> Array:
        """η² and ∫ σ_h : C⁻¹ : σ_h of each body, (2, bodies); without heat that is a(u_h, u_h)."""
        bodies = self.model.problem.bodies
        sums = np.zeros((2, bodies.count))
        parts = (self.model.elastic(v) for v in (solution.displacements, bodies.members))
        recovered = self._recovered(solution).by_class
        for number, (u, body) in enumerate(zip(*parts, strict=True)):
            for _, part, error, stress in self._distances(number, u, recovered[number]):
                each = (
                    self._lengths(number, error).sum(axis=1),
                    np.einsum("mci,mci->m", stress, stress),
                )
                for row, values in zip(sums, each, strict=True):
                    row += np.bincount(body[part], values, bodies.count)
        return np.asarray(self.model.comm.allreduce(sums))

    def cell_squares(self, solution: Solution) -> list[Array]:
        """η² by cell, (cells, members) of each class (collective)."""
        result = []
        recovered = self._recovered(solution).by_class
        for number, u in enumerate(self.model.elastic(solution.displacements)):
            squares = np.empty((len(self.recovery.cells[number].nodes), u.shape[1]))
            for rows, part, error, _ in self._distances(number, u, recovered[number]):
                squares[rows, part] = self._lengths(number, error).T
            result.append(squares)
        return result

    def _lengths(self, number: int, error: Array) -> Array:
        """η² of cells from σ* - σ_h at their points, (members, cells)."""
        squares = np.einsum("mci,mci->mc", error, error)
        basis = self._sampled[number]
        if basis is not None:
            misfit = error @ basis
            squares -= MISFIT * np.einsum("mci,mci->mc", misfit, misfit)
        return squares

    @cached_property
    def _sampled(self) -> list[Array | None]:
        """Basis of fields that samples determine, by class and component; None if not used.

        None is used where stresses are no more accurate at the samples than elsewhere: with mean
        dilatation, whose volumetric part is constant over a cell, and for a nearly incompressible
        material, whose pressure has the same error everywhere.
        """
        recovery, result = self.recovery, []
        for cells, averaged, materials in zip(
            recovery.cells, recovery.averaged, self.model.materials, strict=True
        ):
            plane = self.model.scene.plane
            stiff = any(material.nearly_incompressible(plane) for material in materials)
            basis = None if averaged or stiff else cells.sampled(2 * cells.degree)
            result.append(None if basis is None else np.kron(basis, np.eye(len(recovery.V))))
        return result

    def _distances(self, number: int, u: Array, recovered: list[Array]) -> Iterator[_Distance]:
        """σ* - σ_h and σ_h of a class, whose squares are ∫ e : C⁻¹ : e: batches of cells.

        Parameters
        ----------
        recovered
            σ* at nodes, by material.

        Yields
        ------
        Rows, members, and two arrays (members, cells, points · components).
        """
        recovery, cells = self.recovery, self.recovery.cells[number]
        table = cells.table(2 * cells.degree)
        field = u.reshape(len(cells.places), cells.dimension, -1).swapaxes(1, 2)
        last_shape: Ints | None = None
        for rows, shape, part in cells.batches(u.shape[1], len(table.weights)):
            if shape is not last_shape:  # members of one class share all that depends on shapes
                root, nodal, weight, operator = self._of_shape(number, shape, table)
                last_shape = shape
            nodes = cells.nodes[rows]
            stress = apply(operator, at_cells(field[:, part], nodes))
            stress = np.tile(stress, weight.shape[1] // stress.shape[2])
            missing = recovery.thermal_at(number, rows, part, table)
            if missing is not None:
                stress = stress - (missing @ root).reshape(stress.shape)
            stress = stress * weight
            side = recovered[cells.tags[shape[0]]]
            error = (at_cells(side[:, part], nodes) @ nodal) * weight - stress
            yield rows, part, error, stress

    def _of_shape(
        self, number: int, shape: Ints, table: Table
    ) -> tuple[Array, Array, Array, Array]:
        """Data for distances in the cells of a class, independent of displacements.

        Returns
        -------
        The root of C⁻¹; the map from its components of σ* at nodes to those at points; weights of
        points, (cells, points · components); and the map from displacements to stresses, at one
        point where they are constant in a cell.
        """
        recovery, cells = self.recovery, self.recovery.cells[number]
        D = np.array(recovery.moduli[number][cells.tags[shape[0]]])
        root = np.linalg.cholesky(np.linalg.inv(D.sum(axis=0)))  # e : C⁻¹ : e = |rootᵀ e|²
        # node by node the same: from root's components of σ* to those at the points
        nodal = np.einsum("qv,st->vsqt", table.values, root)
        nodal = nodal.reshape(table.values.shape[1] * len(root), -1)
        points = cells.samples if cells.degree == 1 and cells.straight_simplices else table
        volume = cells.gradients(shape, points)[1]
        weight = np.repeat(np.sqrt(table.weights * volume), len(root), axis=1)
        return (
            root,
            nodal,
            weight,
            recovery.stress_at(number, shape, points, root.T @ D @ recovery.V),
        )


def accuracy_of(squares: Array, solution: Solution) -> Accuracy:
    """The errors of an answer.

    Parameters
    ----------
    squares : (2, bodies)
        η² and ∫ σ_h : C⁻¹ : σ_h of each body.
    """
    measures = solution.measures
    groups, count = measures.groups, len(measures.gaps)
    square, norm, rounding, reported = (
        np.bincount(groups, values, count)
        for values in (*squares, measures.roundings, measures.scales + measures.pressed)
    )
    solver = measures.error_squares()
    # strains that the solver's error exceeds have no digits, as rounding errors have none
    total, strained = float(norm.sum()), norm > np.maximum(SIZES.strainless * rounding, solver)
    if (~strained & (reported > 0.0)).any():  # forces, but no strains to be relative to
        return Accuracy(np.nan, np.nan, np.nan, total, np.nan)
    if not strained.any():
        return Accuracy(0.0, 0.0, 0.0, 0.0, 0.0)
    totals = np.divide(square + solver, norm, out=np.zeros(count), where=strained)
    worst = int(np.argmax(totals))
    errors = np.sqrt(np.array([square, solver, rounding])[:, worst] / norm[worst])
    some = strained[groups] & (measures.scales > 0.0)
    bodies = np.sqrt(np.stack([squares[0], solver[groups]])[:, some] / measures.scales[some])
    return Accuracy(
        discretisation=float(errors[0]),
        algebraic=float(errors[1]),
        total=float(np.sqrt(totals[worst])),
        square=total,
        round_off=float(errors[2]),
        bodies=tuple((float(mesh), float(error)) for mesh, error in bodies.T),
    )
