"""The process and the machine it runs on: memory, disk, streams, exit codes.

Nothing here knows a scene. Other rooms ask how much memory is free (`memory`), measure their stages
(`timings`), write files that appear whole or not at all (`disk`, `whole_file`) and end with
the exit codes of the contract (`exits`). `environment` says which libraries and which BLAS a run
uses.
"""
