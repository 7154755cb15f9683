"""Speed against accuracy: settings of a scene that no other setting beats in both.

Every point is a real run in a process of its own; seconds count from the mesh to the certified
solution. Boxes have the scene's cells, halved and doubled; meshes from files have halved edges. On
these meshes the degree, the cell, the tolerance, the expansion and the decomposition vary, and
PETSc's bound-constrained solvers run for comparison. From the coarsest mesh the scene is also
refined to given accuracies. Settings that the schema of a scene refuses are left out with a
message, so that a new option of the schema takes part at once. Errors are measured against the
extrapolated answer of `reference`.
"""

import itertools
import math
import tempfile
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from contact_app.errors import ConfigurationError
from contact_app.scene.bodies import CELLS, Box
from contact_app.scene.build import build_scene
from contact_app.scene.configuration import load
from contact_app.scene.scene import Scene
from contact_app.scene.schema.bodies import Body
from contact_app.studies.chart_figure import APPLICATION, draw
from contact_app.studies.peers import METHODS
from contact_app.studies.processes import RunError
from contact_app.studies.reference import QUANTITIES, Distances, Fields, ReferenceAnswer
from contact_app.studies.runs import run_one
from contact_app.studies.tables import write

COLUMNS = ("method", "degree", "cell", "dofs", "tolerance", "subdomains", "seconds",
           "peak_rss_gb", "error_energy", "error_displacement", "error_pressure")  # fmt: skip
DEGREES = (1, 2)
TOLERANCES = ("auto", 1e-2, 1e-4, 1e-8, 1e-10)
"""Further tolerances on the two finest meshes; auto is a tenth of the mesh's estimated error."""
USUAL = 1e-6
LOOSE = 1e-3
"""Further tolerances of PETSc's solvers on their finest mesh."""
EXPANSIONS = ("fixed", "projcg", "gfgf-opt")
"""Further expansions on the finest mesh."""
PARTS = (1, 2, 4)
"""Further decompositions on the finest mesh, as subdomains along each axis."""
ACCURACIES = (0.2, 0.1, 0.05, 0.03)
"""Target errors in energy norm for refinement."""
SMALLEST, LARGEST = Fraction(1, 8), 8
EVEN, UNEVEN = 2_500_000, 700_000
"""Most degrees of freedom of a reference: of boxes, and of meshes from files."""


@dataclass(frozen=True)
class Variant:
    """One way to run the scene."""

    factor: Fraction
    """Cells along each axis relative to the scene's."""
    cell: str
    degree: int | None = 1
    """None leaves it to the scene and its refinement."""
    tolerance: float | str = USUAL
    method: str = APPLICATION
    decomposition: str | None = None
    expansion: str | None = None
    """None for the scene's own."""
    accuracy: float | None = None
    """Target error for refinement from this mesh on; None without refinement."""

    @property
    def name(self) -> str:
        """Name of the method in the CSV."""
        kind = self.expansion or (f"accuracy {self.accuracy:g}" if self.accuracy else "")
        return f"{self.method} {kind}".strip()

    @property
    def kind(self) -> "Variant":
        """Key of a series; if a run takes too long, finer meshes of its series are left out."""
        return replace(self, factor=Fraction(1), tolerance=USUAL)

    @property
    def halvings(self) -> int:
        """Number of times that edges of meshes from files are halved."""
        return int(math.log2(self.factor))

    def overrides(self, scene: Scene, refine: Sequence[int] = ()) -> list[str]:
        """Changes of the scene's file; `refine` is the scene's own number of halvings by body."""
        result = []
        for number, body in enumerate(scene.bodies):
            if isinstance(body.mesh, Box):
                cells = ",".join(str(n) for n in scaled(body.mesh.cells, self.factor))
                result.append(f"bodies.{number}.mesh.box.cells=[{cells}]")
                result.append(f"bodies.{number}.mesh.box.cell={self.cell}")
            else:
                times = refine[number] + self.halvings
                result.append(f"bodies.{number}.mesh.refine={times}")
            if self.degree is not None:
                result.append(f"bodies.{number}.degree={self.degree}")
        if self.method in METHODS:
            result.append("decomposition=auto")
        elif self.decomposition:
            result.append(f"decomposition={self.decomposition}")
        if self.expansion:
            result.append(f"solver.expansion={self.expansion}")
        if self.accuracy:
            result.append(f"accuracy={self.accuracy}")
        return result

    def describe(self, scene: Scene) -> str:
        """A short description."""
        mesh = scene.bodies[0].mesh
        if isinstance(mesh, Box):
            cells = "x".join(str(n) for n in scaled(mesh.cells, self.factor))
        else:
            cells = f"halved {self.halvings} times" if self.halvings else "as given"
        where = f", {self.decomposition}" if self.decomposition else ""
        degree = "" if self.degree is None else f", degree {self.degree}"
        return f"{self.name}{degree}, {self.cell} {cells}, {self.tolerance}{where}"


