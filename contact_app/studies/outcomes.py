"""How a method did on a scene on which methods fail (`stability`)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration
from contact_app.scene.scene import Scene

OURS, WHOLE = "contact-app", "contact-app, whole"


@dataclass(frozen=True)
class Outcome:
    """How one method did on one case.

    Attributes
    ----------
    verdict : str
        One of those of `stability`.
    detail : str
    applications : int
        Hessian multiplications; of peers, multiplications with the stiffness or factors.
    energy, penetration : float
        The penetration relative to the largest displacement.
    growth : float
        Products over those of the milder twin; 0 without one.
    strains : tuple of float
        Twice the strain energy of each body; empty for peers, which take one body.
    """

    verdict: str
    detail: str = ""
    applications: int = 0
    energy: float = float("nan")
    penetration: float = float("nan")
    growth: float = 0.0
    strains: tuple[float, ...] = ()

    def __str__(self) -> str:
        work = f" ({self.applications})" if self.applications else ""
        if self.growth:
            work += f" ×{self.growth:.1f}"
        return f"{self.verdict}{work}" + (f": {self.detail}" if self.detail else "")


def built(made: dict[str, Any], subdomains: Any) -> Scene:
    """The scene, cut into so many subdomains."""
    decomposition = {"subdomains": subdomains}
    return build_scene(Configuration.model_validate({**made, "decomposition": decomposition}))


def shortened(text: str, most: int = 240) -> str:
    """The first sentence or so, without what only this study's scenes are called."""
    text = " ".join(text.split()).removeprefix("scene: ").replace("|", "/")
    text = re.sub(r"/\S*/(\S+\.vtu)", r"\1", text)
    return text if len(text) <= most else text[: most - 1].rsplit(" ", 1)[0] + " …"
