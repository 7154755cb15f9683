"""Contact mechanics with error certificates: scenes, runs, studies and the command line.

`contact_app.solve` takes a YAML file or a mapping of the same keys and returns the answer;
`contact_app.ContactProblem` solves contact for a dolfinx user's own forms. Each room (a directory)
names in its `__all__` the modules that other rooms may import; its other modules are private.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "Answer": "contact_app.run.answer",
    "CaseAnswers": "contact_app.run.answer",
    "Contact": "contact_app.forms.contacts",
    "ContactProblem": "contact_app.forms.problem",
    "Cylinder": "contact_app.scene.obstacles",
    "Plane": "contact_app.scene.obstacles",
    "SignedDistance": "contact_app.forms.contacts",
    "Sphere": "contact_app.scene.obstacles",
    "solve": "contact_app.run.answer",
}
"""Module that defines each name of the Python interface."""

__all__ = [
    "Answer", "CaseAnswers", "Contact", "ContactProblem", "Cylinder", "Plane", "SignedDistance",
    "Sphere", "solve",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Names of the Python interface.

    Importing them imports dolfinx, so other commands start fast.
    """
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
