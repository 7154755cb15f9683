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

from collections.abc import Callable, Iterable, Iterator
from functools import partial

import numpy as np
from mpi4py import MPI

from contact_app.accuracy.contact_limits import entered_beside, slipped_through
from contact_app.accuracy.entered_pairs import (
    entered_by_rigid_bodies,
    entered_pairs,
    entered_without_contact,
)
from contact_app.accuracy.faceted_curves import median_gaps, pair_distances, sagittas
from contact_app.accuracy.solved_scene import SolvedScene
from contact_app.accuracy.trust import few_cells
from contact_app.model.equilibrium import body_frame, contact_motions, motion_size
from contact_app.model.loaded_area import loaded_facets, straddled_area
from contact_app.model.obstacle_hints import facing_away, turned_round
from contact_app.results.carried import carried
from contact_app.results.free_motions import free_motions
from contact_app.results.friction import closing_points, moved_by_held
from contact_app.results.percent import percent
from contact_app.results.reactions import hold_records
from contact_app.results.repeated_sentences import without_repetitions
from contact_app.results.shared_forces import shared_force_warnings
from contact_app.results.sliding import largest_sliding, sliding_on_each_other
from contact_app.results.tilted_pairs import tilted_pairs
from contact_app.results.undetermined import Movable, play_warnings, undetermined
from contact_app.run import warning_texts as texts
from contact_app.scene.bodies import MOTION_NAMES
from contact_app.scene.conditions import Pressure, Traction
from meshes.arrays import Array
from meshes.merged_nodes import CLOSED_SEAM, JOINED_GROUPS
from meshes.quadratic import CORNERS_ONLY
from solver.contact.certificate import EQUILIBRIUM_FLOOR
from solver.driver import reason_text
from solver.exchange import NodeExchange
from solver.problem.sizes import SIZES
from solver.qp.result import Reason
from solver.rigid_motions import MOTIONS
from solver.tfeti.dual import DualProblem

SIMPLICES = ("triangle", "tetrahedron")

ROUNDED_STRAINS = 1e-3
"""Energy norm of rounding errors over that of the strains, above which there is a warning."""

STRADDLED = 0.01
"""Area of facets partly on a loaded boundary, over its area, above which there is a warning."""

SMALL_PART = 0.05
"""Relative error of the solver in heated bodies above which there is a warning."""

HELD_LOAD = 0.05
"""Share of the load on a body that its `hold` may carry without a warning. Flat facets of round
surfaces drive a held rotation with up to a hundredth."""


UNFINISHED = (
    Reason.MAX_ITERATIONS, Reason.MAX_OUTER_ITERATIONS, Reason.UNSETTLED, Reason.SLIDES,
    Reason.STOPPED,
)  # fmt: skip
"""Reasons after which displacements say nothing about the scene: bodies may be far away."""


def model_warnings(answer: SolvedScene) -> list[str]:
    """Warnings for the certificate, one sentence each (collective)."""
    warnings = [sentence for check in CHECKS for sentence in check(answer) if sentence]
    return without_repetitions(warnings, [body.name for body in answer.model.scene.bodies])


def _moved(answer: SolvedScene) -> tuple[DualProblem, NodeExchange, Array]:
    """The problem, its nodes, and their displacement."""
    return answer.model.problem, answer.model.node_exchange, answer.nodes.displacement


def _large_deformations(answer: SolvedScene) -> list[str]:
    """Strains and rotations that are not small."""
    comm, cells = answer.model.comm, answer.cells
    largest = cells.largest_strain, cells.largest_rotation
    return texts.large_deformations(*(comm.allreduce(value, op=MPI.MAX) for value in largest))


def _straight_edges(answer: SolvedScene) -> Iterator[str]:
    """Round boundaries whose straight edges are coarse beside displacements or gaps."""
    scene, moved = answer.model.scene, answer.solution.measures.deformations
    distances = sagittas(answer.model.geometry, answer.nodes)
    gaps = median_gaps(answer.model) if any(distances) else []
    for contact, sagitta, gap in zip(scene.contacts, distances, gaps, strict=False):
        body = scene.bodies[contact.body]
        if text := texts.straight_edges(body.name, sagitta, moved[contact.body], gap, body.degree):
            yield f"{contact.source}: {text}"


def _straight_facets(answer: SolvedScene) -> Iterator[str]:
    """Round bodies in contact through flat facets that are coarse for displacements or gaps."""
    scene, moved = answer.model.scene, answer.solution.measures.deformations
    every = pair_distances(answer.model.geometry, answer.nodes)
    is_off = any(distances.facets for distances in every)
    gaps = median_gaps(answer.model)[len(scene.contacts) :] if is_off else []
    for pair, distances, gap in zip(scene.pairs, every, gaps, strict=False):
        names = f"{scene.bodies[pair.body].name} and {scene.bodies[pair.other].name}"
        largest = max(moved[pair.body], moved[pair.other])
        if text := texts.flat_facets(names, distances, largest, gap, pair.round):
            yield f"{pair.source}: {text}"


