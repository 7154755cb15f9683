"""Friction on undecomposed bodies against an independent method and against Total FETI."""

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.model.model import build_model
from contact_app.run.increments import solved_increments
from contact_app.run.solve import solve_scene
from solver.backend import SharedPlace, Statuses
from solver.contact.stopping import StoppingRule
from solver.primal.backend import Multigrid
from solver.primal.by_active_sets import solve_by_multigrid
from solver.primal.factor import FactorOptions
from solver.primal.first_set import find_first_set
from solver.primal.hierarchy import build_hierarchy
from solver.primal.matrices import Matrices
from solver.primal.merged import merge
from solver.primal.products import multiply
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from tests import scenes
from tests.comparison import solve
from tests.contact_app.run import test_friction
from tests.contact_app.run.test_friction import LAWS, on_a_slope, pair, rough
from tests.rows import covering
from tests.scenes import CONFIGS
from tests.stability.fuzz_friction import judge

CELLS = ("quadrilateral", "triangle", "hexahedron", "tetrahedron")


def check(made: scenes.Config) -> None:
    """Solve a scene by multigrid and compare it with the reference."""
    summary = test_friction.check(made, None, 1e-7, method="primal").summary
    assert summary["solver"]["method"] == "primal", summary["certificate"]["warnings"]


@pytest.mark.parametrize(
    ("law", "cell", "name"), covering(LAWS, CELLS, ["wall", "pushed", "hollow_sphere"]), ids=str
)
def test_obstacles(name: str, cell: str, law: dict[str, float]) -> None:
    n = 4 if scenes.dimension(cell) == 2 else 2
    check(rough(scenes.ALL[name](cell, n), law))


@pytest.mark.parametrize(
    ("law", "cell", "degree"),
    [(LAWS[0], "triangle", 2), (LAWS[1], "quadrilateral", 1), (LAWS[0], "tetrahedron", 1)],
    ids=str,
)
def test_pairs(cell: str, degree: int, law: dict[str, float]) -> None:
    check(pair(cell, law, degree))


@pytest.mark.parametrize("seed", range(2, 8))
def test_random_scenes(seed: int) -> None:
    assert judge(seed, "primal").kind == "agrees"


@pytest.mark.parametrize(("cell", "along"), [("quadrilateral", 0.0), ("tetrahedron", 0.2)])
def test_friction_alone_holds_a_block_on_a_slope(cell: str, along: float) -> None:
    solved = solve(on_a_slope(cell, {"coulomb": 0.4}, 0.3, along), method="primal")
    assert solved.summary["solver"]["method"] == "primal"
    force = np.array(solved.summary["contacts"][0]["force"])
    held = np.linalg.norm(force[: scenes.dimension(cell) - 1])
    assert held == pytest.approx(20.0 * 0.4 * np.sin(0.3), rel=1e-6)


MULTIGRID_ALWAYS = FactorOptions(small=0.0, thin_seconds=0.0, slow_seconds=0.0)


@pytest.mark.ratchet
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_multigrid_handles_elastic_rows(law: dict[str, float]) -> None:
    """The test uses multigrid although `auto` would use a factor; the V-cycle alone would not
    converge on stiff springs."""
    made = {**rough(scenes.ALL["pushed"]("hexahedron", 5), law), "solver": {"method": "primal"}}
    problem = scenes.problem(made)
    task = Task(problem, StoppingRule(1e-9), MPRGP(rtol=1e-10, max_iterations=2000))
    found = solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS)
    known = solve(made, [2, 2, 2], method="active-set", tolerance=1e-10)
    assert found.converged, found.certificate
    assert found.counts.hessian < 130, found.counts
    assert found.measures.energy == pytest.approx(known.summary["solution"]["energy"], rel=1e-7)


@pytest.mark.ratchet
def test_the_cycle_has_springs_for_sliding_points() -> None:
    """A ball in grooves takes 27 operator applications."""
    rubbed = [f"contacts.{k}.friction={{tresca: 10}}" for k in range(2)]
    scene = scenes.read("ball_in_grooves", ["solver.method=primal", *rubbed])
    summary = solve_scene(scene, MPI.COMM_SELF).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 50


@pytest.mark.ratchet
def test_the_first_set_has_friction() -> None:
    """A bracket takes 48 operator applications; 72 where all points of the first set stick."""
    settings = ["solver.method=primal", "contacts.0.friction={tresca: 3000}"]
    scene = scenes.read("bracket", settings)
    summary = solve_scene(scene, MPI.COMM_SELF).summary
    assert summary["certificate"]["passed"]
    assert summary["solver"]["hessian_multiplications"] <= 58


