"""Stresses in equilibrium with the data of a box, with nearly the least complementary energy.

On the grid of the box (`grid_stress`) equilibrium is B s = -f, d equations a cell; loads fix values
on the surface, and on the contact the pressure p = t_n - σ_nn has to be positive. Among the
stresses that satisfy these conditions, one with a small energy

    J*(σ) = ½ ∫ σ : C⁻¹ : σ - ∫_D σn · u_D + ∫_C p g

is sought by conjugate gradients, preconditioned by the diagonal of the energy on the subspace B s =
0. They need about the same small number of steps on every grid. Each step solves with B diag⁻¹ Bᵀ:
by a factor for small grids and by the iterations of `separable` for larger ones. They stop as soon
as the energy hardly falls. Then facets with tension lose their pressure, facets on which a pressure
would lower the energy receive one, and the search continues. At its end equilibrium is restored up
to rounding errors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from contact_app.accuracy.guarantee.grid_stress import GridStress, GridStresses
from contact_app.accuracy.guarantee.separable import EquilibriumPreconditioner, conjugate_gradients
from contact_app.errors import ContactError
from meshes.arrays import Array, Mask
from solver.factors import CholeskyFactor

BALANCED = 1e-10
"""Largest residual of equilibrium by rounding errors; a larger one means no equilibrium."""

AGREE = 1e-12
"""Difference of tractions, relative to the largest, that counts as rounding error."""


@dataclass(frozen=True)
class SearchOptions:
    """The tuned numbers of the search for an admissible stress."""

    solved: float = 1e-4
    most_iterations: int = 1000
    """Residual of a projection relative to the projected vector, and its most iterations."""
    balancings: int = 8
    """Number of projections after which only rounding errors are left of a residual."""
    unbalanced: float = 0.01
    """Residual of equilibrium after two projections above which equilibrium is impossible."""
    most_steps: int = 300
    """Largest number of conjugate gradient steps on one set of pressed facets."""
    look_back: int = 3
    worth: float = 0.02
    """The search continues while this number of last steps gains this share of J(û) + J*(σ)."""
    worth_pressing: float = 1e-3
    """Share of J(û) + J*(σ) that pressures on further facets have to gain by a first estimate."""
    most_sets: int = 40
    growing_sets: int = 15
    """Number of sets of pressed facets that are tried, and number of sets that may be enlarged."""
    direct: tuple[int, int] = (200_000, 12_000)
    """Largest number of equations that are factored, in the plane and in space: factors of more
    fill up."""
    shift: float = 1e-10
    """Shift of a factored matrix relative to its diagonal: it is singular where a body is not
    held."""
    rounded: float = 1e-24
    """Square of the gradient, relative to the first one, that counts as rounding error."""


class NoAdmissibleStressError(ContactError):
    """No stress of the space satisfies the data; the message names the datum and its place."""


@dataclass(frozen=True, eq=False)
class FaceData:
    """The known data of one face of a box; facets are those of the grid."""

    held: Mask  # (facets…, d)
    """Components whose displacement is known and whose traction is therefore unknown."""
    displacement: Array  # (facets…, d)
    """Displacement of the held components."""
    traction: Array  # (facets…, d)
    """Load, force per area."""
    contact: Mask  # (facets…)
    """Facets that an obstacle may push."""
    gap: Array  # (facets…)
    """Distance along the outward normal to that obstacle."""

    @classmethod
    def free(cls, shape: tuple[int, ...], dimension: int) -> "FaceData":
        """A face on which nothing acts."""
        vectors = (*shape, dimension)
        return cls(
            np.zeros(vectors, bool), np.zeros(vectors), np.zeros(vectors),
            np.zeros(shape, bool), np.zeros(shape),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class AdmissibleStress:
    """An admissible stress."""

    stress: GridStress
    energy: float
    """J*(σ)."""
    pressures: list[Array]
    """p on the facets of each face (x-, x+, y-, …), zero off the contact."""
    residual: float
    """Largest component of div σ + f, relative to the largest sum of the magnitudes of its
    terms."""
    slip: float
    """Energy norm of the correction that would remove the residual."""
    steps: int
    """Conjugate gradient steps."""


class AdmissibleStresses:
    """The stresses of a box that are in equilibrium with its data.

    Parameters
    ----------
    axes
        Ascending grid coordinates along each axis.
    compliance : (components, components)
        C⁻¹ of an isotropic material, engineering shear.
    faces
        x-, x+, y-, …
    force : (d,)
        Force per volume.

    Raises
    ------
    NoAdmissibleStressError
        Shear tractions contradict each other along an edge.
    """

    def __init__(
        self,
        axes: Sequence[Array],
        compliance: Array,
        faces: Sequence[FaceData],
        force: Array,
        options: SearchOptions | None = None,
    ) -> None:
        self.options = options or SearchOptions()
        self.space = GridStresses(axes)
        self._compliance, size = compliance, self.space.size
        self.divergence = np.repeat(-force, int(np.prod(self.space.cells)))
        self._low, self._high = np.full(size, np.inf), np.full(size, -np.inf)
        self.work, self._load = np.zeros(size), np.zeros(size)
        self.contact = np.zeros(size, bool)
        for number, face in enumerate(faces):
            self._note_normal(number, face)
            for component, pair in enumerate(self.space.pairs, self.space.dimension):
                if number // 2 in pair:
                    self._note_shear(number, face, component)
        self._refuse_contradictions()
        self.prescribed = np.isfinite(self._low)

    def _note_normal(self, number: int, face: FaceData) -> None:
        """Store σ_nn on a face: known, free because the face is held, or a contact pressure."""
        axis, end = divmod(number, 2)
        sign, rows = (1.0 if end else -1.0), self.space.rows_on_face(axis, number)
        held = face.held[..., axis]
        pressed = face.contact & ~held
        self.contact[rows] = pressed
        # σn is sign σ_ii e_i, so that a traction's normal part is the normal stress
        self._load[rows] = sign * face.traction[..., axis]
        fixed = ~held & ~pressed
        self._low[rows[fixed]] = self._high[rows[fixed]] = self._load[rows[fixed]]
        moved = np.where(pressed, face.gap, np.where(held, sign * face.displacement[..., axis], 0))
        self.work[rows] = self.space.facet_areas(axis) * moved

    def _note_shear(self, number: int, face: FaceData, component: int) -> None:
        """Store σ_ij on the edges of a face's facets, as far as each facet knows it."""
        axis, end = divmod(number, 2)
        pair = self.space.pairs[component - self.space.dimension]
        (other,) = set(pair) - {axis}
        along = other if other < axis else other - 1  # among the axes of the face
        sign, rows = (1.0 if end else -1.0), self.space.rows_on_face(component, number)
        fixed, value = ~face.held[..., other], sign * face.traction[..., other]
        moved = sign * self.space.facet_areas(axis) * face.displacement[..., other]
        rows, fixed, value, moved = (
            np.moveaxis(a, along, 0) for a in (rows, fixed, value, np.where(fixed, 0.0, moved))
        )
        for edge in (rows[:-1], rows[1:]):
            np.minimum.at(self._low, edge[fixed], value[fixed])
            np.maximum.at(self._high, edge[fixed], value[fixed])
            np.add.at(self.work, edge, 0.5 * moved)

    def _refuse_contradictions(self) -> None:
        """Refuse shears that differ where two faces meet: σ_xy = σ_yx has one value there."""
        fixed = np.isfinite(self._low)
        largest = np.abs(self._high[fixed]).max(initial=0.0)
        different = np.flatnonzero(fixed)[(self._high - self._low)[fixed] > AGREE * largest]
        if not len(different):
            return
        space, row = self.space, different[0]
        component = next(k for k, part in enumerate(space.parts) if part.start <= row < part.stop)
        place = np.unravel_index(row - space.parts[component].start, space.shapes[component])
        pair = space.pairs[component - space.dimension]
        along = "".join("xyz"[k] for k in pair)
        at = " and ".join(f"{'xyz'[k]} = {space.axes[k][place[k]]:g}" for k in pair)
        raise NoAdmissibleStressError(
            f"the shear tractions that meet at {at} contradict each other (σ_{along} = "
            f"{self._low[row] + 0.0:g} and {self._high[row] + 0.0:g}): no symmetric stress with "
            "continuous tractions has both"
        )

    @cached_property
    def matrix(self) -> sparse.csr_matrix:
        """A of ∫ σ : C⁻¹ : σ = sᵀ A s."""
        return self.space.energy_matrix(self._compliance)

    def energy(self, s: Array) -> float:
        """J*(σ), with p = t_n - σ_nn on the contact; `work` holds the part of σ_nn."""
        prescribed_work = float(self.work[self.contact] @ self._load[self.contact])
        return prescribed_work + float(0.5 * s @ (self.matrix @ s) - self.work @ s)

    def search(
        self, start: Array, touching: Sequence[Mask], other_energy: float
    ) -> AdmissibleStress:
        """An admissible stress of nearly least energy.

        Parameters
        ----------
        start : (size,)
            Initial stress, not necessarily in equilibrium.
        touching
            Facets of each face that may carry a pressure: those with pressure in the initial
            stress, if it has any. All may if these cannot carry the loads.
        other_energy
            J(û) of an admissible displacement, which -J*(σ) cannot exceed.

        Raises
        ------
        NoAdmissibleStressError
            Pressures alone do not keep the loads in equilibrium.
        """
        pressed = np.zeros(self.space.size, bool)
        for number, facets in enumerate(touching):
            pressed[self.space.rows_on_face(number // 2, number)] |= facets
        pressed &= self.contact
        if (pushing := pressed & (start < self._load)).any():
            pressed = pushing
        s, steps, options = start, 0, self.options
        for attempt in range(options.most_sets):
            fixed = self.prescribed | (self.contact & ~pressed)
            s = np.where(fixed, np.where(self.prescribed, self._low, self._load), s)
            subspace = _Subspace(self, ~fixed)
            s = subspace.balanced(s, 2)
            if subspace.residual(s) > options.unbalanced:
                if (pressed == self.contact).all():
                    break
                pressed = self.contact.copy()
                continue
            s, count = self._descended(subspace, s, other_energy)
            steps += count
            pulling, missing = pressed & (s > self._load), np.zeros_like(pressed)
            if attempt < options.growing_sets:
                missing = self._missing(subspace, s, self.contact & ~pressed, other_energy)
            if not (pulling | missing).any():
                s = subspace.balanced(s)
                pulling = pressed & (s > self._load)
                if not pulling.any():
                    return self._stresses(subspace, s, steps)
            pressed = (pressed & ~pulling) | missing
        single = [axis for axis, n in zip("xyz", self.space.cells, strict=False) if n == 1]
        raise NoAdmissibleStressError(
            "no stress on this grid, with pressures on the contact, was found to keep the loads in "
            "equilibrium"
            + (f": take two cells or more along {', '.join(single)}" if single else "")
        )

    def _missing(self, subspace: "_Subspace", s: Array, empty: Mask, other_energy: float) -> Mask:
        """Facets without pressure on which a pressure would lower the energy noticeably."""
        slope = np.where(empty, subspace.slope(self.matrix @ s - self.work), 0.0)
        missing = slope > 0.0
        gain = 0.5 * float((slope**2 / self.matrix.diagonal())[missing].sum())
        if gain <= self.options.worth_pressing * (other_energy + self.energy(s)):
            missing[:] = False
        return missing

    def _descended(self, subspace: "_Subspace", s: Array, other_energy: float) -> tuple[Array, int]:
        """Minimise the energy by conjugate gradients over stresses in equilibrium."""
        gradient, z = subspace.projected(self.matrix @ s - self.work)
        direction, square = -z, float(gradient @ z)
        energy, first, step, options = self.energy(s), square, 0, self.options
        gains: list[float] = []
        while step < options.most_steps and square > options.rounded * first:
            moved = self.matrix @ direction
            length = square / float(direction @ moved)
            s = s + length * direction
            step += 1
            gains.append(0.5 * length * square)
            energy -= gains[-1]
            last = sum(gains[-options.look_back :])
            if step >= options.look_back and last <= options.worth * (other_energy + energy):
                break
            gradient, z = subspace.projected(gradient + length * moved)
            before, square = square, float(gradient @ z)
            direction = square / before * direction - z
        return s, step

    def _stresses(self, subspace: "_Subspace", s: Array, steps: int) -> AdmissibleStress:
        pressure = np.where(self.contact, self._load - s, 0.0)
        faces = [
            pressure[self.space.rows_on_face(number // 2, number)]
            for number in range(2 * self.space.dimension)
        ]
        if subspace.residual(s) > BALANCED:
            raise NoAdmissibleStressError("equilibrium was not reached")
        change = subspace.balanced(s, 1) - s
        slip = max(float(change @ (self.matrix @ change)), 0.0) ** 0.5
        return AdmissibleStress(
            self.space.stress(s), self.energy(s), faces, subspace.residual(s), slip, steps
        )


class _Subspace:
    """B s = -f with some values free: projections onto it, by the diagonal of the energy."""

    def __init__(self, stresses: AdmissibleStresses, free: Mask) -> None:
        self._B, self._divergence, self._free = stresses.space.divergence, stresses.divergence, free
        self._options = options = stresses.options
        self._inverse = np.where(free, 1.0 / stresses.matrix.diagonal(), 0.0)
        self._S = sparse.csr_matrix(self._B @ sparse.diags(self._inverse) @ self._B.T)
        self._preconditioner: Callable[[Array], Array]
        if len(self._divergence) <= options.direct[stresses.space.dimension - 2]:
            diagonal = self._S.diagonal()
            shift = options.shift * np.where(diagonal > 0.0, diagonal, diagonal.max(initial=1e-300))
            factor = CholeskyFactor(self._S + sparse.diags(shift))
            self._preconditioner = lambda right: factor.solve(right[:, None])[:, 0]
        else:
            self._preconditioner = EquilibriumPreconditioner(stresses.space, self._inverse)

    def balanced(self, s: Array, most: int | None = None) -> Array:
        """The nearest stress in equilibrium, by at most the given number of projections."""
        missing = self._divergence - self._B @ s
        for _ in range(most or self._options.balancings):
            better = s + self._inverse * (self._B.T @ self._solved(missing))
            left = self._divergence - self._B @ better
            if np.linalg.norm(left) >= 0.5 * np.linalg.norm(missing):
                break
            s, missing = better, left
        return s

    def slope(self, gradient: Array) -> Array:
        """The part of a gradient that keeps equilibrium, known values included."""
        y = self._solved(self._B @ (self._inverse * gradient))
        return np.asarray(gradient - self._B.T @ y)

    def projected(self, gradient: Array) -> tuple[Array, Array]:
        """The part of a gradient that keeps equilibrium, and the steepest descent that keeps it.

        Iterations continue with that part, since the rest would only add rounding errors.
        """
        left = np.where(self._free, self.slope(gradient), 0.0)
        return left, self._inverse * left

    def residual(self, s: Array) -> float:
        """Largest component of B s + f, relative to the largest sum of its terms' magnitudes."""
        left = float(np.abs(self._divergence - self._B @ s).max())
        scale = float((np.abs(self._divergence) + abs(self._B) @ np.abs(s)).max())
        return left / scale if scale > 0.0 else 0.0

    def _solved(self, right: Array) -> Array:
        """Solve B diag⁻¹ Bᵀ y = right to a small relative residual."""
        limits = self._options.solved, self._options.most_iterations
        return conjugate_gradients(self._S.__matmul__, self._preconditioner, right, *limits)
