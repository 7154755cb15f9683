"""Studies: programs that measure this application or reproduce tables and figures of the paper.

Each runs by ``python -m contact_app.studies.NAME`` or as a command (`commands`), and writes CSV
files and the tables and figures of ``docs/benchmarks`` from them. `paper`, `cube` and `svm` repeat
the tables of Kružík et al. (2020), `verification` compares contacts with their theory. `parts`,
`peers` and `undecomposed` measure PETSc's solvers on the same problems, `calculix` another program.
`stability` runs scenes on which contact methods fail, `claims` tests the claimed accuracies. No
other room imports this one.
"""

__all__ = ["commands"]
