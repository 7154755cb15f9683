"""One run from file to files: the order of its stages, progress, warnings, fallbacks, `check`.

Input is a `Scene`; the product is a solved scene with its certificate (`solve`), and the files of a
run. `run` solves and writes a scene, `cases` its load cases and `steps` a load history; `answer` is
the same for Python. `check` reports the model (`model_report`) and its cost (`cost`) without
solving. `ways` and `fallback` decide the next method where an answer cannot be certified.
`model_warnings` compares the answer with the assumptions of its model, and `result_directory`
removes the files of earlier runs.
"""

__all__ = [
    "answer", "cases", "check", "coarse_increments", "fallback", "increments", "other_increments",
    "path_dependence", "progress", "run", "solve", "step_equilibrium", "summary", "warning_texts",
]  # fmt: skip
