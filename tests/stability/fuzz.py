"""Random scenes against the undecomposed reference: ``python -m tests.stability.fuzz 500``.

Every scene must end, within its time, in one of these ways:

agrees        certified, with the energy of the independent active-set solution, or, where that
              misses its own tolerance, with the optimality conditions of the undecomposed system
degraded      not certified, and says so; the energy need not be right
escapes       refused for want of an equilibrium, and a linear programme finds the escape, too
contradicts   held nodes are pushed into an obstacle, or two obstacles leave a node no room; the
              reference, or a linear programme for each node, finds so, too
refused       input that is refused in a sentence
undecided     certified, where the reference says neither yes nor no

Anything else is a fault: a crash, a scene that hangs, an answer certified wrongly, an equilibrium
denied that exists, or one found that does not.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import block_diag
from scipy.optimize import linprog, lsq_linear
from scipy.spatial import cKDTree

from contact_app.studies.time_limit import OutOfTime, time_limit
from tests import extended, reference, scenes
from tests.stability.random_scenes import random_scene

PATIENCE = 60.0
"""Seconds of processor time after which a scene of a few thousand unknowns is said to hang."""

ENERGY = 1e-6
"""Relative difference of energies that a certified answer may leave; the tolerance is 1e-8."""

OPTIMAL = 1e-6
"""Relative residual of the optimality conditions that shows an answer to be right."""

REFERENCE = 1e-7
"""Relative residual of the optimality conditions that the reference may leave here."""

EXTENDED = 1500
"""Unknowns of a body up to which extended precision decides where the reference fails."""

MARK = "<!-- python -m tests.stability.fuzz 500 --document docs/stability.md -->"
"""Line of the document below which the counts stand."""

GOOD = ("agrees", "degraded", "escapes", "contradicts", "refused", "undecided")


@dataclass(frozen=True)
class Verdict:
    """How one scene ended: one of :data:`GOOD`, or a fault; with details and seconds."""

    seed: int
    kind: str
    detail: str
    seconds: float
    products: int = 0

    @property
    def fault(self) -> bool:
        return self.kind not in GOOD


def judge(seed: int) -> Verdict:
    """Solve a random scene and compare it with the reference."""
    from contact_app.errors import ConfigurationError, ContactError, NoEquilibriumError
    from contact_app.run import solve_scene

    made, subdomains = random_scene(seed)
    summary: dict[str, Any] | None = None
    message = ""
    began = time.process_time()
    try:
        with time_limit(PATIENCE):
            scene = scenes.build(made, subdomains)
            solved = solve_scene(scene)
            summary = solved.summary
    except NoEquilibriumError as error:
        message = str(error)
    except (ConfigurationError, ContactError) as error:
        kind = "refused" if isinstance(error, ConfigurationError) else "gives up"
        return Verdict(seed, kind, str(error)[:300], time.process_time() - began)
    except OutOfTime:
        return Verdict(seed, "hangs", f"{subdomains}", time.process_time() - began)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return Verdict(seed, "crashes", f"{error!r} at {where}", time.process_time() - began)
    seconds = time.process_time() - began

    system = reference.assemble(scene)
    bodies = [np.unique(system.body)] if scene.pairs else [[b] for b in np.unique(system.body)]
    escapes = max(escape_work(system, group) for group in bodies) > 1e-7
    if summary is None:
        kind = "escapes" if escapes else "denies an equilibrium"
        if "push held nodes" in message and reference_contradicts(scene):
            kind = "contradicts"
        if "no room" in message and overlap_at_nodes(system) > 0.0:
            kind = "contradicts"
        return Verdict(seed, kind, message, seconds)
    products = summary["solver"]["hessian_multiplications"]
    if not summary["certificate"]["passed"]:
        return Verdict(seed, "degraded", str(summary["certificate"]), seconds, products)
    if overlap_at_nodes(system) > 1e-6 * float(np.ptp(system.points, axis=0).max()):
        return Verdict(seed, "invents an equilibrium", "nodes overlap", seconds, products)
    try:
        near = in_order(system, *solved.displacement_at_nodes())
        known, stored = energy_by_body(system, bodies, near)
    except reference.ReferenceError as error:
        residual = optimality(system, *solved.displacement_at_nodes())
        detail = f"{error}; ours leave {residual:.1e} of the optimality conditions"
        kind = "invents an equilibrium" if escapes else "undecided"
        enough = max(OPTIMAL, float(summary["solver"]["tolerance"]))
        return Verdict(seed, "agrees" if residual < enough else kind, detail, seconds, products)
    energy = summary["solution"]["energy"]
    # the energy told is above the least one by at most the duality gap, which the certificate
    # holds below the tolerance
    allowed = max(ENERGY, 1.01 * float(summary["solver"]["tolerance"]))
    if abs(energy - known) <= allowed * max(abs(known), 1e-9 * stored):
        return Verdict(seed, "agrees", "", seconds, products)
    detail = f"energy {energy!r}, reference {known!r}"
    return Verdict(seed, "certified wrongly", detail, seconds, products)


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


def in_order(system: reference.System, points: np.ndarray, u: np.ndarray) -> np.ndarray | None:
    """Displacements in the order of the reference's unknowns; None where points do not match."""
    distance, order = cKDTree(points).query(system.points)
    extent = np.ptp(system.points, axis=0).max()
    if distance.max() > 1e-9 * extent or np.unique(order).size < order.size:
        return None
    return np.asarray(u[order].ravel())


