"""Stored results of a chart, so that a stopped study can go on.

``runs.json`` has the row of each point, or why there is none, and what the chart was made of: with
another scene, other changes or another reference it begins anew. ``reference-0.npz`` and so on are
the fields of the reference, the finest first.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

Row = dict[str, Any]


class StoredPoints:
    """Points and references of a chart in a directory.

    Parameters
    ----------
    made_of
        Texts that say which chart this is.
    resume
        Take what an earlier run of the same chart left there.

    Attributes
    ----------
    points
        Rows, or reasons why there is none, by what was run.
    """

    def __init__(self, directory: Path, made_of: Sequence[str], resume: bool) -> None:
        self._directory = directory
        self._key = sha256("\n".join(made_of).encode()).hexdigest()
        self.points: dict[str, Row | str] = {}
        directory.mkdir(parents=True, exist_ok=True)
        if not (resume and self._load()):
            for path in directory.glob("reference-*.npz"):
                path.unlink()

    @property
    def _path(self) -> Path:
        return self._directory / "runs.json"

    def _load(self) -> bool:
        try:
            found = json.loads(self._path.read_text(encoding="utf-8"))
            if found["key"] != self._key:
                return False
            self.points = found["points"]
        except (OSError, ValueError, KeyError):
            return False
        return True

    def add(self, name: str, point: Row | str) -> None:
        """Keep a row, or why there is none."""
        self.points[name] = point
        self.save()

    def save(self) -> None:
        """Write all points."""
        text = json.dumps({"key": self._key, "points": self.points}, indent=1)
        new = self._path.with_suffix(".new")
        new.write_text(text, encoding="utf-8")
        new.replace(self._path)

    def reference(self, number: int) -> Path:
        """Where the fields of a reference are, or go."""
        return self._directory / f"reference-{number}.npz"

    def rows(self) -> list[Row]:
        """All rows."""
        return [point for point in self.points.values() if not isinstance(point, str)]
