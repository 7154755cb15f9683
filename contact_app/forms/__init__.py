"""Contact for forms of a dolfinx user's own: `ContactProblem`, used like dolfinx's `LinearProblem`.

The forms are assembled over the cells of each rank without boundary conditions, so that the
stiffness of a rank is that of a floating part of the body (`parts`); the parts are joined by Total
FETI (Z. Dostál, D. Horák, R. Kučera, *Total FETI*, Commun. Numer. Methods Eng. 22, 2006). The input
is a bilinear and a linear form, Dirichlet conditions and contacts on tagged facets (`contacts`).
The product is a displacement with its certificate, pressures, gaps and a summary (`problem`).
"""

from contact_app.forms.contacts import Contact, SignedDistance
from contact_app.forms.problem import ContactProblem

__all__ = ["Contact", "ContactProblem", "SignedDistance"]
