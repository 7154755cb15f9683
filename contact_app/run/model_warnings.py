"""Warnings where the answer violates assumptions of the model.

The gap is linearised: the distance of the undeformed node along the obstacle's normal there. This
is accurate for small strains and rotations, and on curved obstacles for small sliding.

First-order cells lock: they are far too stiff in bending (their shear strain cannot vanish together
with a curvature) and near ν = 0.5 (their volume cannot be constant at every point). Quadrilaterals
and hexahedra show this by the share of the strain energy in strains that vary within cells,

    1 - Σ |T| σ̄ : ε̄ / a(u, u)    with the means σ̄, ε̄ over each cell T,

which falls with the square of the cell size if the cells resolve the answer, and stays near one if
they lock. Strains of triangles and tetrahedra are constant; for them ν and the estimated error of
the mesh are tested.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from contact_app.accuracy.contact_limits import (
    ENOUGH_FACETS,
    FEWEST_FACETS,
    entered_beside,
    expected_error,
    pressed_facets,
    slipped_through,
)
from contact_app.accuracy.entered_pairs import entered_pairs
from contact_app.accuracy.faceted_curves import compared, median_gaps, pair_sagittas, sagittas
from contact_app.accuracy.sharp_edges import sentences, sharp_peaks
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.accuracy.trust import few_cells
from contact_app.model.loaded_area import loaded_facets, straddled_area
from contact_app.results.free_motions import free_motions
from contact_app.results.friction import approach_of_held, closing_points
from contact_app.results.percent import percent
from contact_app.results.repeated_sentences import without_repetitions
from contact_app.results.sliding import largest_sliding, sliding_on_each_other
from contact_app.results.undetermined import play_warnings, undetermined
from contact_app.scene.bodies import MOTION_NAMES
from contact_app.scene.conditions import Pressure, Traction
from solver.contact.certificate import EQUILIBRIUM_FLOOR
from solver.contact.sizes import STRAINLESS
from solver.driver import reason_text

SMOOTHED = "and max_smoothed_pressure may be a third off, too"
"""Sentence on the smoothed pressure in warnings of fewer than three facets across a contact. With
2.2 to 2.7 across Hertz's ellipse (ball_in_grooves.yaml, its ball turned by random angles) it is 2 %
to 22 % too low, with 2.8 across Hertz's circle up to 31 %."""

SMALL_STRAIN, SMALL_ROTATION = 0.05, 0.1
"""Strain, and rotation in radians, above which a warning follows: they are not small."""

SMALL_SAGITTA = 0.01
"""Error of a gap by sliding along a curved obstacle, over the displacement, that is warned of."""

SIMPLICES = ("triangle", "tetrahedron")

LARGE_ERROR = 0.4
"""Estimated relative error of first-order simplices above which there is a warning."""

ROUNDED_STRAINS = 1e-3
"""Energy norm of rounding errors over that of the strains, above which there is a warning."""

STRADDLED = 0.01
"""Area of facets partly on a loaded boundary, over its area, above which there is a warning."""

SMALL_PART = 0.05
"""Relative error of the solver in heated bodies above which there is a warning."""

VARYING_ENERGY = 0.3
"""Largest admissible share of the energy in strains that vary within first-order cells.

In bending the share is 1/n² for n cells of equal sides across the thickness.
"""


CLOSING = 0.5
"""Share of the points with friction that may close or open under a load applied at once. Of 20
random scenes with more, friction changed by more than 5 % of its limits in 12, by up to 40 %, when
the load was applied in twelve increments; of 34 with fewer in 6
(`python -m tests.stability.increments`)."""


LARGE_FRICTION = 1.0
"""Coefficient of friction from which on a warning follows: there may be other answers. For
isotropic bodies in the plane an answer is known to exist below √(3 - 4ν)/(2 - 2ν), 0.87 to 1 (C.
Eck, J. Jarušek, *Existence results for the static contact problem with Coulomb friction*, Math.
Models Methods Appl. Sci. 8, 1998); examples of several have larger ones (P. Hild, *Non-unique
slipping in the Coulomb friction model in two-dimensional linear elasticity*, Q. J. Mech. Appl.
Math. 57, 2004). Random scenes: `python -m tests.stability.several_answers`."""


def model_warnings(answer: SolvedScene) -> list[str]:
    """Warnings for the certificate, one sentence each (collective)."""
    warnings = [sentence for check in CHECKS for sentence in check(answer)]
    return without_repetitions(warnings, [body.name for body in answer.model.scene.bodies])


