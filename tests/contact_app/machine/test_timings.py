"""Seconds by stage, and of runs that share a beginning."""

from __future__ import annotations

import time

from contact_app.machine.timings import Timings


def test_runs_that_share_a_beginning_count_it_once_each() -> None:
    shared = Timings()
    with shared.measure("setup"):
        time.sleep(0.02)
    total = shared.as_dict()["total"]
    time.sleep(0.05)  # another run, which is none of the next one's business
    run = shared.branched(total)
    with run.measure("solve"):
        time.sleep(0.01)
    found = run.as_dict()
    assert found["setup"] == shared.seconds["setup"] >= 0.02
    assert found["solve"] >= 0.01
    assert shared.seconds["solve"] == 0.0
    assert total + 0.01 <= found["total"] < shared.as_dict()["total"]


def test_a_stage_inside_another_counts_for_itself_alone() -> None:
    timings = Timings()
    with timings.measure("setup"):
        time.sleep(0.01)
        for _ in range(2):
            with timings.measure("assembly"):
                time.sleep(0.03)
                with timings.measure("setup"):
                    time.sleep(0.01)
    assert 0.03 <= timings.seconds["setup"] < 0.06
    assert 0.06 <= timings.seconds["assembly"] < 0.09
