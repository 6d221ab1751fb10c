"""Diagnosis of a bench's change from the trials of its logbook: reference sessions against one since the change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from estimation.data import table
from logbook.bench_state import BenchState, state_of
from logbook.change_cause import Cause, enter_cause, outdated, trials_of
from logbook.database import Logbook
from parameters import InputError


class ChangeTrials(NamedTuple):
    """Files of a change: reference trials before it, trials of one session since it, 1σ between sessions."""

    references: list[Path]
    trials: list[Path]
    session_sd: Mapping[str, float] | None


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


def change_trials(book: Logbook) -> ChangeTrials | None:
    """Return the files of the change that the logbook states; None if it states none."""
    state = state_of(book)
    if not state.alarms:
        return None
    given = trials_of(book, state.alarms[0], state.sessions, state.notes)
    before, since = ([book.place(trial.path) for trial in trials] for trials in (given.references, given.trials))
    return ChangeTrials(before, since, state.scatter)


def _diagnosed(book: Logbook, state: BenchState) -> Cause:
    """Diagnose the newest session since the first alarm; raises `InputError` if trials are missing or unusable."""
    from diagnosis.finder import Finder
    from diagnosis.report.headline import headline

    given = trials_of(book, state.alarms[0], state.sessions, state.notes)
    before, since = ([table.read(book.place(trial.path), book.path or None) for trial in trials]
                     for trials in (given.references, given.trials))
    found = Finder(session_sd=state.scatter).examine(before).diagnose(since)
    named = found.verdict in ("found", "ambiguous")
    return Cause(found.verdict, tuple(found.rivals), found.part if named else None,
                 found.warnings[0] if found.verdict == "refused" else "", given.trials[0].session,
                 tuple(trial.session for trial in given.references), tuple(trial.path for trial in given.trials),
                 given.since, tuple(sorted(headline(found), key=lambda sentence: not sentence.startswith("Changed"))))