def energy_by_body(
    system: reference.System, groups: Sequence[Any], near: np.ndarray | None = None
) -> tuple[float, float]:
    """Energy of the solution, and the size of the stored energy and work that cancel in it.

    Bodies that do not see each other are solved each in its own unit of force: a soft body's
    accuracy does not suffer from a stiff neighbour. Those on which the reference fails in double
    precision are solved in extended precision, beginning with what is closed in `near`.
    """
    energy = stored = 0.0
    contact = sp.csr_matrix(system.contact)
    for group in groups:
        nodes = np.flatnonzero(np.isin(system.body, group))
        dofs = (nodes[:, None] * system.dimension + np.arange(system.dimension)).ravel()
        rows = np.isin(system.contact_node, nodes)
        K, load, B = system.stiffness[dofs][:, dofs], system.load[dofs], contact[rows][:, dofs]
        free, u = ~system.held[dofs], system.prescribed[dofs].copy()
        extent = float(np.ptp(system.points[nodes], axis=0).max())
        programme = K[free][:, free], (load - K @ u)[free], B[:, free], system.gap[rows] - B @ u
        try:
            u[free] = reference.minimise(*programme, extent, tolerance=REFERENCE)[0]
        except reference.ReferenceError:
            if near is None or free.sum() > EXTENDED:
                raise
            found = extended.minimise(*programme, near[dofs][free])
            if found is None:
                raise
            u[free] = found
        work, strain = float(load @ u), 0.5 * float(u @ (K @ u))
        energy += strain - work
        stored += strain + abs(work)
    return energy, stored


def optimality(system: reference.System, points: np.ndarray, u: np.ndarray) -> float:
    """Residual of displacements in the undecomposed system, with the best contact forces for them.

    The forces are the non-negative least squares solution for the rows that are closed.
    """
    ours = in_order(system, points, u)
    if ours is None:
        return np.inf
    u, free = ours, ~system.held
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
        blocks.append(_rigid_motions(points / np.abs(points).max(), system.dimension))
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


def _rigid_motions(points: np.ndarray, dimension: int) -> np.ndarray:
    """Translations and infinitesimal rotations at the points, shape (n·dimension, 3 or 6)."""
    columns = [np.tile(np.eye(dimension)[i], len(points)) for i in range(dimension)]
    for a, b in ((0, 1), (1, 2), (0, 2))[: 1 if dimension == 2 else 3]:
        turn = np.zeros((len(points), dimension))
        turn[:, a], turn[:, b] = -points[:, b], points[:, a]
        columns.append(turn.ravel())
    return np.array(columns).T


def summary(verdicts: Sequence[Verdict]) -> str:
    """Counts of verdicts, a table in Markdown, and the hardest scenes."""
    counts = Counter(v.kind for v in verdicts)
    slowest = max(verdicts, key=lambda v: v.seconds)
    hardest = max(verdicts, key=lambda v: v.products)
    rows = [f"| {kind} | {count} |" for kind, count in counts.most_common()]
    first, last = verdicts[0].seed, verdicts[-1].seed
    return "\n".join(
        [
            f"| seeds {first} to {last} | {len(verdicts)} |",
            "|---|---:|",
            *rows,
            "",
            f"Slowest: seed {slowest.seed}, {slowest.seconds:.0f} s ({slowest.kind}); most "
            f"products: seed {hardest.seed}, {hardest.products:,} ({hardest.kind}). Not certified: "
            f"{_seeds(verdicts, 'degraded')}; undecided: {_seeds(verdicts, 'undecided')}.",
        ]
    )


def _seeds(verdicts: Sequence[Verdict], kind: str) -> str:
    return ", ".join(str(v.seed) for v in verdicts if v.kind == kind) or "none"


def main() -> int:
    """Judge scenes, tell faults as they come, count at the end; exit code 1 if there was one."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scenes", type=int, nargs="?", default=500)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--document", type=Path, help="docs/stability.md, to write the counts into")
    arguments = parser.parse_args()
    verdicts = []
    for seed in range(arguments.first, arguments.first + arguments.scenes):
        verdict = judge(seed)
        verdicts.append(verdict)
        if verdict.kind in ("agrees", "escapes", "contradicts") and verdict.seconds < 10.0:
            continue
        print(
            f"scene {seed}: {verdict.kind} ({verdict.seconds:.1f} s) {verdict.detail}", flush=True
        )
    told = summary(verdicts)
    print(told)
    if arguments.document is not None:
        text = arguments.document.read_text(encoding="utf-8")
        before, mark, _ = text.partition(MARK)
        if not mark:
            raise SystemExit(f"{arguments.document} has no line that says {MARK}")
        arguments.document.write_text(f"{before}{MARK}\n\n{told}\n", encoding="utf-8")
    return int(any(v.fault for v in verdicts))


if __name__ == "__main__":
    sys.exit(main())
