"""One run from file to files: the order of its stages, progress, warnings, fallbacks, `check`.

`run` solves and writes a scene, `check` reports the model (`model_report`) and its cost (`cost`)
without solving.
`result_directory` removes what earlier runs left. `ways` and `fallback` decide the next method
where an answer cannot be certified. `model_warnings` compares the answer with the assumptions of
its model.
"""
