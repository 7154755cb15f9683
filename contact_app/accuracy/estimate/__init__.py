"""The error of the mesh, estimated from recovered stresses (Zienkiewicz and Zhu, 1992).

A recovered stress σ* is continuous within a material and nearer to the true stress than the
stresses σ_h of the elements. The estimate is the energy norm of σ* - σ_h. Input is a model with its
solution; the products are squared errors of bodies and cells and the relative errors of the scene
(`error_estimate.ErrorEstimator`). `patches` are the cells about a node, `patch_fits` fits
polynomials to their stresses, `tractions` and `touching` find the known tractions on the surface,
`stress_recovery` makes the recovered field of the fits and `error_estimate` compares it with the
stresses of the elements. `calibration` corrects known biases of the estimate.
Theory: docs/theory/error_estimate.md.
"""

__all__ = ["error_estimate", "stress_recovery"]
