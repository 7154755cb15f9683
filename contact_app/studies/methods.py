"""Operator applications of the default method and of the paper's algorithm, scene by scene.

``python -m contact_app.studies.methods [SCENE…]`` solves each scene by `solver.method: auto` and by
`smalbe`, MPRGP with the projected CG expansion inside SMALBE-M under the paper's rules, to the
scene's own tolerance, and prints a table of applications of the dual operator. Without names it
takes the scenes of `configs/`. Where no subdomain floats both are MPRGP or conjugate gradients.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

from contact_app.errors import ContactError
from contact_app.run.solve import solve_scene
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load

METHODS = ("auto", "smalbe")


def row(path: Path) -> str:
    """Of one scene."""
    cells = []
    for method in METHODS:
        settings = [f"solver.method={method}"]
        if method == "smalbe":
            settings.append("solver.expansion=projcg")
        try:
            summary = solve_scene(build_scene(load(path, settings)), MPI.COMM_SELF).summary
        except ContactError as error:
            cells.append(str(error).splitlines()[0][:40])
            continue
        solver = summary["solver"]
        note = "" if summary["certificate"]["passed"] else ", not certified"
        cells.append(f"{solver['hessian_multiplications']:,} ({solver['method']}{note})")
    unknowns = f"{summary['mesh']['dofs']:,}"
    return f"| {path.stem} | {unknowns} | " + " | ".join(cells) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Default method and the paper's algorithm.")
    parser.add_argument("scenes", nargs="*", type=Path)
    scenes = parser.parse_args().scenes or sorted(Path("configs").glob("*.yaml"))
    print("| scene | unknowns | auto | smalbe |\n|---|---:|---:|---:|")
    for path in scenes:
        print(row(path), flush=True)


if __name__ == "__main__":
    main()
