"""One run from file to files: the order of its stages, progress, warnings, fallbacks, `check`.

`run` solves and writes a scene, `check` says beforehand what will be modelled (`model_report`) and
what it costs (`cost`).
`result_directory` removes what earlier runs left. `fallback` decides what is tried where an answer
cannot be certified. `model_warnings` holds the answer against the assumptions
of its model.
"""