def _large_deformations(answer: SolvedScene) -> Iterator[str]:
    """Strains and rotations that are not small."""
    comm, cells = answer.model.comm, answer.cells
    strain = comm.allreduce(cells.largest_strain, op=MPI.MAX)
    rotation = comm.allreduce(cells.largest_rotation, op=MPI.MAX)
    if strain > SMALL_STRAIN:
        yield f"strains reach {strain:.2g}; the model assumes small ones (below {SMALL_STRAIN})"
    if rotation > SMALL_ROTATION:
        yield (
            f"rotations reach {rotation:.2g} rad; the model assumes small ones, and gaps and "
            "normals are those of the undeformed shape"
        )


def _straight_edges(answer: SolvedScene) -> Iterator[str]:
    """Round boundaries whose straight edges are coarse beside displacements or gaps."""
    scene, moved = answer.model.scene, answer.solution.measures.deformations
    found = sagittas(answer.model, answer.nodes)
    gaps = median_gaps(answer.model) if any(found) else []
    for contact, sagitta, gap in zip(scene.contacts, found, gaps, strict=False):
        body = scene.bodies[contact.body]
        share = compared(sagitta, moved[contact.body], gap)
        if share:
            second = "a mesh file of second order (in Gmsh: Mesh.ElementOrder = 2)"
            remedy = f"use {second}" if body.degree == 2 else f"use degree: 2 and {second}"
            yield (
                f"{contact.source}: the boundary of {body.name} is round and the edges of its mesh "
                f"are straight: the middle of an edge lies up to {sagitta:.2g} beside the curve, "
                f"{share}, and the answer is that of the polygon; {remedy}"
            )


def _straight_facets(answer: SolvedScene) -> Iterator[str]:
    """Round bodies in contact through flat facets that are coarse for displacements or gaps."""
    scene, moved = answer.model.scene, answer.solution.measures.deformations
    found = pair_sagittas(answer.model, answer.nodes)
    gaps = median_gaps(answer.model)[len(scene.contacts) :] if any(found) else []
    for pair, sagitta, gap in zip(scene.pairs, found, gaps, strict=False):
        share = compared(sagitta, max(moved[pair.body], moved[pair.other]), gap)
        if not share:
            continue
        names = f"{scene.bodies[pair.body].name} and {scene.bodies[pair.other].name}"
        second = "degree: 2 and a mesh file of second order (in Gmsh: Mesh.ElementOrder = 2)"
        message = (
            "the facets decide the gaps and the largest pressure; use `round: true` of the contact "
            f"and max_smoothed_pressure, or {second}"
        )
        if pair.round:
            message = (
                "the facets decide the largest pressure; use max_smoothed_pressure instead, or "
                f"{second}"
            )
        yield (
            f"{pair.source}: {names} are round there and meet by flat facets, which lie up to "
            f"{sagitta:.2g} beside the curve (h²/8R), {share}: {message}"
        )


def _beside_obstacles(answer: SolvedScene) -> Iterator[str]:
    """Sliding along curved obstacles, and contact that leaves its boundary."""
    model, solution = answer.model, answer.solution
    scene = model.scene
    for i, contact in enumerate(scene.contacts):
        radius = getattr(contact.obstacle, "curvature_radius", None)
        if radius:
            sliding = largest_sliding(model, solution, answer.nodes, i)
            sagitta = sliding**2 / (2.0 * radius)
            if sagitta > SMALL_SAGITTA * solution.measures.deformations[contact.body] > 0.0:
                yield (
                    f"{contact.source}: nodes in contact slide by up to {sliding:.3g} along an "
                    f"obstacle of radius {radius:.3g}: over this length its surface curves away by "
                    f"{sagitta:.2g}, which the linearised gap leaves out"
                )
        entered, depth = entered_beside(model, solution, i)
        if entered:
            yield (
                f"{contact.source}: {entered:,} surface nodes of {scene.bodies[contact.body].name} "
                f"outside {contact.boundary} penetrate the obstacle, by up to {depth:.3g}: the "
                "contact is wider than this boundary; name a larger boundary"
            )


def _between_nodes(answer: SolvedScene) -> list[str]:
    """Obstacles that enter the body between its nodes, and bodies that enter each other."""
    return [
        *slipped_through(answer.model, answer.solution),
        *entered_pairs(answer.model, answer.solution, answer.nodes),
    ]


