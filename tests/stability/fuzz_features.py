"""Random scenes with new features: ``python -m tests.stability.fuzz_features 300``.

Every scene of `feature_scenes` must end in one of these ways:

agrees      certified, with the displacements of the undecomposed reference (`coupled_reference`) in
            energy norm, and its motions of rigid bodies
escapes     refused for want of an equilibrium, and a linear programme finds the escape, too
contradicts held nodes are pushed into an obstacle; the reference finds so, too
slides      where a rigid body was brought by an answer it leaves, and the run says so
degraded    not certified, and says so, where the reference has no answer, where rigid bodies do not
            come to rest, or where a body is moved so far that no digit is left of its strains
undecided   certified, where the reference has no answer

Anything else is a fault.
"""

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import lsq_linear

from contact_app.errors import NoEquilibriumError
from contact_app.run.solve import solve_scene
from tests import coupled_reference, reference
from tests.coupled_reference import Coupled
from tests.stability import verdicts
from tests.stability.feature_scenes import feature_scene
from tests.stability.fuzz import OPTIMAL, optimality
from tests.stability.groups import in_order, motions_at
from tests.stability.verdicts import Verdict, attempt

ACCURATE = 4e-8
"""Squared relative error in energy norm of an answer that agrees; the tolerance is 1e-8."""

MOVED = 1e-5
"""Difference of the motions of rigid bodies, over the largest displacement."""

AT_REST = 1e-9
"""Displacement of the elastic bodies over that of the rigid ones, or over the largest force by the
largest stiffness of a node, below which they are at rest: a plane that slides out of the way of a
block, or conditions and ties that hold every loaded node, leave rounding errors alone."""

STRAINLESS = 1e-9
"""Strains that are rounding errors of rigid motions, over displacements by the size of a cell."""

CLOSED = 1e-12
"""Gap over the length of the bodies that is a rounding error."""

HELD_APART = ("push held nodes", "no room", "no displacement satisfies both")
"""Words of the messages about conditions that contradict each other."""

ESCAPES = 1e-7
"""Work on a motion that nothing stops, over the loads, which is none."""


def judge(
    seed: int, *, solve: Any = solve_scene, patience: float = 120.0, method: str = "auto"
) -> Verdict:
    """Solve a random scene and hold it against the reference.

    Parameters
    ----------
    solve
        In place of `solve_scene`.
    patience
        Seconds of processor time after which it is said to hang.
    method
        `solver.method`; another than `auto` takes its own decomposition.
    """
    made, subdomains = feature_scene(seed)
    if method != "auto":
        made["solver"]["method"], subdomains = method, None
    done = attempt(made, subdomains, solve, patience)
    scene, solved, seconds = done.scene, done.solved, done.seconds
    if done.fault is not None:
        return Verdict(seed, *done.fault, seconds)
    message = str(done.error)
    if done.error is not None and not isinstance(done.error, NoEquilibriumError):
        return Verdict(seed, "gives up", message, seconds)
    if solved is None and "earlier solves have moved them" in message:
        return Verdict(seed, "slides", message, seconds)
    if solved is None and any(words in message for words in HELD_APART):
        kind = "contradicts" if _contradicts(scene) else "denies an equilibrium"
        return Verdict(seed, kind, message, seconds)
    if solved is None:
        work = coupled_reference.escape_work(coupled_reference.assemble(scene))
        kind = "escapes" if work > ESCAPES else "denies an equilibrium"
        return Verdict(seed, kind, message, seconds)
    kind, detail = _judged(solved)
    told = solved.summary["solver"]
    return Verdict(seed, kind, detail, seconds, told["hessian_multiplications"], told["method"])


def _contradicts(scene: Any) -> bool:
    """Whether the reference has no answer, either."""
    try:
        coupled_reference.solve(coupled_reference.assemble(scene))
    except reference.ReferenceError:
        return True
    return False


