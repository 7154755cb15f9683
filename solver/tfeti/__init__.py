"""Total FETI: gluing, kernels, generalised inverses, coarse problem, dual operator, recovery."""
