"""docs/guide/results.md names all that a run leaves."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from contact_app.results.history import COLUMNS
from contact_app.run.solve import solve_scene
from contact_app.scene.schema.options import FIELDS
from tests import scenes

MANUAL = (Path(__file__).parents[3] / "docs" / "guide" / "results.md").read_text()

BY_NAME = ("probes", "sections", "pair_forces")
"""Mappings whose keys are names of the scene."""


def keys(found: dict[str, Any]) -> Iterator[str]:
    for key, value in found.items():
        yield key
        inner = value if isinstance(value, list) else [value]
        if key in BY_NAME:
            inner = list(value.values())
        for record in inner:
            if isinstance(record, dict):
                yield from keys(record)


def test_the_manual_names_every_key_column_and_field() -> None:
    made = scenes.two_bodies("hexahedron", 2)
    body = made["bodies"][0]
    plane = {"point": [0, 0, 0.26], "normal": [0, 0, 1]}
    made["output"] = {
        "probes": {"tip": body["mesh"]["box"]["lower"]},
        "sections": {"middle": {"in": body["name"], "plane": plane}},
    }
    summary = solve_scene(scenes.build(made)).summary
    words = set(re.findall(r"\w+", MANUAL))
    assert {*keys(summary), *COLUMNS, *FIELDS} - words == set()
