"""Multigrid on undecomposed bodies gives the answer of the undecomposed reference."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse

from contact_app.model.model import build_model
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from solver.backend import Turn
from solver.contact.options import SolverOptions
from solver.contact.stopping import StoppingRule
from solver.distributed import local_rows
from solver.driver import solve as solve_problem
from solver.primal import by_active_sets
from solver.primal.backend import IterationOptions
from solver.primal.by_active_sets import solve_by_multigrid
from solver.primal.cycle import CycleOnSets
from solver.primal.factor import FactorOptions, diagonal_below
from solver.primal.first_set import find_first_set
from solver.primal.hierarchy import build_hierarchy
from solver.primal.merged import merge
from solver.primal.projector import Projector
from solver.primal.vertices import vertex_level
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
from solver.vectors import Array
from tests import scenes
from tests.comparison import in_order_of, in_space, reference_of, solve
from tests.ranks import execute
from tests.rows import covering

ENERGY, FORCE = 1e-8, 1e-6
CONFIGS = Path(__file__).parents[3] / "configs"


def check(name: str, cell: str, n: int) -> None:
    """Energy, displacement in energy norm and contact force of a scene."""
    solution = solve(scenes.ALL[name](cell, n), method="primal")
    known, summary = reference_of(name, cell, n), solution.summary
    assert summary["certificate"]["passed"], summary["certificate"]
    assert summary["solver"]["method"] == "primal", summary["certificate"]["warnings"]
    scale = max(abs(known.energy), 0.5 * abs(known.u.ravel() @ known.system.load))
    assert summary["solution"]["energy"] == pytest.approx(known.energy, rel=0, abs=ENERGY * scale)
    strain_energy = known.u.ravel() @ (known.system.stiffness @ known.u.ravel())
    error = known.energy_error(in_order_of(known, solution))
    assert np.sqrt(max(error, 0.0)) < 1e-5 * np.sqrt(strain_energy)
    load = max(np.abs(known.contact_force).max(), np.abs(known.system.load).sum())
    np.testing.assert_allclose(
        summary["solution"]["contact_force"], in_space(known.contact_force), rtol=0,
        atol=FORCE * load,
    )  # fmt: skip
    # the stated bound on the error in energy norm is one
    bound = solution.solution.measures.error_squares().sum()
    assert error <= 4.0 * bound + 1e-13 * strain_energy


@pytest.mark.parametrize(("name", "cell"), covering(scenes.ALL, scenes.CELLS_3D[::-1]))
def test_scenes_in_space(name: str, cell: str) -> None:
    check(name, cell, 4)


@pytest.mark.parametrize(
    ("name", "cell"),
    covering([n for n in scenes.ALL if n not in scenes.ONLY_3D], scenes.CELLS_2D[::-1]),
)
def test_scenes_in_the_plane(name: str, cell: str) -> None:
    check(name, cell, 6)


MULTIGRID_ALWAYS = FactorOptions(small=0.0, thin_seconds=0.0, slow_seconds=0.0)


def test_a_heated_body_is_certified_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its residual has to be small beside the contact forces, a thousandth of the thermal ones."""
    made = {**scenes.rollers_and_floor("tetrahedron", 6), "solver": {"method": "primal"}}
    made["bodies"][0]["material"]["expansion"] = 0.1
    made["conditions"].append({"in": "block", "temperature": "100 - 20*z"})
    answers, certified = [], by_active_sets.certified

    def watched(*arguments: Any) -> Any:
        answers.append(certified(*arguments))
        return answers[-1]

    monkeypatch.setattr(by_active_sets, "certified", watched)
    problem = build_model(scenes.build(made), MPI.COMM_SELF).problem
    task = Task(problem, StoppingRule(1e-9), MPRGP(rtol=1e-10, max_iterations=2000))
    assert solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS).converged
    assert len(answers) == 1


@pytest.mark.parametrize(("name", "cell"), covering(scenes.ALL, scenes.CELLS_3D))
def test_multigrid_where_a_factor_would_be_taken(name: str, cell: str) -> None:
    made = {**scenes.ALL[name](cell, 4), "solver": {"method": "primal"}}
    problem = scenes.problem(made)
    inner = MPRGP(rtol=1e-10, max_iterations=2000)
    task = Task(problem, StoppingRule(1e-9), inner)
    found = solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS)
    known = reference_of(name, cell, 4)
    assert found.converged, found.certificate
    scale = max(abs(known.energy), 0.5 * abs(known.u.ravel() @ known.system.load))
    assert found.measures.energy == pytest.approx(known.energy, rel=0, abs=ENERGY * scale)


