"""A live line on a terminal, plain lines in a pipe, and a solve that stops when asked."""

import io
import os
import signal

import numpy as np
import pytest
from rich.console import Console

from contact_app.run import progress
from contact_app.run.progress import Interruption, Progress, together
from solver import MPRGP, BoxQP
from solver.qp.result import Reason, Step


def step(outer: int, iteration: int, kind: str = "cg") -> Step:
    return Step(outer, iteration, kind, 10.0**-iteration, 2e-3, 5, 0.1 * iteration)


def shown(events: list[Step], term: str | None = None, **options: float) -> str:
    text = io.StringIO()
    environment = {} if term is None else {"TERM": term}
    console = Console(file=text, width=70, force_terminal=bool(term), _environ=environment)
    with Progress(console=console, **options) as monitor:
        for event in events:
            monitor(event)
    return text.getvalue()


def test_a_pipe_gets_a_line_for_each_outer_iteration_and_the_last() -> None:
    events = [step(outer, 4 * outer + i) for outer in (1, 2) for i in range(4)]
    text = shown(events, outer_seconds=0.0)
    lines = text.splitlines()
    assert [line.split(",")[0] for line in lines] == ["outer 1", "outer 2", "outer 2"]
    last = "outer 2, iteration 11, residual 1.0e-11, equalities 2.0e-03, active 5, 1.1 s"
    assert lines[-1] == last
    assert len(last) < 80
    assert "\x1b" not in text


def test_outer_iterations_that_are_over_at_once_do_not_flood_a_pipe() -> None:
    assert len(shown([step(outer, outer) for outer in range(1, 100)]).splitlines()) <= 3


def test_a_pipe_gets_a_line_every_few_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(np.arange(0.0, 100.0, 0.5))
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    lines = shown([step(1, i) for i in range(20)]).splitlines()
    iterations = [int(line.split("iteration ")[1].split(",")[0]) for line in lines]
    assert iterations == [0, 4, 8, 12, 16, 19]


def test_a_terminal_gets_one_line_that_is_taken_away_again() -> None:
    text = shown([step(1, i) for i in range(3)], term="xterm")
    assert "outer 1" in text
    assert text.endswith("\x1b[2K")


def test_a_terminal_that_cannot_rewrite_gets_plain_lines() -> None:
    text = shown([step(1, i) for i in range(3)], term="dumb")
    assert len(text.splitlines()) == 2
    assert "\x1b" not in text


def test_without_outer_iterations_and_equalities_none_are_named() -> None:
    text = shown([Step(0, 3, "cg", 0.5, 0.0, 7, 0.25)])
    assert text == "iteration 3, residual 5.0e-01, active 7, 0.2 s\n"


def test_stages_are_named_and_other_ranks_are_silent() -> None:
    for show, expected in ((True, "assembling ...\n"), (False, "")):
        text = io.StringIO()
        with Progress(show, Console(file=text)) as monitor:
            monitor.stage("assembling")
            if not show:
                monitor(step(1, 1))
        assert text.getvalue() == expected


def test_the_last_step_is_shown_before_the_next_stage() -> None:
    text = io.StringIO()
    with Progress(console=Console(file=text, width=70, _environ={})) as monitor:
        monitor(step(1, 1))
        monitor(step(1, 2))
        monitor.stage("writing")
    beginnings = [line.split(", residual")[0] for line in text.getvalue().splitlines()]
    assert beginnings == ["outer 1, iteration 1", "outer 1, iteration 2", "writing ..."]


def test_together_every_monitor_gets_every_step_and_one_can_stop() -> None:
    seen: list[int] = []
    both = together(lambda event: event.iteration == 2, None, lambda e: seen.append(e.iteration))
    assert [both(step(0, i)) for i in (1, 2, 3)] == [False, True, False]
    assert seen == [1, 2, 3]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_the_solve_with_a_partial_answer(number: int) -> None:
    def interrupt(event: Step) -> None:
        if event.iteration == 3:
            os.kill(os.getpid(), number)

    n = 50
    qp = BoxQP(2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1), np.ones(n))
    before = signal.getsignal(number)
    with Interruption() as interruption:
        result = MPRGP(rtol=1e-12).solve(qp, monitor=together(interrupt, interruption))
        assert interruption.requested
        assert signal.getsignal(number) == before, "a second signal must end the program"
    assert result.reason is Reason.STOPPED
    assert result.counts.inner == 3
    assert signal.getsignal(number) == before


def test_signals_are_as_before_when_none_came() -> None:
    before = signal.getsignal(signal.SIGINT)
    with Interruption() as interruption:
        assert signal.getsignal(signal.SIGINT) != before
    assert signal.getsignal(signal.SIGINT) == before
    assert not interruption.requested
