"""Trials into a logbook: figures, date and session; a trial against the history of its bench; the diagnosis of a
change that the logbook states.
"""

from __future__ import annotations

import datetime
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from threadpoolctl import threadpool_limits

from bowden.bench.buses import BusSettings
from bowden.deferred import on_first_use
from estimation.data import table
from estimation.linear_sums import session_sums
from logbook.bench_state import (
    CONSTANTS,
    BenchState,
    Cause,
    enter_cause,
    measured_deviations,
    outdated,
    sequence_of,
    state_of,
    trials_of,
)
from logbook.database import Logbook, NewTrial, TrialEntry, open_logbook
from logbook.session_fits import fit_missing, recording_of
from parameters import InputError
from physics.forward.path_constants import FREE, TABLE
from trial import read
from trial.read import one_path, path_names
from trial.signals import FORCE_FIGURES

with on_first_use():
    from bowden.models.diagnosing import Diagnosis
    from diagnosis.report.headline import headline
    from trial.report.compare_page import judged

EPOCH_NS: Final = 10**17
"""Time of a recording, ns, from which it is a date and not a time since the start: 1973."""
ENTERED: Final = ("verdict", "causes", "class", "experiment")
"""Keys of a diagnosis that the logbook stores."""


def add(folder: Path, files: Mapping[Path, str | None], figures: Mapping[str, Any] | None = None
        ) -> list[tuple[TrialEntry, bool]]:
    """Enter trials or tables, fit them, and return each entry and whether it is new; acknowledged once this returns.

    `files`: by path the label of the session (None: the recording's own date, of a simulated bench its day).  All are
    read before the first one is entered.  A file that was entered is not entered again and keeps its session.
    """
    with open_logbook(folder) as book:
        labels = {entry.id: entry.label for entry in book.sessions()}
        given = []
        for path, session in files.items():
            described = _described(path, figures, book.path)
            label = labels.get(book.session_of(described.digest) or 0) or _label(path, session, described)
            given.append((described, label, _place(label, path, described)))
        entries = [book.enter_trial(*one) for one in given]
        fit_missing(book)
        return [(book.trials(1, trial=number)[0], new) for number, new in entries]


