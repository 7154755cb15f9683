"""The records of an answer in ``summary.json``."""

from collections.abc import Sequence
from hashlib import sha1
from typing import Any

import numpy as np

from contact_app.model.model import Model
from contact_app.results.contacts import contact_records
from contact_app.results.fields import NodeFields
from contact_app.results.free_motions import free_motions
from contact_app.results.friction import dissipated_work
from contact_app.results.mirror import whole_summary
from contact_app.results.probes import probe_records
from contact_app.results.reactions import hold_records, reaction_records
from contact_app.results.rigid import rigid_records
from contact_app.results.sections import section_records
from contact_app.results.ties import in_order_of_file, tie_records
from solver.contact.row_kinds import RowKind
from solver.contact.solution import Solution
from solver.driver import reason_text
from solver.tfeti.dual import DualProblem
from solver.tfeti.subdomain.classes import FactoredClass


def summary_of(
    model: Model, solution: Solution, nodes: NodeFields, peaks: Sequence[float | None]
) -> dict[str, Any]:
    """`summary.json` of an answer, without timings, environment and accuracy (collective).

    Parameters
    ----------
    peaks
        The largest smoothed pressures of contacts where they are not those at nodes.
    """
    scene, comm = model.scene, model.comm
    summary = summary_of_solution(model, solution)
    summary["solution"] |= _totals(model, solution, nodes)
    pairs, forces = scene.pairs, comm.allreduce(nodes.pair_forces)
    summary["solution"]["pair_forces"] = {
        pair.source: [float(f) for f in force] for pair, force in zip(pairs, forces, strict=True)
    }
    ties = tie_records(model, solution, nodes.surface)
    records = contact_records(model, nodes, peaks)
    summary["contacts"] = in_order_of_file((*scene.contact_names, *scene.tie_names), records, ties)
    summary["reactions"] = reaction_records(model, solution, nodes)
    if scene.rigid.bodies:
        summary |= rigid_records(model, solution, nodes, summary["reactions"], ties)
    summary["reactions"] += hold_records(model, solution)
    slides = free_motions(model, solution)
    if slides:
        names = [body.name for body in scene.bodies]
        summary["free_motions"] = [slide.record(names[slide.body]) for slide in slides]
    if model.probes:
        summary["probes"] = probe_records(model, solution)
    if model.sections:
        summary["sections"] = section_records(model, solution, nodes)
    return whole_summary(summary, model.geometry, nodes) if scene.mirrors else summary


def summary_of_solution(model: Model, solution: Solution) -> dict[str, Any]:
    """The part of `summary.json` that needs no fields at nodes and cells (collective)."""
    problem, scene = model.problem, model.scene
    multiplier = solution.multiplier[problem.inequality]
    certificate = solution.certificate.as_dict()
    decides = solution.certificate.deciding(solution.tolerance)
    if decides is not None:
        certificate["decided_by"] = model.geometry.body_names[decides]
    return {
        "scene": {"title": scene.title, "dimension": scene.dimension},
        "mesh": {
            "cells": model.partition.cells,
            "nodes": model.partition.nodes,
            "dofs": model.dofs,
        },
        "decomposition": decomposition_record(problem, model.partition.count),
        "solver": solver_record(solution),
        "solution": {
            "energy": solution.measures.energy,
            "active_contacts": model.comm.allreduce(int((multiplier > 0.0).sum())),
        },
        "certificate": certificate,
    }


def _totals(model: Model, solution: Solution, nodes: NodeFields) -> dict[str, Any]:
    """The numbers of `solution` that come from the fields of all ranks (collective)."""
    comm, magnitude = model.comm, np.linalg.norm(nodes.displacement, axis=1)
    largest = [magnitude.max(initial=0.0), nodes.contact_pressure.max(initial=0.0)]
    displacement, pressure = np.max(comm.allgather(largest), axis=0)
    totals = {
        "max_displacement": float(displacement),
        "mean_displacement": comm.allreduce(float(magnitude.sum())) / model.partition.nodes,
        "contact_force": [float(f) for f in comm.allreduce(nodes.contact_force)],
        "max_contact_pressure": float(pressure),
    }
    if model.scene.has_friction:
        totals["dissipated_work"] = dissipated_work(model.problem, solution, model.pressed_before)
    return totals


def decomposition_record(problem: DualProblem, subdomains: int) -> dict[str, Any]:
    """`decomposition` of a summary: sizes of the dual problem (collective).

    Parameters
    ----------
    subdomains
        Number of subdomains on all ranks.
    """
    tied, tangential = (problem.count(kind) for kind in (RowKind.TIED, RowKind.TANGENT))
    holding = RowKind.DIRICHLET, RowKind.SUPPORT, RowKind.MEAN
    return {
        "subdomains": subdomains,
        "congruence_classes": distinct_classes(problem),
        "dual": problem.comm.allreduce(problem.size),
        "gluing": problem.count(RowKind.GLUING),
        "dirichlet": sum(map(problem.count, holding)),
        "contact": problem.count(RowKind.CONTACT),
        **({"tied": tied} if tied else {}),
        **({"tangential": tangential} if tangential else {}),
    }


def distinct_classes(problem: DualProblem) -> int:
    """Number of classes of equal stiffness on all ranks; a class on several ranks counts once."""
    classes = {_without_round_off(cls) for cls in problem.classes}
    return len(set().union(*problem.comm.allgather(classes)))


def _without_round_off(cls: FactoredClass) -> tuple[str, ...]:
    """Numbers that tell classes apart; ranks have one from others of its similar subdomains."""
    K, probe = cls.stiffness, np.sin(np.arange(cls.unknowns))
    energies = probe @ (K @ probe), np.abs(probe) @ K.diagonal()
    free = sha1(cls.free.tobytes(), usedforsecurity=False).hexdigest()
    return (*(f"{energy:.6e}" for energy in energies), free)


def solver_record(solution: Solution) -> dict[str, Any]:
    """`solver` of a summary: method, reason of the end, and work."""
    counts = solution.counts
    return {
        "method": solution.method,
        "converged": solution.converged,
        "tolerance": solution.tolerance,
        "reason": reason_text(solution),
        "outer_iterations": counts.outer,
        "hessian_multiplications": counts.hessian,
        "cg_steps": counts.cg,
        "expansion_steps": counts.expansion,
        "proportioning_steps": counts.proportioning,
        "norm_estimation_multiplications": counts.norm_estimation,
    }