def _judged(solved: Any) -> tuple[str, str]:
    """The verdict on an answer: the reference is of the scene as its rigid bodies are placed."""
    scene, certificate = solved.model.scene, solved.summary["certificate"]
    coupled = coupled_reference.assemble(scene)
    passed = certificate["passed"]
    try:
        known = coupled_reference.solve(coupled)
    except reference.ReferenceError as error:
        if not passed:
            return "degraded", f"{error}; {certificate['warnings']}"
        found = _answer(solved, coupled)
        if _at_rest(coupled, found):
            return "agrees", f"{error}; ours are rigid motions within the gaps, without a load"
        if _stopped(coupled, found):
            return "agrees", f"{error}; nothing moves, and forces on closed rows balance the loads"
        residual = optimality(coupled.system, found)
        if residual < OPTIMAL:
            return "agrees", f"{error}; ours leave {residual:.1e} of the optimality conditions"
        escapes = coupled_reference.escape_work(coupled) > ESCAPES
        kind = "invents an equilibrium" if escapes else "undecided"
        return kind, f"{error}; ours leave {residual:.1e} of the optimality conditions"
    if not passed:
        honest = (
            "positions of the rigid bodies still change",
            "is hardly strained: rounding errors",
        )
        told = any(words in text for text in certificate["warnings"] for words in honest)
        return ("degraded" if told else "given up"), str(certificate)
    system, d, n = coupled.system, scene.dimension, coupled.meshed
    K = system.stiffness[: n * d][:, : n * d]
    found = _answer(solved, coupled)
    error = found[: n * d] - known[:n].ravel()
    right = known[:n].ravel()
    least = _least(coupled)
    still = max(np.abs(found[: n * d]).max(), np.abs(right).max()) < least
    if still and max(np.abs(found).max(), np.abs(known).max()) < least:
        return "agrees", "nothing moves"
    scale = abs(_energy(system, known.ravel())) if still else float(right @ (K @ right))
    scale = scale or 1.0
    strained = _without_rigid_motions(system, error)
    away = 0.0 if still else abs(float(strained @ (K @ strained))) / scale
    largest = max(float(np.abs(right).max()), float(np.abs(found[: n * d]).max()), 1e-300)
    rigid = float(np.abs(known[n:]).max(initial=0.0))
    largest = rigid if still else max(largest, AT_REST * rigid)
    turned = _rigid_error(solved, found[n * d :].reshape(-1, d), known[n:]) / largest
    detail = f"squared error {away:.1e}, rigid bodies off by {turned:.1e}"
    if away <= ACCURATE and turned > MOVED:  # what no active contact decides has many answers
        entered = float((system.contact @ found - system.gap).max(initial=0.0)) / largest
        detail += f", rows entered by {entered:.1e}"
        worse = _energy(system, found) - _energy(system, known.ravel())
        detail += f", energy higher by {worse / (scale + abs(_energy(system, found))):.1e}"
        fits = entered <= OPTIMAL and worse <= OPTIMAL * scale
        return ("agrees" if fits else "certified wrongly"), detail
    return ("agrees" if away <= ACCURATE else "certified wrongly"), detail


def _least(coupled: Coupled) -> float:
    """Displacement below which bodies are at rest: `AT_REST`, of forces over stiffness."""
    system, d, n = coupled.system, coupled.system.dimension, coupled.meshed
    forces = np.concatenate(
        [system.load[: n * d].reshape(-1, d), system.load[n * d :].reshape(-1, 2, d)[:, 0]]
    )
    return AT_REST * float(np.abs(forces).max() / system.stiffness.diagonal().max())


def _stopped(coupled: Coupled, found: np.ndarray) -> bool:
    """Whether nothing moves but what is prescribed, and closed rows can bear all loads.

    Conditions, ties and contact stop each loaded node. Displacements are rounding errors, so that
    no residual of theirs means anything; that of the displacements without them does.
    """
    system = coupled.system
    exact = np.where(system.held, system.prescribed, 0.0)
    if np.abs(found - exact).max() >= _least(coupled):
        return False
    slack = system.gap - system.contact @ exact
    length = float(np.ptp(system.points[: coupled.meshed], axis=0).max())
    if slack.min(initial=0.0) < -CLOSED * length:
        return False
    rows = sp.csr_matrix(system.contact)[np.abs(slack) <= CLOSED * length][:, ~system.held]
    needed = (system.load - system.stiffness @ exact)[~system.held]
    borne = lsq_linear(rows.T.toarray(), needed, bounds=(0.0, np.inf), method="bvls")
    return float(np.linalg.norm(borne.fun)) <= OPTIMAL * float(np.linalg.norm(system.load))


