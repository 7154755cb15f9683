"""Warnings that the answers of scenes and of forms share: their limits and their sentences.

Each function on a contact returns a sentence without the name of the contact, or an empty text
where there is nothing to say.
"""

from contact_app.accuracy.faceted_curves import FITTED, FITTED_SMOOTH, Distances, compared

SMALL_STRAIN, SMALL_ROTATION = 0.05, 0.1
"""Strain, and rotation in radians, above which a warning follows: they are not small."""

LARGE_ERROR = 0.4
"""Estimated relative error of first-order simplices above which there is a warning."""

VARYING = 0.3
"""Largest admissible share of the energy in strains that vary within first-order cells.

In bending the share is 1/n² for n cells of equal sides across the thickness.
"""

SMALL_SAGITTA = 0.01
"""Error of a gap by sliding along a curved obstacle, over the displacement, that is warned of."""

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


def large_deformations(strain: float, rotation: float) -> list[str]:
    """Strains and rotations, in radians, that are not small."""
    sentences = []
    if strain > SMALL_STRAIN:
        sentences.append(
            f"strains reach {strain:.2g}; the model assumes small ones (below {SMALL_STRAIN})"
        )
    if rotation > SMALL_ROTATION:
        sentences.append(
            f"rotations reach {rotation:.2g} rad; the model assumes small ones, and gaps and "
            "normals are those of the undeformed shape"
        )
    return sentences


def corners_only() -> str:
    """A second-order file at the default degree."""
    return (
        "its mesh file is of second order, and bodies have degree 1 unless the scene says "
        "otherwise: only the corners of cells are used, with straight edges; use degree: 2 for "
        "curved cells, or degree: 1 if straight ones are meant"
    )


def locking_in_volume(poisson: float, remedy: str) -> str:
    """First-order cells of a nearly incompressible body."""
    return (
        f"first-order cells lock as Poisson's ratio nears 0.5 (it is {poisson:.4g}): displacements "
        f"come out too small; use {remedy}"
    )


def stiff_simplices(error: float, names: str, remedy: str) -> str:
    """First-order triangles or tetrahedra with a large error.

    Parameters
    ----------
    error
        Estimate, relative, in energy norm; it may be NaN.
    names
        Of the bodies; empty for all.
    """
    if not error > LARGE_ERROR:
        return ""
    return (
        f"the error of the mesh is estimated at {100.0 * error:.0f} % in energy norm: first-order "
        f"triangles and tetrahedra{f' ({names})' if names else ''} are stiff in bending; use "
        f"{remedy} or a finer mesh"
    )


def locking_in_bending(share: float, quantity: str, near: str, remedy: str) -> str:
    """First-order cells whose strains vary within them.

    Parameters
    ----------
    share
        Of a quantity of the body, in strains that vary within cells.
    near
        Further cause.
    """
    if share <= VARYING:
        return ""
    return (
        f"{100.0 * share:.0f} % of its {quantity} lies in strains that vary within cells: "
        f"first-order cells lock in bending{near}, and displacements come out too small; use "
        f"{remedy} or several times as many cells across"
    )


def moved_beyond_size(name: str, moved: float, size: float) -> str:
    """A body that moves farther than it is large, as with lengths in two units."""
    if not moved > size:
        return ""
    return (
        f"{name} moves by {moved:.3g}, farther than it is large ({size:.3g}): displacements are "
        "assumed to be small; compare the units of mesh, obstacles, loads and moduli, and the "
        "places of obstacles"
    )


def straight_edges(name: str, sagitta: float, moved: float, gap: float, degree: int) -> str:
    """Straight edges of a round body on an obstacle that are coarse beside displacements or gaps.

    Parameters
    ----------
    sagitta
        Largest distance of the middle of an edge from the curve.
    moved, gap
        Largest displacement of the body, and median gap of the contact.
    """
    share = compared(sagitta, moved, gap)
    if not share:
        return ""
    second = "a mesh file of second order (in Gmsh: Mesh.ElementOrder = 2)"
    remedy = f"use {second}" if degree == 2 else f"use degree: 2 and {second}"
    return (
        f"the boundary of {name} is round and the edges of its mesh are straight: the middle of an "
        f"edge lies up to {sagitta:.2g} beside the curve, {share}, and the answer is that of the "
        f"polygon; {remedy}"
    )


