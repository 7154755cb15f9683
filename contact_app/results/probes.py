"""Displacements at the probes of a scene."""

from typing import Any

import numpy as np

from contact_app.model.model import Model
from solver.contact.solution import Solution


def probe_records(model: Model, solution: Solution) -> dict[str, Any]:
    """`probes` of ``summary.json``, by name (collective)."""
    d, records = model.scene.dimension, {}
    for probe in model.probes:
        moved = np.zeros(d)
        if probe.subdomain is not None:
            cls, column = model.place[probe.subdomain]
            u = solution.displacements[cls][:, column].reshape(-1, d)
            moved = probe.shares @ u[probe.nodes]
            for mirror in probe.mirrors:
                moved[mirror.axis] *= -1.0
        records[probe.name] = {"displacement": [float(v) for v in model.comm.allreduce(moved)]}
    return records
