"""Sentences that differ in nothing but the names of bodies and contacts, said once with a count.

A tower of 50 blocks makes one remark 49 times. The reader needs it once, with how many more there
are and what they are about.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

LISTED = 5
"""Names that are listed of those beyond the first."""

PLACE = r"\b(?:contacts|conditions|bodies)\[\d+\](?:\.\w+)*"
"""How messages name a part of the configuration."""


def said_once(sentences: Sequence[str], names: Iterable[str]) -> list[str]:
    """Sentences, those alike joined into one where the first of them stood.

    Two are alike if they are equal once the names of bodies and the places in the configuration are
    left out. Numbers count: the largest of several is never hidden behind another.

    Parameters
    ----------
    names
        Of bodies.

    >>> said_once(["b1: is loose", "b2: is stiff", "b3: is loose"], ["b1", "b2", "b3"])
    ['b1: is loose (and 1 more alike: b3)', 'b2: is stiff']
    """
    known = sorted(map(re.escape, set(names)), key=len, reverse=True)
    bodies = [rf"(?<![\w.])(?:{'|'.join(known)})(?![\w])"] if known else []
    pattern = re.compile("|".join([PLACE, *bodies]))
    groups: dict[str, list[str]] = {}
    for sentence in sentences:
        groups.setdefault(pattern.sub("\0", sentence), []).append(sentence)
    return [_joined(group, pattern) for group in groups.values()]


def _joined(group: list[str], pattern: re.Pattern[str]) -> str:
    """The first sentence of a group, with a count of the others and what some are about."""
    first, *others = group
    if not others:
        return first
    about = [found[0] for found in map(pattern.search, others) if found]
    listed = dict.fromkeys(about[:LISTED])
    if not listed:
        return f"{first} (said {len(group)} times)"
    last = f", … {about[-1]}" if len(about) > LISTED else ""
    return f"{first} (and {len(others)} more alike: {', '.join(listed)}{last})"
