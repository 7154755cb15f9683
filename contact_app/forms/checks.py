"""Checks before assembly, with the messages of their errors."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from numbers import Integral, Real
from typing import Any, get_args

import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc
from scipy import linalg, sparse
from ufl.core.expr import Expr

from contact_app.errors import ConfigurationError
from contact_app.forms.contacts import Contact, SignedDistance, values_of
from contact_app.scene.conditions import Friction
from contact_app.scene.obstacles import Cylinder, Plane, Sphere
from meshes import dolfinx_compat
from solver.contact.options import Method

CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")

DEGREES = (1, 2)

UNSYMMETRIC = 1e-10
"""Largest difference of K and its transpose, over the largest entry, that counts as round-off."""

LANCZOS = 20
"""Number of products with K in the search for a negative energy."""


@contextmanager
def together(comm: MPI.Intracomm) -> Iterator[None]:
    """Context manager that raises the error of any rank on all ranks (collective)."""
    fault: Exception | None = None
    try:
        yield
    except Exception as error:
        fault = error
    kinds = ConfigurationError, ArithmeticError, TypeError, ValueError
    number = next((k for k, kind in enumerate(kinds) if isinstance(fault, kind)), None)
    faults = comm.allgather(None if fault is None else (number, f"{fault}"))
    if fault is not None:
        raise fault
    for number, text in filter(None, faults):
        raise RuntimeError(text) if number is None else kinds[number](text)


def check_forms(a: Any, L: Any, bcs: Sequence[Any]) -> Any:
    """The vector Lagrange space of the forms.

    Raises
    ------
    TypeError
        Something is not what dolfinx's `LinearProblem` takes, or PETSc is complex.
    ValueError
        The forms have other arguments, the space is another one, or a condition is on another.
    """
    if np.issubdtype(PETSc.ScalarType, np.complexfloating):
        raise TypeError("contact needs real numbers: this PETSc is built for complex ones")
    if not isinstance(a, ufl.Form) or not isinstance(L, ufl.Form):
        raise TypeError(
            f"a and L must be forms of ufl, not yet compiled by dolfinx.fem.form; they are "
            f"{type(a).__name__} and {type(L).__name__}"
        )
    rank = [len(form.arguments()) for form in (a, L)]
    if rank != [2, 1]:
        raise ValueError(
            f"a must be bilinear and L linear; they have {rank[0]} and {rank[1]} arguments"
        )
    space = a.arguments()[0].ufl_function_space()
    for argument in (*a.arguments(), *L.arguments()):
        if argument.ufl_function_space() != space:
            raise ValueError("trial and test functions of a and L must be of one space")
    _check_space(space)
    for form, name in ((a, "a"), (L, "L")):
        if any(np.iscomplexobj(getattr(c, "value", 0.0)) for c in form.constants()):
            raise TypeError(f"contact needs real numbers: {name} has a complex constant")
        _check_tags_of_integrals(form, name, space.mesh)
        kinds = {integral.integral_type() for integral in form.integrals()}
        if not kinds <= {"cell", "exterior_facet"}:
            raise ValueError(
                f"{name} has integrals over {', '.join(sorted(kinds))}; those over cells (dx) and "
                "facets of the surface (ds) are allowed, since others join cells of several ranks"
            )
    for number, condition in enumerate(bcs):
        if not hasattr(condition, "dof_indices"):
            raise TypeError(f"bcs[{number}] is no Dirichlet condition of dolfinx.fem.dirichletbc")
        condition_space = condition.function_space
        if not space._cpp_object.contains(getattr(condition_space, "_cpp_object", condition_space)):
            raise ValueError(f"bcs[{number}] is of another space than the forms")
    return space


def _check_tags_of_integrals(form: Any, name: str, mesh: Any) -> None:
    """Refuse integrals over other meshes, and those over tags that no entity has (collective).

    dolfinx leaves the latter out, and a load would be missing without a word.
    """
    for integral in form.integrals():
        if integral.ufl_domain() != mesh.ufl_domain():
            raise ValueError(f"{name} has an integral over another mesh than that of its functions")
    data: dict[str, Any] = {}
    for integral in form.integrals():
        if integral.subdomain_data() is not None:
            data[integral.integral_type()] = integral.subdomain_data()
    for integral in form.integrals():
        kind, over = integral.integral_type(), integral.subdomain_id()
        measure = {"cell": "dx", "exterior_facet": "ds"}.get(kind)
        if measure is None or isinstance(over, str):
            continue
        tags = data.get(kind)
        if tags is None:
            raise ValueError(
                f"{name} has an integral over {measure}({over}) without tags, which is zero; take "
                f'ufl.Measure("{measure}", domain=mesh, subdomain_data=tags)({over})'
            )
        if hasattr(tags, "values"):
            count = int(np.isin(tags.values, over).sum())
            if mesh.comm.allreduce(count) == 0:
                raise ValueError(
                    f"{name} has an integral over {measure}({over}), but the tags of {measure} "
                    f"have no entity with the value {over}"
                )


def _check_space(space: Any) -> None:
    """Refuse spaces other than continuous vector Lagrange of degree 1 or 2 on known cells."""
    mesh, degree = space.mesh, dolfinx_compat.lagrange_degree(space)
    d, components = mesh.geometry.dim, space.dofmap.index_map_bs
    if degree is None or components == 1 or components != space.dofmap.bs:
        raise ValueError(
            f"the forms are over {space.ufl_element()}; contact needs a continuous vector Lagrange "
            "space of displacements"
        )
    cell = mesh.topology.cell_name()
    if cell not in CELLS:
        raise ValueError(f"the mesh has cells {cell}; contact needs {', '.join(CELLS)}")
    if mesh.topology.dim != d:
        raise ValueError(
            f"the mesh has cells {cell} in {d}D; contact in the plane needs points of two "
            "coordinates (of Gmsh: model_to_mesh with gdim=2)"
        )
    if components != d:
        raise ValueError(f"the space has {components} components in {d}D; displacements have {d}")
    if degree not in DEGREES:
        raise ValueError(f"the space is of degree {degree}; contact needs degree 1 or 2")


def check_holding(comm: MPI.Intracomm, bcs: Sequence[Any]) -> None:
    """Check that each Dirichlet condition holds something on some rank (collective).

    Raises
    ------
    ValueError
    """
    held = [len(condition.dof_indices()[0]) for condition in bcs]
    for number, count in enumerate(comm.allreduce(np.array(held, np.int64))):
        if count == 0:
            raise ValueError(
                f"bcs[{number}] holds no node: the entities or coordinates that were given to "
                "dolfinx for it match none of the mesh; leave it out if that is intended"
            )


def check_lists(bcs: Any, contacts: Any) -> None:
    """Check that conditions and contacts are lists, also of one.

    Raises
    ------
    TypeError
    """
    for name, values in (("bcs", bcs), ("contacts", contacts)):
        if not isinstance(values, Sequence) or isinstance(values, str):
            raise TypeError(
                f"{name} must be a list, not {type(values).__name__}; of one: {name}=[…]"
            )  # fmt: skip


def check_options(method: Any, tolerance: Any, max_iterations: Any) -> None:
    """Check the options of the solver.

    Raises
    ------
    TypeError, ValueError
    """
    if method not in get_args(Method):
        raise ValueError(f"method is {method!r}; allowed: {', '.join(get_args(Method))}")
    if not isinstance(tolerance, Real):
        raise TypeError(f"tolerance must be a number, not {tolerance!r}")
    if not 0.0 < float(tolerance) < 1.0:
        raise ValueError(f"tolerance must lie between 0 and 1, not {tolerance!r}")
    if not isinstance(max_iterations, Integral) or max_iterations < 1:
        raise ValueError(f"max_iterations must be a whole number from 1 on, not {max_iterations!r}")


def check_contacts(contacts: Sequence[Contact], mesh: Any, degree: int | None) -> None:
    """Check the arguments of the contacts, except for the existence of their facets.

    Raises
    ------
    TypeError, ValueError
    """
    for number, contact in enumerate(contacts):
        at = f"contacts[{number}]"
        if not isinstance(contact, Contact):
            raise TypeError(f"{at} must be a Contact, not {type(contact).__name__}")
        tags, d = contact.facet_tags, mesh.topology.dim
        if not (hasattr(tags, "dim") and hasattr(tags, "values")):
            raise TypeError(f"{at}.facet_tags must be dolfinx's mesh tags of facets")
        if tags.dim != d - 1:
            raise ValueError(f"{at}.facet_tags are of dimension {tags.dim}; facets have {d - 1}")
        if not dolfinx_compat.is_tagged(mesh, tags):
            raise ValueError(f"{at}.facet_tags are of another mesh than the forms")
        if (contact.obstacle is None) == (contact.against is None):
            raise ValueError(f"{at} needs an obstacle or `against`, and not both")
        for tag in (contact.tag, contact.against):
            if tag is not None and not np.issubdtype(np.asarray(tag).dtype, np.integer):
                raise TypeError(f"{at}: a value of facet tags is an integer, not {tag!r}")
        if contact.against is not None:
            both = set(values_of(contact.tag)) & set(values_of(contact.against))
            if both:
                raise ValueError(f"{at}: facets with the tag {min(both)} are on both sides")
        _check_friction(contact.friction, f"{at}.friction")
        interference: Any = contact.interference
        if not isinstance(interference, Real) or not np.isfinite(float(interference)):
            raise ValueError(f"{at}.interference must be a number, not {interference!r:.60}")
        for name, kind in (("round", bool), ("name", str)):
            value = getattr(contact, name)
            if not isinstance(value, kind):
                raise TypeError(f"{at}.{name} must be of type {kind.__name__}, not {value!r}")
        if contact.weight is not None:
            _check_function(contact.weight, f"{at}.weight")
            if degree != 1:
                raise ValueError(f"{at}.weight is for spaces of degree 1, not {degree}")
            if contact.against is not None:
                raise ValueError(f"{at}.weight is for obstacles, not for facets against facets")
        if contact.obstacle is not None:
            if contact.round:
                raise ValueError(f"{at}.round is for facets against facets; leave it out")
            _check_obstacle(contact.obstacle, f"{at}.obstacle", d)
        for k, earlier in enumerate(contacts[:number]):
            shared = set(values_of(earlier.tag)) & set(values_of(contact.tag))
            same = contact.obstacle is not None and earlier.obstacle == contact.obstacle
            if shared and same and earlier.law != contact.law:
                raise ValueError(
                    f"{at} repeats contacts[{k}] with other friction at facets {min(shared)}: a "
                    "node has one contact with an obstacle; leave one of them out"
                )


def _check_friction(law: Any, at: str) -> None:
    """That a law of friction, if there is one, has one number, and that it is of use."""
    if law is None:
        return
    if isinstance(law, Friction):
        law = {name: value for name, value in vars(law).items() if value is not None}
    one_law = 'one law: {"coulomb": coefficient} or {"tresca": slip limit}'
    if not isinstance(law, Mapping):
        raise TypeError(f"{at} must be {one_law}, not {law!r}")
    if len(law) != 1 or set(law) - {"coulomb", "tresca"}:
        raise ValueError(f"{at} must be {one_law}, not {dict(law)!r}")
    ((name, value),) = law.items()
    if not isinstance(value, Real):
        raise TypeError(f"{at}[{name!r}] must be a number, not {value!r}")
    if not 0.0 <= float(value) < np.inf:
        raise ValueError(f"{at}[{name!r}] must be zero or a positive number, not {value!r}")


def _check_obstacle(obstacle: Any, at: str, d: int) -> None:
    """Numbers and dimensions of an obstacle."""
    if isinstance(obstacle, SignedDistance):
        _check_function(obstacle.distance, f"{at}.distance")
        if obstacle.gradient is not None:
            _check_function(obstacle.gradient, f"{at}.gradient")
        return
    if isinstance(obstacle, Expr) or (callable(obstacle) and not isinstance(obstacle, type)):
        _check_function(obstacle, at)
        return
    if not isinstance(obstacle, Plane | Sphere | Cylinder):
        raise TypeError(
            f"{at} must be a Plane, Sphere, Cylinder, SignedDistance or a function of points, not "
            f"{obstacle!r:.60}"
        )
    if d == 2 and obstacle.not_in_plane:
        raise ValueError(f"{at}: a {type(obstacle).__name__} {obstacle.not_in_plane}")
    for name in (*obstacle.places, *obstacle.directions):
        vector = np.asarray(getattr(obstacle, name), np.float64)
        flat = vector.shape == (3,) and d == 2 and vector[2] == 0.0
        if not (vector.shape == (d,) or flat) or not np.isfinite(vector).all():
            raise ValueError(f"{at}.{name} must be {d} numbers, not {getattr(obstacle, name)!r}")
        if name in obstacle.directions and not vector.any():
            raise ValueError(f"{at}.{name} is zero; a direction has a length")
    radius, hollow = getattr(obstacle, "radius", 1.0), getattr(obstacle, "hollow", False)
    if not isinstance(radius, Real) or not 0.0 < float(radius) < np.inf:
        raise ValueError(f"{at}.radius must be a positive number, not {radius!r}")
    if not isinstance(hollow, bool):
        raise TypeError(f"{at}.hollow must be True or False, not {hollow!r}")


def _check_function(function: Any, at: str) -> None:
    """Raise an error unless `function` is a Python function of points; ufl expressions are not."""
    if not callable(function) or isinstance(function, Expr):
        raise TypeError(
            f"{at} must be a Python function of points x of shape (n, dimension), whose first "
            f"coordinates are x[:, 0]; it is of type {type(function).__name__}"
        )


def check_facets(comm: MPI.Intracomm, counts: tuple[int, int], at: str, tag: int) -> None:
    """Refuse a tag of a contact without facets, or with facets inside of the body (collective).

    Parameters
    ----------
    counts
        Tagged facets of this rank, and those of them on the surface.
    at
        What the side is called.
    """
    tagged, outside = comm.allreduce(np.array(counts))
    if outside == 0:
        count = f"{tagged} facets have it inside of the bodies" if tagged else "no facet has it"
        raise ValueError(
            f"{at}: no facet of the surface has the tag {tag} ({count}); contact is on the surface"
        )


def check_matrices(stiffness: Sequence[sparse.csr_matrix], loads: Sequence[Any]) -> None:
    """Refuse a form that is not symmetric, or gives some displacement a negative energy.

    Loads that are not numbers are refused, too.
    """
    if not all(np.isfinite(f).all() for f in loads):
        raise ValueError("L has entries that are not finite; look at its coefficients")
    for K in stiffness:
        size = np.abs(K.data).max(initial=0.0)
        if not np.isfinite(size):
            raise ValueError("a has entries that are not finite; look at its coefficients")
        off = np.abs((K - K.T).data).max(initial=0.0)
        if off > UNSYMMETRIC * size:
            raise ValueError(
                f"a is not symmetric: a(u, v) and a(v, u) differ by {off / size:.1e} of the "
                "largest entry of its matrix; contact is solved as a minimum of energy, which "
                "needs a symmetric form"
            )
        if not (K.diagonal() > 0.0).all():
            raise ValueError(
                "a is not elliptic: some displacement of a single node has no positive energy; "
                "look at its sign, and whether it has a part on every cell"
            )
        lowest = lowest_ritz_value(K)
        if lowest < -UNSYMMETRIC * size:
            raise ValueError(
                "a is not elliptic: the energy of some displacement is negative "
                f"(|K| = {size:.1e}, an eigenvalue below {lowest:.1e}); look at its moduli"
            )


def lowest_ritz_value(K: sparse.csr_matrix) -> float:
    """An upper bound of the smallest eigenvalue of a symmetric matrix, by Lanczos's method.

    A negative value proves that the matrix is indefinite, which a factor need not show. Wrong
    moduli give negative energies for displacements of all wavelengths, which this finds; it may
    miss a single negative eigenvalue.
    """
    n = K.shape[0]
    q, before, beta = np.cos(np.arange(1.0, n + 1.0)), np.zeros(n), 0.0
    q /= np.linalg.norm(q)
    diagonal, beside = [], []
    for _ in range(min(LANCZOS, n)):
        r = K @ q - beta * before
        diagonal.append(float(q @ r))
        r -= diagonal[-1] * q
        beta = float(np.linalg.norm(r))
        if beta <= UNSYMMETRIC * abs(diagonal[0]):
            break
        beside.append(beta)
        before, q = q, r / beta
    values = linalg.eigvalsh_tridiagonal(diagonal, beside[: len(diagonal) - 1])
    return float(values[0])
