"""The process and the machine it runs on: memory, disk, streams, ranks, exit codes.

Nothing here depends on a scene. The room asks the operating system and MPI for the state of the
machine, and turns its failures into errors for users and exit codes. `memory` measures the free
memory, `timings` the stages of a run, and `time_limit` ends a run after a processor time. `disk`
and `atomic_file` write files that appear complete or not at all, `caches` finds directories for
compiled forms, and `streams` protects output to closed or full streams. `ranks` runs an action on
one rank and raises its errors on all. `exits` has the exit codes. `environment` names the libraries
and the BLAS of a run.
"""

__all__ = [
    "atomic_file", "caches", "disk", "environment", "exits", "memory", "ranks", "streams",
    "time_limit", "timings",
]  # fmt: skip
