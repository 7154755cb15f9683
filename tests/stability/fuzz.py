"""Random scenes against the undecomposed reference: ``python -m tests.stability.fuzz 1000``.

Every scene must end, within its time, in one of these ways:

agrees        certified, with the energy and, in each body, the strains of the independent
              active-set solution, or, where that misses its own tolerance, with the optimality
              conditions of the undecomposed system
degraded      not certified, and says so, where the reference has no answer either, or where
              displacements in double precision have no digits for the strains
escapes       refused for want of an equilibrium, and a linear programme finds the escape, too
contradicts   held nodes are pushed into an obstacle, or two obstacles leave a node no room; the
              reference, or a linear programme for each node, finds so, too
refused       input that is refused in a sentence
undecided     certified, where the reference says neither yes nor no

Anything else is a fault: a crash, a scene that hangs, an answer certified wrongly, a scene given
up that the reference solves, an equilibrium denied that exists, or one found that does not, and a
mesh accepted whose cells overlap.
"""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import block_diag
from scipy.optimize import linprog, lsq_linear

from contact_app.errors import ConfigurationError, NoEquilibriumError
from contact_app.run.solve import solve_scene
from tests import reference
from tests.stability import verdicts
from tests.stability.defect_scenes import kind_of, overlapping_cells
from tests.stability.groups import Known, groups_of, in_order, motions_at
from tests.stability.groups import solve as solve_groups
from tests.stability.random_scenes import random_scene
from tests.stability.verdicts import Verdict, attempt

ENERGY = 1e-6
"""Relative difference of energies that a certified answer may leave; the tolerance is 1e-8."""

ACCURATE = 2.0
"""Squared relative error of each body in energy norm, over the tolerance, that a certified answer
may leave: the displacements may be as far on one side of the least energy as the bound on the
other."""

OPTIMAL = 1e-6
"""Relative residual of the optimality conditions that shows an answer to be right."""


def judge(
    seed: int,
    method: str = "auto",
    *,
    solve: Callable[[Any], Any] = solve_scene,
    kind_of: Callable[[int], Any] = kind_of,
    patience: float = 60.0,
) -> Verdict:
    """Solve a random scene and compare it with the reference.

    Parameters
    ----------
    method
        `solver.method`; another than `auto` takes its own decomposition.
    kind_of
        What tells the kind of the scene of a seed.
    patience
        Seconds of processor time after which a scene of a few thousand unknowns is said to hang.
    """
    made, subdomains = random_scene(seed)
    if method != "auto":
        made["solver"].pop("expansion", None)  # which asks for SMALBE-M
        made["solver"]["method"], subdomains = method, None
    done = attempt(made, subdomains, solve, patience)
    scene, solved, seconds = done.scene, done.solved, done.seconds
    if done.fault is not None:
        return Verdict(seed, *done.fault, seconds)
    message = "" if done.error is None else str(done.error)
    if done.error is not None and not isinstance(done.error, NoEquilibriumError):
        kind = "refused" if isinstance(done.error, ConfigurationError) else "gives up"
        if kind_of(seed) is overlapping_cells and "mesh.file is" not in message:
            kind = "refused for another reason"
        return Verdict(seed, kind, message[:300], seconds)
    if kind_of(seed) is overlapping_cells:
        return Verdict(seed, "accepts overlapping cells", "", seconds)

    system = reference.assemble(scene)
    escapes = max(escape_work(system, group) for group in groups_of(scene)) > 1e-7
    if solved is None:
        return Verdict(seed, _denied(scene, system, escapes, message), message, seconds)
    kind, detail = _judged(scene, system, solved, escapes)
    told = solved.summary["solver"]
    return Verdict(seed, kind, detail, seconds, told["hessian_multiplications"], told["method"])


def _denied(scene: Any, system: reference.System, escapes: bool, message: str) -> str:
    """The verdict on a scene that was said to have no equilibrium."""
    if "push held nodes" in message and reference_contradicts(scene):
        return "contradicts"
    if "no room" in message and overlap_at_nodes(system) > 0.0:
        return "contradicts"
    return "escapes" if escapes else "denies an equilibrium"


def _judged(scene: Any, system: reference.System, solved: Any, escapes: bool) -> tuple[str, str]:
    """The verdict on an answer, and details."""
    passed = solved.summary["certificate"]["passed"]
    if passed and overlap_at_nodes(system) > 1e-6 * float(np.ptp(system.points, axis=0).max()):
        return "invents an equilibrium", "nodes overlap"
    tolerance = float(solved.summary["solver"]["tolerance"])
    u = in_order(system, solved.nodes.points, solved.nodes.displacement)
    try:
        known = solve_groups(system, groups_of(scene), u)
    except reference.ReferenceError as error:
        if not passed:
            return "degraded", f"{error}; {solved.summary['certificate']}"
        residual = optimality(system, u)
        detail = f"{error}; ours leave {residual:.1e} of the optimality conditions"
        kind = "invents an equilibrium" if escapes else "undecided"
        return "agrees" if residual < max(OPTIMAL, tolerance) else kind, detail
    if not passed:
        digits = all(body.has_digits(tolerance) for body in known.bodies)
        return "given up" if digits else "degraded", str(solved.summary["certificate"])
    return _compared(solved, known, u, tolerance)


