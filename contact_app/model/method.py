"""The choice of `solver.method: auto`, and the requirements of a method on the model.

The rules are based on measured CPU seconds of whole runs at 1e-8 on one rank (`contact-app bench
parts` on the parts of `meshes/samples/make_trials.py`; tables are in docs/benchmarks/speed.md).
Bodies are from mesh files, of both degrees:

=================================  ==================================  ============================
bodies                             seconds by multigrid over those by  operator applications by
                                   Total FETI                          multigrid, by Total FETI
=================================  ==================================  ============================
one thick, 10,000 unknowns and     0.2 to 1.05                         hardly grow with the mesh
more
one thick, 5,000 to 10,000         0.14 to 1.25, in the median 0.9     50, 910 on three bumps
one thin, 20,000 and more          0.5 to 1.2                          up to 254, 55 to over 800
one thin, 10,000 to 20,000         0.4 to 1.4, in the median 0.7       12 to 553, 14 to 738
one thin, 5,000 to 10,000          0.4 to 3.9, in the median 1.0       up to 937
several, 7,000 to 176,000          0.26 to 1.2, once 1.5               13 to 102, 19 to 797
nearly incompressible              0.19 to 0.61                        up to 1,118 by Total FETI
friction, one thick                0.34 to 1.19                        up to 1,413 by Total FETI
friction, several                  0.2 to 1.03                         28 to 87, 34 to 2,265
friction, thin                     0.19 to 0.8                         26 to 127, 135 to 1,098
friction, one thin in the plane    0.3 to 1.6, once 2.2                8, 344 on a rod
friction, histories                0.4 to 0.95, once 1.3               0.28 to 1.0 of Total FETI's
ties without contact, thin, plane  0.3 to 1.0                          3 to 29, 106 to 3,418
=================================  ==================================  ============================

Boxes take a fifth to a half by Total FETI, whose subdomains share their factors. Small thin bodies
begin with Total FETI, with a limit on its iterations (`patience`), and continue with multigrid.
With friction they are no exception as long as V-cycles solve on the many sets: a factor for each
takes up to 2.9 times the seconds of Total FETI. In the plane a body is thin by its area, so that a
curved strip is. Bodies that ties join to one piece count as one. Total FETI left a part, an
increment of three of five histories, and two strips without a certificate.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from contact_app.scene.bodies import Body
from contact_app.scene.conditions import Tie
from contact_app.scene.scene import Scene
from meshes.connected import connected
from solver.contact.options import SolverOptions
from solver.primal.factor import FactorOptions
from solver.tfeti.constraints.options import TotalFetiOptions


@dataclass(frozen=True)
class MethodLimits:
    """Limits of the rules."""

    least: int = 5_000
    least_thin: int = 10_000
    """Unknowns from which on multigrid is used, and those where one body is thin. With friction it
    is used for all."""
    thin: float = FactorOptions().thin
    """Longest over shortest extent of a thin body."""
    largest_thin: Mapping[int, int] = field(default_factory=lambda: {2: 500_000, 3: 60_000})
    """Unknowns up to which factors of thin scenes are inexpensive, by dimension."""
    patience: int = 300
    patience_unknowns: int = 25_000
    """Iterations of Total FETI on a thin scene after which the undecomposed problem is solved, and
    unknowns in space up to which these cost about as much as the sets of the other method. With
    more unknowns a factor costs as much as more iterations: 250 on 22,000 unknowns, 600 on 86,000,
    890 on 48,000 of a disc. Thin trial parts take 55 to 282; if contact peels off row by row,
    hundreds more change little."""
    patience_in_plane: int = 200
    """The same in the plane, where factors are cheap: an iteration takes up to two operator
    applications, and a strip 500 times as long as thick with a lifted end takes 34 by the other
    method. In all it takes some 500 applications then, with 300 iterations some 680."""
    patience_of_multigrid: int = 600
    """Iterations of multigrid without friction after which Total FETI is tried. The slowest trial
    part takes 254; a thin one on which a factor costs too much takes 364."""
    patience_with_friction: int = 1000
    """Iterations of Total FETI with friction after which multigrid is tried. Parts take 18 to 540.
    Where bodies stand in several frictional contacts at once, conjugate gradients may take
    thousands on a set: `three_bodies.yaml` with Tresca friction of 3 takes 7,520, multigrid 57."""


LIMITS = MethodLimits()


def with_chosen_method(scene: Scene) -> Scene:
    """The scene with `method: primal` if `auto` chooses multigrid."""
    if not MethodChoice.of(scene).takes_multigrid:
        return scene
    return scene.solved_by(method="primal")


@dataclass(frozen=True)
class MethodChoice:
    """The properties of a scene on which the choice of its method depends."""

    bodies: Sequence[Body]
    ties: Sequence[Tie]
    """Elastic bodies, and the tied pairs of them."""
    automatic: bool
    decomposed: bool
    """Whether the scene names no method, and whether it names its decomposition."""
    touches: bool
    rubs: bool
    """Whether there are contacts, and contacts with friction."""

    @classmethod
    def of(cls, scene: Scene) -> "MethodChoice":
        """The properties of a scene."""
        decomposed = scene.decomposition.subdomains is not None
        automatic = scene.solver.method == "auto"
        touches, rubs = bool(scene.touching), scene.has_friction
        return cls(scene.bodies, scene.ties, automatic, decomposed, touches, rubs)

    @property
    def free(self) -> bool:
        """Whether the scene names neither a method nor a decomposition."""
        return self.automatic and not self.decomposed

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.bodies[0].mesh.dimension

    @property
    def unknowns(self) -> int:
        """Displacement components at the nodes of all bodies."""
        return self.dimension * sum(body.nodes for body in self.bodies)

    @property
    def takes_multigrid(self) -> bool:
        """Whether `auto` chooses multigrid.

        It does so if all bodies come from mesh files, in space, with friction or enough unknowns
        for its levels to save time, and if the scene names no other method or decomposition. In the
        plane one thin body with friction has multigrid, as have thin tied bodies without contact.
        """
        if not self.free or self._is_thin_in_plane():
            return self.free
        if self.dimension == 2 or any(body.mesh.congruent for body in self.bodies):
            return False
        least = LIMITS.least_thin if self._has_thin_body() else LIMITS.least
        return self.rubs or self.unknowns >= least

    @property
    def may_peel(self) -> bool:
        """Whether contact may peel off row by row, as on thin bodies.

        With friction contact hardly peels off; Total FETI has no limit there.
        """
        small = self.unknowns <= LIMITS.largest_thin[self.dimension]
        smooth = self.touches and not self.rubs
        return self.free and smooth and small and self._has_thin_body()

    @property
    def may_jump(self) -> bool:
        """Whether active sets may move loose bodies back and forth, and multigrid can follow.

        Bodies that only contact holds may roll or slide far on a set that constrains them weakly.
        """
        return self.free and self.touches and not self.rubs and not self._is_one_piece()

    @property
    def may_stall(self) -> bool:
        """Whether Total FETI may stall with friction, and multigrid can follow.

        It may in named subdomains, too: a block between three rough planes takes 10,364 operator
        applications in one, and 23 by multigrid.
        """
        return self.automatic and self.rubs

    @property
    def why_total_feti(self) -> str:
        """The reason why `auto` solves a scene by Total FETI, for the report of `check`."""
        if self.decomposed:
            return "the scene names its decomposition"
        if any(body.mesh.congruent for body in self.bodies):
            return "congruent subdomains of boxes share a factor"
        if self.dimension == 2:
            return "in the plane subdomains have cheap factors"
        return "multigrid does not pay on so few unknowns"

    def _is_thin_in_plane(self) -> bool:
        """Whether one thin body in the plane has friction, or tied ones have no contact.

        Thin bodies may be straight or curved.
        """
        small = self.dimension == 2 and self.unknowns <= LIMITS.largest_thin[2]
        rubs = len(self.bodies) == 1 and self.rubs
        linear = bool(self.ties) and not self.touches
        if not small or not (rubs or linear):
            return False
        meshes = [body.mesh for body in self.bodies]
        return any(max(np.subtract(m.upper, m.lower)) ** 2 >= LIMITS.thin * m.size for m in meshes)

    def _is_one_piece(self) -> bool:
        """Whether there is one body, or ties join all bodies, directly or through others."""
        ends = np.array([(tie.body, tie.other) for tie in self.ties], np.int64).reshape(-1, 2)
        return not connected(ends.T, len(self.bodies)).any()

    def _has_thin_body(self) -> bool:
        extents = [np.subtract(body.mesh.upper, body.mesh.lower) for body in self.bodies]
        return any(bool(e.max() >= LIMITS.thin * e.min()) for e in extents)


def patience(bodies: Sequence[Body]) -> int:
    """Iterations of Total FETI after which a scene that may peel off is solved by multigrid."""
    dimension = bodies[0].mesh.dimension
    if dimension == 2:
        return LIMITS.patience_in_plane
    unknowns = dimension * sum(body.nodes for body in bodies)
    return round(LIMITS.patience * math.sqrt(max(1.0, unknowns / LIMITS.patience_unknowns)))


def is_undecomposed(solver: SolverOptions) -> bool:
    """Whether the scene is solved for the displacements of undecomposed bodies."""
    return solver.method == "primal"


def feti_options(solver: SolverOptions) -> TotalFetiOptions | None:
    """Whether subdomains are factored; None for the defaults."""
    return TotalFetiOptions(factored=False) if is_undecomposed(solver) else None
