"""The contact problem of a decomposition, as both methods take it, and the certificate of answers.

Input are subdomains with stiffness, loads and conditions at nodes; `parts` has them as records:
`subdomains` of equal stiffness, the rows of B (`constraints`), contact points and a load case.
`decomposed` is the problem with its rows by kind and products with B, `contact_law` its law,
`constraint_hierarchy` its levels of contact rows, and `task` a solve of it. The product of a method
is an `answer`, whose certificate `certify` computes from the `sizes` of each body and the
`duality_gap` to the admissible displacement that `feasible` finds. `free_motions` are rigid motions
that nothing resists, and `least_motion` chooses among answers of equal energy.
"""

__all__ = [
    "answer", "certify", "constraint_hierarchy", "constraints", "contact_law", "decomposed",
    "duality_gap", "free_motions", "least_motion", "sizes", "subdomains", "parts", "task",
]  # fmt: skip
