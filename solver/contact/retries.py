"""Active sets that begin anew with other rules where they do not settle.

With friction sets may not settle because each has other contact, or because points were released
before a state showed that they slide; multigrid then goes on without sets. In Total FETI, and where
contact peels off row by row, the loop begins from the contact without friction; where points were
released, or the first set was guessed, it begins again without such releases.
"""

from dataclasses import replace

from solver.backend import S, Statuses
from solver.contact.active_set import ActiveSetMethod, Start, active_set_loop
from solver.contact.active_set_options import Failure
from solver.contact.law import ContactLaw, StateError
from solver.contact.solve_on_set import Outcome, StoppingTest
from solver.qp.result import Reason


def solve_with_retries(method: ActiveSetMethod[S], start: Start) -> Outcome[S]:
    """Run the active-set loop, again with other rules where its sets fail (collective).

    Returns
    -------
    The last outcome, with the work of all runs; its reason is None where the sets do not settle.
    """
    outcome, failure = active_set_loop(method, start)
    insists = method.options.insists
    if failure is Failure.PEELS or (insists and failure is Failure.UNSETTLED):
        outcome, statuses = _contact_without_friction(method.after(outcome), start)
        if statuses is None and not insists:
            return replace(outcome, reason=None)
        settling = 0 if insists else method.options.settling
        patient = method.with_options(settling=settling, may_peel=True).after(outcome)
        outcome, failure = active_set_loop(patient, replace(start, statuses=statuses))
    unsettled = outcome.reason is None and failure in (Failure.UNSETTLED, Failure.AHEAD)
    if unsettled and not insists:
        return outcome
    guessed = start.statuses is not None and outcome.reason in (None, Reason.SLIDES)
    if failure is Failure.AHEAD or guessed:  # sets may settle if no point is released too early
        method.backend.forget()
        patient = method.with_options(settling=0, early_release=False).after(outcome)
        outcome, failure = active_set_loop(patient, replace(start, statuses=None))
    if failure is Failure.VANISHED:  # SMALBE-M begins without forces
        return replace(outcome, state=None)
    return outcome


def _contact_without_friction(
    method: ActiveSetMethod[S], start: Start
) -> tuple[Outcome[S], Statuses | None]:
    """Active set without friction, and the statuses of the law at its state (collective).

    None where bodies are held by friction alone.
    """
    settled = StoppingTest[S](lambda state: 1.0, lambda state: True)
    outcome, _ = active_set_loop(replace(method, test=settled, law=ContactLaw()), start)
    state, before = outcome.state, outcome.following
    if outcome.reason is not Reason.ACCEPTED or state is None:
        return outcome, None
    error = method.options.significant * method.options.first_reduction
    zero = StateError.of(method.backend.comm, state, before.active, error)
    return outcome, method.law.following(before.active, state, zero, before, False)[0]
