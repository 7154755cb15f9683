"""Contacts of tagged facets, with rigid obstacles or with other tagged facets.

An obstacle is a plane, a sphere, a cylinder or the zero set of a function φ that is negative inside
of it. The condition φ(x + u) ≥ 0, linearised at the undeformed point, is

    φ(x) + ∇φ(x) · u ≥ 0,   so   -n · u ≤ g   with   n = ∇φ / |∇φ|,   g = φ / |∇φ|.

Of a signed distance, |∇φ| = 1, g is the distance itself.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from contact_app.errors import ConfigurationError
from contact_app.model.facets import moments
from contact_app.scene.conditions import FRICTIONLESS, Friction
from contact_app.scene.obstacles import SHAPES, Cylinder, Obstacle, Plane, Sphere
from meshes.arrays import Array

STEP = 1e-5
"""Step of difference quotients over the size of the mesh, accurate to half the digits."""

FLAT = 1e-12
"""Slope of a distance, over its difference quotients' scale, below which it has no direction."""


@dataclass(frozen=True)
class SignedDistance:
    """An obstacle of any smooth shape: where a function is negative.

    Notes
    -----
    The gap is the value over the length of the gradient, the distance to first order.
    """

    directions: ClassVar[tuple[str, ...]] = ()
    not_in_plane: ClassVar[str] = ""

    distance: Callable[[Array], Array]
    """Points (n, dimension) to values (n,): positive outside, negative inside of the obstacle."""
    gradient: Callable[[Array], Array] | None = None
    """Points (n, dimension) to gradients (n, dimension); difference quotients unless given."""

    def gap_and_normal(self, points: Array, d: int, step: float) -> tuple[Array, Array]:
        """Gap (n,) and normal (n, 3) at points (n, 3).

        Parameters
        ----------
        d
            Dimension of the points that the functions are given.
        step
            Of difference quotients.

        Raises
        ------
        ConfigurationError
            The functions return something else, or a point has no normal.
        """
        x = np.ascontiguousarray(points[:, :d])
        if len(x) == 0:
            return np.zeros(0), np.zeros((0, 3))
        value = _called("signed distance of the obstacle", self.distance, x, (len(x),))
        if self.gradient is not None:
            slope = _called("gradient of the obstacle", self.gradient, x, x.shape)
        else:
            slope = np.empty_like(x)
            for axis, e in enumerate(step * np.eye(d)):
                high = _called("signed distance of the obstacle", self.distance, x + e, (len(x),))
                low = _called("signed distance of the obstacle", self.distance, x - e, (len(x),))
                slope[:, axis] = (high - low) / (2.0 * step)
        length = np.linalg.norm(slope, axis=1)
        flat = ~(length > FLAT)
        if flat.any():
            at = ", ".join(f"{v:g}" for v in x[np.argmax(flat)])
            raise ConfigurationError(
                f"the signed distance has no gradient at the contact node ({at}), and the obstacle "
                "no normal there; make the contact boundary smaller"
            )
        normal = np.zeros((len(x), 3))
        normal[:, :d] = slope / length[:, None]
        return value / length, normal

    def describe(self, dimension: int = 3) -> str:
        """A phrase for messages."""
        return f"signed distance {getattr(self.distance, '__name__', 'function')}"


def _called(name: str, function: Callable[[Array], Array], x: Array, shape: tuple) -> Array:
    """Values of a user's function at points (n, dimension), of a shape."""
    try:
        values = np.asarray(function(x))
    except Exception as error:
        raise ConfigurationError(
            f"the {name}, called with points of shape {x.shape}, raised {type(error).__name__}: "
            f"{error}"
        ) from error
    if not np.issubdtype(values.dtype, np.number) or np.iscomplexobj(values):
        kind = "nothing" if values.dtype == object else f"values of type {values.dtype}"
        raise ConfigurationError(f"the {name} returned {kind}; it must return real numbers")
    values = values.astype(np.float64)
    if values.shape != shape:
        raise ConfigurationError(
            f"the {name} returned an array of shape {values.shape} for points "
            f"of shape {x.shape}; it must return one of shape {shape} (a row of x is a point: its "
            "coordinates are x[:, 0], x[:, 1], not x[0], x[1] as in dolfinx)"
        )
    if not np.isfinite(values).all():
        raise ConfigurationError(f"the {name} is not finite at a contact node")
    return values