def _compared(solved: Any, known: Known, u: np.ndarray | None, tolerance: float) -> tuple[str, str]:
    """The verdict on an answer that is certified, where the right one is known."""
    if u is None:
        return "undecided", "the nodes of the reference are others"
    energy = solved.summary["solution"]["energy"]
    # the energy told is above the least one by at most the duality gap, which the certificate
    # holds below the tolerance; so it does the error of each body
    allowed = max(ENERGY, 1.01 * tolerance)
    allowed = allowed * max(abs(known.energy), known.floor) + known.blur
    if not abs(energy - known.energy) <= allowed:
        return "certified wrongly", f"energy {energy!r}, reference {known.energy!r}"
    error, body = known.worst(u)
    detail = f"squared error of body {body} is {error:.1e} of its strains"
    return ("agrees" if error <= ACCURATE * tolerance else "certified wrongly"), detail


def reference_contradicts(scene: Any) -> bool:
    """Whether the reference finds held nodes inside an obstacle, too."""
    try:
        reference.solve(scene)
    except reference.ReferenceError as error:
        return "held node penetrates" in str(error)
    return False


def overlap_at_nodes(system: reference.System) -> float:
    """Least penetration that some node cannot avoid, whatever the bodies' stiffness."""
    worst = 0.0
    contact, d = sp.csr_matrix(system.contact), system.dimension
    for node in np.unique(system.contact_node):
        dofs = node * d + np.arange(d)
        rows = np.flatnonzero(system.contact_node == node)
        # mortar rows see other nodes, too, which can give way
        rows = rows[contact[rows].getnnz(axis=1) == contact[rows][:, dofs].getnnz(axis=1)]
        if len(rows) == 0:
            continue
        normals = contact[rows][:, dofs].toarray()
        gaps = system.gap[rows] - normals @ system.prescribed[dofs]
        normals = normals[:, ~system.held[dofs]]
        if not normals.any():
            continue
        found = linprog(  # least t with normals u ≤ gaps + t
            np.append(np.zeros(normals.shape[1]), 1.0),
            A_ub=np.column_stack([normals, -np.ones(len(rows))]),
            b_ub=gaps,
            bounds=[(None, None)] * normals.shape[1] + [(0.0, None)],
            method="highs",
        )
        worst = max(worst, float(found.fun) if found.status == 0 else 0.0)
    return worst


def optimality(system: reference.System, u: np.ndarray | None) -> float:
    """Residual of displacements in the undecomposed system, with the best contact forces for them.

    The forces are the non-negative least squares solution for the rows that are closed.
    """
    if u is None:
        return np.inf
    free = ~system.held
    K, B = system.stiffness, sp.csr_matrix(system.contact)
    slack = system.gap - B @ u
    closed = slack <= 1e-6 * max(np.abs(u).max(), np.abs(system.gap).min(initial=0.0))
    multiplier = np.zeros(len(slack))
    if closed.any():
        needed = (system.load - K @ u)[free]
        rows = B[closed][:, free]
        scale = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
        scale[scale < 1e-12] = np.inf
        found = lsq_linear(
            (rows.toarray() / scale[:, None]).T, needed, bounds=(0.0, np.inf), method="bvls"
        )
        multiplier[closed] = found.x / scale
    u_held = np.where(system.held, u, 0.0)
    return reference.optimality(
        K[free][:, free],
        (system.load - K @ u_held)[free],
        B[:, free],
        system.gap - B @ u_held,
        u[free],
        multiplier,
    )


def escape_work(system: reference.System, group: Any) -> float:
    """Largest work of the loads on rigid motions of some bodies that no condition stops.

    Relative to the sum of the loads' magnitudes times the size of a body. Zero when the bodies can
    be in equilibrium; by linear programming, independent of the application.
    """
    nodes = np.flatnonzero(np.isin(system.body, group))
    dofs = (nodes[:, None] * system.dimension + np.arange(system.dimension)).ravel()
    blocks = []
    for body in group:
        points = system.points[system.body == body]
        points = points - points.mean(axis=0)
        blocks.append(motions_at(points / np.abs(points).max(), system.dimension))
    R = block_diag(*blocks)
    rows = sp.csr_matrix(system.contact)[:, dofs] @ R
    # a row whose nodes are held sees only what is left of it
    held, load = R[system.held[dofs]], system.load[dofs]
    scale = float(np.abs(load).sum())
    if scale == 0.0:
        return 0.0
    seen = np.abs(rows).max(axis=1, initial=0.0) > 1e-12
    found = linprog(
        -(load @ R) / scale,
        A_ub=np.vstack([rows[seen], np.zeros((1, R.shape[1]))]),
        b_ub=np.zeros(int(seen.sum()) + 1),
        A_eq=np.vstack([held, np.zeros((1, R.shape[1]))]),
        b_eq=np.zeros(len(held) + 1),
        bounds=(-1.0, 1.0),
        method="highs",
    )
    return -float(found.fun) if found.status == 0 else 0.0


if __name__ == "__main__":
    sys.exit(verdicts.main(__doc__, judge, method="auto"))
