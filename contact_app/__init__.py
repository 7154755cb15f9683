"""Contact mechanics with error certificates: scenes, runs, studies and the command line.

`contact_app.solve` takes a YAML file or a mapping of the same keys and returns the answer.
"""

from __future__ import annotations

from typing import Any

__all__ = ["Answer", "CaseAnswers", "solve"]


def __getattr__(name: str) -> Any:
    """The interface; dolfinx is imported when it is used, so that other commands start at once."""
    if name in __all__:
        from contact_app.run import answer

        return getattr(answer, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