def scaled(cells: Sequence[int], factor: Fraction) -> tuple[int, ...]:
    """Cells along each axis times a factor.

    Raises
    ------
    ValueError
        A product is not a whole number.
    """
    result = [n * factor for n in cells]
    if any(n.denominator != 1 for n in result):
        raise ValueError(f"{tuple(cells)} times {factor}")
    return tuple(int(n) for n in result)


@dataclass(frozen=True)
class Sweep:
    """Runs of a chart."""

    scene: Scene
    variants: tuple[Variant, ...]
    """In the order they run."""
    references: tuple[Variant, ...]
    """Three references; cells are halved from one to the next."""
    left_out: tuple[str, ...]
    """Sentences on settings that the scene does not allow."""
    refine: tuple[int, ...] = ()
    """Number of times that the scene itself halves the edges of each mesh from a file."""
    parallel: bool = False
    """Whether this application runs with a rank on each core instead of threads of BLAS."""

    def overrides(self, variant: Variant) -> list[str]:
        """Changes of the scene's file that make a variant."""
        return variant.overrides(self.scene, self.refine)


def plan(
    config: Path, overrides: Sequence[str] = (), largest: int = 250_000, peers: bool = True
) -> Sweep:
    """Choose the runs that a scene allows and that are worth their time.

    Parameters
    ----------
    largest
        Unknowns of the finest mesh of the sweep.

    Raises
    ------
    ConfigurationError
        The scene is wrong, its bodies have different cells, or its meshes are too fine.
    """
    configuration = load(config, overrides)
    scene = build_scene(configuration)
    refine = tuple(body.mesh.refine for body in configuration.bodies if isinstance(body, Body))
    cell = scene.bodies[0].mesh.cell
    if any(body.mesh.cell != cell for body in scene.bodies):
        raise ConfigurationError(f"{config}: a chart needs bodies of one kind of cell")
    files = not all(isinstance(body.mesh, Box) for body in scene.bodies)
    left_out: list[str] = []

    def allowed(variant: Variant, what: str) -> bool:
        try:
            settings = [*variant.overrides(scene, refine), f"solver.tolerance={variant.tolerance}"]
            build_scene(load(config, [*overrides, *settings]))
        except ConfigurationError as error:
            left_out.append(f"{what}: {str(error).splitlines()[0]}")
            return False
        return True

    levels = _levels(scene, largest)
    coarse, fine = levels[0], levels[-1]
    cells = [cell]
    if files:
        left_out.append("other cells and coarser meshes: a mesh from a file has its own")
    else:
        cells += [c for c in CELLS[scene.dimension] if c != cell and allowed(Variant(coarse, c), c)]
    degrees = [1, *(p for p in DEGREES[1:] if allowed(Variant(coarse, cell, p), f"degree {p}"))]
    fitting = {p: [f for f in levels if _dofs(scene, f, p) <= largest] for p in degrees}
    every = itertools.product(levels, cells, degrees)
    variants = [Variant(f, c, p) for f, c, p in every if f in fitting[p]]
    for p in degrees:
        swept = [
            t for t in TOLERANCES if allowed(Variant(coarse, cell, p, t), f"degree {p} to {t}")
        ]
        variants += [Variant(f, cell, p, t) for f in fitting[p][-2:] for t in swept]
    variants += [
        Variant(fine, cell, expansion=e) for e in EXPANSIONS if e != scene.solver.expansion
    ]
    for n in PARTS:
        number = str(n**scene.dimension) if files else str([n] * scene.dimension)
        variant = Variant(fine, cell, decomposition=f"{{subdomains: {number}}}")
        if allowed(variant, f"{n}^{scene.dimension} subdomains"):
            variants.append(variant)
    if peers and (len(scene.bodies) > 1 or files):
        left_out.append(
            f"peers: they take {'scenes of one body' if len(scene.bodies) > 1 else 'boxes'}"
        )
    elif peers:
        variants += _of_peers(cell, fitting)
    variants += [
        variant
        for variant in (
            Variant(coarse, cell, p, "auto", accuracy=a)
            for a in ACCURACIES
            for p in (degrees if files else [None])
        )
        if allowed(variant, f"refinement to an error of {variant.accuracy:g}")
    ]
    order = sorted(range(len(variants)), key=lambda i: variants[i].factor)
    finest, degree = _reference_mesh(scene, levels, degrees, UNEVEN if files else EVEN)
    references = tuple(Variant(finest / 2**k, cell, degree, min(1e-8, USUAL)) for k in (2, 1, 0))
    return Sweep(scene, tuple(variants[i] for i in order), references, tuple(left_out), refine)


