"""The error of the mesh, estimated from recovered stresses (Zienkiewicz and Zhu, 1992).

`patches` are the cells about a node, `patch_fits` fits polynomials to their stresses,
`stress_recovery` makes the recovered field of them and `error_estimate` compares it with the
stresses of the elements. `calibration` corrects known biases of the estimate.
"""
