"""Ways to solve a dual problem to a certified answer.

`by_mprgp` serves problems without a coarse problem or without contact rows, `by_active_sets` all
others, and `by_smalbe` those whose active sets do not settle, or the paper's algorithm. Each takes
a `task.Task` and ends with a `Solution`; `answers` recovers displacements and certifies them.
`solver.driver` chooses.
"""
