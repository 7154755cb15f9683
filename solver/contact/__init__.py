"""The discrete contact problem, seen from its answer: how large it is and how far it may be off.

It holds what the certificate is made of. The duality gap between an admissible displacement and a
multiplier in equilibrium bounds the error in energy (`duality_gap`). The sizes of each body say
what errors are relative to (`sizes`).
"""
