"""Stored results of a chart, so that a stopped study can go on.

``runs.json`` has the row of each point, or the reason why it has none, and the input of the chart.
With another scene, other changes or another reference the chart begins anew. ``reference-0.npz``
and so on are the fields of the reference, the finest first.
"""

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
        Whether to load the results of an earlier run of the same chart.

    Attributes
    ----------
    points
        Rows, or reasons for missing rows, by the name of the run.
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
            points = json.loads(self._path.read_text(encoding="utf-8"))
            if points["key"] != self._key:
                return False
            self.points = points["points"]
        except (OSError, ValueError, KeyError):
            return False
        return True

    def add(self, name: str, point: Row | str) -> None:
        """Store a row, or the reason why it is missing."""
        self.points[name] = point
        self.save()

    def save(self) -> None:
        """Write all points."""
        text = json.dumps({"key": self._key, "points": self.points}, indent=1)
        new = self._path.with_suffix(".new")
        new.write_text(text, encoding="utf-8")
        new.replace(self._path)

    def reference(self, number: int) -> Path:
        """File with the fields of a reference."""
        return self._directory / f"reference-{number}.npz"

    def rows(self) -> list[Row]:
        """All rows."""
        return [point for point in self.points.values() if not isinstance(point, str)]