def flat_facets(names: str, distances: Distances, moved: float, gap: float, is_round: bool) -> str:
    """Flat facets of round bodies that are coarse beside displacements or gaps.

    Parameters
    ----------
    distances
        From the curve.
    moved, gap
        Largest displacement of the bodies, and median gap of the contact.
    is_round
        Whether the gap is that of smooth surfaces through the nodes.
    """
    distance = distances.smooth if is_round else distances.facets
    share = compared(distance, moved, gap, FITTED_SMOOTH if is_round else FITTED)
    if not share:
        return ""
    second = "degree: 2 and a mesh file of second order (in Gmsh: Mesh.ElementOrder = 2)"
    facets = (
        f"{names} are round there and meet by flat facets, which lie up to {distances.facets:.2g} "
    )
    if is_round:
        return (
            f"{facets}beside the curve (h²/8R): the smooth surfaces of `round: true` may lie "
            f"{distance:.2g} beside it, {share}; use finer facets, or {second}"
        )
    return (
        f"{facets}beside the curve (h²/8R), {share}: the facets decide the gaps and the largest "
        f"pressure; use `round: true` of the contact and max_smoothed_pressure, or {second}"
    )


def curving_away(sliding: float, radius: float | None, moved: float) -> str:
    """Sliding along a round obstacle, beside the displacement of the body."""
    sagitta = sliding**2 / (2.0 * radius) if radius else 0.0
    if not sagitta > SMALL_SAGITTA * moved > 0.0:
        return ""
    return (
        f"nodes in contact slide by up to {sliding:.3g} along an "
        f"obstacle of radius {radius:.3g}: over this length its surface curves away by "
        f"{sagitta:.2g}, which the linearised gap leaves out"
    )


def beside_boundary(name: str, boundary: str, entered: int, depth: float) -> str:
    """Surface nodes outside of a contact boundary that enter the obstacle."""
    if not entered:
        return ""
    return (
        f"{entered:,} surface nodes of {name} outside {boundary} penetrate the obstacle, by up to "
        f"{depth:.3g}: the contact is wider than this boundary; name a larger boundary"
    )


def sliding_far(sliding: float, facet: float) -> str:
    """Bodies that slide along each other by more than a facet."""
    if sliding <= facet:
        return ""
    return (
        f"the bodies slide along each other by up to {sliding:.3g}, more "
        f"than a facet ({facet:.2g}); the undeformed shape decides which parts may touch"
    )


def rubbing_where_open(count: int) -> str:
    """Friction of a given limit at nodes without a contact force."""
    if not count:
        return ""
    return (
        f"Tresca friction acts on {count} nodes that carry no contact "
        "force; with friction: {coulomb: …} friction acts on pressed nodes alone"
    )


def several_answers(coefficient: float, pressed: bool) -> str:
    """Coulomb friction so large that the answer need not be unique."""
    if not pressed or coefficient < LARGE_FRICTION:
        return ""
    return (
        f"with a coefficient of friction of {coefficient:g} the answer "
        "need not be unique: the certificate holds for this one, and there may be others"
    )


def closing_at_once(changed: int, touching: int, since: str, remedy: str) -> str:
    """Frictional contact that grows under a load that is applied at once.

    Parameters
    ----------
    since
        The state from which slip is measured.
    """
    if changed <= CLOSING * touching:
        return ""
    return (
        f"{changed:,} of {touching:,} contact points with friction close or open under the "
        f"load, which is applied at once: their slip is measured from {since}, not "
        f"from the state in which they touched; {remedy}"
    )
