"""Seconds by stage, and of runs that share a beginning."""

from contact_app.machine.timings import Timings


class Clock:
    """It stands still but where it is moved."""

    def __init__(self) -> None:
        self.seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


def test_runs_that_share_a_beginning_count_it_once_each() -> None:
    clock = Clock()
    shared = Timings(clock)
    with shared.measure("setup"):
        clock.seconds += 2.0
    total = shared.as_dict()["total"]
    clock.seconds += 5.0  # another run, which is none of the next one's business
    run = shared.branched(total)
    with run.measure("solve"):
        clock.seconds += 1.0
    found = run.as_dict()
    assert (found["setup"], found["solve"], found["total"]) == (2.0, 1.0, 3.0)
    assert shared.seconds["solve"] == 0.0
    assert shared.as_dict()["total"] == 8.0


def test_a_stage_inside_another_counts_for_itself_alone() -> None:
    clock = Clock()
    timings = Timings(clock)
    with timings.measure("setup"):
        clock.seconds += 1.0
        for _ in range(2):
            with timings.measure("assembly"):
                clock.seconds += 3.0
                with timings.measure("setup"):
                    clock.seconds += 1.0
    assert timings.seconds["setup"] == 3.0
    assert timings.seconds["assembly"] == 6.0


def test_the_clock_of_a_run_is_a_real_one() -> None:
    timings = Timings()
    with timings.measure("setup"):
        pass
    assert 0.0 <= timings.seconds["setup"] <= timings.as_dict()["total"]
