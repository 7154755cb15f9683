"""The summary of a load history."""

from typing import Any

from contact_app.run.step_records import summary_of_steps


def record(number: int, *warnings: str) -> dict[str, Any]:
    certificate = {"passed": True, "warnings": list(warnings)}
    return {"increment": number, "certificate": certificate, "timings": {"solve": 1.0},
            "solution": {}}  # fmt: skip


def test_a_warning_appears_once_with_its_increments() -> None:
    """Contacts keep their numbers: the same warning of another contact is another warning."""
    records = [
        record(1, "contacts[0]: strains reach 0.06", "rotations reach 1.5e-01 rad"),
        record(2, "contacts[0]: strains reach 0.07", "contacts[1]: strains reach 0.2", "coarse"),
        record(3, "contacts[0]: strains reach 0.08", "coarse"),
        record(4, "contacts[0]: strains reach 0.09", "rotations reach 1.5e-01 rad"),
    ]
    summary = summary_of_steps({}, records)
    assert summary["certificate"]["warnings"] == [
        "contacts[0]: strains reach 0.09 (all 4 increments; the numbers are those of increment 4, "
        "`steps` has the others)",
        "rotations reach 1.5e-01 rad (increments 1, 4)",
        "contacts[1]: strains reach 0.2 (increment 2)",
        "coarse (increments 2 to 3)",
    ]
    assert summary["timings"] == {"solve": 4.0}
    assert summary["steps"] == records


def test_the_warnings_of_a_single_increment_stay() -> None:
    assert summary_of_steps({}, [record(1, "coarse")])["certificate"]["warnings"] == ["coarse"]
