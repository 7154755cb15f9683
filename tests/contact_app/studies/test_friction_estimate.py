"""The error estimate and runs to an accuracy with friction."""

from functools import cache

import numpy as np
import pytest
from mpi4py import MPI

from contact_app.accuracy.refine.refinement import solve_to_accuracy
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.errors import ConfigurationError
from contact_app.results.friction import friction_potential
from contact_app.run.increments import solved_increments
from contact_app.run.solve import solve_scene
from contact_app.studies.effectivity import AnswerOnMesh, Case, errors_from_differences
from tests import scenes
from tests.comparison import solve
from tests.rows import covering

YOUNG, POISSON = 1000.0, 0.3
SHEAR = YOUNG / (2 * (1 + POISSON))
CONFINED = YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))

Law = dict[str, float]
LAWS: tuple[Law, ...] = ({"coulomb": 0.3}, {"tresca": 3.0})


def sheared(cell: str, law: Law, degree: int, pair: bool) -> scenes.Config:
    """One or two blocks with a constant pressure of 10 and friction of 3, whose foot slides.

    The displacement is linear: exact on every mesh. In space the slip runs across both axes.
    """
    d, height = scenes.dimension(cell), 2.0 if pair else 1.0
    pressure, shear = 10.0, 3.0
    along = np.array([1.0]) if d == 2 else np.array([0.6, 0.8])
    strain, down = shear / SHEAR, pressure / CONFINED
    top = [*(along * (strain * height + 0.01)), -down * height]
    bodies = [scenes.block(cell, 3, "block", (0, 0, height - 1.0), (1, 1, height))]
    floor = {"plane": {"point": [0.0] * d, "normal": [0.0] * (d - 1) + [1.0]}}
    contact: scenes.Config = {"on": f"block.{scenes.down(cell)}", "obstacle": floor}
    conditions: list[scenes.Config] = [{"on": f"block.{scenes.up(cell)}", "displacement": top}]
    if pair:
        bodies.append(scenes.block(cell, 2, "lower", (0, 0, 0), (1, 1, 1)))
        conditions.append(scenes.clamp(cell, f"lower.{scenes.down(cell)}"))
        contact = {"on": contact["on"], "against": f"lower.{scenes.up(cell)}"}
    side = pressure * POISSON / (1 - POISSON)
    for body in bodies:
        body["degree"] = degree
        body["material"] = {"young": YOUNG, "poisson": POISSON}
        for axis, name in enumerate("xy"[: d - 1]):
            for sign, end in ((-1.0, "-"), (1.0, "+")):
                traction = [0.0] * d
                traction[axis], traction[-1] = -sign * side, sign * shear * float(along[axis])
                conditions.append({"on": f"{body['name']}.{name}{end}", "traction": traction})
    return scenes.config(cell, bodies, conditions, [{**contact, "friction": law}])


@pytest.mark.parametrize(
    ("law", "cell", "degree", "pair"),
    covering(LAWS, ["quadrilateral", "triangle", "hexahedron", "tetrahedron"], [1, 2], [0, 1]),
    ids=str,
)
def test_zero_where_sliding_under_a_constant_stress_is_exact(
    law: Law, cell: str, degree: int, pair: int
) -> None:
    made = sheared(cell, law, degree, bool(pair))
    solved = solve(made, 1 if pair else [2] * scenes.dimension(cell), tolerance=1e-12)
    assert solved.summary["contacts"][0]["nodes"]["slip"] > 3
    assert solved.summary["contacts"][0]["max_pressure"] == pytest.approx(10.0)
    assert solved.accuracy.discretisation < 1e-8


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_zero_where_sticking_under_a_constant_stress_is_exact(cell: str) -> None:
    made = sheared(cell, {"coulomb": 0.5}, 1, False)
    top = made["conditions"][0]["displacement"]
    size = np.linalg.norm(top[:-1])
    top[:-1] = [float(t * (size - 0.01) / size) for t in top[:-1]]
    solved = solve(made, 1, tolerance=1e-12)
    assert solved.summary["contacts"][0]["nodes"]["slip"] == 0
    assert solved.accuracy.discretisation < 1e-8


def pushed(cell: str, n: int, law: Law, degree: int = 1) -> scenes.Config:
    """A block pressed onto a floor and pushed aside: part of its foot sticks, the rest slides."""
    d = scenes.dimension(cell)
    block = {**scenes.block(cell, n), "degree": degree}
    floor = {"plane": {"point": [0.0] * d, "normal": [0.0] * (d - 1) + [1.0]}}
    top = {"on": f"block.{scenes.up(cell)}", "displacement": scenes.vector(cell, 0.03, 0.01, -0.05)}
    contact = {"on": f"block.{scenes.down(cell)}", "obstacle": floor, "friction": law}
    return scenes.config(cell, [block], [top], [contact])


def answer(cell: str, n: int, solved: SolvedScene, degree: int = 1) -> AnswerOnMesh:
    return AnswerOnMesh(Case("", cell, (), False, degree=degree), n, solved)


@cache
def tight(cell: str, n: int, law: tuple[str, float], degree: int = 1) -> AnswerOnMesh:
    """The block, solved to nearly nothing."""
    made = pushed(cell, n, dict([law]), degree)
    return answer(cell, n, solve(made, 1, tolerance=1e-9), degree)


COULOMB, TRESCA = ("coulomb", 0.3), ("tresca", 20.0)


