"""Names of conditions and the factors that load cases give them.

    conditions:
      - {name: press, on: cube.z+, traction: [0, 0, -465]}
    cases:
      braking: {press: 1, push: 1}

Whatever else multiplies named conditions by factors reads them by `names_of_conditions` and
`read_factors`.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence

from contact_app.scene.keys import Keys, Place
from contact_app.scene.scene import LoadCase

LONGEST = 100
"""Characters of a case's name."""

RESERVED = ("con", "nul")
"""Names that some systems take for devices."""


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
                "each name is given once",
            )
        first[condition.name] = i
    return list(first)


def read_factors(
    keys: Keys, given: Mapping[str, float], path: Place, known: Sequence[str]
) -> tuple[tuple[str, float], ...]:
    """Factors of conditions by name, each name one that is known."""
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            keys.fail((*path, name), f"names no condition{hint} (known: {', '.join(known)})")
    return tuple(given.items())


def read_cases(keys: Keys) -> tuple[LoadCase, ...]:
    """The load cases of a scene file."""
    known, given = names_of_conditions(keys), keys.configuration.cases
    if given is None:
        return ()
    if not known:
        keys.fail(
            ("cases",),
            "give factors to conditions by their names, and no condition has a name: add one, e.g. "
            "{name: press, on: …}",
        )
    _refuse_bad_names(keys, list(given))
    return tuple(
        LoadCase(name, read_factors(keys, factors, ("cases", name), known))
        for name, factors in given.items()
    )


def _refuse_bad_names(keys: Keys, names: Sequence[str]) -> None:
    """Refuse names of cases that are no names of directories, each different from the others."""
    seen: dict[str, str] = {}
    for name in names:
        short = len(name) <= LONGEST and name.lower() not in RESERVED
        if not short or not re.fullmatch(r"\w[\w-]*", name):
            keys.fail(
                ("cases", name),
                "is no name of a case: each names a directory of results, so letters, digits, _ "
                f"and - are allowed, {LONGEST} at most",
            )
        if name.lower() in seen:
            keys.fail(
                ("cases", name),
                f"and {seen[name.lower()]} differ in capital letters alone, and some systems take "
                "their directories for one",
            )
        seen[name.lower()] = name
