"""The choice of `solver.method: auto`, and the requirements of a method on the model.

The rule is based on CPU seconds of whole runs at 1e-8 on one rank
(`contact-app bench parts` on the parts of `meshes/samples/make_trials.py`; the table is in
docs/benchmarks/speed.md). One body from a mesh file:

- Thick bodies of 10,000 unknowns or more take 0.2 to 1.05 of the seconds of Total FETI by
  multigrid, in both degrees. Its iterations hardly grow with the mesh. Between 5,000 and 10,000
  unknowns it is 0.14 to 1.25 (1.7 on a graded block with three contact rows): the median is 0.9,
  and a bracket on three bumps takes 50 operator applications where Total FETI takes 910.
- Thin bodies of 20,000 unknowns or more take 0.5 to 1.2 of the seconds of Total FETI by multigrid,
  in both degrees. Between 11,000 and 16,000 unknowns it is 0.5 to 1.4, and up to 2.5 for bodies of
  degree 2 that Total FETI need not cut (0.8 s in place of 0.3). Total FETI takes 55 to 282 operator
  applications on the thin trial parts, and more than 800 if contact peels off row by row. So small
  thin bodies begin with Total FETI, with a limit on its iterations (`patience`), and continue with
  multigrid.

Several bodies from mesh files: multigrid takes 0.54 to 1.16 of the seconds of Total FETI (27,000 to
176,000 unknowns, both degrees), least where many sets are needed. On 20 scenes without thin bodies
(10,000 to 37,000 unknowns, both degrees; the four of `configs/`, a hinge, a key, a dovetail, a
clamp, crossed bars, a taper lock, a cardan joint, an elastomer between plates) it takes 0.26 to
1.10 of the CPU seconds, in the median 0.78, and 13 to 102 operator applications in place of 19 to
797. Between 7,000 and 9,000 unknowns five pairs take 0.76 to 1.2, a bearing cap on its housing 1.5
(0.6 s in place of 0.4). Two thin plates (40,000 and 46,000 unknowns, degrees 1 and 2) take 1.2 and
1.05, and 0.55 and 0.33 if contact alone holds the upper one. Boxes take a fifth to a half by Total
FETI, whose subdomains share their factors.

Nearly incompressible material counts as any other. One body of rubber alone or with steel (21,000
to 34,000 unknowns, Poisson's ratios 0.49 to 0.4999, moduli up to 10⁴ apart, both degrees) takes
0.19 to 0.61 of the CPU seconds of Total FETI, which takes up to 1,118 operator applications; a
rubber flange on a steel one (50,031 unknowns) a third.

Bodies that ties join to one piece behave as one body: a cantilever, two blocks and a bracket, each
cut in two (17,000 to 227,000 unknowns), take 44 to 55 microseconds of CPU time an unknown by
multigrid at degree 1 and 33 to 40 at degree 2, and 53 to 59 and 84 to 93 by Total FETI.

With friction (`make_trials.py --friction 0.3`) multigrid takes 0.34 to 1.19 of the CPU seconds of
Total FETI on one thick body of 10,000 unknowns or more, where Total FETI takes up to 1,413
applications and left one part uncertified. On several bodies from mesh files it takes 0.2 to 1.03
of the CPU seconds (the four pairs of `meshes/samples/make_parts.py` and five other parts; 10,000 to
101,000 unknowns, both degrees), and 28 to 87 operator applications in place of 34 to 2,265. Thin
bodies are no exception as long as V-cycles solve on the many sets and not a factor each, which
takes up to 2.9 times the seconds of Total FETI. With V-cycles a leaf spring, a pressed plate and a
beam on rollers take 0.19 to 0.8 of them, and 26 to 127 operator applications in place of 135 to
1,002; a lifted plate takes 13 s and 1,218, where Total FETI has no answer after 32 s. A lap joint,
a clutch and three plates 30 times as wide as thick (13,000 to 41,000 unknowns, both degrees) take
0.27 to 0.75 of the seconds, and 42 to 125 applications in place of 167 to 1,098. Small scenes take
less, too: histories of a split clamp, a wheel on a rail and a bar in a V-groove (774 to 6,315
unknowns) 0.47 to 0.86 of the seconds and 114 to 273 applications in place of 341 to 2,348, and
`mindlin.yaml` 24 in place of 345.

One thin body in the plane has an inexpensive factor: on 54 random strips 20 to 300 times as long as
thick, with both laws and degrees, multigrid takes 0.3 to 1.6 of the CPU seconds of Total FETI (once
2.2), and certifies two answers that Total FETI does not. It takes 8 operator applications for 344
on `rough_rod.yaml`.

A body counts as thin there by its area, so that a curved strip does: a strap over a cylinder takes
44 to 172 operator applications for 1,024 to 1,202.

Tied bodies without any contact, thin and in the plane, have one linear problem, and the rows of the
tie are ill-conditioned in the dual one. On bimetal strips and rings (2,400 to 36,000 unknowns, both
degrees, boxes and files) multigrid takes 3 to 29 operator applications in 0.3 to 1.0 of the CPU
seconds of Total FETI, which takes 106 to 3,418. With contact each takes fewer seconds on some.

Increments of a history share the matrices of multigrid as they do the factors of Total FETI, so
that a history is solved as a single load is. On parts that are loaded, unloaded and loaded again in
15 to 18 increments with Coulomb friction (pillow block, hub on a shaft, pin in a lug, wrench on a
nut, tenon; 7,000 to 35,000 unknowns) multigrid takes 0.45 to 0.95 of the CPU seconds of Total FETI
and 0.28 to 1.0 of its operator applications; Total FETI left the first increment of three of the
five without a certificate. On 12 random strips in the plane (20 to 300 times as long as thick, both
laws and degrees) that slide to and fro it takes 0.4 to 0.85 of the CPU seconds, once 1.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from contact_app.scene.bodies import Body
from contact_app.scene.conditions import Tie
from contact_app.scene.scene import Scene
from meshes.connected import connected
from solver.contact.options import SolverOptions
from solver.primal.factor import THIN
from solver.tfeti.options import TotalFetiOptions

LEAST, LEAST_THIN = 5_000, 20_000
"""Unknowns of bodies from mesh files from which on multigrid is used, and those where one body is
thin. With friction it is used for all."""

LARGEST_THIN = {2: 500_000, 3: 60_000}
"""Unknowns up to which factors of thin scenes are inexpensive, by dimension."""

PATIENCE, PATIENCE_UNKNOWNS = 300, 25_000
"""Iterations of Total FETI on a thin scene after which the undecomposed problem is solved, and
unknowns in space up to which these iterations cost about as much as the sets of the other method.
With more unknowns a factor costs as much as more iterations: 250 on 22,000 unknowns, 600 on 86,000,
890 on 48,000 of a disc. Thin trial parts take 55 to 282; if contact peels off row by row, hundreds
more change little."""

PATIENCE_IN_PLANE = 200
"""`PATIENCE` in the plane, where factors are cheap: an iteration takes up to two operator
applications, and a strip 500 times as long as thick with a lifted end takes 34 by the other method.
In all it takes some 500 applications then, with 300 iterations some 680."""

PATIENCE_OF_MULTIGRID = 600
"""Iterations of multigrid without friction after which Total FETI is tried. The slowest trial part
takes 254; a thin one on which a factor costs too much takes 364."""

PATIENCE_WITH_FRICTION = 1000
"""Iterations of Total FETI with friction after which multigrid is tried. Parts with Tresca's or
Coulomb's law take 18 to 540. Where bodies stand in several frictional contacts at once, conjugate
gradients may take thousands on a set: `three_bodies.yaml` with Tresca friction of 3 takes 7,520,
multigrid 57."""


def with_chosen_method(scene: Scene) -> Scene:
    """The scene with `method: primal` if `auto` chooses multigrid."""
    if not MethodChoice.of(scene).takes_multigrid:
        return scene
    return scene.solved_by(method="primal")


@dataclass(frozen=True)
class MethodChoice:
    """The properties of a scene on which the choice of its method depends.

    Attributes
    ----------
    bodies, ties
        Elastic bodies, and the tied pairs of them.
    free
        Whether the scene names neither a method nor a decomposition.
    decomposed
        Whether the scene names its decomposition.
    touches, rubs
        Whether there are contacts, and contacts with friction.
    """

    bodies: Sequence[Body]
    ties: Sequence[Tie]
    free: bool
    decomposed: bool
    touches: bool
    rubs: bool

    @classmethod
    def of(cls, scene: Scene) -> MethodChoice:
        """The properties of a scene."""
        decomposed = scene.decomposition.subdomains is not None
        free = scene.solver.method == "auto" and not decomposed
        touches, rubs = bool(scene.touching), scene.has_friction
        return cls(scene.bodies, scene.ties, free, decomposed, touches, rubs)

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
        return self.rubs or self.unknowns >= (LEAST_THIN if self._has_thin_body() else LEAST)

    @property
    def may_peel(self) -> bool:
        """Whether contact may peel off row by row, as on thin bodies.

        With friction contact hardly peels off; Total FETI has no limit there.
        """
        small = self.unknowns <= LARGEST_THIN[self.dimension]
        smooth = self.touches and not self.rubs
        return self.free and smooth and small and self._has_thin_body()

    @property
    def may_jump(self) -> bool:
        """Whether active sets may move loose bodies back and forth, and multigrid can follow.

        Bodies that only contact holds may roll or slide far on a set that holds them badly.
        """
        return self.free and self.touches and not self.rubs and not self._is_one_piece()

    @property
    def may_stall(self) -> bool:
        """Whether conjugate gradients may stall with friction, and multigrid can follow."""
        return self.free and self.rubs

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
        small = self.dimension == 2 and self.unknowns <= LARGEST_THIN[2]
        rubs = len(self.bodies) == 1 and self.rubs
        linear = bool(self.ties) and not self.touches
        if not small or not (rubs or linear):
            return False
        meshes = [body.mesh for body in self.bodies]
        return any(max(np.subtract(m.upper, m.lower)) ** 2 >= THIN * m.size for m in meshes)

    def _is_one_piece(self) -> bool:
        """Whether there is one body, or ties join all bodies, directly or through others."""
        ends = np.array([(tie.body, tie.other) for tie in self.ties], np.int64).reshape(-1, 2)
        return not connected(ends.T, len(self.bodies)).any()

    def _has_thin_body(self) -> bool:
        extents = [np.subtract(body.mesh.upper, body.mesh.lower) for body in self.bodies]
        return any(bool(e.max() >= THIN * e.min()) for e in extents)


def patience(bodies: Sequence[Body]) -> int:
    """Iterations of Total FETI after which a scene that may peel off is solved by multigrid."""
    dimension = bodies[0].mesh.dimension
    if dimension == 2:
        return PATIENCE_IN_PLANE
    unknowns = dimension * sum(body.nodes for body in bodies)
    return round(PATIENCE * math.sqrt(max(1.0, unknowns / PATIENCE_UNKNOWNS)))


def is_undecomposed(solver: SolverOptions) -> bool:
    """Whether the scene is solved for the displacements of undecomposed bodies."""
    return solver.method == "primal"


def feti_options(solver: SolverOptions) -> TotalFetiOptions | None:
    """Whether subdomains are factored; None for the defaults."""
    return TotalFetiOptions(factored=False) if is_undecomposed(solver) else None
