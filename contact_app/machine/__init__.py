"""The process and the machine it runs on: memory, disk, streams, ranks, exit codes.

Nothing here depends on a scene. `memory` measures the free memory, `timings` the stages of a run.
`disk` and `atomic_file` write files that appear complete or not at all. `ranks` runs an action on
one rank and raises its errors on all. `exits` has the exit codes. `environment` names the libraries
and the BLAS of a run.
"""
