"""Directions of earlier sets on a set whose slip directions turned."""

import numpy as np
import pytest
from mpi4py import MPI

from solver import MPRGP
from solver.backend import Statuses, Turn
from solver.tfeti.active_set_problem import ActiveSetProblem
from solver.tfeti.changed_frames import BalancedPreconditioner, ChangedDirections, RowFrame
from solver.tfeti.derived import turned, with_active
from solver.tfeti.directions import Directions
from solver.tfeti.dual import DualProblem
from solver.tfeti.preconditioner import DualPreconditioner
from solver.tfeti.projected import RangeOperator
from solver.vectors import Array
from tests import scenes

TOLERANCE = 1e-8


@pytest.fixture(scope="module")
def problem() -> DualProblem:
    """A block on a rough floor in eight parts."""
    cell = "hexahedron"
    floor = {"on": "block.z-", "obstacle": scenes.plane(cell, (0, 0, 0), (0, 0, 1))}
    moved = {"on": "block.z+", "displacement": [0.02, 0.01, -0.02]}
    rough = floor | {"friction": {"tresca": 1.0}}
    made = scenes.config(cell, [scenes.block(cell, 6)], [moved], [rough])
    return scenes.problem(made, [2, 2, 2], comm=MPI.COMM_WORLD)


def sliding(problem: DualProblem, angle: float) -> Statuses:
    """All points in contact; they slide in a direction that varies, and give way across."""
    points = problem.friction
    assert points is not None
    first = points.rows[points.first]
    angles = angle + 0.3 * np.arange(len(first))
    turn = Turn(first, first + 1, np.cos(angles), np.sin(angles))
    active = np.ones(problem.size, bool)
    active[first] = False
    tractions, compliance = np.zeros(problem.size), np.zeros(problem.size)
    tractions[first] = 0.1
    compliance[first + 1] = 1e-3
    return Statuses(active, tractions, turn, compliance)


def solved(problem: DualProblem, statuses: Statuses, known: Directions | None) -> tuple[Array, int]:
    """The multiplier of a set and the products that it took."""
    on_set = ActiveSetProblem(problem, statuses, None, known)
    on_set.solve(MPRGP(max_iterations=500), TOLERANCE, None)
    return on_set.state().multiplier, on_set.counts.hessian


@pytest.mark.ratchet
def test_directions_serve_again_where_points_turn(problem: DualProblem) -> None:
    """The same multiplier, sooner."""
    known = Directions(problem.B, problem.conditional)
    solved(problem, sliding(problem, 0.0), known)
    alone, all_products = solved(problem, sliding(problem, 0.02), None)
    found, products = solved(problem, sliding(problem, 0.02), known)
    assert found == pytest.approx(alone, abs=1e-6 * np.abs(alone).max())
    assert products <= all_products - 3


def test_stored_directions_belong_to_the_original_frames(problem: DualProblem) -> None:
    """They are in equilibrium, and their products are those of F."""
    known = Directions(problem.B, problem.conditional)
    solved(problem, sliding(problem, 0.0), known)
    known.begin()
    known.settle()
    assert known.count > 0
    coarse = problem.coarse
    assert coarse is not None
    product, rest = np.empty(problem.size), np.empty(coarse.kernels)
    for vector, applied in zip(known.vectors, known.applied, strict=True):
        problem.F.apply(vector, product)
        assert applied == pytest.approx(product, abs=1e-9 * np.abs(product).max())
        coarse.restrict(vector, rest)
        assert np.abs(rest).max() <= 1e-9 * np.abs(vector).max()


def test_the_balanced_preconditioner_is_symmetric_and_exact_on_its_range(
    problem: DualProblem,
) -> None:
    """With turned points it is symmetric and positive; without any it inverts P F on V."""
    known = Directions(problem.B, problem.conditional)
    everything = Statuses(np.ones(problem.size, bool))
    solved(problem, everything, known)
    known.begin()
    known.settle()
    for statuses in (everything, sliding(problem, 0.1)):
        mine = problem if statuses.turn is None else turned(problem, statuses.turn)
        reduced = with_active(mine, statuses.active)
        assert reduced.coarse is not None
        frame = RowFrame(statuses.turn, None)
        args = (statuses, frame, statuses.compliance, reduced.coarse)
        changed = ChangedDirections(known, mine, *args)
        own = BalancedPreconditioner(DualPreconditioner(reduced, np.inf), changed)

        def applied(r: Array, own: BalancedPreconditioner = own) -> Array:
            out = np.empty_like(r)
            own.apply(r, np.ones(len(r), bool), out)
            return out

        one, other = np.random.default_rng(0).standard_normal((2, problem.size))
        for r in (one, other):
            reduced.coarse.project_transpose(r, r)
        sums = [one @ applied(other), other @ applied(one), one @ applied(one)]
        mixed, back, square = problem.comm.allreduce(np.array(sums))
        assert mixed == pytest.approx(back, abs=1e-5 * square)
        assert square > 0.0
        if statuses.turn is None:
            operator, r = RangeOperator(reduced.F, reduced.coarse), np.empty(problem.size)
            for vector in known.vectors:
                operator.apply(vector, r)
                assert applied(r) == pytest.approx(vector, abs=1e-6 * np.abs(vector).max())
