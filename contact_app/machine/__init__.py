"""The process and the machine it runs on: memory, disk, streams, exit codes.

Nothing here depends on a scene. `memory` tells the free memory, `timings` measures stages, `disk`
and `atomic_file` write files that appear complete or not at all, and `exits` has the exit codes.
`environment` names the libraries and the BLAS of a run.
"""
