"""Cause of a change: the recorded trials to diagnose for it, and the diagnosis that the logbook keeps.

The session model is linear and dates a change; an effect that acts otherwise looks like another effect in it.  The
cause is therefore the verdict of a diagnosis: trials of one session since the change against trials of sessions before
it.  A caller that can diagnose runs it (`bowden.models.change_diagnosis`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from logbook.change_search import Change
from logbook.database import Logbook, Note, TrialEntry
from parameters import InputError

MOST_TRIALS: Final = 4
"""Most reference trials, and most trials of the session since the change: more cost seconds each and add less than
sessions scatter."""
MORE_SESSIONS: Final = 2
"""Growth of the number of sessions since a change after which it is diagnosed again, on a newer session: a drift that
was too small to name has grown."""


class Cause(NamedTuple):
    """Cause of a change by diagnosis: `verdict`, ambiguity set and part of the bench; `remark`: a reason or warning.

    `verdict` None: not diagnosed, for the reason in `remark`.  `session`: the diagnosed one; `references`: sessions of
    the reference trials; `trials`: numbers of the diagnosed trials; `since`: sessions since the change at that time.
    """

    verdict: str | None
    among: tuple[str, ...] = ()
    part: str | None = None
    remark: str = ""
    session: int = 0
    references: tuple[int, ...] = ()
    trials: tuple[int, ...] = ()
    since: int = 0

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


def kept_cause(book: Logbook, change: Change, sessions: Sequence[int], notes: Sequence[Note]) -> Cause | None:
    """Return the diagnosis that the logbook keeps of a change; None if its sessions are not on both sides of it."""
    content = book.cause()
    if content is None:
        return None
    plain: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in content.items()}
    kept = Cause(**plain)
    of = _sessions(change, sessions, notes)
    return kept if kept.session in of.after and set(kept.references) <= set(of.before) else None


def outdated(cause: Cause | None, change: Change, sessions: Sequence[int], notes: Sequence[Note]) -> bool:
    """Return whether a change is to be diagnosed: not yet diagnosed, or long ago (`MORE_SESSIONS`)."""
    return cause is None or _sessions(change, sessions, notes).since >= MORE_SESSIONS * cause.since


def trials_of(book: Logbook, change: Change, sessions: Sequence[int], notes: Sequence[Note]) -> CauseTrials:
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


def _sessions(change: Change, sessions: Sequence[int], notes: Sequence[Note]) -> _Sessions:
    resets = [note.after for note in notes if note.resets]
    begin = max((after for after in resets if after < change.since), default=0)
    end = min((after for after in resets if after >= change.since), default=max(sessions))
    return _Sessions(tuple(s for s in sessions if begin < s < change.since_low),
                     tuple(s for s in sessions if change.since_high <= s <= end),
                     sum(change.since <= s <= end for s in sessions))


def _recorded(book: Logbook, session: int) -> list[TrialEntry]:
    """Return a session's fitted trials whose files have the content that was entered, oldest first."""
    return [trial for trial in reversed(book.trials(session=session)) if trial.estimated and trial.there
            and hashlib.sha256(book.place(trial.path).read_bytes()).hexdigest() == book.digest(trial.id)]
