"""Cause of a change: the recorded trials to diagnose for it, and the diagnosis that the logbook keeps.

The evidence of all sessions is linear in the constants and dates a change.  Its cause is the verdict of a diagnosis:
trials of one session since the change against trials of sessions before it.  A caller that can diagnose runs it
(`bowden.models.logbook_entries`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from logbook.database import Logbook, Note, TrialEntry
from parameters import InputError
from physics.laws import Array

MOST_TRIALS: Final = 4
"""Most reference trials, and most trials of the session since the change: more cost seconds each and add less than
sessions scatter."""
MORE_SESSIONS: Final = 2
"""Growth of the number of sessions since a change after which it is diagnosed again, on a newer session: a drift that
was too small to name has grown."""


class DatedChange(NamedTuple):
    """A change of one effect: log Bayes factor in nats, course, number of its first session with the 95 % interval.

    `departure`: of the free constants at the newest session, in coordinates.
    """

    effect: str
    nats: float
    course: str
    since: int
    since_low: int
    since_high: int
    departure: Array


class Cause(NamedTuple):
    """Cause of a change by diagnosis: `verdict`, ambiguity set and part of the bench; `remark`: a reason or warning.

    `card`: first sentences of the diagnosis' page.

    `verdict` None: not diagnosed, for the reason in `remark`.  `session`: the diagnosed one; `references`: sessions of
    the reference trials; `trials`: files of the diagnosed trials; `since`: sessions since the change at that time.
    """

    verdict: str | None
    among: tuple[str, ...] = ()
    part: str | None = None
    remark: str = ""
    session: int = 0
    references: tuple[int, ...] = ()
    trials: tuple[str, ...] = ()
    since: int = 0
    card: tuple[str, ...] = ()

    @property
    def named(self) -> bool:
        """True if the diagnosis names at least one effect."""
        return bool(self.among)


class CauseTrials(NamedTuple):
    """Trials to diagnose: `references` of sessions before a change, `trials` of one session since it."""

    references: tuple[TrialEntry, ...]
    trials: tuple[TrialEntry, ...]
    since: int


class _Sessions(NamedTuple):
    """Fitted sessions before a change and since it, without maintenance in between, and those since its likeliest
    beginning."""

    before: tuple[int, ...]
    after: tuple[int, ...]
    since: int


def kept_cause(book: Logbook, change: DatedChange, sessions: Sequence[int], notes: Sequence[Note]) -> Cause | None:
    """Return the diagnosis that the logbook keeps of a change; None if its sessions are not on both sides of it."""
    content = book.cause()
    if content is None:
        return None
    plain: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in content.items()}
    kept = Cause(**plain)
    of = _sessions(change, sessions, notes)
    return kept if kept.session in of.after and set(kept.references) <= set(of.before) else None


def outdated(cause: Cause | None, change: DatedChange, sessions: Sequence[int], notes: Sequence[Note]) -> bool:
    """Return whether a change is to be diagnosed: not yet diagnosed, or long ago (`MORE_SESSIONS`)."""
    return cause is None or _sessions(change, sessions, notes).since >= MORE_SESSIONS * cause.since


def trials_of(book: Logbook, change: DatedChange, sessions: Sequence[int], notes: Sequence[Note]) -> CauseTrials:
    """Return the trials to diagnose: of the newest session since the change, and of the first ones before it.

    Maintenance that resets a constant ends the sessions on either side.  All trials are of one experiment.  Raises
    `InputError` if a side has no fitted trial whose file is there, unchanged.
    """
    of = _sessions(change, sessions, notes)
    after = next(filter(None, (_recorded(book, session) for session in reversed(of.after))), [])
    if not after:
        raise InputError("no trial since the change is at hand as it was recorded.")
    alike = [trial for trial in after if trial.experiment == after[0].experiment]
    references: list[TrialEntry] = []
    for session in of.before:
        found = [trial for trial in _recorded(book, session) if trial.experiment == after[0].experiment]
        references += found[:1]
        if len(references) == MOST_TRIALS:
            break
    if not references:
        raise InputError(f"no trial of the experiment {after[0].experiment} before the change is at hand as it was "
                         "recorded.")
    return CauseTrials(tuple(references), tuple(alike[:MOST_TRIALS]), of.since)


def enter_cause(book: Logbook, found: Cause) -> None:
    """Enter a diagnosis of a change."""
    content: dict[str, Any] = found._asdict()
    book.enter_cause(content)


def _sessions(change: DatedChange, sessions: Sequence[int], notes: Sequence[Note]) -> _Sessions:
    at = {number: k for k, number in enumerate(sessions)}
    resets = [at.get(note.after, -1) for note in notes if note.resets]
    begin = max((after for after in resets if after < at[change.since]), default=-1)
    end = min((after for after in resets if after >= at[change.since]), default=len(sessions) - 1)
    return _Sessions(tuple(sessions[begin + 1:at[change.since_low]]), tuple(sessions[at[change.since_high]:end + 1]),
                     end + 1 - at[change.since])


def _recorded(book: Logbook, session: int) -> list[TrialEntry]:
    """Return a session's fitted trials whose files have the content that was entered, oldest first."""
    return [trial for trial in reversed(book.trials(session=session)) if trial.estimated and trial.there
            and hashlib.sha256(book.place(trial.path).read_bytes()).hexdigest() == book.digest(trial.id)]