def test_friction_of_the_first_set_is_within_its_limit_and_along_the_slip() -> None:
    settings = ["solver.method=primal", "contacts.0.friction={coulomb: 0.1}"]
    scene = scenes.read("pin_in_lug", settings)
    system = merge(build_model(scene, MPI.COMM_SELF, needed="distinct").problem)
    first, points = find_first_set(system, build_hierarchy(system)), system.problem.friction
    assert first.multiplier is not None
    assert points is not None
    multiplier = system.on_all_rows(first.multiplier)
    slips = points.slips(system.on_all_rows(multiply(system.C, first.u) - system.c))
    forces, limits = points.forces(multiplier), points.slip_limits(multiplier)
    size = points.sizes(forces)
    assert (size <= limits * (1.0 + 1e-9)).all()
    slides = size >= 0.99 * limits
    touching = limits > 0.0
    assert 0 < (slides & touching).sum()
    along = points.sizes(slips) * size - points.dots(slips, forces)
    assert along.max() <= 1e-9 * (points.sizes(slips) * size).max()


def test_steps() -> None:
    """Slip measured from the last increment; the way back is another one."""
    made = pair("quadrilateral", {"coulomb": 0.3})
    made["conditions"][1:] = [
        {"name": "press", "on": "upper.y+", "displacement": [None, -0.02]},
        {"name": "push", "on": "upper.y+", "traction": [3.0, 0.0]},
    ]
    made["steps"] = [{"press": 1}, {"push": 1, "increments": 2}, {"push": -1, "increments": 2}]
    ends = []
    for method in ("active-set", "primal"):
        made["solver"] = {"method": method, "tolerance": 1e-9}
        *_, last = solved_increments(scenes.build(made), MPI.COMM_SELF, lambda place: None)
        assert last.solved.summary["solver"]["method"] == method
        ends.append(last.solved.nodes.displacement)
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-7 * np.abs(ends[0]).max())


@pytest.mark.ratchet
def test_rows_for_mean_motions_do_not_slow_conjugate_gradients_with_friction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The upper stub of the flange has `hold` and sticks: its means are left to a coarse space."""
    path = CONFIGS / "bolted_flange.yaml"
    values = ["bodies.0.degree=1", "bodies.1.degree=1", "solver.method=primal"]
    scene = scenes.read(path, [*values, "contacts.0.friction={tresca: 3.0}"])
    scene = scene.under(scene.cases[2])
    held = solve_scene(scene, MPI.COMM_SELF).summary
    monkeypatch.setattr(Multigrid, "prepare_motions", lambda *_: 0)
    left_to_projector = solve_scene(scene, MPI.COMM_SELF).summary
    assert held["certificate"]["passed"]
    same = pytest.approx(left_to_projector["solution"]["energy"], rel=1e-5)
    assert held["solution"]["energy"] == same
    work, more = (s["solver"]["hessian_multiplications"] for s in (held, left_to_projector))
    assert work < 0.75 * more


@pytest.mark.parametrize(("friction", "direct"), [(0.3, False), (0.0, True)])
def test_v_cycles_solve_on_sets_of_thin_bodies_with_friction(friction: float, direct: bool) -> None:
    """Three plates took 17 s of CPU time with a factor for each set, and take 4 s with V-cycles."""
    floor = {"obstacle": {"plane": {"point": [0, 0, 0], "normal": [0, 0, 1]}}}
    law = {"friction": {"coulomb": friction}} if friction else {}
    made = {
        "dimension": 3,
        "bodies": [scenes.box("plate", [40, 40, 2], [4, 4, 1])],
        "conditions": [
            {"on": "plate.x-", "displacement": [0, 0, 0]},
            {"on": "plate.z+", "traction": [0, 0, -1]},
        ],
        "contacts": [{"on": "plate.z-", **floor, **law}],
        "solver": {"method": "primal"},
    }
    problem = build_model(scenes.build(made), MPI.COMM_SELF, needed="distinct").problem
    assert Matrices.of(problem, FactorOptions(small=0.0)).direct == direct


def test_problems_under_other_loads_share_the_lifts_of_mean_motions() -> None:
    """Increments of a history need one V-cycle for each mean in all."""
    settings = [f"bodies.{k}.degree=1" for k in (0, 1)]
    settings += ["solver.method=primal", "contacts.0.friction={tresca: 3.0}"]
    scene = scenes.read("bolted_flange", settings)
    problem = build_model(scene.under(scene.cases[2]), MPI.COMM_SELF, needed="distinct").problem
    place = SharedPlace()
    first = Multigrid(problem, place=place)
    statuses = Statuses(first.closed_in(first.first_set()))
    of_first = first.on_set(statuses, None)
    second = Multigrid(problem, place=place)
    of_second = second.on_set(statuses, None)
    assert second.motions.lifts_means
    means = int(first.system.means.sum())
    assert of_first.counts.hessian - of_second.counts.hessian == means > 0


def test_rows_for_mean_motions_are_left_to_the_projector_without_friction() -> None:
    values = ["bodies.0.degree=1", "bodies.1.degree=1", "solver.method=primal"]
    scene = scenes.read("bolted_flange", values)
    problem = build_model(scene.under(scene.cases[2]), MPI.COMM_SELF, needed="distinct").problem
    backend = Multigrid(problem)
    backend.on_set(Statuses(backend.closed_in(backend.first_set())), None)
    assert backend.system.means.any()
    assert not backend.motions.lifts_means
