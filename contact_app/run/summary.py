"""The summary of a solved scene, the content of `summary.json`."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha1
from typing import Any

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.machine.environment import environment
from contact_app.machine.timings import Timings
from contact_app.model.model import Model
from contact_app.results.contacts import contact_records
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


@dataclass(frozen=True)
class Totals:
    """The numbers of `summary.json` that come from the fields of an answer, over all ranks.

    Attributes
    ----------
    max_displacement, mean_displacement
        Largest and mean |u| over the nodes of the undecomposed mesh, lengths.
    contact_force : (3,)
        Resultant force of the obstacles on the bodies.
    max_contact_pressure
    """

    max_displacement: float
    mean_displacement: float
    contact_force: tuple[float, ...]
    max_contact_pressure: float


def summary_of(solved: SolvedScene) -> dict[str, Any]:
    """`summary.json` of a solved scene (collective)."""
    comm, nodes, partition = solved.model.comm, solved.nodes, solved.model.partition
    magnitude = np.linalg.norm(nodes.displacement, axis=1)
    totals = Totals(
        comm.allreduce(float(magnitude.max(initial=0.0)), op=MPI.MAX),
        comm.allreduce(float(magnitude.sum())) / partition.nodes,
        tuple(float(f) for f in comm.allreduce(nodes.contact_force)),
        comm.allreduce(float(nodes.contact_pressure.max(initial=0.0)), op=MPI.MAX),
    )
    summary = summarise(solved.model, solved.solution, totals, solved.timings)
    pairs, forces = solved.model.scene.pairs, comm.allreduce(nodes.pair_forces)
    summary["solution"]["pair_forces"] = {
        pair.source: [float(f) for f in force] for pair, force in zip(pairs, forces, strict=True)
    }
    summary["contacts"] = in_order_of_file(
        solved.model.scene, contact_records(solved.model, nodes),
        tie_records(solved.model, solved.solution),
    )  # fmt: skip
    summary["reactions"] = reaction_records(solved.model, solved.solution, nodes)
    if solved.model.scene.rigid_bodies:
        summary |= rigid_records(solved.model, solved.solution, nodes, summary["reactions"])
    summary["reactions"] += hold_records(solved.model, solved.solution)
    slides = free_motions(solved.model, solved.solution)
    if slides:
        bodies = solved.model.scene.bodies
        summary["free_motions"] = [slide.record(bodies[slide.body].name) for slide in slides]
    if solved.model.probes:
        summary["probes"] = probe_records(solved.model, solved.solution)
    if solved.model.sections:
        summary["sections"] = section_records(solved.model, solved.solution, nodes)
    summary["accuracy"] = solved.accuracy.as_dict()
    if solved.communication is not None:
        summary["solver"]["communication_per_multiplication"] = solved.communication
    if solved.model.scene.mirrors:
        return whole_summary(summary, solved.model, nodes)
    return summary


def summarise(model: Model, solution: Solution, totals: Totals, timings: Timings) -> dict[str, Any]:
    """The part of `summary.json` that needs no fields at all nodes and cells (collective)."""
    problem, scene, comm = model.problem, model.scene, model.comm
    multiplier = solution.multiplier[problem.inequality]
    certificate = solution.certificate.as_dict()
    decides = solution.certificate.deciding(solution.tolerance)
    if decides is not None:
        certificate["decided_by"] = scene.body_names[decides]
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
            "max_displacement": totals.max_displacement,
            "mean_displacement": totals.mean_displacement,
            "active_contacts": comm.allreduce(int((multiplier > 0.0).sum())),
            "contact_force": list(totals.contact_force),
            "max_contact_pressure": totals.max_contact_pressure,
            **(
                {"dissipated_work": dissipated_work(problem, solution)}
                if scene.has_friction
                else {}
            ),
        },
        "certificate": certificate,
        "timings": timings.as_dict(),
        "environment": environment(comm),
    }


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
        "congruence_classes": _distinct_classes(problem),
        "dual": problem.comm.allreduce(problem.size),
        "gluing": problem.count(RowKind.GLUING),
        "dirichlet": sum(map(problem.count, holding)),
        "contact": problem.count(RowKind.CONTACT),
        **({"tied": tied} if tied else {}),
        **({"tangential": tangential} if tangential else {}),
    }


def _distinct_classes(problem: DualProblem) -> int:
    """Number of classes of equal stiffness on all ranks; a class on several ranks counts once."""
    found = []
    for cls in problem.classes:
        K = cls.stiffness
        seen = K @ np.sin(np.arange(K.shape[0])), K.diagonal(), np.asarray(cls.free, float)
        found.append(sha1(np.concatenate(seen).tobytes(), usedforsecurity=False).digest())
    return len(set().union(*problem.comm.allgather(found)))


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