@pytest.mark.ratchet
def test_a_set_that_takes_few_steps_a_digit_keeps_its_cycle() -> None:
    """A factor in its place would cost more than the remaining steps."""
    made = {**scenes.wall("tetrahedron", 12), "solver": {"method": "primal"}}
    problem = scenes.problem(made)
    task = Task(problem, StoppingRule(1e-9), MPRGP(rtol=1e-10, max_iterations=2000))

    def applications(**slow: float) -> int:
        options = replace(MULTIGRID_ALWAYS, **slow)
        return solve_by_multigrid(task, None, None, options).counts.hessian

    alone = applications()
    sooner = applications(slow=2, slow_digit=1, slow_seconds=1e9, step=1.0)
    later = applications(slow=8, slow_seconds=1e9, step=1.0)
    too_costly = applications(slow=2, slow_digit=1, slow_seconds=1e9, step=1e-12, least_step=0.0)
    assert sooner < 0.9 * alone
    assert later == too_costly == alone


def test_a_factor_that_replaces_the_cycle_late_has_steps_of_its_own() -> None:
    """The set has taken more steps by then than a set with a factor may take."""
    made = {
        "dimension": 3,
        "bodies": [scenes.box("beam", [100, 1, 1], [100, 2, 2], young=2.1e5)],
        "conditions": [{"on": "beam.x-", "displacement": [0, 0, 0]},
                       {"on": "beam.x+", "displacement": [None, None, -0.1]}],
        "contacts": [{"on": "beam.z-", "obstacle": {"sphere": {"center": [60, 0, -20],
                                                               "radius": 20}}}],
        "solver": {"method": "primal"},
    }  # fmt: skip
    problem = scenes.problem(made)
    task = Task(problem, StoppingRule(1e-8), MPRGP(rtol=1e-10, max_iterations=2000))
    late = FactorOptions(
        small=0.0,
        thin_seconds=0.0,
        slow=IterationOptions().stalled_with_factor + 1,
        slow_digit=1,
        step=1.0,
    )
    found = solve_by_multigrid(task, None, None, late)
    assert found.counts.cg > late.slow
    assert found.converged, found.certificate


@pytest.mark.ratchet
@pytest.mark.parametrize("degree", [1, 2])
def test_a_strip_that_lifts_off_takes_few_products(degree: int) -> None:
    found = solve(scenes.lifted_strip(200.0, [400, 2], degree, method="primal")).summary
    assert found["certificate"]["passed"]
    assert found["solver"]["method"] == "primal"
    assert found["solver"]["hessian_multiplications"] < 60


@pytest.mark.ratchet
def test_multigrid_alone_finds_the_line_where_a_shelf_rests() -> None:
    """If the solve began with all rows, most sets would only release rows that never touch."""
    shelf = CONFIGS / "cylinder.yaml"
    coarse = ["bodies.0.mesh.box.cells=[30, 5, 1]", "solver.method=primal"]
    problem = build_model(build_scene(load(shelf, coarse)), MPI.COMM_SELF).problem
    task = Task(problem, StoppingRule(1e-6), MPRGP(rtol=1e-8, max_iterations=2000))
    found = solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS)
    assert found.converged
    assert found.counts.hessian < 190  # 134; 253 from all rows on


def test_a_begun_solve_goes_on_from_contact_forces() -> None:
    scene = scenes.build(
        {**scenes.wall("hexahedron", 8), "solver": {"method": "primal", "tolerance": 1e-8}}
    )
    problem = build_model(scene, MPI.COMM_SELF).problem
    cold = solve_problem(problem, scene.solver)
    warm = solve_problem(problem, scene.solver, start=cold.guess)
    assert cold.converged
    assert warm.converged
    touching = problem.inequality & (cold.multiplier > 1e-9 * np.abs(cold.multiplier).max())
    assert (warm.multiplier[touching] > 0.0).all()


