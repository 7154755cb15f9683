"""Names of conditions and the factors that load cases and load steps give them.

conditions:
  - {name: press, on: cube.z+, traction: [0, 0, -465]}
cases:                                   steps:
  braking: {press: 1, push: 1}             - {press: 1}
                                           - {push: 1, increments: 8}
"""

import re
from collections.abc import Mapping, Sequence

from contact_app.scene.keys import Keys, Place
from contact_app.scene.scene import LoadCase, LoadStep
from contact_app.scene.schema.base import suggestion

LONGEST = 100
"""Largest number of characters in the name of a case."""


def names_of_conditions(keys: Keys) -> list[str]:
    """The names of conditions in the order of the file; each is given once."""
    first: dict[str, int] = {}
    for i, condition in enumerate(keys.configuration.conditions):
        if condition.name is None:
            continue
        if condition.name in first:
            keys.fail(
                ("conditions", i, "name"),
                f"is {condition.name!r}, the name of conditions[{first[condition.name]}] already; "
                "each condition has its own: give the factors of both in cases and steps",
            )
        first[condition.name] = i
    return list(first)


def read_factors(
    keys: Keys,
    values: Mapping[str, float],
    path: Place,
    names: Sequence[str],
    others: Sequence[str] = (),
) -> tuple[tuple[str, float], ...]:
    """Factors of conditions by name; unknown names are errors.

    Parameters
    ----------
    others
        Further keys that are allowed in addition to the names.
    """
    for name in values:
        if name not in names:
            hint = suggestion(name, [*names, *others])
            keys.fail((*path, name), f"names no condition{hint} (known: {', '.join(names)})")
    return tuple(values.items())


def read_cases(keys: Keys) -> tuple[LoadCase, ...]:
    """The load cases of a scene file."""
    names, entries = names_of_conditions(keys), keys.configuration.cases
    if entries is None:
        return ()
    _refuse_without_names(keys, "cases", names)
    _refuse_bad_names(keys, list(entries))
    return tuple(
        LoadCase(name, read_factors(keys, factors, ("cases", name), names))
        for name, factors in entries.items()
    )


def read_steps(keys: Keys) -> tuple[LoadStep, ...]:
    """The load history of a scene file."""
    names, entries = names_of_conditions(keys), keys.configuration.steps
    if entries is None:
        return ()
    if keys.configuration.cases is not None:
        keys.fail(
            ("steps",),
            "and cases exclude each other: cases begin at the unloaded state, each step where the "
            "one before ends; leave one of them out",
        )
    _refuse_without_names(keys, "steps", names)
    if "increments" in names:
        keys.fail(
            ("steps",),
            "have the key `increments`, the number of parts in which a step is solved, and a "
            "condition has the same name: rename the condition",
        )
    factors: dict[str, float] = {}
    steps = []
    for i, step in enumerate(entries):
        named = read_factors(keys, step.model_extra or {}, ("steps", i), names, ["increments"])
        if not named:
            keys.fail(
                ("steps", i),
                f"names no condition, so that it changes no load (known: {', '.join(names)})",
            )
        factors |= dict(named)
        steps.append(LoadStep(tuple(factors.items()), step.increments))
    return tuple(steps)


def idle_conditions(keys: Keys) -> tuple[str, ...]:
    """A sentence on each condition with a name that no case and no step has: it never acts."""
    cases, steps = keys.configuration.cases, keys.configuration.steps
    if cases is None and steps is None:
        return ()
    loadings = [*(cases or {}).values(), *(step.model_extra or {} for step in steps or ())]
    named = set().union(*loadings)
    return tuple(
        f"conditions[{i}]: no {'step' if steps else 'case'} names {condition.name!r}, so that its "
        "factor is 0 throughout; a condition without a name always acts in full"
        for i, condition in enumerate(keys.configuration.conditions)
        if condition.name is not None and condition.name not in named
        if condition.displacement is None or any(condition.displacement)
    )


def _refuse_without_names(keys: Keys, key: str, names: Sequence[str]) -> None:
    if not names:
        keys.fail(
            (key,),
            "give factors to conditions by their names, and no condition has a name: add one, e.g. "
            "{name: press, on: …}",
        )


def _refuse_bad_names(keys: Keys, names: Sequence[str]) -> None:
    """Refuse names of cases that are not valid, distinct names of directories."""
    earlier: dict[str, str] = {}
    for name in names:
        if len(name) > LONGEST or not re.fullmatch(r"\w[\w-]*", name):
            keys.fail(
                ("cases", name),
                "is no valid name of a case: it becomes the name of a directory; letters, digits, "
                f"_ and - are allowed, {LONGEST} at most",
            )
        if name.lower() in earlier:
            keys.fail(
                ("cases", name),
                f"and {earlier[name.lower()]} differ in upper and lower case only, and some "
                "systems do not distinguish their directories",
            )
        earlier[name.lower()] = name