def entered(folder: Path, path: Path, session: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Enter a trial that was just recorded; return its number, session and whether it was fitted."""
    [(entry, _)] = add(folder, {path: session}, figures)
    return {"logbook": str(folder), "trial": entry.id, "session": entry.label, "fitted": entry.estimated,
            "remark": entry.remark}


def label(given: str | None, chosen: BusSettings) -> str:
    """Return the session of a trial that is about to be recorded: a simulated bench's is its day."""
    if given is not None and given.strip():
        return _checked(given, "--label")
    if chosen.simulated:
        return f"day {chosen.arguments['day']}"
    return datetime.date.today().isoformat()


def add_model(folder: Path, kind: str, path: Path) -> None:
    """Enter a bench model file: `kind` "calibration" or "fit"."""
    with open_logbook(folder) as book:
        book.enter_model(kind, path, path.read_text(encoding="utf-8"))


def reference_trials(folder: Path | None, healthy: Sequence[Path] | None = None, trials: Sequence[Path] = ()
                     ) -> tuple[list[Path], dict[str, float] | None]:
    """Return reference trials, the logbook's if none are given as `healthy`, none of `trials`, and 1σ between sessions.

    1σ: of each constant, in coordinates; None before two reference sessions, and without a logbook.  Raises
    `InputError` where no reference session has a trial whose file is there.
    """
    found, deviations = list(healthy or ()), None
    if folder is not None:
        with open_logbook(folder) as book:
            if not found:
                kept = book.reference()
                entries = [book.trials(1, trial=number)[0] for number in (() if kept is None else kept.trials)]
                found = [book.place(trial.path) for trial in entries if trial.there]
            deviations = measured_deviations(book)
        if not found:
            raise InputError(f"{folder}: no reference session has a fitted trial whose file is there; name reference "
                             "trials with --healthy.")
    same = {trial.resolve() for trial in trials}
    return [path for path in found if path.resolve() not in same], deviations


def path_of(folder: Path | None, path: str | None) -> str | None:
    """Return the force path to diagnose: that of the logbook, of a bench of several; without a logbook `path`.

    Raises `InputError` if `path` is another one than the logbook's.
    """
    if folder is None:
        return path
    with open_logbook(folder) as book:
        followed = book.path or None
    if path not in (None, followed):
        raise InputError(f"--path {path}: the logbook {folder} follows " + (
            f"{followed}; leave --path out, or give that path's logbook." if followed else
            "a bench of a single force path; leave --path out."))
    return followed


def against_history(folder: Path, path: Path) -> dict[str, Any]:
    """Return how far a trial lies from its bench's own history, constant by constant; the logbook is not changed.

    `scatters`: departure over the 1σ of sessions, uncertainty of the bench included; `probability` that a session in
    the reference condition departs as far in all constants together.  A session of the logbook is compared with the
    others.
    """
    with open_logbook(folder) as book, threadpool_limits(1, user_api="blas"):
        described = _described(path, None, book.path)
        kept, followed = book.reference(), sequence_of(book, without=book.session_of(described.digest))
        if kept is None or followed is None or followed[1].count < 2:
            raise InputError(f"{folder}: has fewer than two other fitted sessions; bowden logbook add enters trials.")
        sequence = followed[1]
        own = session_sums(sequence.fit, sequence.columns, recording_of(path, described.outcome, book.path),
                           kept.motions)
        departure, scatters, probability = sequence.departure(own, sequence.scatter())
        return {"trial": str(path), "logbook": str(folder), "sessions": sequence.count, "probability": probability,
                "constants": {name: {"departure": float(departure[k]), "scatters": float(scatters[k]),
                                     "form": TABLE[FREE[k]].form, "unit": TABLE[FREE[k]].unit}
                              for k, name in enumerate(CONSTANTS)}}


def add_verdict(folder: Path, path: Path, content: Mapping[str, Any]) -> None:
    """Enter the keys `ENTERED` of a trial's diagnosis in a logbook; a trial that is new to it is entered first."""
    [(entry, _)] = add(folder, {path: None})
    with open_logbook(folder) as book:
        book.enter_verdict(entry.id, {name: content[name] for name in ENTERED if name in content})


def _described(path: Path, figures: Mapping[str, Any] | None, force_path: str) -> NewTrial:
    """Return a file as the logbook keeps it; raises `InputError` for one that is neither a trial nor a table.

    `force_path`: the one of a trial of several whose figures are kept.
    """
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a trial or a table.") from None
    if path.suffix.lower() != ".mcap":
        given = table.read(path, force_path or None)
        return NewTrial(path, digest, "table", None, float(given["time_s"][-1] - given["time_s"][0]), {}, {}, "")
    recorded = read.open(path)
    if force_path and path_names(recorded):
        recorded, figures = one_path(recorded, force_path), (figures or {}).get("paths", {}).get(force_path)
    told = dict(recorded.metadata)
    result = recorded.result or {}
    outcome = None if "imported_from" in told else str(result.get("outcome", "not closed"))
    lasts = float(recorded.time_ns[-1] - recorded.time_ns[0]) * 1e-9 if len(recorded.time_ns) else 0.0
    found = judged(recorded) if figures is None else figures
    return NewTrial(path, digest, told.get("experiment", ""), outcome, lasts, told | _recorded_date(recorded),
                    {one.name: found.get(one.name) for one in FORCE_FIGURES} if found else {}, told.get("commit", ""))


def _recorded_date(recorded: read.Trial) -> dict[str, str]:
    """Return the date at which a trial was recorded, by its own time stamps; nothing where these begin at 0."""
    first = int(recorded.time_ns[0]) if len(recorded.time_ns) else 0
    return {} if first < EPOCH_NS else {
        "date": datetime.datetime.fromtimestamp(first * 1e-9, datetime.UTC).isoformat(timespec="seconds")}


def _label(path: Path, session: str | None, described: NewTrial) -> str:
    """Return the label of a trial's session; raises `InputError` if neither the user nor the file states one."""
    if session is not None:
        if not session.strip():
            raise InputError("--session: expected a label, such as a date; leave it out for the recording's own date.")
        return _checked(session)
    if "day" in described.conditions:
        return f"day {described.conditions['day']}"
    if "date" in described.conditions:
        return described.conditions["date"][:10]
    raise InputError(f"{path}: holds no date of its recording; name its session with --session, such as a date: "
                     "--session 2026-03-02.")


def _checked(label: str, option: str = "--session") -> str:
    """Return a label; raises `InputError` for digits that look like a date and are none, and for a date to come."""
    label = label.strip()
    if not re.match(r"\d{4}-\d\d?-\d\d?(?!\d)", label):
        return label
    try:
        date = datetime.datetime.fromisoformat(label).date()
    except ValueError:
        raise InputError(f"{option} {label}: is no date of the calendar; write year, month and day as 2026-03-02, or "
                         "a label that does not begin like a date.") from None
    today = datetime.date.today()
    if date > today + datetime.timedelta(days=1):  # a bench in another time zone can be a day ahead
        raise InputError(f"{option} {label}: is in the future, today is {today}; give the date of the recording.")
    return label


def _place(label: str, path: Path, described: NewTrial) -> float | None:
    """Return where a session is in time: of its label, as a date or a number, else of the recording's own date."""
    for text in (label, described.conditions.get("date", "")):
        try:
            since = datetime.datetime.fromisoformat(text).replace(tzinfo=None) - datetime.datetime(1970, 1, 1)
            return since.total_seconds() / 86400.0
        except ValueError:
            continue
    number = re.fullmatch(r"(?:day\s+)?(\d+)", label)
    return float(number[1]) if number else None


class ChangeTrials(NamedTuple):
    """Files of a change: reference trials before it, trials of one session since it, 1σ between sessions."""

    references: list[Path]
    trials: list[Path]
    session_sd: Mapping[str, float] | None


def diagnosed_state(book: Logbook, limits: Mapping[str, float] | None = None) -> BenchState:
    """Return the state of a bench, a suspected change diagnosed from its recorded trials, which the logbook keeps.

    A diagnosis takes seconds; it is repeated when the number of sessions since the change has doubled.  If trials are
    not at hand, the kept diagnosis remains, or the reason.  `limits`: as in `state_of`.
    """
    state = state_of(book, limits)
    if not state.suspected or not outdated(state.cause, state.suspected[0], state.sessions, state.notes):
        return state
    try:
        found = _diagnosed(book, state)
    except InputError as error:
        return state if state.cause is not None else replace(state, cause=Cause(None, remark=str(error)))
    enter_cause(book, found)
    return state_of(book, limits)


def change_trials(book: Logbook) -> ChangeTrials | None:
    """Return the files of the change that the logbook states; None if it states none."""
    state = state_of(book)
    if not state.alarms:
        return None
    given = trials_of(book, state.alarms[0], state.sessions, state.notes)
    before, since = ([book.place(trial.path) for trial in trials] for trials in (given.references, given.trials))
    return ChangeTrials(before, since, state.scatter)


def _diagnosed(book: Logbook, state: BenchState) -> Cause:
    """Diagnose the newest session since a suspected change; raises `InputError` if trials are missing or unusable."""
    given = trials_of(book, state.suspected[0], state.sessions, state.notes)
    before, since = ([book.place(trial.path) for trial in trials] for trials in (given.references, given.trials))
    found = Diagnosis(path=book.path or None, session_sd=state.scatter).fit(before).diagnose(since).found
    named = found.verdict in ("found", "ambiguous")
    return Cause(found.verdict, tuple(found.rivals), found.part if named else None,
                 found.warnings[0] if found.verdict == "refused" else "", given.trials[0].session,
                 tuple(trial.session for trial in given.references), tuple(trial.path for trial in given.trials),
                 given.since, tuple(sorted(headline(found), key=lambda sentence: not sentence.startswith("Changed"))))
