"""Methods that solve a dual problem to a certified answer.

`by_mprgp` solves problems without a coarse problem or without contact rows, and `by_active_sets`
all others. `by_smalbe` goes on where active sets do not settle, and has the paper's algorithm. Each
takes a `task.Task` and ends with a `Solution`; `answers` recovers displacements and certifies them.
`solver.driver` chooses.
"""