def test_a_stopped_solve_reports_its_errors() -> None:
    scene = scenes.build({**scenes.wall("hexahedron", 6), "solver": {"method": "primal"}})
    problem = build_model(scene, MPI.COMM_SELF).problem
    steps: list[object] = []
    found = solve_problem(
        problem, SolverOptions(method="primal"), lambda step: steps.append(step) or True
    )
    assert not found.converged
    assert found.reason.name == "STOPPED"
    assert np.isfinite(found.certificate.equilibrium)


ON_RANKS = """
import sys
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from tests import scenes
from tests.comparison import solve
made = scenes.ALL[sys.argv[1]](sys.argv[2], 4)
found = solve(made, method="primal").summary
assert found["certificate"]["passed"], found["certificate"]
if MPI.COMM_WORLD.rank == 0:
    print(found["solver"]["method"], repr(found["solution"]["energy"]))
"""


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("name", "cell", "ranks"),
    [("wall", "tetrahedron", 2), ("two_bodies", "hexahedron", 3), ("sliding", "triangle", 2)],
)
def test_ranks_agree(name: str, cell: str, ranks: int) -> None:
    method, energy = execute(ON_RANKS, name, cell, ranks=ranks).split()[-2:]
    assert method == "primal"
    assert float(energy) == pytest.approx(reference_of(name, cell, 4).energy, rel=1e-8)


def test_rows_that_hold_a_motion_in_the_mean_do_not_cut_the_coarse_spaces() -> None:
    """The upper stub of the flange has `hold` for sliding and turning, in the mean of its nodes."""
    path = CONFIGS / "bolted_flange.yaml"
    values = ["bodies.0.degree=1", "bodies.1.degree=1", "solver.method=primal"]
    scene = build_scene(load(path, values))
    problem = build_model(scene.under(scene.cases[0]), MPI.COMM_SELF, needed="distinct").problem
    system = merge(problem)
    assert system.means.any()
    every = Projector(system, np.ones(len(system.rows), bool))
    narrow = every.narrow
    assert set(every.rows) - set(narrow.rows) == set(np.flatnonzero(system.means))
    assert narrow.narrow is narrow
    forces = np.random.default_rng(3).standard_normal(len(every.rows))
    jumps = local_rows(system.C) @ every.lifting(forces)  # by the inverse of the narrow rows
    np.testing.assert_allclose(jumps[every.rows], forces, atol=1e-8 * np.abs(forces).max())


def test_the_cycle_that_has_followed_sets_is_that_of_the_last_one() -> None:
    """It changes the springs of changed rows alone.

    Both cycles are symmetric, and their corrections leave the active rows alone.
    """
    scene = build_scene(load(CONFIGS / "pin_in_lug.yaml", ["solver.method=primal"]))
    system = merge(build_model(scene, MPI.COMM_SELF, needed="distinct").problem)
    hierarchy, number = build_hierarchy(system), np.arange(len(system.rows))
    first, last = (Projector(system, number % k > 0) for k in (3, 4))
    followed, fresh = CycleOnSets(system, hierarchy), CycleOnSets(system, hierarchy)
    residuals = np.random.default_rng(0).standard_normal((2, system.size))

    def corrections(cycle: CycleOnSets, projector: Projector) -> Array:
        cycle.adapt_to(projector)
        results = np.empty_like(residuals)
        for residual, result in zip(residuals, results, strict=True):
            cycle.apply(projector.apply_transpose(residual), result)
        return results

    other = corrections(followed, first)
    again, expected = corrections(followed, last), corrections(fresh, last)
    scale = np.abs(expected).max()
    assert np.abs(other - expected).max() > 1e-3 * scale
    assert np.abs(again - expected).max() < 1e-6 * scale
    for z in (other, expected):
        assert residuals[0] @ z[1] == pytest.approx(residuals[1] @ z[0], rel=1e-6)
    moved = [np.abs(last.C @ z).max() for z in expected]
    sizes = [(last.C.power(2) @ z**2).max() ** 0.5 for z in expected]
    assert max(moved) < 1e-9 * min(sizes)


