"""The cost of a run, estimated from the outline of its model.

Time is estimated from the sizes of the subdomains by the model that chooses the decomposition
(`solver.tfeti.subdomain.costs`), for the Hessian multiplications that bodies of such a shape needed
in measurements; a badly conditioned scene needs several times as many. Each cell adds its share of
error estimate and output. docs/benchmarks/speed.md compares estimates with runs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from contact_app.machine.memory import available_bytes, needed_bytes
from contact_app.model.decomposition import APPLICATIONS_GLUED, APPLICATIONS_WHOLE
from contact_app.model.outline import Outline
from contact_app.scene.bodies import Body
from contact_app.scene.scene import Decomposition
from meshes import Subdomain
from meshes.arrays import Ints
from solver.tfeti.subdomain.costs import Group, run_seconds

AUTOMATIC = 1e-3
"""Expected value of an automatic tolerance."""

CELL_RATE = {2: 8e-7, 3: 2e-6}
"""Seconds per cell for error estimate, fields and output, by dimension."""

PACE = 0.6
"""Ratio of measured seconds to those of the cost model, which was fitted on a slower machine."""

STEP_SECONDS = 7e-4
"""Seconds of calls and exchanges per operator application with gluing, for any decomposition."""

STARTED = 0.022
"""Constant seconds of a run of any size."""


@dataclass(frozen=True)
class Cost:
    """Estimated peak memory (bytes) and time (seconds) of a run on one process."""

    memory: float
    seconds: float


def estimate(
    outline: Outline, decomposition: Decomposition, tolerance: float | Literal["auto"]
) -> Cost:
    """The cost of a run by the formulas of this module and of `memory` (collective)."""
    partition, d = outline.partition, outline.partition.dimension
    gluing, groups = gluing_rows(outline), groups_of(outline, decomposition)
    contact = partition.comm.allreduce(len(outline.contact.gaps))
    held = partition.comm.allreduce(int(outline.rows.held.held.sum()))
    rows = gluing + contact + (0 if outline.eliminated.all() else held)
    dofs = partition.nodes * d
    memory = needed_bytes(dofs, rows, tuple((g.unknowns, d) for g in groups))
    seconds = STARTED + CELL_RATE[d] * partition.cells
    applications = _applications(outline.geometry.bodies, tolerance, bool(gluing))
    seconds += PACE * run_seconds(groups, rows, applications, bool(gluing))
    seconds += STEP_SECONDS * applications if gluing else 0.0
    return Cost(memory, seconds)


def _applications(bodies: Sequence[Body], tolerance: float | Literal["auto"], glued: bool) -> float:
    """Expected applications of the dual operator: more for slender bodies and small tolerances."""
    slenderness = 1.0
    for body in bodies:
        edges = np.subtract(body.mesh.upper, body.mesh.lower)[: body.mesh.dimension]
        slenderness = max(slenderness, float(edges.max() / edges.min()))
    digits = max(-math.log10(AUTOMATIC if tolerance == "auto" else tolerance), 2.0) / 6.0
    applications = APPLICATIONS_GLUED if glued else APPLICATIONS_WHOLE
    return float(applications * math.sqrt(slenderness) * digits**0.6)


def cost_lines(cost: Cost, part: str = "") -> list[str]:
    """Lines on memory and time of a run, and on the checks done.

    Parameters
    ----------
    part
        Case or increment, of which the cost is that of the first; empty for the whole run.
    """
    each = f"for the first {part} and less for each later one, " if part else ""
    lines = [
        f"memory: about {cost.memory / 1e9:.2g} GB of {available_bytes() / 1e9:.3g} GB available",
        f"time: about {_duration(cost.seconds)} {each}on one process of two cores, within a factor "
        "of two or three on other machines; several times longer where the scene is badly "
        "conditioned (thin cells, Poisson's ratio near 0.5, bodies of unlike stiffness)",
        "checked: names, sizes, boundaries, contradictions and equilibrium; nothing was solved",
    ]
    if cost.memory > available_bytes():
        more = "this is more memory than is available: use a coarser mesh or more subdomains"
        lines.insert(1, f"  {more}")
    return lines


def groups_of(outline: Outline, decomposition: Decomposition) -> list[Group]:
    """Subdomains of this rank by shape and material."""
    by_graph, bodies = isinstance(decomposition.subdomains, int), outline.geometry.bodies
    members: dict[tuple, list[int]] = {}
    for local, s in enumerate(outline.partition.subdomains):
        key: tuple = (id(s.reference), bodies[s.body].materials)
        if outline.eliminated[s.body]:
            key = (*key, s.body)
        members.setdefault(key, []).append(local)
    groups = []
    for numbers in members.values():
        s = outline.partition.subdomains[numbers[0]]
        interface = len(outline.surface.local[numbers[0]])
        if outline.eliminated[s.body]:
            first, last = outline.partition.first_node[s.body : s.body + 2]
            nodes = outline.contact.entries.node
            interface = len(np.unique(nodes[(nodes >= first) & (nodes < last)]))
        d = outline.partition.dimension
        unknowns = len(s.reference.points) * d
        in_grid = not (outline.eliminated[s.body] or by_graph)
        order = _reflections(bodies[s.body], s) if in_grid else 1
        groups.append(Group(d, unknowns, interface * d, len(numbers), order))
    return groups


def _reflections(body: Body, s: Subdomain) -> int:
    """Expected order of the reflection group of a subdomain of a grid."""
    if not body.mesh.congruent:
        return 1
    return 2**body.mesh.dimension if s.reference.cell in ("quadrilateral", "hexahedron") else 2


def gluing_rows(outline: Outline) -> int:
    """Number of gluing rows of B: one less than the copies of each shared unknown."""
    partition, (_, nodes, _, copies) = outline.partition, outline.exchange.copies_of_nodes
    more = int((copies - 1)[nodes < partition.nodes].sum())
    return int(partition.comm.allreduce(more)) * partition.dimension


def distinct_nodes(outline: Outline, nodes: list[Ints]) -> Ints:
    """Distinct node numbers of all ranks on rank 0; empty on other ranks."""
    here = np.unique(np.concatenate([np.zeros(0, np.int64), *nodes]))
    parts = outline.partition.comm.gather(here)
    return here[:0] if parts is None else np.unique(np.concatenate(parts))


def _duration(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.1g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