@pytest.mark.parametrize(
    ("cell", "meshes", "degree", "law", "most"),
    [
        ("quadrilateral", (4, 8, 16, 32), 1, COULOMB, 1.4),
        ("quadrilateral", (4, 8, 16, 32), 1, TRESCA, 1.1),
        ("triangle", (4, 8, 16), 1, TRESCA, 1.4),
        ("quadrilateral", (4, 8, 16), 2, COULOMB, 1.5),
        ("hexahedron", (2, 4, 8), 1, COULOMB, 1.4),
        ("hexahedron", (2, 4, 8), 1, TRESCA, 1.2),
    ],
)
def test_effectivity_against_a_fine_answer(
    cell: str, meshes: tuple[int, ...], degree: int, law: tuple[str, float], most: float
) -> None:
    """The estimate is the error, or up to a half more, and falls at its rate.

    With friction taken for none in the recovery it exceeds the error the more the finer the mesh.
    """
    answers = [tight(cell, n, law, degree) for n in meshes]
    nodes = answers[-1].solved.summary["contacts"][0]["nodes"]
    assert nodes["stick"]
    assert nodes["slip"]
    errors, _ = errors_from_differences([a.error_to(answers[-1]) for a in answers[:-1]])
    worth = [
        a.solved.accuracy.discretisation * a.norm / e for a, e in zip(answers, errors, strict=False)
    ]
    assert all(0.95 < w < most for w in worth), worth


def after_history(n: int, law: Law) -> list[AnswerOnMesh]:
    """The block pressed, pushed to and fro, then relieved of most of its load."""
    made = pushed("quadrilateral", n, law)
    foot = made["conditions"][0]
    x, y = foot["displacement"]
    made["conditions"] = [
        {**foot, "name": "press", "displacement": [None, y]},
        {**foot, "name": "push", "displacement": [x, None]},
    ]
    steps = [{"press": 1}, {"push": 1, "increments": 2}, {"push": -0.5}, {"press": 0.3, "push": 0}]
    scene = scenes.build({**made, "steps": steps, "solver": {"tolerance": 1e-9}}, 1)
    history = solved_increments(scene, MPI.COMM_WORLD, lambda place: None)
    return [answer("quadrilateral", n, increment.solved) for increment in history]


@pytest.mark.parametrize("law", [COULOMB, TRESCA])
def test_effectivity_in_a_history(law: tuple[str, float]) -> None:
    """Each increment has an estimate, about as good as without a history.

    The last one, in which stresses of the history remain, has errors of slips that it inherits and
    the estimate does not see.
    """
    histories = [after_history(n, dict([law])) for n in (4, 8, 16)]
    for number, answers in enumerate(zip(*histories, strict=True), start=1):
        errors, _ = errors_from_differences([a.error_to(answers[-1]) for a in answers[:-1]])
        worth = [
            a.solved.accuracy.discretisation * a.norm / e
            for a, e in zip(answers, errors, strict=False)
        ]
        least = 0.7 if number == len(histories[0]) else 0.95
        assert all(least < w < 1.4 for w in worth), (number, worth)


@pytest.mark.parametrize("law", [COULOMB, TRESCA])
def test_an_automatic_tolerance_leaves_a_tenth_of_the_error_of_the_mesh(
    law: tuple[str, float],
) -> None:
    fine = tight("quadrilateral", 32, law)
    made = pushed("quadrilateral", 32, dict([law]))
    auto = answer("quadrilateral", 32, solve(made, 4, tolerance="auto"))
    error = fine.product(fine.displacement - auto.displacement) ** 0.5 / fine.norm
    found = auto.solved.accuracy
    assert auto.solved.summary["certificate"]["passed"]
    assert error < 0.12 * found.discretisation
    assert found.discretisation == pytest.approx(fine.solved.accuracy.discretisation, rel=0.02)


@pytest.mark.parametrize("law", [COULOMB, TRESCA])
def test_an_accuracy_is_met(law: tuple[str, float]) -> None:
    """The energy with the work of friction is that of a finer mesh, but for the errors of both."""
    made = {**pushed("quadrilateral", 6, dict([law])), "accuracy": 0.03}
    made["solver"] = {"tolerance": 1e-8}
    found = solve_to_accuracy(scenes.build(made), solve_scene)
    assert not found.missed
    assert found.levels[-1].total < 0.03
    fine, norm = tight("quadrilateral", 32, law), found.solved.accuracy.square**0.5
    energies = [
        s.solution.measures.energy + friction_potential(s.model.problem, s.solution)
        for s in (found.solved, fine.solved)
    ]
    own = fine.solved.accuracy.discretisation
    error = (2.0 * max(energies[0] - energies[1], 0.0) / norm**2 + own**2) ** 0.5
    assert error < (1.0 if own < 0.03 else 1.6) * 0.03


def test_a_guaranteed_bound_is_refused() -> None:
    made = {**pushed("quadrilateral", 2, {"coulomb": 0.3}), "certificate": {"guaranteed": True}}
    with pytest.raises(ConfigurationError, match=r"contacts\[0\]\.friction.*guaranteed"):
        scenes.build(made)


def test_the_estimate_is_that_of_any_decomposition() -> None:
    whole = tight("quadrilateral", 8, COULOMB).solved.accuracy.discretisation
    for parts in ([2, 2], 5):
        made = pushed("quadrilateral", 8, {"coulomb": 0.3})
        split = solve(made, parts, tolerance=1e-10)
        assert split.accuracy.discretisation == pytest.approx(whole, rel=1e-5)