def test_the_cycle_goes_on_from_that_of_the_first_set() -> None:
    """Its springs follow the set; open rows have the faint springs of the first set besides."""
    scene = build_scene(load(CONFIGS / "pin_in_lug.yaml", ["solver.method=primal"]))
    system = merge(build_model(scene, MPI.COMM_SELF, needed="distinct").problem)
    hierarchy = build_hierarchy(system)
    made = find_first_set(system, hierarchy).cycle
    assert made is not None
    projector = Projector(system, np.arange(len(system.rows)) % 3 > 0)
    residual = projector.apply_transpose(np.random.default_rng(0).standard_normal(system.size))
    found = []
    for cycle in (CycleOnSets(system, hierarchy, made), CycleOnSets(system, hierarchy)):
        cycle.adapt_to(projector)
        found.append(np.empty(system.size))
        cycle.apply(residual, found[-1])
    begun, fresh = found
    assert np.linalg.norm(begun - fresh) < 1e-3 * np.linalg.norm(fresh)


def test_springs_on_few_unknowns_go_down_a_level() -> None:
    """The springs of motions held in the mean, of which coarse levels have the diagonal."""
    scene = build_scene(load(CONFIGS / "pin_in_lug.yaml", ["solver.method=primal"]))
    system = merge(build_model(scene, MPI.COMM_SELF, needed="distinct").problem)
    P = build_hierarchy(system).prolongations[0]
    springs = np.where(np.arange(system.size) % 7 == 0, 1.0 + np.arange(system.size), 0.0)
    local = local_rows(P)
    expected = (local.T @ sparse.diags(springs) @ local).diagonal()
    assert diagonal_below(P, springs) == pytest.approx(expected, rel=1e-12)


def test_the_cycle_follows_compliances_and_turned_frames() -> None:
    """Its springs for sliding points of one set are gone on the next set."""
    given = ["solver.method=primal", "contacts.0.friction={tresca: 1}"]
    scene = build_scene(load(CONFIGS / "pin_in_lug.yaml", given))
    system = merge(build_model(scene, MPI.COMM_SELF, needed="distinct").problem)
    points, draw = system.problem.friction, np.random.default_rng(0)
    assert points is not None
    first, active = points.rows[points.first], system.problem.inequality.copy()
    active[first + 1] = True
    compliance = np.zeros(len(active))
    compliance[first + 1] = 10.0 ** draw.uniform(-8.0, -4.0, len(first))
    hierarchy = build_hierarchy(system)
    followed, fresh = CycleOnSets(system, hierarchy), CycleOnSets(system, hierarchy)
    followed.adapt_to(Projector(system, system.normal))
    for _ in range(2):
        angle = draw.uniform(-3.0, 3.0, len(first))
        turned = system.turned(Turn(first, first + 1, np.cos(angle), np.sin(angle)))
        soft = Projector(turned, active[system.rows], compliance[system.rows])
        followed.adapt_to(soft)
    fresh.adapt_to(soft)
    residual = draw.standard_normal(system.size)
    again, expected = np.empty_like(residual), np.empty_like(residual)
    followed.apply(residual, again)
    fresh.apply(residual, expected)
    assert np.abs(again - expected).max() < 1e-6 * np.abs(expected).max()


def of_degree_2(name: str, cell: str, n: int) -> scenes.Config:
    """A scene with bodies of degree 2."""
    made = scenes.ALL[name](cell, n)
    for body in made["bodies"]:
        body["degree"] = 2
    return made


@pytest.mark.parametrize(
    ("name", "cell"),
    [("wall", "hexahedron"), ("pushed", "tetrahedron"), ("two_bodies", "tetrahedron")],
)
def test_degree_2_has_a_level_of_degree_1(name: str, cell: str) -> None:
    made = of_degree_2(name, cell, 3)
    scene = scenes.build({**made, "solver": {"method": "primal"}})
    problem = build_model(scene, MPI.COMM_SELF).problem
    system = merge(problem)
    level = vertex_level(system)
    assert level is not None
    vertices = len(level.rigid)
    assert vertices < 0.25 * system.size
    again = local_rows(level.P) @ level.rigid  # a rigid motion of degree 1 is one of degree 2
    inner = np.abs(local_rows(level.P)).sum(axis=1).A1 > 1.0 - 1e-12  # no held vertex beside it
    assert inner.sum() > 0.5 * system.size
    np.testing.assert_allclose(again[inner], system.rigid[inner], rtol=0, atol=1e-12)
    assert not np.abs(again[system.held]).any()
    task = Task(problem, StoppingRule(1e-9), MPRGP(rtol=1e-10, max_iterations=2000))
    found = solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS)
    assert found.converged, found.certificate
    known = solve(made, method="auto").solution.measures.energy
    assert found.measures.energy == pytest.approx(known, rel=1e-7)


