"""The numerical core: quadratic programs with bounds and equalities, and Total FETI."""

from solver.errors import IndefiniteError, NotFiniteError, QPError, UnboundedError
from solver.expansion import Expansion, expansion_by_name, expansion_names
from solver.mprgp import MPRGP
from solver.operators import Operator, as_operator
from solver.qp import BoxQP
from solver.result import Counts, Monitor, Reason, Result, Step
from solver.smalbe import SMALBE, Equalities, OuterState

__all__ = [
    "MPRGP",
    "SMALBE",
    "BoxQP",
    "Counts",
    "Equalities",
    "Expansion",
    "IndefiniteError",
    "Monitor",
    "NotFiniteError",
    "Operator",
    "OuterState",
    "QPError",
    "Reason",
    "Result",
    "Step",
    "UnboundedError",
    "as_operator",
    "expansion_by_name",
    "expansion_names",
]