def _of_peers(cell: str, fitting: dict[int, list[Fraction]]) -> Iterator[Variant]:
    """Runs of PETSc's contact solvers on the meshes that fit, by degree."""
    names = [name for name, method in METHODS.items() if method.contact]
    for m, (p, levels) in itertools.product(names, fitting.items()):
        yield from (Variant(f, cell, p, USUAL, m) for f in levels)
        yield from (Variant(f, cell, p, LOOSE, m) for f in levels[-1:])


def _levels(scene: Scene, largest: int) -> list[Fraction]:
    """Factors of the meshes of the sweep, coarsest first."""
    boxes = [body.mesh for body in scene.bodies if isinstance(body.mesh, Box)]
    levels = []
    factor = SMALLEST if len(boxes) == len(scene.bodies) else Fraction(1)
    while factor <= LARGEST and _dofs(scene, factor, 1) <= largest:
        try:
            smallest = min((n for box in boxes for n in scaled(box.cells, factor)), default=2)
        except ValueError:
            smallest = 0
        if smallest >= 2:
            levels.append(factor)
        factor *= 2
    if not levels:
        raise ConfigurationError(
            f"the scene's mesh has more than {largest} degrees of freedom; allow a chart more, or "
            "coarsen the mesh"
        )
    return levels


def _dofs(scene: Scene, factor: Fraction, degree: int) -> int:
    """Unknowns of a mesh of the sweep; approximate for files halved twice or more."""
    nodes, d = 0, scene.dimension
    for body in scene.bodies:
        mesh = body.mesh
        if isinstance(mesh, Box):
            nodes += math.prod(int(n * factor) * degree + 1 for n in mesh.cells)
        else:
            times = int(math.log2(factor)) + degree - 1
            nodes += mesh.nodes_of(2) * 2 ** (d * (times - 1)) if times else mesh.nodes_of(1)
    return nodes * d


def _reference_mesh(
    scene: Scene, levels: Sequence[Fraction], degrees: Sequence[int], most: int
) -> tuple[Fraction, int]:
    """Finest mesh of the reference and its degree: nodes of one or two halvings beyond the sweep.

    A quarter of its cells along each axis is a whole number, at least that of the coarsest mesh.

    Raises
    ------
    ConfigurationError
        The mesh has too many unknowns.
    """
    for degree in reversed(degrees):
        least = max(2 * levels[-1] / degree, 4 * levels[0])
        for factor in (2 * least, least):
            if _dofs(scene, factor, degree) <= most:
                return factor, degree
    raise ConfigurationError(
        f"the reference of a chart needs the mesh twice halved, which has more than {most:,} "
        "degrees of freedom; coarsen it"
    )