def _coarse_pressures(answer: SolvedScene) -> Iterator[str]:
    """Pressures that vary within single facets."""
    scene, comm = answer.model.scene, answer.model.comm
    every = pressed_facets(answer.model, answer.nodes)
    for item, facets in zip(scene.touching, every, strict=True):
        across = facets.across(comm, scene.dimension)
        narrow = facets.across_narrow_side(comm, scene.dimension)
        if across < FEWEST_FACETS:
            yield (
                f"{item.source}: the pressure varies within single facets: only about "
                f"{max(across, 1.0):.0f} across carry the contact; the largest pressure depends on "
                f"the mesh, {SMOOTHED}; use smaller cells there"
            )
        elif narrow < FEWEST_FACETS:
            yield (
                f"{item.source}: the pressure varies within single facets: about {narrow:.1f} "
                "facets lie across the narrow side of the contact and "
                f"{max(facets.along_axes(comm)):.0f} along it; the largest pressure depends on the "
                f"mesh, {SMOOTHED}; use smaller cells there"
            )
        elif narrow < ENOUGH_FACETS:
            yield (
                f"{item.source}: the pressure varies as that of Hertz's contact with only about "
                f"{narrow:.1f} facets across: max_smoothed_pressure may be "
                f"{100.0 * expected_error(narrow):.0f} % off, more where the pressure is singular, "
                "and the pressure of single nodes more; use smaller cells there"
            )


def _sharp_edges(answer: SolvedScene) -> list[str]:
    """Largest pressures at sharp edges (collective)."""
    return sentences(answer.model, sharp_peaks(answer.model, answer.nodes))


def _sliding_bodies(answer: SolvedScene) -> Iterator[str]:
    """Bodies that slide along each other by more than a facet."""
    scene = answer.model.scene
    for i, pair in enumerate(scene.pairs, start=len(scene.contacts)):
        sliding, facet = sliding_on_each_other(answer.model, answer.solution, answer.nodes, i)
        if sliding > facet:
            yield (
                f"{pair.source}: the bodies slide along each other by up to {sliding:.3g}, more "
                f"than a facet ({facet:.2g}); the undeformed shape decides which parts may touch"
            )


def _locking_in_volume(answer: SolvedScene) -> Iterator[str]:
    """First-order cells of nearly incompressible bodies."""
    scene = answer.model.scene
    for body in scene.bodies:
        if body.nearly_incompressible(scene.plane) and body.plain:
            poisson = max(material.poisson for material in body.materials)
            remedy = "degree: 2"
            if body.mesh.cell in ("quadrilateral", "hexahedron"):
                remedy = "mean_dilatation: true or degree: 2"
            yield (
                f"{body.name}: first-order cells lock as Poisson's ratio nears 0.5 "
                f"(it is {poisson:g}): displacements come out too small; use {remedy}"
            )


def _locking_in_bending(answer: SolvedScene) -> Iterator[str]:
    """First-order cells whose strains vary within them."""
    shares = _varying_energy(answer)
    for body, share in zip(answer.model.scene.bodies, shares, strict=True):
        if body.degree == 1 and share > VARYING_ENERGY:
            near = " or near ν = 0.5" if body.plain else ""
            yield (
                f"{body.name}: {100.0 * share:.0f} % of its strain energy lies in strains that "
                f"vary within cells: first-order cells lock in bending{near}, and displacements "
                "come out too small; use degree: 2 or several times as many cells across"
            )


def _coarse_meshes(answer: SolvedScene) -> Iterator[str]:
    """Bodies with few cells, and first-order simplices with a large error."""
    scene, solution = answer.model.scene, answer.solution
    error = solution.accuracy.discretisation if solution.accuracy else np.nan
    yield from few_cells(scene, error)
    simplices = [b.name for b in scene.bodies if b.degree == 1 and b.mesh.cell in SIMPLICES]
    if error > LARGE_ERROR and simplices:
        yield (
            f"the error of the mesh is estimated at {100.0 * error:.0f} % in energy norm: "
            f"first-order triangles and tetrahedra ({', '.join(simplices)}) are stiff in bending; "
            "use degree: 2 or a finer mesh"
        )


