"""The discrete contact problem: active sets, stopping rule, certificate, checkpoint.

Input is a `solver.backend.Backend`, which solves on a given active set, and a contact law; the
product is the active set of the solution with its state. `active_set` is the loop over active sets
(Hintermüller, Ito and Kunisch, 2002), `solve_on_set` the solve on one of them, `active_set_update`
makes the next one, and `retries` begins the loop anew where sets do not settle. `law` and
`friction_law` are the contact laws (Signorini, Tresca, Coulomb), `stopping` decides when an answer
is accurate enough, and `certificate` has the numbers that say how far it may be off, which
`solver.problem.certify` computes. Nothing in this package depends on a backend. The backends stand
in packages of their own, and `solver.driver` chooses one. Theory: docs/theory/active_sets.md.
"""

from solver.contact.certificate import Certificate
from solver.contact.checkpoint import Checkpoint
from solver.contact.options import SolverOptions
from solver.contact.solution import Solution

__all__ = [
    "Certificate", "Checkpoint", "Solution", "SolverOptions", "active_set", "active_set_options",
    "active_set_update", "bodies", "certificate", "checkpoint", "equilibrium", "friction_law",
    "friction_points", "group_balance", "law", "monitoring", "nearest_point", "options", "retries",
    "row_kinds", "slip_front", "slip_limits", "solution", "solve_on_set", "stopping", "vector_file",
]  # fmt: skip
