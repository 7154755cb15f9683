"""The summary of a load history."""

from __future__ import annotations

from typing import Any

from contact_app.run.step_records import summary_of_steps


def record(step: int, *warnings: str) -> dict[str, Any]:
    certificate = {"passed": True, "warnings": list(warnings)}
    return {"step": step, "factor": 0.5, "certificate": certificate, "timings": {"solve": 1.0},
            "solution": {}}  # fmt: skip


def test_warnings_that_differ_only_in_numbers_appear_once() -> None:
    """Contacts keep their numbers: the same warning of another contact is another warning."""
    records = [
        record(1, "contacts[0]: strains reach 0.06", "rotations reach 1.5e-01 rad"),
        record(2, "contacts[0]: strains reach 0.07", "contacts[1]: strains reach 0.2"),
        record(3, "contacts[0]: strains reach 0.08"),
    ]
    summary = summary_of_steps({}, records)
    assert summary["certificate"]["warnings"] == [
        "contacts[0]: strains reach 0.08",
        "step 1, factor 0.5: rotations reach 1.5e-01 rad",
        "step 2, factor 0.5: contacts[1]: strains reach 0.2",
        "further warnings of earlier increments (2) differ from these only in their numbers: "
        "`steps` of summary.json has them",
    ]
    assert summary["timings"] == {"solve": 3.0}
    assert summary["steps"] == records