@dataclass(frozen=True)
class Progress:
    """Messages of a running chart: a sentence, or the row of a point."""

    text: str
    row: dict[str, Any] | None = None


def chart(
    config: Path,
    output: Path,
    sweep: Sweep,
    overrides: Sequence[str] = (),
    limit: float = 30.0,
    runs: "Runs | None" = None,
) -> Iterator[Progress]:
    """Run a sweep; write ``frontier.csv`` as it grows and ``frontier.png`` at its end.

    An interrupted sweep leaves its results so far.

    Parameters
    ----------
    limit
        Time limit of a point in seconds; a series beyond it is not continued on finer meshes.
    runs
        Functions that run the reference and the points.
    """
    runs, sentence = runs or Runs(), ""
    rows: list[dict[str, Any]] = []
    output.mkdir(parents=True, exist_ok=True)
    for left_out in sweep.left_out:
        yield Progress(f"left out: {left_out}")
    try:
        with tempfile.TemporaryDirectory() as scratch:
            file = Path(scratch) / "fields.npz"
            reference = yield from runs.reference(config, sweep, overrides, file)
            sentence = reference.describe()
            yield Progress(sentence)
            slow: set[Variant] = set()
            for number, variant in enumerate(sweep.variants):
                head = f"[{number + 1}/{len(sweep.variants)}] {variant.describe(sweep.scene)}"
                if variant.kind in slow:
                    yield Progress(f"{head}: left out after a coarser mesh")
                    continue
                try:
                    row = runs.point(config, sweep, variant, overrides, limit, file, reference)
                except RunError as error:
                    slow.add(variant.kind)
                    yield Progress(f"{head}: {error}")
                    continue
                rows.append(row)
                write(rows, COLUMNS, output / "frontier.csv")
                yield Progress(head, row)
    finally:
        write(rows, COLUMNS, output / "frontier.csv")
        if rows:
            draw(rows, output / "frontier.png", sweep.scene.title, sentence)


def solve_reference(
    config: Path, sweep: Sweep, overrides: Sequence[str], file: Path
) -> Generator[Progress, None, ReferenceAnswer]:
    """Solve the three finest meshes, with their fields in a file, and extrapolate."""
    scene = sweep.scene
    sampled, distances = [], None
    for variant in reversed(sweep.references):
        yield Progress(f"reference: {variant.describe(scene)}")
        settings = [*overrides, *sweep.overrides(variant)]
        try:
            run_one(
                APPLICATION, config, settings, variant.tolerance, fields=file,
                parallel=sweep.parallel,
            )  # fmt: skip
        except RunError as error:
            raise ConfigurationError(f"{config}: the reference failed: {error}") from error
        fields = Fields.load(str(file))
        distances = distances or Distances.of(scene, fields)
        sampled.append(distances.sample(fields))
    assert distances is not None
    return ReferenceAnswer.of(distances, sampled[::-1])


def solve_point(
    config: Path,
    sweep: Sweep,
    variant: Variant,
    overrides: Sequence[str],
    limit: float,
    file: Path,
    reference: ReferenceAnswer,
) -> dict[str, Any]:
    """Run one variant and measure its errors."""
    settings = [*overrides, *sweep.overrides(variant)]
    row = run_one(variant.method, config, settings, variant.tolerance, limit, file, sweep.parallel)
    fields = Fields.load(str(file))
    errors = reference.errors(reference.distances.sample(fields))
    return {
        "method": variant.name,
        "degree": int(fields.degree.min()),
        "cell": variant.cell,
        "dofs": row["dofs"],
        "tolerance": variant.tolerance,
        "subdomains": row["subdomains"],
        "seconds": round(row["seconds"], 4),
        "peak_rss_gb": round(row["peak_rss_gb"], 3),
        **{f"error_{q}": float(f"{e:.4g}") for q, e in zip(QUANTITIES, errors, strict=True)},
    }


@dataclass(frozen=True)
class Runs:
    """Functions that solve the reference and a point of a chart."""

    reference: Callable[..., Generator[Progress, None, ReferenceAnswer]] = solve_reference
    point: Callable[..., dict[str, Any]] = solve_point