def _stresses_beside_expansion(answer: SolvedScene) -> Iterator[str]:
    """Stresses that are small compared with those that would prevent the thermal expansion."""
    accuracy = answer.solution.accuracy
    if not answer.model.scene.temperatures or accuracy is None:
        return
    if np.isnan(accuracy.algebraic):
        across = "that across the plane and " if answer.model.scene.plane == "strain" else ""
        yield (
            f"the bodies expand with the temperature and have no stress but {across}rounding "
            "errors, so a relative error does not exist"
        )
    elif accuracy.algebraic > SMALL_PART:
        yield (
            f"stresses are small beside those that would stop the thermal expansion, and the "
            f"solver's part of their error may reach {percent(accuracy.algebraic)}: lower "
            "solver.tolerance"
        )


def _straddled_facets(answer: SolvedScene) -> Iterator[str]:
    """Loads on boundaries whose edge runs through facets."""
    scene, partition = answer.model.scene, answer.model.partition
    loads: list[Traction | Pressure] = [*scene.tractions, *scene.pressures]
    for load in loads:
        left = straddled_area(scene, partition, load)
        area = loaded_facets(scene, partition, load)[1] if left > 0.0 else 0.0
        if left > STRADDLED * area:
            yield (
                f"{load.source}: facets that straddle the edge of {load.boundary} carry no load: "
                f"the load acts on an area of {area:.4g}, but the expression holds on about "
                f"{area + left:.4g}; the total force then depends on the mesh; total_force "
                "prescribes it"
            )


def _without_facets(answer: SolvedScene) -> Iterator[str]:
    """Contact forces at nodes without a facet, whose pressure is not shown."""
    lost = answer.model.comm.allreduce(answer.nodes.without_area)
    if lost:
        yield (
            f"{lost} nodes in contact lie on no whole facet of their contact boundary: their "
            "contact forces are included in all sums, but they have no contact pressure"
        )


def _certificates(answer: SolvedScene) -> Iterator[str]:
    """Certificates that did not pass, or passed at rounding errors."""
    solution, certificate = answer.solution, answer.solution.certificate
    if certificate.passed and certificate.equilibrium > max(solution.tolerance, EQUILIBRIUM_FLOOR):
        yield (
            f"forces balance only to {certificate.equilibrium:.1g} of the load, because of "
            "rounding errors of the displacements: a stiff body moves far and is hardly "
            "strained, so its stresses have few digits"
        )
    if not certificate.passed:
        yield f"not certified: {reason_text(solution)}"


def _free_motions(answer: SolvedScene) -> list[str]:
    """Bodies that are not held and not driven by a load."""
    return [note for note in answer.model.notes if "can move freely" in note]


def _rubs_where_open(answer: SolvedScene) -> Iterator[str]:
    """Friction of a given limit at nodes without a contact force."""
    scene, comm = answer.model.scene, answer.model.comm
    for contact, found in zip(scene.touching, answer.nodes.contacts, strict=True):
        count = comm.allreduce(int((found.rubs & ~found.closed).sum()))
        if count:
            yield (
                f"{contact.source}: Tresca friction acts on {count} nodes that carry no contact "
                "force; with friction: {coulomb: …} friction acts on pressed nodes alone"
            )


def _several_answers(answer: SolvedScene) -> Iterator[str]:
    """Coulomb friction so large that the answer need not be unique."""
    for contact, found in zip(answer.model.scene.touching, answer.nodes.contacts, strict=True):
        law = contact.friction
        pressed = answer.model.comm.allreduce(int(found.closed.any()), op=MPI.MAX)
        if law is not None and (law.coulomb or 0.0) >= LARGE_FRICTION and pressed:
            yield (
                f"{contact.source}: with a coefficient of friction of {law.coulomb:g} the answer "
                "need not be unique: the certificate holds for this one, and there may be others"
            )


def _closes_at_once(answer: SolvedScene) -> Iterator[str]:
    """Frictional contact that grows under a load that is applied at once (collective)."""
    model = answer.model
    if not model.scene.has_friction or model.scene.in_step:
        return
    approach = approach_of_held(model, None)
    changed, touching = closing_points(model.problem, answer.solution, None, approach)
    if changed > CLOSING * touching:
        yield (
            f"{changed:,} of {touching:,} contact points with friction close or open under the "
            "load, which is applied at once: their slip is measured from the unloaded state, not "
            "from the state in which they touched; `steps` with several increments show how much "
            "this matters"
        )