@pytest.mark.ratchet
def test_a_part_of_degree_2_takes_few_products() -> None:
    path = CONFIGS / "pillow_block.yaml"
    scene = build_scene(load(path, ["solver.method=primal", "solver.tolerance=1e-8"]))
    problem = build_model(scene.under(scene.cases[-1]), MPI.COMM_SELF, needed="distinct").problem
    task = Task(problem, StoppingRule(1e-8), MPRGP(rtol=1e-10, max_iterations=2000))
    found = solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS)
    assert found.converged
    assert found.counts.hessian < 45  # 36; 62 where GAMG aggregates the nodes of degree 2


DEGREE_2_ON_RANKS = """
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from tests import scenes
from tests.contact_app.run.test_primal import MULTIGRID_ALWAYS, of_degree_2
from contact_app.model.model import build_model
from solver.primal.by_active_sets import solve_by_multigrid
from solver.contact.stopping import StoppingRule
from solver.problem.task import Task
from solver.qp.mprgp import MPRGP
made = {**of_degree_2("pushed", "tetrahedron", 3), "solver": {"method": "primal"}}
problem = build_model(scenes.build(made), MPI.COMM_WORLD).problem
task = Task(problem, StoppingRule(1e-9), MPRGP(rtol=1e-10, max_iterations=2000))
found = solve_by_multigrid(task, None, None, MULTIGRID_ALWAYS)
assert found.converged
if MPI.COMM_WORLD.rank == 0:
    print(found.counts.hessian, repr(found.measures.energy))
"""


@pytest.mark.mpi
def test_ranks_agree_on_degree_2() -> None:
    (count, energy), (other, known) = (
        execute(DEGREE_2_ON_RANKS, ranks=ranks).split()[-2:] for ranks in (2, 1)
    )
    assert float(energy) == pytest.approx(float(known), rel=1e-8)
    assert int(count) < int(other) + 10


PIN_ON_RANKS = """
from mpi4py import MPI
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from tests.contact_app.run.test_primal import CONFIGS
pin = load(CONFIGS / "pin_in_lug.yaml", ["solver.method=primal"])
summary = solve_scene(build_scene(pin, comm=MPI.COMM_WORLD), MPI.COMM_WORLD).summary
if MPI.COMM_WORLD.rank == 0:
    print(summary["solver"]["method"])
"""


@pytest.mark.mpi
def test_springs_join_coarse_levels_whose_sums_over_ranks_have_no_zeros() -> None:
    """This pin of degree 2 was left to Total FETI on two ranks."""
    assert execute(PIN_ON_RANKS, ranks=2).split()[-1] == "primal"


UNEVEN_ON_RANKS = """
import numpy as np
from mpi4py import MPI
from contact_app.model.model import build_model
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from solver.primal.merged import merge
from solver.primal.vertices import vertex_level
from solver.distributed import local_rows
from tests.contact_app.run.test_primal import CONFIGS
comm = MPI.COMM_WORLD
scene = build_scene(load(CONFIGS / "hub_on_shaft.yaml", ["solver.method=primal"]), comm=comm)
system = merge(build_model(scene, comm, needed="distinct").problem)
nodes, mean = system.nodes, comm.allreduce(system.size) / comm.size
assert max(comm.allgather(3 * int(nodes.first_here.sum()))) > 1.1 * mean
assert max(comm.allgather(system.size)) < 1.01 * mean
for values in (nodes.points[:, 0], nodes.points[:, 1], nodes.points[:, 2], nodes.body):
    owned = nodes.at_owners(values[nodes.first_here])
    assert len(owned) * 3 == system.size
    brought = system.at_copies(np.repeat(owned, 3).astype(float))
    np.testing.assert_allclose(brought[::3], values, rtol=0, atol=1e-12)
level = vertex_level(system)
P = local_rows(level.P)
again = P @ np.concatenate(comm.allgather(level.rigid))
inner = np.abs(P).sum(axis=1).A1 > 1.0 - 1e-12  # no held vertex beside it
assert inner.mean() > 0.5
np.testing.assert_allclose(again[inner], system.rigid[inner], rtol=0, atol=0.05)  # curved edges
"""


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_own_equal_numbers_of_nodes(ranks: int) -> None:
    """The hub is larger than its shaft; ranks have one body each, or parts of them."""
    execute(UNEVEN_ON_RANKS, ranks=ranks)
