"""The part of a linear form that acts on strains only: thermal stresses, stresses of assembly.

∫ S : grad v does no work in a translation, so these loads balance themselves on each body. The
reactions to them do so, too, and both may be far larger than contact forces. So the certificate
measures forces without them (`solver.problem.sizes.force_references`), as in a heated scene. In
cylindrical coordinates the circumferential stress acts on v_r / r, which is no derivative: that
part counts as a load.
"""

from typing import Any

from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.constantvalue import Zero
from ufl.corealg.multifunction import MultiFunction


class _OfDerivatives(MultiFunction):
    """Replaces arguments that are not differentiated by zero."""

    expr = MultiFunction.reuse_if_untouched

    def argument(self, o: Any) -> Any:
        """Zero."""
        return Zero(o.ufl_shape)

    def derivative(self, o: Any) -> Any:
        """The derivative; arguments in it stay."""
        return o


def stress_loads(form: Any) -> Any | None:
    """The terms of a linear form with derivatives of its argument; None if it has none."""
    lowered = apply_derivatives(apply_algebra_lowering(form))
    terms = map_integrand_dags(_OfDerivatives(), lowered)
    return terms if terms.integrals() and terms.arguments() else None