def _at_rest(coupled: Coupled, found: np.ndarray) -> bool:
    """Whether no load acts, and displacements strain nothing and keep all rows and held values."""
    system, dofs = coupled.system, coupled.meshed * coupled.system.dimension
    largest, K = float(np.abs(found).max()), system.stiffness[:dofs][:, :dofs]
    strained = _without_rigid_motions(system, found[:dofs])
    energy = float(strained @ (K @ strained))
    entered = float((system.contact @ found - system.gap).max(initial=0.0))
    moved = float(np.abs(found - system.prescribed)[system.held].max(initial=0.0))
    return (
        not system.load.any()
        and energy <= STRAINLESS**2 * K.diagonal().max() * largest**2
        and max(entered, moved) <= OPTIMAL * largest
    )


def _without_rigid_motions(system: reference.System, error: np.ndarray) -> np.ndarray:
    """A difference of displacements without the rigid motion of each body, which strains nothing.

    Where a body may slide, the two answers are at different places, and products of K with the
    slide leave rounding errors larger than the strains.
    """
    result, d = error.copy(), system.dimension
    bodies = system.body[: len(error) // d]
    for body in np.unique(bodies):
        nodes = np.flatnonzero(bodies == body)
        dofs = (nodes[:, None] * d + np.arange(d)).ravel()
        points = system.points[nodes] - system.points[nodes].mean(axis=0)
        motions = motions_at(points / np.abs(points).max(), d)
        result[dofs] -= motions @ np.linalg.lstsq(motions, error[dofs], rcond=None)[0]
    return result


def _energy(system: reference.System, u: np.ndarray) -> float:
    return float(0.5 * u @ (system.stiffness @ u) - system.load @ u)


def _answer(solved: Any, coupled: Coupled) -> np.ndarray:
    """The unknowns of an answer in the order of the reference."""
    system, n, scene = coupled.system, coupled.meshed, solved.model.scene
    meshed = replace(system, points=system.points[:n], body=system.body[:n])
    found = in_order(meshed, solved.nodes.points, solved.nodes.displacement)
    assert found is not None, "the nodes of the reference are others"
    parts = [found]
    for number in scene.moving:
        record = solved.summary["rigid_bodies"][scene.rigid.bodies[number].name]
        own = np.zeros(2 * scene.dimension)
        own[: scene.dimension] = record["displacement"]
        turn = np.atleast_1d(record["rotation"])
        own[scene.dimension : scene.dimension + len(turn)] = turn
        parts.append(own)
    return np.concatenate(parts)


def _rigid_error(solved: Any, found: np.ndarray, known: np.ndarray) -> float:
    """Largest difference of displacements, and of rotations times the length of the scene.

    Of motions that no row sees neither answer is the right one: they are left out.
    """
    scene = solved.model.scene
    length = max(float(np.ptp([b.mesh.lower, b.mesh.upper], axis=0).max()) for b in scene.bodies)
    free = [w for w in solved.summary["certificate"]["warnings"] if "can move freely" in w]
    worst = 0.0
    for nth, number in enumerate(scene.moving):
        name = scene.rigid.bodies[number].name
        if any(w.startswith(name) or f"{name}" in w.split(" can move")[0] for w in free):
            continue
        error = np.abs(found[2 * nth : 2 * nth + 2] - known[2 * nth : 2 * nth + 2]).max(axis=1)
        worst = max(worst, float(error[0]), length * float(error[1]))
    return worst


if __name__ == "__main__":
    sys.exit(verdicts.main(__doc__, judge, method="auto"))
