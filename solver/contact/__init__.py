"""The discrete contact problem: active sets, stopping rule, certificate, checkpoint.

`driver` chooses the algorithm, `active_set` is the loop over active sets, `stopping` decides when
an answer is good enough, `certificate` recomputes from an answer how far it may be off: the duality
gap between an admissible displacement and a multiplier in equilibrium bounds its error in energy
(`duality_gap`), the sizes of each body say what errors are relative to (`sizes`).
"""
