"""Reading supports, loads and contacts of a scene file, with boundaries resolved by name."""

from contact_app.scene.bodies import FACES, Body, Box
from contact_app.scene.conditions import (
    FRICTIONLESS,
    BodyContact,
    BodyForce,
    Contact,
    DisplacementCondition,
    Friction,
    Pressure,
    RigidTie,
    Temperature,
    Tie,
    TotalLoad,
    Traction,
)
from contact_app.scene.expressions import ExpressionError, FieldExpression
from contact_app.scene.keys import Keys, Place
from contact_app.scene.obstacles import SHAPES
from contact_app.scene.read_rigid import RigidReader, read_moment, read_obstacle
from contact_app.scene.rigid import RigidBody, RigidLoad, RigidMotion
from contact_app.scene.schema import conditions as c
from contact_app.scene.schema.base import suggestion

Condition = (
    DisplacementCondition | Traction | Pressure | BodyForce | TotalLoad | Temperature
    | RigidMotion | RigidLoad
)  # fmt: skip

TOTALS = ("total_force", "total_moment")


class ConditionReader:
    """Reads conditions and contacts, given the bodies by name."""

    def __init__(
        self, keys: Keys, bodies: tuple[Body, ...], rigid_bodies: tuple[RigidBody, ...] = ()
    ) -> None:
        self.keys, self.bodies = keys, bodies
        self.names = [body.name for body in bodies]
        self.rigid = RigidReader(keys, rigid_bodies)

    def _name(self, text: str, path: Place) -> int:
        if text in self.rigid.names:
            self.keys.fail(
                path,
                f"names {text}, which is rigid and has no boundaries; `in: {text}` holds, moves or "
                f"loads it, and `against: {text}` lets the boundary of an elastic body touch it",
            )
        self._refuse_unknown(text, self.names, path)
        return self.names.index(text)

    def _refuse_unknown(self, text: str, names: list[str], path: Place) -> None:
        if text not in names:
            hint = suggestion(text, names)
            self.keys.fail(path, f"names the body {text!r}{hint} (known: {', '.join(names)})")

    def boundary(self, text: str, path: Place, inner: bool = False) -> tuple[int, str]:
        """Number of the body and name of the boundary in ``body.boundary``.

        Parameters
        ----------
        inner
            Whether it is to be an inner surface: of the mesh, or of an expression.
        """
        name, dot, boundary = text.partition(".")
        if text in self.rigid.names:
            self._name(text, path)
        if not dot or not boundary:
            self.keys.fail(
                path, f"is {text!r}; it has the form body.boundary, e.g. {self._example(text)}"
            )
        body = self._name(name, path)
        mesh = self.bodies[body].mesh
        of_mesh, other = (mesh.inner, mesh.boundaries) if inner else (mesh.boundaries, mesh.inner)
        boundaries = [*of_mesh, *self.bodies[body].boundaries]
        if boundary not in boundaries:
            kind = "inner surface" if inner else "boundary"
            hint = suggestion(boundary, boundaries, f"{name}.")
            if boundary in other:
                hint = "; it is on the surface" if inner else "; it lies inside, for sections alone"
            elif boundary in mesh.groups:
                hint = "; it is a group of cells, not of facets"
            elif boundary in FACES and not isinstance(mesh, Box):
                hint = "; only a box has it"
            if not boundaries:
                hint += (
                    "; the body has none: name it in the mesh file (in Gmsh a physical group) or "
                    "by an expression under `boundaries`"
                )
            listing = f" (known: {', '.join(boundaries)})" if boundaries else ""
            self.keys.fail(path, f"names the {kind} {boundary!r} of {name}{hint}{listing}")
        return body, boundary

    def _example(self, text: str) -> str:
        """A boundary with its body, where possible of the name that was given alone."""
        every = [(body.name, (*body.mesh.boundaries, *body.boundaries)) for body in self.bodies]
        named = [f"{name}.{text}" for name, boundaries in every if text in boundaries]
        return (
            *named,
            *(f"{name}.{boundaries[0]}" for name, boundaries in every if boundaries),
            "part.foot",
        )[0]

    def condition(self, i: int, condition: c.Condition) -> Condition:
        """A support or load."""
        path: Place = ("conditions", i)
        source = f"conditions[{i}]"
        if condition.inside is not None:
            body_names = [*self.names, *self.rigid.names]
            self._refuse_unknown(condition.inside, body_names, (*path, "in"))
        if condition.inside in self.rigid.names:
            return self.rigid.condition(i, condition)
        if condition.rotation is not None:
            names = ", ".join(self.rigid.names)
            self.keys.fail(
                (*path, "rotation"),
                "is of a rigid body, as in {in: punch, rotation: [0, 0, 0.01]}"
                + (f" (known: {names})" if names else "; the scene has none"),
            )
        kinds = [k for k in ("displacement", "traction", "pressure", "force", "temperature")
                 if getattr(condition, k) is not None]  # fmt: skip
        total = [k for k in TOTALS if getattr(condition, k) is not None]
        if total and not kinds:
            return self._total_load(condition, path, source)
        if total or condition.at is not None:
            key = (*total, "at")[0]
            self.keys.fail(
                (*path, key), "belongs to a total_force or total_moment, which stand alone"
            )
        if len(kinds) != 1:
            self.keys.fail(
                path,
                f"has {' and '.join(kinds) or 'no kind'}; exactly one of displacement, traction, "
                "pressure, force, temperature, or total_force and total_moment, is allowed",
            )
        kind = kinds[0]
        if kind in ("force", "temperature"):
            if condition.inside is None or condition.on is not None:
                example = {"force": "[0, 0, -1]", "temperature": "80"}[kind]
                text = f"a {kind} acts `in` a body, e.g. {{in: {self.names[0]}, {kind}: {example}}}"
                if kind == "force":
                    text += "; on a boundary there are traction, pressure and total_force"
                self.keys.fail(path, text)
            body = self._name(condition.inside, (*path, "in"))
            if kind == "temperature":
                return self._temperature(body, condition.temperature, path)
            vector = self.keys.vector(condition.force or [], (*path, "force"), "a force")
            return BodyForce(body, vector, source)
        if condition.on is None or condition.inside is not None:
            self.keys.fail(path, f"a {kind} acts `on` a boundary, e.g. {{on: cube.z+, {kind}: …}}")
        body, boundary = self.boundary(condition.on, (*path, "on"))
        if kind == "pressure":
            return Pressure(body, boundary, condition.pressure or 0.0, source)
        if kind == "traction":
            vector = self.keys.vector(condition.traction or [], (*path, kind), "a traction")
            return Traction(body, boundary, vector, source)
        values = condition.displacement or []
        self.keys.components(values, (*path, kind))
        if all(v is None for v in values):
            self.keys.fail((*path, kind), "leaves every component free; give a number for one")
        return DisplacementCondition(body, boundary, tuple(values), source)

    def _temperature(self, body: int, value: float | str | None, path: Place) -> Temperature:
        """A rise of temperature of a body; its materials need a coefficient of expansion."""
        keys, at = self.keys, (*path, "temperature")
        if self.bodies[body].expansion == 0.0:
            keys.fail(
                at,
                f"does nothing: no material of {self.names[body]} has an `expansion`, e.g. "
                "{young: 2.1e5, poisson: 0.3, expansion: 1.2e-5}",
            )
        try:
            text = value if isinstance(value, str) else repr(value)
            rise = FieldExpression.parse(text, ("x", "y", "z")[: keys.dimension])
        except ExpressionError as error:
            keys.fail(at, str(error))
        return Temperature(body, rise, f"conditions[{path[1]}]")

    def _total_load(self, condition: c.Condition, path: Place, source: str) -> TotalLoad:
        """A total force and moment; `at` has as many components as the scene has axes."""
        keys, d = self.keys, self.keys.dimension
        if condition.on is None or condition.inside is not None:
            keys.fail(path, "a total force or moment acts `on` a boundary, e.g. on: cube.z+")
        body, boundary = self.boundary(condition.on, (*path, "on"))
        force = condition.total_force or [0.0] * d
        vector = keys.vector(force, (*path, "total_force"), "a force")
        at = None
        if condition.at is not None:
            at = keys.space(condition.at, (*path, "at"), "a point")
        moment = read_moment(keys, condition.total_moment, (*path, "total_moment"))
        return TotalLoad(body, boundary, vector, moment, at, source)

    def contacts(self, i: int, contact: c.Contact) -> list[Contact | BodyContact | Tie | RigidTie]:
        """A contact with an obstacle or with another body, or a tied pair.

        A contact with a rigid body gives one contact for each of its obstacles.
        """
        path, source, keys = ("contacts", i), f"contacts[{i}]", self.keys
        if (contact.obstacle is None) == (contact.against is None):
            forms = " or ".join(f"{{{kind}: …}}" for kind in SHAPES)
            both = "has both; " if contact.obstacle else ""
            keys.fail(
                path, f"{both}needs an `obstacle`: {forms}; or `against`: another body.boundary"
            )
        rigid = contact.against in self.rigid.names
        if rigid and contact.on.partition(".")[0] in self.rigid.names:
            keys.fail(
                (*path, "on"),
                f"is {contact.on!r}, which is rigid as {contact.against} is, and two rigid bodies "
                "do not touch each other: give one of them a mesh and a stiff material",
            )
        body, boundary = self.boundary(contact.on, (*path, "on"))
        if contact.tied:
            self._refuse_beside_tied(contact, path)
        law = self._law(contact.friction, (*path, "friction"))
        if contact.round and (rigid or contact.obstacle is not None):
            shape = f"{contact.against} is rigid and" if rigid else "a round obstacle is"
            keys.fail(
                (*path, "round"), f"is for two elastic bodies: {shape} round as it is; leave it out"
            )
        overlap = contact.interference
        if contact.obstacle is not None:
            obstacle = read_obstacle(keys, contact.obstacle, (*path, "obstacle"))
            self._refuse_other_friction(i, contact)
            return [Contact(body, boundary, obstacle, source, overlap, law)]
        self._refuse_repeated(i, contact)
        if rigid:
            number = self.rigid.names.index(contact.against or "")
            if contact.tied:
                return [RigidTie(body, boundary, number, source)]
            return [
                Contact(body, boundary, shape, source, overlap, law, rigid=number, part=part)
                for part, shape in enumerate(self.rigid.bodies[number].obstacles)
            ]
        other, other_boundary = self.boundary(contact.against or "", (*path, "against"))
        if other == body:
            keys.fail(
                (*path, "against"),
                f"is a boundary of {self.names[body]} itself; contact of a body with itself is not "
                "modelled",
            )
        if contact.tied:
            return [Tie(body, boundary, other, other_boundary, source)]
        return [
            BodyContact(body, boundary, other, other_boundary, source, overlap, law, contact.round)
        ]

    def _refuse_repeated(self, i: int, contact: c.Contact) -> None:
        """Refuse a contact between two boundaries that an earlier contact has."""
        for k, earlier in enumerate(self.keys.configuration.contacts[:i]):
            if {earlier.on, earlier.against} == {contact.on, contact.against}:
                self.keys.fail(
                    ("contacts", i), f"repeats contacts[{k}]: each pair of boundaries is given once"
                )

    def _refuse_other_friction(self, i: int, contact: c.Contact) -> None:
        """Refuse a boundary and an obstacle that an earlier contact has with other friction."""
        for k, earlier in enumerate(self.keys.configuration.contacts[:i]):
            same = (earlier.on, earlier.obstacle) == (contact.on, contact.obstacle)
            if same and earlier.friction != contact.friction:
                self.keys.fail(
                    ("contacts", i),
                    f"repeats contacts[{k}] with other friction: a node has one contact with an "
                    "obstacle; leave one of them out",
                )

    def _law(self, entry: c.Friction | None, path: Place) -> Friction:
        """A law of friction; none if its coefficient or limit is zero."""
        if entry is None:
            return FRICTIONLESS
        laws = [key for key in ("coulomb", "tresca") if getattr(entry, key) is not None]
        if len(laws) != 1:
            self.keys.fail(
                path,
                f"has {' and '.join(laws) or 'no law'}; exactly one is allowed, "
                "{coulomb: coefficient} or {tresca: slip limit}",
            )
        if not getattr(entry, laws[0]):
            return FRICTIONLESS
        configuration = self.keys.configuration
        if configuration.certificate.guaranteed:
            self.keys.fail(
                path,
                "does not go together with a guaranteed bound "
                f"({configuration.where(('certificate', 'guaranteed'))}): the bound assumes that "
                "the answer minimises an energy, which does not hold with Coulomb's friction; "
                "leave one of them out",
            )
        return Friction(entry.coulomb, entry.tresca)

    def _refuse_beside_tied(self, contact: c.Contact, path: Place) -> None:
        """Refuse keys that have no meaning in a tied contact."""
        if contact.obstacle is not None:
            self.keys.fail(
                (*path, "tied"),
                "is for two bodies; hold a boundary with a displacement condition instead",
            )
        for key in ("interference", "friction", "round"):
            if key in contact.model_fields_set:
                self.keys.fail((*path, key), "has no meaning in a tied contact; leave it out")
