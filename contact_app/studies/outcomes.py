"""Result of a method on a scene on which methods fail (`stability`)."""

import re
from dataclasses import dataclass
from typing import Any

from contact_app.scene.build import build_scene
from contact_app.scene.configuration import Configuration
from contact_app.scene.scene import Scene

APPLICATION, WHOLE = "contact-app", "contact-app, whole"


@dataclass(frozen=True)
class Outcome:
    """Result of one method on one case."""

    verdict: str
    """One of the verdicts of `stability`."""
    detail: str = ""
    applications: int = 0
    """Hessian multiplications; for PETSc's solvers multiplications with the stiffness, or
    factors."""
    energy: float = float("nan")
    penetration: float = float("nan")
    """The penetration relative to the largest displacement."""
    growth: float = 0.0
    """Work relative to the milder variant; 0 without a variant."""
    strains: tuple[float, ...] = ()
    """Twice the strain energy of each body; empty for PETSc's solvers, which take one body."""

    @property
    def cell(self) -> str:
        """The verdict and the work, for a table."""
        verdict = f"**{self.verdict}**" if self.verdict == "WRONG" else self.verdict
        notes = [str(self.applications)] if self.applications else []
        notes += [f"×{self.growth:.1f}"] if self.growth else []
        return f"{verdict} ({', '.join(notes)})" if notes else verdict

    def __str__(self) -> str:
        return self.cell + (f": {self.detail}" if self.detail else "")


def built(made: dict[str, Any], subdomains: Any) -> Scene:
    """The scene, cut into a number of subdomains."""
    decomposition = {"subdomains": subdomains}
    return build_scene(Configuration.model_validate({**made, "decomposition": decomposition}))


def shortened(text: str, most: int = 240) -> str:
    """The first sentence or so, without the names of this study's scenes."""
    text = " ".join(text.split()).removeprefix("scene: ").replace("|", "/")
    text = re.sub(r"/\S*/(\S+\.vtu)", r"\1", text)
    return text if len(text) <= most else text[: most - 1].rsplit(" ", 1)[0] + " …"
