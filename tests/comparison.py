"""Compare a solution of the application with a reference, node by node."""

from functools import cache
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from contact_app.model.outline import outline_of_scene
from solver.problem.certify import certify
from tests import reference, scenes


@cache
def reference_of(name: str, cell: str, n: int) -> reference.Reference:
    """Reference solution of a scene of :data:`tests.scenes.ALL`, computed once."""
    return reference.solve(scenes.build(scenes.ALL[name](cell, n)))


def in_order_of(known: reference.Reference, solution: Any) -> np.ndarray:
    """The solution's displacement in the node order of a reference, shape (n, dim).

    Fails unless the two sets of nodes are the same.
    """
    points, u = solution.nodes.points, solution.nodes.displacement
    assert points.shape == known.points.shape, "another number of nodes"
    distance, index = cKDTree(points).query(known.points)
    extent = np.ptp(known.points, axis=0).max()
    assert distance.max() < 1e-9 * extent, "a node of the mesh is missing"
    assert np.unique(index).size == index.size, "two bodies share a point: nodes are ambiguous"
    return np.asarray(u)[index]


def same_displacement(known: reference.Reference, solved: Any, part: float = 1e-7) -> None:
    """Hold an answer against a reference, to a part of the largest displacement at each node."""
    u = in_order_of(known, solved)
    np.testing.assert_allclose(u, known.u, rtol=0, atol=part * np.abs(known.u).max())


def solve(made: scenes.Config, subdomains: int | list[int] | None = None, **options: Any) -> Any:
    """Solve a configuration with the application, with some solver options replaced."""
    from contact_app.run.solve import solve_scene

    made = {**made, "solver": {**made.get("solver", {}), **options}}
    return solve_scene(scenes.build(made, subdomains))


def in_space(vector: np.ndarray) -> np.ndarray:
    """A vector with three components, as summaries have it in 2D, too."""
    return np.concatenate([vector, np.zeros(3 - len(vector))])


def counts(solution: Any) -> dict[str, int]:
    """Iteration counts of a solution."""
    names = (
        "outer_iterations",
        "hessian_multiplications",
        "cg_steps",
        "expansion_steps",
        "proportioning_steps",
    )
    return {name: solution.summary["solver"][name] for name in names}


def same_contacts(found: dict[str, Any], known: dict[str, Any], part: float = 1e-6) -> None:
    """Hold `contacts` of two summaries of one scene against each other.

    Parameters
    ----------
    part
        Of the largest force, which counts as a moment on an arm of one, and of the largest
        pressure, that is no difference.
    """
    ours, theirs = found["contacts"], known["contacts"]
    assert [(c["on"], c["with"], c["nodes"]) for c in ours] == [
        (c["on"], c["with"], c["nodes"]) for c in theirs
    ]
    force = max((np.abs(c["force"]).max() for c in theirs), default=0.0)
    pressure = max((c["max_pressure"] for c in theirs), default=0.0)
    sizes = {"force": force, "moment": force, "max_pressure": pressure, "point": 1.0, "area": 1.0}
    for one, other in zip(ours, theirs, strict=True):
        for key, size in sizes.items():
            np.testing.assert_allclose(
                one[key], other[key], rtol=0, atol=part * size, err_msg=f"{one['on']} {key}"
            )


def load_resultant(scene: Any) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment about the origin of the nodal loads of a scene."""
    known, d = outline_of_scene(scene, MPI.COMM_SELF), scene.dimension
    force, moment = np.zeros(3), np.zeros(3)
    for s, vector in zip(known.partition.subdomains, known.acting.vectors, strict=True):
        if vector is not None:
            nodal = np.zeros((len(s.points()), 3))
            nodal[:, :d] = vector.reshape(-1, d)
            force += nodal.sum(axis=0)
            moment += np.cross(s.points(), nodal).sum(axis=0)
    return force, moment


def certified_in_and_slid(solved: Any, slide: float) -> tuple[Any, Any]:
    """`certify` of a plane answer moved down into its obstacle, and of this one slid along x.

    It moves down by a hundredth of its largest displacement.
    """
    problem, solution = solved.model.problem, solved.solution
    entered = [u.copy() for u in solution.displacements]
    for u in entered:
        u[1::2] -= 1e-2 * solution.measures.displacement
    slid = [u.copy() for u in entered]
    for u in slid:
        u[0::2] += slide
    before, after = (certify(problem, solution.multiplier, u, 1e-6) for u in (entered, slid))
    return before, after
