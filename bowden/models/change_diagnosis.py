"""Diagnosis of a bench's change from the trials of its logbook: sessions before the change against one since it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from logbook.bench_state import BenchState, measured_deviations, state_of
from logbook.change_cause import Cause, enter_cause, outdated, trials_of
from logbook.database import Logbook
from parameters import InputError


def diagnosed_state(book: Logbook, limits: Mapping[str, float] | None = None) -> BenchState:
    """Return the state of a bench, the cause of an alarm diagnosed from its recorded trials and kept in the logbook.

    A diagnosis takes seconds; it is repeated when the number of sessions since the change has doubled.  If trials are
    not at hand, the kept diagnosis remains, or the reason.  `limits`: as in `state_of`.
    """
    state = state_of(book, limits)
    if not state.alarms or not outdated(state.cause, state.alarms[0], state.sessions, state.notes):
        return state
    try:
        found = _diagnosed(book, state)
    except InputError as error:
        return state if state.cause is not None else replace(state, cause=Cause(None, remark=str(error)))
    enter_cause(book, found)
    return replace(state, cause=found)


def _diagnosed(book: Logbook, state: BenchState) -> Cause:
    """Diagnose the newest session since the first alarm; raises `InputError` if trials are missing or unusable."""
    from diagnosis.finder import Finder

    given = trials_of(book, state.alarms[0], state.sessions, state.notes)
    before, since = ([book.place(trial.path) for trial in trials] for trials in (given.references, given.trials))
    found = Finder(session_sd=measured_deviations(book)).examine(before).diagnose(since)
    named = found.verdict in ("found", "ambiguous")
    return Cause(found.verdict, tuple(found.rivals), found.part if named else None,
                 found.warnings[0] if found.verdict == "refused" else "", given.trials[0].session,
                 tuple(trial.session for trial in given.references), tuple(trial.id for trial in given.trials),
                 given.since)
