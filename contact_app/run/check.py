"""The model of a scene, what it leaves out, and what it costs, without solving it.

The outline of the model (subdomains, conditions, loads and their equilibrium) is the first stage of
a run. So `check` refuses every scene that a run would refuse before it assembles a matrix.
"""

from mpi4py import MPI
from rich.console import Console

from contact_app.model.method import with_chosen_method
from contact_app.model.outline import Outline, outline_of_scene
from contact_app.run.case_models import outlines_of_cases
from contact_app.run.cost import cost_lines, estimate
from contact_app.run.model_report import loads_on_bodies, modelled_lines
from contact_app.scene.scene import Scene


def report(scene: Scene, comm: MPI.Intracomm = MPI.COMM_WORLD) -> None:
    """Print what a run would model and what it would cost (collective).

    Raises
    ------
    ConfigurationError, NoEquilibriumError
        A run would raise the same error.
    """
    from contact_app.accuracy.guarantee.box_surface import refuse_unguaranteed, stress_bytes
    from contact_app.model.symmetry import halved

    halving = halved(scene)
    if scene.symmetry:
        scene = halving.scene
    scene = with_chosen_method(scene)
    outlines: dict[str, Outline] = {}
    if scene.loadings:
        outlines = {k: v for k, v in outlines_of_cases(scene, comm).items() if v is not None}
        outline = next(iter(outlines.values()))
    else:
        outline = outline_of_scene(scene, comm, needed="distinct")
    refuse_unguaranteed(scene, outline.partition)
    lines = describe(scene, outline)
    for name, of_case in outlines.items():
        label = f"case {name}" if scene.cases else name
        lines += [f"{label}: {line}" for line in loads_on_bodies(scene.bodies, of_case)]
    if scene.symmetry:
        lines = [*halving.notes, "", *lines]
    elif halving.scene.mirrors:
        share = 2 ** len(halving.scene.mirrors)
        lines.append(f"symmetry: `symmetry: allow` would solve one of {share} equal parts")
    if scene.guaranteed:
        lines.append(
            "guaranteed error bound: its stresses take about "
            f"{stress_bytes(scene.bodies) / 1e9:.2g} GB in addition, and more time"
        )
    if comm.rank == 0:
        console = Console(highlight=False, markup=False, soft_wrap=True)
        for line in lines:
            console.print(line)


def describe(scene: Scene, outline: Outline) -> list[str]:
    """Lines of the report (collective)."""
    cost = estimate(outline, scene.decomposition, scene.solver.tolerance)
    part = "increment" if scene.steps else "case" if scene.cases else ""
    return [*modelled_lines(scene, outline), "", *cost_lines(cost, part)]
