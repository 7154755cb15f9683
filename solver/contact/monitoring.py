"""Monitors of a contact problem: steps with the number of the active set and its contact rows."""

from typing import Any

from solver.qp.result import Monitor, Step


def on_active_set(monitor: Monitor | None, number: int, rows: int, before: int) -> Monitor | None:
    """A monitor that adds the number of the active set to each step and calls another monitor.

    Parameters
    ----------
    number
        Number of the set, from 1.
    rows
        Contact rows in it, over all ranks.
    before
        Iterations on earlier sets.
    """
    if monitor is None:
        return None
    receiver = monitor

    def forward(step: Step) -> Any:
        return receiver(step._replace(
            iteration=before + step.iteration, active=rows, active_set=number, active_rows=rows
        ))  # fmt: skip

    return forward


def with_bounds(monitor: Monitor | None, rows: int) -> Monitor | None:
    """A monitor that replaces the number of rows at a bound by the number of the other rows.

    Steps that already hold a number of contact rows keep it.
    """
    if monitor is None:
        return None
    receiver = monitor

    def forward(step: Step) -> Any:
        if step.active_rows is None:
            step = step._replace(active_rows=rows - step.active)
        return receiver(step)

    return forward