def _beside_obstacles(answer: SolvedScene) -> Iterator[str]:
    """Sliding along curved obstacles, and contact that leaves its boundary."""
    model, solution = answer.model, answer.solution
    scene = model.scene
    for i, contact in enumerate(scene.contacts):
        radius, moved = contact.obstacle.curvature_radius, solution.measures.deformations
        if radius:
            sliding = largest_sliding(*_moved(answer), solution, i)
            if text := texts.curving_away(sliding, radius, moved[contact.body]):
                yield f"{contact.source}: {text}"
        entered, depth = entered_beside(model, solution, i, contact.body)
        name = scene.bodies[contact.body].name
        if text := texts.beside_boundary(name, contact.boundary, entered, depth):
            yield f"{contact.source}: {text}"


def _facing_away(answer: SolvedScene) -> Iterator[str]:
    """Boundaries that face away from their obstacle (collective)."""
    contacts, pressed = answer.model.scene.contacts, answer.pressed
    for source in turned_round(answer.model.geometry):
        pulls = any(p for c, p in zip(contacts, pressed, strict=False) if c.source == source)
        yield f"{source}: {facing_away(pulls)}"


def _coarse_pressures(answer: SolvedScene) -> Iterator[str]:
    """Pressures that vary within single facets."""
    contacts = answer.model.scene.touching
    for contact, coarse in zip(contacts, answer.coarse_pressures, strict=True):
        if coarse is not None:
            yield f"{contact.source}: {coarse.warning}"


def _sliding_bodies(answer: SolvedScene) -> Iterator[str]:
    """Bodies that slide along each other by more than a facet."""
    scene = answer.model.scene
    for i, pair in enumerate(scene.pairs, start=len(scene.contacts)):
        sliding_and_size = sliding_on_each_other(*_moved(answer), answer.solution, i)
        if text := texts.sliding_far(*sliding_and_size):
            yield f"{pair.source}: {text}"


def _corners_only(answer: SolvedScene) -> Iterator[str]:
    """Second-order files that are solved at degree 1 though the scene names no degree."""
    for body in answer.model.scene.bodies:
        if body.degree == 1 and not body.degree_given and CORNERS_ONLY in body.mesh.notes:
            yield f"{body.name}: {texts.corners_only()}"


def _merged_nodes(answer: SolvedScene) -> Iterator[str]:
    """Seams, cracks and joints of parts in a mesh file that merging its nodes has closed."""
    for body in answer.model.scene.bodies:
        for note in body.mesh.notes:
            if CLOSED_SEAM in note or JOINED_GROUPS in note:
                yield f"{body.name}: {note}"


def _locking_in_volume(answer: SolvedScene) -> Iterator[str]:
    """First-order cells of nearly incompressible bodies."""
    scene = answer.model.scene
    for body in scene.bodies:
        if body.nearly_incompressible(scene.plane) and body.plain:
            poisson = max(material.poisson for material in body.materials)
            remedy = "degree: 2"
            if body.mesh.cell in ("quadrilateral", "hexahedron"):
                remedy = "mean_dilatation: true or degree: 2"
            yield f"{body.name}: {texts.locking_in_volume(poisson, remedy)}"


def _locking_in_bending(answer: SolvedScene) -> Iterator[str]:
    """First-order cells whose strains vary within them."""
    shares = _varying_energy(answer)
    for body, share in zip(answer.model.scene.bodies, shares, strict=True):
        near = " or near ν = 0.5" if body.plain else ""
        text = texts.locking_in_bending(share, "strain energy", near, "degree: 2")
        if body.degree == 1 and text:
            yield f"{body.name}: {text}"


def _coarse_meshes(answer: SolvedScene) -> Iterator[str]:
    """Bodies with few cells, and first-order simplices with a large error."""
    scene, solution = answer.model.scene, answer.solution
    error = solution.accuracy.discretisation if solution.accuracy else np.nan
    if scene.accuracy is None:
        yield from few_cells(scene.bodies, error)
    simplices = [b.name for b in scene.bodies if b.degree == 1 and b.mesh.cell in SIMPLICES]
    if simplices:
        yield texts.stiff_simplices(error, ", ".join(simplices), "degree: 2")


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
        left = straddled_area(scene.bodies, partition, load)
        area = loaded_facets(scene.bodies, partition, load)[1] if left > 0.0 else 0.0
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


def _friction(answer: SolvedScene) -> Iterator[str]:
    """Friction of open nodes, and friction for which the answer need not be unique (collective)."""
    scene, comm = answer.model.scene, answer.model.comm
    for contact, nodes in zip(scene.touching, answer.nodes.contacts, strict=True):
        count = comm.allreduce(int((nodes.rubs & ~nodes.closed).sum()))
        pressed = comm.allreduce(int(nodes.closed.any()), op=MPI.MAX)
        several = texts.several_answers(contact.law.coefficient, bool(pressed))
        for text in filter(None, (texts.rubbing_where_open(count), several)):
            yield f"{contact.source}: {text}"
    names = [contact.source for contact in scene.touching]
    yield from shared_force_warnings(answer.model.problem, answer.solution, names)


