"""The numerical core: quadratic programs with bounds and equalities, and contact problems.

`qp` holds the quadratic programs, `contact` the active sets and laws of contact, and `problem` the
matrices of a contact problem with the certificate of its answers. `tfeti` and `primal` are two
methods to solve it, and `driver` chooses between them.

Input is a contact problem as matrices and records; the product is a `contact.Solution` with its
certificate. Nothing here depends on dolfinx or on scene files.
"""

from solver.errors import IndefiniteError, NotFiniteError, QPError, UnboundedError
from solver.qp.box_qp import BoxQP
from solver.qp.equalities import Equalities
from solver.qp.expansion import Expansion, expansion_by_name, expansion_names
from solver.qp.mprgp import MPRGP
from solver.qp.operators import Operator, as_operator
from solver.qp.outer_state import OuterState
from solver.qp.result import Counts, Monitor, Reason, Result, Step
from solver.qp.smalbe import SMALBE

__all__ = [
    "MPRGP", "SMALBE", "BoxQP", "Counts", "Equalities", "Expansion", "IndefiniteError", "Monitor",
    "NotFiniteError", "Operator", "OuterState", "QPError", "Reason", "Result", "Step",
    "UnboundedError", "as_operator", "expansion_by_name", "expansion_names",
]  # fmt: skip
