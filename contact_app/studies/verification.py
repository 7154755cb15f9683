"""Contact problems with known solutions, as convergence studies: ``contact-app verify``.

Each case is a commented scene of ``configs/``, solved on a series of meshes, with numbers of the
solution compared with those of the theory. The numbers (`verification_measures`) are:

* Hertz (ball, cylinder, two cylinders): the squares of the theory's pressures lie on a line over
  r², p² = p0² (1 - r²/a²). It is fitted to all nodes with pressure; half-width a and peak p0 follow
  from it. The largest nodal pressure, without a fit, is compared as well.
* Flat punch: the pressure is singular at the punch's edge, so it is compared on the inner half of
  the punch, |x| ≤ a/2, as the root mean square of p √(a² - x²) π/P - 1. P is the computed force.
  The block is 16 half-widths wide and high instead of infinite, which is part of the error.
* Press fit: mean pressure over the nodes of the rim that touch.
* Interference fit and shrink fit: resultant on the quarter over its radius, and the largest nodal
  pressure.
* Thick ring: the errors in L2 of displacement and stress, relative to the exact fields, and the
  mean and largest pressure over the nodes of the outer side.
* Hertz with degree 2: beside the fit the largest error of the pressure within 0.8 a of the middle,
  relative to the peak: 1 + that error.
* Tied cantilever: displacement of the middle of its end, and the strain energy.
* Rigid ball: the fit as for Hertz, on a quarter of the block; its approach beside that
  of a layer as deep.
* Confined column: resultant on the wall against which it is pressed.
* Rod on a rough floor: mean displacement of its end, and the distance of the farthest slipping node
  from there.
* Plate on a rough plane: displacements of five points; the numbers beside them are published means
  of several programs instead of a theory.
* Load histories: `contact_app.studies.history_cases`; the block on an incline:
  `contact_app.studies.incline`; Mindlin's contact in space: `contact_app.studies.mindlin`; a belt
  and a turned ring that slide everywhere: `contact_app.studies.round_friction`.

Meshes of round bodies are coarse meshes drawn in Gmsh (``meshes/samples/coarse``). Every edge is
halved until cells have the given size, and new nodes are moved onto the circle or ball
(`refine_on_sphere`).

Sources: H. Hertz (1882); K. L. Johnson, *Contact Mechanics* (1985), chapters 2 and 4; S. P.
Timoshenko, J. N. Goodier, *Theory of Elasticity* (1970), section 28.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError
from contact_app.run.increments import SolvedIncrement, solved_increments
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene
from contact_app.studies.hertz import Quantity, hertz_quantities
from contact_app.studies.history_cases import cattaneo, graded_block, rod_cycle
from contact_app.studies.incline import incline
from contact_app.studies.mindlin import graded_half_block, mindlin
from contact_app.studies.refine_on_sphere import refined_round
from contact_app.studies.round_friction import (
    BELT,
    TURNED_RING,
    belt,
    turned_ring,
    write_belt,
    write_ring,
)
from contact_app.studies.verification_measures import (
    cantilever,
    column,
    fit,
    hertz_profile,
    press_fit,
    punch,
    rigid_ball,
    ring,
    roller,
    rough_plate,
    rough_rod,
    rough_roller,
    round_fit,
)
from meshes import CellMesh

ROOT = Path(__file__).parents[2]
EXACT = 1e-7
"""Relative error below which a rate has no meaning."""


@dataclass(frozen=True)
class Level:
    """One mesh of a study: overrides of the scene, or size of cells and shape of edges."""

    label: str
    overrides: tuple[str, ...] = ()
    size: float | None = None
    curved: bool = False


@dataclass(frozen=True)
class Case:
    """A scene with a known solution."""

    name: str
    """Name of the case, and of its scene in ``configs/`` unless `scene` is given."""
    title: str
    """Title of its section in docs/benchmarks/verification.md, which tells the numbers of the
    theory."""
    measure: Callable[[SolvedScene], list[Quantity]] | None
    """Function that returns numbers of a solution with those of the theory."""
    levels: tuple[Level, ...]
    """Meshes, the coarsest first."""
    sample: str | None = None
    """Mesh of `COARSE` that is refined for levels with a size."""
    bodies: tuple[int, ...] = (0,)
    """Numbers of the bodies that have this mesh."""
    scene: str | None = None
    history: Callable[[Sequence[SolvedIncrement]], list[Quantity]] | None = None
    """Function like `measure` of all increments of a load history."""
    graded: Callable[[Path, int], Path] | None = None
    """Function that writes the mesh of the first body, for levels with a number of cells instead of
    a sample."""

    @property
    def config(self) -> str:
        """Name of the scene."""
        return self.scene or self.name


@dataclass(frozen=True)
class Row:
    """Results on one mesh."""

    case: str
    level: str
    dimension: int
    dofs: int
    seconds: float
    equilibrium: float
    certified: bool
    quantities: tuple[Quantity, ...]


def _sizes(
    *sizes: float, curved: bool = False, overrides: tuple[str, ...] = ()
) -> tuple[Level, ...]:
    return tuple(Level(f"size {size:g}", overrides, size, curved) for size in sizes)


def _boxes(*counts: Sequence[int]) -> tuple[Level, ...]:
    return tuple(
        Level(" × ".join(map(str, c)), (f"bodies.0.mesh.box.cells=[{','.join(map(str, c))}]",))
        for c in counts
    )


def _tied(*fine: int) -> tuple[Level, ...]:
    """Two parts; the numbers of their cells at the cut have the ratio 2 to 3."""
    return tuple(
        Level(
            f"{12 * n} × {2 * n} and {12 * n} × {3 * n}",
            (f"bodies.0.mesh.box.cells=[{12 * n},{2 * n}]",
             f"bodies.1.mesh.box.cells=[{12 * n},{3 * n}]"),
        )
        for n in fine
    )  # fmt: skip


def _quarters(*counts: int) -> tuple[Level, ...]:
    """A quarter of a block under a ball, 20 long, and a quarter of the force."""
    quarter = (
        "bodies.0.mesh.box.lower=[0,0,-20]", "bodies.0.mesh.box.upper=[20,20,0]",
        "conditions.2.total_force=[0,0,-375]",
        "conditions.3={on: block.x-, displacement: [0, null, null]}",
        "conditions.4={on: block.y-, displacement: [null, 0, null]}",
    )  # fmt: skip
    return tuple(
        Level(f"{n} × {n} × {n}", (*quarter, f"bodies.0.mesh.box.cells=[{n},{n},{n}]"))
        for n in counts
    )


COARSE = {
    "disc_quarter": {4.0: "coarse/disc_quarter.msh"},
    "ring_quarter": {1.0: "coarse/ring_quarter.msh"},
    "roller_on_block": {4.0: "coarse/roller_on_block.msh"},
    "shaft_and_hub": {1.0: "coarse/shaft_and_hub.msh"},
    "sphere_eighth": {2.8: "coarse/sphere_eighth.msh", 2.0: "sphere_eighth.msh"},
}
"""Coarse meshes of each sample in ``meshes/samples``, by the size of cells in ``make.py``."""

ROUND = {
    "disc_quarter": (("rim",),),
    "ring_quarter": (("inner", "outer"),),
    "roller_on_block": (("face",), ()),
    "shaft_and_hub": (("skin",), ("bore", "outside")),
    "sphere_eighth": (("sphere",),),
}
"""Parts of the surface of each body of a sample that lie on a circle or ball."""

ROUGH = (
    "contacts.0.friction={coulomb: 0.1}",
    "conditions.3.name=press",
    "steps=[{press: 1, increments: 4}]",
)
"""The roller on the block with friction, as a load history."""

CASES = (
    Case(
        "hertz_sphere", "Hertz: a ball on a rigid plane",
        hertz_quantities, _sizes(2.8, 2.0, 1.4, 1.0, 0.7), "sphere_eighth",
    ),
    Case(
        "hertz_disc", "Hertz: a cylinder on a rigid plane",
        hertz_quantities, _sizes(4.0, 2.0, 1.0, 0.5), "disc_quarter",
    ),
    Case(
        "roller_on_block", "Hertz: two elastic bodies, a roller on a block",
        roller, _sizes(4.0, 2.0, 1.0, 0.5), "roller_on_block", (0, 1),
    ),
    Case(
        "roller_with_friction", "NAFEMS R0094: the roller on the block with friction",
        None, _sizes(4.0, 2.0, 1.0, 0.5, overrides=ROUGH), "roller_on_block", (0, 1),
        scene="roller_on_block", history=rough_roller,
    ),
    Case(
        "roller_on_steel", "NAFEMS R0094 with a block of steel",
        None, _sizes(4.0, 2.0, 1.0, 0.5, overrides=(*ROUGH, "bodies.1.material.young=2.1e5")),
        "roller_on_block", (0, 1), scene="roller_on_block", history=rough_roller,
    ),
    Case(
        "flat_punch", "A rigid flat punch on a half plane",
        punch, _boxes((64, 64), (128, 128), (256, 256)),
    ),
    Case(
        "press_fit", "A cylinder pressed into a rigid hole",
        press_fit, _sizes(4.0, 2.0, 1.0, 0.5), "disc_quarter",
    ),
    Case(
        "interference_fit", "A shaft in a hub, by interference",
        fit, _sizes(1.0, 0.5, 0.25, curved=True), "shaft_and_hub", (0, 1),
    ),
    Case(
        "shrink_fit", "A hub shrunk onto a shaft",
        fit, _sizes(1.0, 0.5, 0.25, curved=True), "shaft_and_hub", (0, 1),
    ),
    Case(
        "round_facets", "A shaft in a hub, by interference, with straight edges",
        round_fit, _sizes(1.0, 0.5, 0.25, 0.125), "shaft_and_hub", (0, 1),
    ),
    Case(
        "tied_cantilever", "A cantilever cut in two and tied, in pure bending",
        cantilever, _tied(1, 2, 4, 8),
    ),
    Case(
        "rigid_ball", "Hertz: a rigid ball pressed into a block by a force",
        rigid_ball, _quarters(16, 24, 32),
    ),
    Case(
        "thick_ring", "A thick ring in a rigid bore: degree 2 with round edges",
        ring, _sizes(1.0, 0.5, 0.25, 0.125, curved=True), "ring_quarter",
    ),
    Case(
        "thick_ring_straight", "The same ring of degree 2 with straight edges",
        ring, _sizes(1.0, 0.5, 0.25, 0.125), "ring_quarter", scene="thick_ring",
    ),
    Case(
        "hertz_disc_degree_2", "Hertz: a cylinder on a plane, degree 2 with round edges",
        hertz_profile, _sizes(4.0, 2.0, 1.0, 0.5, curved=True, overrides=("bodies.0.degree=2",)),
        "disc_quarter", scene="hertz_disc",
    ),
    Case(
        "hertz_disc_degree_2_straight",
        "Hertz: a cylinder on a plane, degree 2 with straight edges",
        hertz_profile, _sizes(4.0, 2.0, 1.0, 0.5, overrides=("bodies.0.degree=2",)),
        "disc_quarter", scene="hertz_disc",
    ),
    Case(
        "hertz_sphere_degree_2", "Hertz: a ball on a plane, degree 2 with round edges",
        hertz_profile, _sizes(2.8, 2.0, 1.4, curved=True, overrides=("bodies.0.degree=2",)),
        "sphere_eighth", scene="hertz_sphere",
    ),
    Case(
        "confined_column", "A laterally confined, nearly incompressible column",
        column, _boxes((1, 1, 2), (2, 2, 4), (4, 4, 8)),
    ),
    Case(
        "rough_rod", "A thin rod on a rough floor, pulled at its end",
        rough_rod, _boxes((50, 1), (100, 1), (200, 2), (400, 4)),
    ),
    Case(
        "plate_on_rough_plane", "SSNV128: a plate pressed and pushed on a rough plane",
        rough_plate, _boxes((32, 32), (64, 64), (128, 128)),
    ),
    Case(
        "incline", "A block on an incline, pushed up it",
        None, _boxes((4, 1), (16, 4), (64, 16)), history=incline,
    ),
    Case(
        "rod_cycle", "The rod pulled, released, pushed and pulled again",
        None, _boxes((50, 1), (100, 1), (200, 2)), history=rod_cycle,
    ),
    Case(
        "belt", "Euler and Eytelwein: a belt slides around a drum",
        belt, tuple(Level(f"{n} cells along it", BELT, n) for n in (20, 40, 80, 160)),
        scene="thick_ring", graded=write_belt,
    ),
    Case(
        "turned_ring", "A ring pressed on a plate and turned",
        turned_ring, tuple(Level(f"{n} cells across its wall", TURNED_RING, n) for n in (2, 4)),
        scene="rigid_plate", graded=write_ring,
    ),
    Case(
        "cattaneo", "Cattaneo and Mindlin: pressed, pushed and let go",
        None, tuple(Level(f"{n} cells over a", size=n) for n in (10, 20, 40)),
        history=cattaneo, graded=graded_block,
    ),
    Case(
        "mindlin", "Mindlin in space: a block pressed against a ball and pushed",
        None, tuple(Level(f"{n} cells over a", size=n) for n in (3, 4, 6)),
        history=mindlin, graded=graded_half_block,
    ),
)  # fmt: skip


def find(names: Sequence[str]) -> list[Case]:
    """Cases by name; all cases without names.

    Raises
    ------
    ConfigurationError
        A name is not one of them.
    """
    cases = {case.name: case for case in CASES}
    for name in names:
        if name not in cases:
            raise ConfigurationError(f"no case {name!r}; known are {', '.join(cases)}")
    return [cases[name] for name in names] if names else list(CASES)


def study(case: Case, levels: Sequence[Level] | None = None) -> Iterator[Row]:
    """Solve a case on its meshes or on some of them; yield one row for each."""
    for level in case.levels if levels is None else levels:
        overrides = list(level.overrides)
        if level.size is not None and case.sample:
            file, times = coarse_mesh(case.sample, level.size)
            overrides += [f"bodies.{body}.mesh.file={file}" for body in case.bodies]
        config = ROOT / "configs" / f"{case.config}.yaml"
        if level.size is not None and case.graded is not None:
            with TemporaryDirectory() as directory:
                file = case.graded(Path(directory) / "graded.vtu", round(level.size))
                scene = build_scene(load(config, [*overrides, f"bodies.0.mesh.file={file}"]))
        else:
            scene = build_scene(load(config, overrides))
        if level.size is not None and case.sample:
            scene = _refined(scene, case, times, level.curved)
        solved, quantities = _measured(case, scene)
        summary: dict[str, Any] = solved.summary
        yield Row(
            case.name,
            level.label,
            scene.dimension,
            summary["mesh"]["dofs"],
            summary["timings"]["total"],
            summary["certificate"]["equilibrium"],
            summary["certificate"]["passed"],
            tuple(quantities),
        )


def _measured(case: Case, scene: Scene) -> tuple[SolvedScene, list[Quantity]]:
    """The solution of a scene (of a load history the last one) and its measured numbers."""
    if case.history is not None:
        increments = list(solved_increments(scene, MPI.COMM_SELF, lambda place: None))
        return increments[-1].solved, case.history(increments)
    assert case.measure is not None
    solved = solve_scene(scene, MPI.COMM_SELF)
    return solved, case.measure(solved)


def coarse_mesh(sample: str, size: float) -> tuple[Path, int]:
    """The coarse mesh of a sample, and the number of halvings that leads to a size of cells.

    Raises
    ------
    ConfigurationError
        No coarse mesh leads to this size.
    """
    for name, file in COARSE[sample].items():
        times = round(np.log2(name / size))
        if times >= 0 and name / 2**times == size:
            return ROOT / "meshes" / "samples" / file, times
    raise ConfigurationError(f"no coarse mesh {sample} gives cells of size {size:g} when halved")


def _refined(scene: Scene, case: Case, times: int, curved: bool) -> Scene:
    """The scene with the meshes of a case refined."""
    bodies = list(scene.bodies)
    for number, sides in zip(case.bodies, ROUND[case.sample or ""], strict=True):
        body = bodies[number]
        assert isinstance(body.mesh, CellMesh)
        mesh = refined_round(body.mesh, times, sides, curved)
        bodies[number] = replace(body, mesh=mesh)
    return replace(scene, bodies=tuple(bodies))


def rate(rows: Sequence[Row], number: int) -> float | None:
    """Order in the cell size h ~ dofs^(-1/dimension), by least squares over all meshes.

    None if the solution is exact on some mesh or there is only one mesh.
    """
    errors = np.array([abs(row.quantities[number].error) for row in rows])
    if len(rows) < 2 or errors.min() < EXACT:
        return None
    sizes = np.array([row.dofs for row in rows], dtype=float) ** (-1.0 / rows[0].dimension)
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