def _closes_at_once(answer: SolvedScene) -> Iterator[str]:
    """Frictional contact that grows under a load that is applied at once (collective)."""
    model = answer.model
    if not model.scene.has_friction or model.scene.in_step:
        return
    approach = moved_by_held(model.geometry, model.problem, None)
    changed = closing_points(model.problem, answer.solution, None, approach)
    remedy = "`steps` with several increments show how much this matters"
    yield texts.closing_at_once(*changed, "the unloaded state", remedy)


def _slides(answer: SolvedScene) -> Iterator[str]:
    """Bodies that slide along round surfaces, resisted by their facets alone (collective)."""
    scene = answer.model.scene
    for motion in free_motions(answer.model, answer.solution):
        names = ", ".join(MOTION_NAMES[scene.dimension][k] for k in motion.names)
        remedy = f"`hold: [{names}]` on the body prevents the motion"
        yield motion.sentence(scene.bodies[motion.body].name, remedy)


def _loaded_holds(answer: SolvedScene) -> Iterator[str]:
    """Bodies whose `hold` carries a part of the load (collective)."""
    scene, loads = answer.model.scene, answer.solution.measures.loads
    numbers = {body.name: number for number, body in enumerate(scene.bodies)}
    for record in hold_records(answer.model, answer.solution):
        number = numbers[record["on"]]
        length = body_frame(scene.bodies[number])[1]
        turns = np.eye(MOTIONS[scene.dimension])[scene.dimension :]
        levers = [length * motion_size(scene.bodies, number, turn) for turn in turns]
        force, moment = (float(np.linalg.norm(record[key])) for key in ("force", "moment"))
        turning = float(np.linalg.norm(np.divide(record["moment"], levers)))
        if max(force, turning) > HELD_LOAD * loads[number]:
            yield (
                f"`hold` on {record['on']} carries a force of {force:.3g} and a moment of "
                f"{moment:.3g}, since loads drive the held motions ({', '.join(record['hold'])}): "
                "the contacts carry this much less. Hold only motions that nothing resists, or "
                "give the body a support"
            )


def _movable(answer: SolvedScene) -> Iterator[str]:
    """Bodies that can be moved, or that friction carries along, without any force (collective)."""
    model, solution = answer.model, answer.solution
    motions_of, movable = partial(contact_motions, model.geometry), Movable.of(model.geometry)
    motions = undetermined(model.problem, solution, motions_of, movable)
    yield from play_warnings(motions, "a displacement condition, `hold` or friction")
    if solution.converged:
        yield from carried(model.problem, solution, motions_of, movable)


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


def _is_unfinished(answer: SolvedScene) -> bool:
    """Whether the displacements are those of an iteration that other causes than rounding ended."""
    return not answer.solution.converged and answer.solution.reason in UNFINISHED


def _moved_beyond_sizes(answer: SolvedScene) -> Iterator[str]:
    """Bodies that move farther than they are large, but for motions that nothing resists."""
    if _is_unfinished(answer):
        return
    bodies, moved = answer.model.scene.bodies, answer.solution.measures.deformations
    for body, largest in zip(bodies, moved, strict=False):
        size = float(np.linalg.norm(np.subtract(body.mesh.upper, body.mesh.lower)))
        yield texts.moved_beyond_size(body.name, float(largest), size)


def _moved_far(answer: SolvedScene) -> list[str]:
    """Bodies whose strains or contact forces are comparable with rounding errors."""
    if _is_unfinished(answer):
        return []
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


def _varying_energy(answer: SolvedScene) -> Array:
    """Share of each body's strain energy in strains that vary within cells, (bodies,)."""
    measures = answer.solution.measures
    means = answer.model.comm.allreduce(answer.cells.energy_of_means)
    strains, roundings = (v[: len(means)] for v in (measures.strains, measures.roundings))
    strained = strains > SIZES.strainless * roundings
    total = np.where(strained, strains, 1.0)
    return np.where(strained, 1.0 - means / total, 0.0)


CHECKS: tuple[Callable[[SolvedScene], Iterable[str]], ...] = (
    _large_deformations, _yielding, _straight_edges, _straight_facets, _beside_obstacles,
    _facing_away,
    lambda answer: slipped_through(answer.model, answer.solution),
    lambda answer: entered_pairs(answer.model, answer.solution, answer.nodes),
    lambda answer: entered_without_contact(answer.model, answer.solution, answer.nodes),
    lambda answer: entered_by_rigid_bodies(answer.model, answer.solution),
    _coarse_pressures,
    _sliding_bodies,
    lambda answer: tilted_pairs(answer.model.geometry, answer.model.problem, answer.solution),
    lambda answer: answer.model.scene.idle,
    _corners_only, _merged_nodes, _locking_in_volume, _locking_in_bending,
    _moved_beyond_sizes, _moved_far, _coarse_meshes, _stresses_beside_expansion,
    _straddled_facets, _without_facets, _certificates,
    lambda answer: answer.overcome,
    lambda answer: answer.model.cautions,
    _slides, _loaded_holds,
    _friction, _closes_at_once, _movable,
)  # fmt: skip
"""The tests of an answer, in the order of their warnings."""
