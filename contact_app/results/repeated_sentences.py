"""Warnings that differ only in the names of bodies and contacts become one with a count.

A tower of 50 blocks causes the same warning 49 times. The reader needs it once, with the number of
repetitions and their names.
"""

import re
from collections.abc import Callable, Iterable, Sequence

LISTED = 5
"""Largest number of listed names after the first."""

MANY = 4
"""Number of sentences of one kind from which on the screen has only the first of them."""

CHANGING = re.compile(r"(?<!\w)\[[^\]]*\]|\balong .*?(?=[,:;])|(?<![\w\[.])[-+]?\d[\w.,+-]*")
"""Pattern of lists, of directions in words and of numbers, but not of indices: `contacts[0]`."""

PLACE = r"\b(?:contacts|conditions|bodies)\[\d+\](?:\.\w+)*"
"""Pattern of names of parts of the configuration in messages."""


def without_repetitions(sentences: Sequence[str], names: Iterable[str]) -> list[str]:
    """The sentences, with those of one kind joined into one at the place of the first.

    Two sentences are of one kind if they differ only in names of bodies and places in the
    configuration. Different numbers make them different, so no larger value is hidden. The same
    sentence, as of two shapes of one rigid body, counts once.

    Parameters
    ----------
    names
        Names of bodies.

    Examples
    --------
    >>> without_repetitions(["b1: is loose", "b2: is stiff", "b3: is loose"], ["b1", "b2", "b3"])
    ['b1: is loose (and 1 more alike: b3)', 'b2: is stiff']
    """
    if len(sentences) < 2:
        return list(sentences)
    pattern = _names(names)
    groups = _grouped(dict.fromkeys(sentences), lambda sentence: pattern.sub("\0", sentence))
    return [_joined(group, pattern) for group in groups]


def shortened(sentences: Sequence[str], names: Iterable[str]) -> list[str]:
    """The sentences for the screen: many of one kind become one with a count.

    Sentences of one kind differ only in names, numbers and directions.

    Parameters
    ----------
    names
        Names of bodies.
    """
    pattern = _names(names)
    kinds = _grouped(sentences, lambda sentence: without_numbers(pattern.sub("#", sentence)))
    return [sentence for kind in kinds for sentence in _first_of_many(kind)]


def without_numbers(sentence: str) -> str:
    """A sentence without its numbers and directions; the numbers of contacts stay."""
    return CHANGING.sub("#", sentence)


def _grouped(sentences: Iterable[str], kind_of: Callable[[str], str]) -> Iterable[list[str]]:
    """The sentences of each kind, in the order of the first of each."""
    groups: dict[str, list[str]] = {}
    for sentence in sentences:
        groups.setdefault(kind_of(sentence), []).append(sentence)
    return groups.values()


def _first_of_many(kind: list[str]) -> list[str]:
    """All sentences of a kind, or the first with the number of the others."""
    if len(kind) < MANY:
        return kind
    return [f"{kind[0]} ({len(kind) - 1} more with other numbers: see summary.json)"]


def _names(names: Iterable[str]) -> re.Pattern[str]:
    """Pattern of the names of bodies and of places in the configuration."""
    patterns = sorted(map(re.escape, set(names)), key=len, reverse=True)
    bodies = [rf"(?<![\w.])(?:{'|'.join(patterns)})(?![\w])"] if patterns else []
    return re.compile("|".join([PLACE, *bodies]))


def _joined(group: list[str], pattern: re.Pattern[str]) -> str:
    """The first sentence of a group, with the number of the others and names of some."""
    first, *others = group
    if not others:
        return first
    about = [match[0] for match in map(pattern.search, others) if match]
    listed = dict.fromkeys(about[:LISTED])
    last = f", … {about[-1]}" if len(about) > LISTED else ""
    return f"{first} (and {len(others)} more alike: {', '.join(listed)}{last})"