@dataclass(frozen=True, eq=False)
class Contact:
    """Facets that an obstacle or other facets keep from moving on."""

    facet_tags: Any
    """dolfinx's mesh tags of facets."""
    tag: int | Sequence[int]
    """Value of the facets that may touch, or several values."""
    obstacle: Plane | Sphere | Cylinder | SignedDistance | Callable[[Array], Array] | None = None
    """`Plane`, `Sphere`, `Cylinder`, `SignedDistance`, or a function that takes points (n,
    dimension) and returns signed distances (n,)."""
    against: int | Sequence[int] | None = None
    """Instead of an obstacle the value (or values) of the facets on the other side. The pressure is
    a field on `tag`, which should be the side with the finer mesh or the softer body."""
    interference: float = 0.0
    """Length along the normal that is subtracted from the gap of the geometry."""
    round: bool = False
    """Whether the gap is that of smooth surfaces through the nodes of both sides; for pairs."""
    name: str = ""
    """Name in messages and the summary; by default for example ``facets 3``."""
    friction: Friction | Mapping[str, float] | None = None
    """``{"coulomb": μ}``, or ``{"tresca": s}`` with the slip limit s, a force per area; or a
    `Friction`. Slip counts from the displacement zero. No friction unless given."""
    weight: Callable[[Array], Array] | None = None
    """Factor of the integrals of the forms, as r of cylindrical coordinates: points (n, dimension)
    to values (n,) from zero on. Pressures, tractions and areas are those of the body then, and
    forces those of the forms. For obstacles and spaces of degree 1."""

    @property
    def law(self) -> Friction:
        """The law of friction."""
        if isinstance(self.friction, Mapping):
            return Friction(**self.friction)
        return self.friction or FRICTIONLESS

    @property
    def on(self) -> str:
        """Name of the contact boundary in messages and the summary."""
        return self.name or f"facets {_listed(self.tag)}"

    @property
    def other(self) -> str:
        """Name of the other side in the summary."""
        if self.against is not None:
            return f"facets {_listed(self.against)}"
        for kind, shape in SHAPES.items():
            if isinstance(self.obstacle, shape):
                return kind
        return "signed distance"

    def shares(self, points: Array, d: int) -> Array:
        """∫ w φ_k over facets with nodes at points (f, n, 3), (f, n), the weight w linear.

        Raises
        ------
        ConfigurationError
            The weight is negative somewhere or no number.
        """
        if len(points) == 0:
            return np.zeros(points.shape[:2])
        integrals = moments(points, d)
        if self.weight is None:
            return np.asarray(integrals.sum(axis=1))
        x = points[:, : integrals.shape[1], :d].reshape(-1, d)
        values = _called(f"weight of {self.on}", self.weight, x, (len(x),))
        if values.min() < -FLAT:
            raise ConfigurationError(f"the weight of {self.on} is negative at a contact node")
        return np.asarray(np.einsum("fj,fjk->fk", values.reshape(integrals.shape[:2]), integrals))

    def gap_and_normal(self, points: Array, d: int, size: float) -> tuple[Array, Array]:
        """Gap (n,) and outward normal of the obstacle (n, 3) at points (n, 3).

        Parameters
        ----------
        size
            Of the mesh.
        """
        obstacle = self.obstacle
        if callable(obstacle):
            obstacle = SignedDistance(obstacle)
        if isinstance(obstacle, SignedDistance):
            try:
                gap, normal = obstacle.gap_and_normal(points, d, STEP * size)
            except ConfigurationError as error:
                raise ConfigurationError(f"contact of {self.on}: {error}") from error
        else:
            assert obstacle is not None
            gap, normal = in_space(obstacle).gap_and_normal(points)
        return gap - self.interference, normal


def in_space(obstacle: Obstacle) -> Obstacle:
    """An obstacle whose vectors have three components, from one that may have two."""
    assert isinstance(obstacle, Plane | Sphere | Cylinder)
    padded = {}
    for entry in fields(obstacle):
        value = getattr(obstacle, entry.name)
        if np.ndim(value) == 1:
            vector = tuple(float(v) for v in value)
            padded[entry.name] = vector + (0.0,) * (3 - len(vector))
    return replace(obstacle, **padded)  # type: ignore[arg-type]


def values_of(tag: int | Sequence[int]) -> tuple[int, ...]:
    """Values of a tag or of several."""
    return tuple(int(t) for t in np.atleast_1d(np.asarray(tag)))


def _listed(tag: int | Sequence[int]) -> str:
    return ", ".join(map(str, values_of(tag)))
