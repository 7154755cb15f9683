"""Methods that solve a dual problem to a certified answer.

Input is a `solver.problem.task.Task`: the dual problem, the stopping rule, the options of MPRGP and
the callbacks; the product is a `Solution` with its certificate. `by_active_sets` is the active-set
loop of `solver.contact` (Hintermüller, Ito and Kunisch, 2002) with conjugate gradients on each set.
`by_mprgp` solves problems without a coarse problem or without contact rows by MPRGP. `by_smalbe` is
SMALBE-M, the paper's algorithm (Kružík et al., 2020); it also solves where active sets do not
settle. `answers` recovers displacements from multipliers and certifies them. `solver.driver`
chooses the method.
"""

__all__ = ["answers", "by_active_sets", "by_mprgp", "by_smalbe"]
