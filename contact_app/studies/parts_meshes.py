"""Sources of meshes for the benchmark of parts: shipped, drawn with Gmsh, or a directory."""

import importlib.util
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from contact_app.errors import CouldNotRunError
from contact_app.scene.yaml_reader import read
from contact_app.studies.fused import mesh_of

SCRIPT = Path(__file__).parents[2] / "meshes" / "samples" / "make_parts.py"

FUSED = ("ball_in_grooves", "bolted_flange", "hub_on_shaft", "pin_in_lug")
"""Parts of several bodies that the script also draws as one."""


@dataclass(frozen=True)
class Meshes:
    """One mesh for each part."""

    name: str
    """In the table."""
    directory: Path | None = None
    """Directory of the files, with the names in the scenes; the scenes' own unless given."""
    factor: float | None = None
    """Draw the meshes there first, with this size of cells near contact relative to the shipped
    mesh."""
    cells: int | None = None
    """Cells along each edge of the box of a scene, in place of a file."""

    def overrides(self, scene: Path, degree: int) -> list[str]:
        """``key=value`` for the meshes of a scene, drawn if need be, and the degree of all bodies.

        Raises
        ------
        CouldNotRunError
            Gmsh cannot draw them.
        """
        directory, values = self.of(scene), []
        for i, body in enumerate(read(scene)[0]["bodies"]):
            values.append(f"bodies.{i}.degree={degree}")
            if directory is not None:
                file = directory.resolve() / Path(body["mesh"]["file"]).name
                values.append(f"bodies.{i}.mesh.file={file}")
            if self.cells is not None:
                values += [f"bodies.{i}.mesh.box.cells={[self.cells] * 3}", "decomposition=auto"]
        return values

    def of(self, scene: Path) -> Path | None:
        """The directory with the meshes of a scene, drawn if need be.

        Raises
        ------
        CouldNotRunError
            Gmsh cannot draw them.
        """
        if self.factor is not None and self.directory is not None:
            self.directory.mkdir(parents=True, exist_ok=True)
            _draw(scene.stem, self.factor, self.directory)
            if scene.stem in FUSED:
                fused = mesh_of(self.directory / scene.name).parent
                fused.mkdir(exist_ok=True)
                _draw(scene.stem, self.factor, fused, "--fused")
        return self.directory


SHIPPED = Meshes("shipped")


def can_draw() -> bool:
    """Whether Gmsh's Python module is there."""
    return importlib.util.find_spec("gmsh") is not None


def drawn(factor: float, directory: Path) -> Meshes:
    """Meshes to be drawn below a directory."""
    return Meshes(f"{factor:g}", directory / f"{factor:g}", factor)


def _draw(part: str, factor: float, directory: Path, *more: str) -> None:
    command = [sys.executable, str(SCRIPT), part, *more, "--factor", str(factor)]
    command += ["--to", str(directory)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise CouldNotRunError(f"{SCRIPT.name} could not draw {part} at {factor:g}: {reason}")