def _slides(answer: SolvedScene) -> Iterator[str]:
    """Bodies that slide along round surfaces, resisted by their facets alone (collective)."""
    scene = answer.model.scene
    touching = {b for item in scene.touching for b in (item.body, getattr(item, "other", -1))}
    for found in free_motions(answer.model, answer.solution):
        if found.body not in touching:
            continue
        body = scene.bodies[found.body]
        names = ", ".join(MOTION_NAMES[scene.dimension][k] for k in found.names)
        yield (
            f"{body.name} slides by {found.largest:.3g} along {found.along}, which its contacts "
            "hardly resist: only the flat facets of round surfaces determine how far it slides. "
            f"Without this motion its largest displacement is {found.without:.3g}; "
            f"`hold: [{names}]` on the body prevents the motion"
        )


def _plays(answer: SolvedScene) -> list[str]:
    """Bodies that can be moved without any change of energy and forces (collective)."""
    return play_warnings(undetermined(answer.model, answer.solution))


def _tied_over_gaps(answer: SolvedScene) -> list[str]:
    """Tied surfaces at a distance from each other."""
    return [note for note in answer.model.notes if "the tied surfaces are" in note]


def _yielding(answer: SolvedScene) -> list[str]:
    """Bodies whose stress exceeds a given yield stress (collective)."""
    model, cells = answer.model, answer.cells
    comm, scene = model.comm, model.scene
    above, total, worst = (np.zeros(len(scene.bodies)) for _ in range(3))
    start = 0
    for s in model.partition.subdomains:
        limits = np.array([m.yield_stress or np.inf for m in scene.bodies[s.body].materials])
        tags = s.reference.tags
        share = cells.von_mises[start : start + len(tags)] / limits[tags]
        above[s.body] += (share > 1.0).sum()
        total[s.body] += len(tags)
        worst[s.body] = max(worst[s.body], float(share.max(initial=0.0)))
        start += len(tags)
    above, total = comm.allreduce(np.stack([above, total]))
    worst = np.max(comm.allgather(worst), axis=0)
    return [
        f"{body.name}: von Mises stress reaches {worst[b]:.3g} times the yield stress, above it in "
        f"{100.0 * above[b] / total[b]:.3g} % of its cells: the material would flow there, and the "
        "model is elastic"
        for b, body in enumerate(scene.bodies)
        if worst[b] > 1.0
    ]


def _moved_far(answer: SolvedScene) -> list[str]:
    """Bodies whose strains or contact forces are comparable with rounding errors."""
    model, measures, sentences = answer.model, answer.solution.measures, []
    elastic, every = model.scene.bodies, slice(len(model.scene.bodies))
    for body, moved, scale, rounding, force in zip(
        elastic, measures.displacements[every], measures.scales[every],
        measures.roundings[every], measures.pressed[every], strict=True,
    ):  # fmt: skip
        share = float(np.sqrt(rounding / scale)) if scale > 0.0 else 0.0
        if share > ROUNDED_STRAINS:
            sentences.append(
                f"{body.name} moves by {moved:.3g} and is hardly strained: rounding errors of its "
                f"displacements reach {percent(share)} of its strains; draw the body nearer "
                "to its final place"
            )
        elif scale == 0.0 and force > 0.0:
            sentences.append(
                f"{body.name} moves by {moved:.3g} and its strains are rounding errors: so are its "
                f"contact forces, {force:.2g} in total"
            )
    return sentences


def _varying_energy(answer: SolvedScene) -> NDArray[np.float64]:
    """Share of each body's strain energy in strains that vary within cells, (bodies,)."""
    measures = answer.solution.measures
    means = answer.model.comm.allreduce(answer.cells.energy_of_means)
    strains, roundings = (v[: len(means)] for v in (measures.strains, measures.roundings))
    strained = strains > STRAINLESS * roundings
    total = np.where(strained, strains, 1.0)
    return np.where(strained, 1.0 - means / total, 0.0)


CHECKS: tuple[Callable[[SolvedScene], Iterable[str]], ...] = (
    _large_deformations, _yielding, _straight_edges, _straight_facets, _beside_obstacles,
    _between_nodes, _coarse_pressures, _sharp_edges, _sliding_bodies, _locking_in_volume,
    _locking_in_bending, _moved_far, _coarse_meshes, _stresses_beside_expansion, _straddled_facets,
    _without_facets, _certificates, _free_motions, _slides, _rubs_where_open, _closes_at_once,
    _several_answers, _plays, _tied_over_gaps,
)  # fmt: skip
"""The tests of an answer, in the order of their warnings."""
