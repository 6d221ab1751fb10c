"""Trials into a logbook: figures, date, and the sums of the trial under the bench's one reference posterior."""

from __future__ import annotations

import datetime
import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from logbook.bench_state import CONSTANTS, sequence_of
from logbook.database import UNFITTED, Logbook, NewTrial, TrialEntry, open_logbook
from parameters import InputError
from physics.path_constants import FREE, TABLE
from trial import read
from trial.paths import names, one_path

if TYPE_CHECKING:
    from bowden.bench.buses import BusSettings
    from estimation.likelihood_data import Recording
    from estimation.reference_fit import ReferenceFit

MOST_REFERENCES: Final = 4
"""Trials of the reference fit, and of the reference of a diagnosis: each costs seconds, and more add less than sessions
scatter."""
EPOCH_NS: Final = 10**17
"""Time of a recording, ns, from which it is a date and not a time since the start: 1973."""
FIGURES: Final = ("relative_rmse_percent", "relative_rmse_window_percent", "max_idle_tension_n", "peak_jump_n")


def add(folder: Path, path: Path, session: str | None = None, figures: Mapping[str, Any] | None = None
        ) -> TrialEntry:
    """Enter a trial or a table, fit it, and return its entry; acknowledged once this returns.

    `session`: its label (None: the recording's own date, of a simulated bench its day).  A file that was entered is not
    entered again.
    """
    with open_logbook(folder) as book:
        described = _described(path, figures, book.path)
        known = {entry.id: entry.label for entry in book.sessions()}.get(book.session_of(described.digest) or 0)
        label = known or _label(path, session, described)
        number, _ = book.enter_trial(described, label, _place(label, path, described))
        fit_missing(book)
        return book.trials(1, trial=number)[0]


def entered(folder: Path, path: Path, session: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Enter a trial that was just recorded; return its number, session and whether it was fitted."""
    entry = add(folder, path, session, figures)
    return {"logbook": str(folder), "trial": entry.id, "session": entry.label, "fitted": entry.estimated,
            "remark": entry.remark}


def label(given: str | None, chosen: BusSettings) -> str:
    """Return the session of a trial that was just recorded: a simulated bench's is its day."""
    if given is not None and given.strip():
        return given.strip()
    if chosen.simulated:
        return f"day {chosen.arguments['day']}"
    return datetime.date.today().isoformat()


def add_model(folder: Path, kind: str, path: Path) -> None:
    """Enter a bench model file: `kind` "calibration" or "fit"."""
    with open_logbook(folder) as book:
        book.enter_model(kind, path, path.read_text(encoding="utf-8"))


def reference_trials(folder: Path) -> tuple[list[Path], dict[str, float] | None]:
    """Return the trials of the reference posterior, and 1σ of each constant between sessions.

    Raises `InputError` where no reference session has a trial whose file is there.
    """
    from logbook.bench_state import measured_deviations

    with open_logbook(folder) as book:
        kept = book.reference()
        trials = [book.trials(1, trial=number)[0] for number in (() if kept is None else kept.trials)]
        found = [book.place(trial.path) for trial in trials if trial.there]
        deviations = measured_deviations(book)
    if not found:
        raise InputError(f"{folder}: no reference session has a fitted trial whose file is there; name reference "
                         "trials with --healthy.")
    return found, deviations


def path_of(folder: Path) -> str | None:
    """Return the force path that a logbook follows, of a bench of several; None of a bench of a single one."""
    with open_logbook(folder) as book:
        return book.path or None


def deviations(folder: Path) -> dict[str, float] | None:
    """Return 1σ of each constant between sessions, in coordinates; None before two reference sessions."""
    from logbook.bench_state import measured_deviations

    with open_logbook(folder) as book:
        return measured_deviations(book)


def against_history(folder: Path, path: Path) -> dict[str, Any]:
    """Return how far a trial lies from its bench's own history, constant by constant; the logbook is not changed.

    `scatters`: departure over the 1σ of sessions, uncertainty of the bench included; `probability` that a session in
    the reference condition departs as far in all constants together.  A session of the logbook is compared with the
    others.
    """
    from threadpoolctl import threadpool_limits

    from estimation.linear_sums import session_sums

    with open_logbook(folder) as book:
        described = _described(path, None, book.path)
        followed = sequence_of(book, without=book.session_of(described.digest))
        if followed is None or followed[1].count < 2:
            raise InputError(f"{folder}: has fewer than two other fitted sessions; bowden logbook add enters trials.")
        sequence = followed[1]
        with threadpool_limits(1, user_api="blas"):
            own = session_sums(sequence.fit, sequence.columns, [_recording_of(path, described.outcome, book.path)])
            departure, scatters, probability = sequence.departure(own, sequence.search()[1])
        return {"trial": str(path), "logbook": str(folder), "sessions": sequence.count, "probability": probability,
                "constants": {name: {"departure": float(departure[k]), "scatters": float(scatters[k]),
                                     "form": TABLE[FREE[k]].form, "unit": TABLE[FREE[k]].unit}
                              for k, name in enumerate(CONSTANTS)}}


def add_verdict(folder: Path, path: Path, content: Mapping[str, Any]) -> None:
    """Enter the verdict on a trial; the trial is entered, too, if it is new."""
    entry = add(folder, path)
    with open_logbook(folder) as book:
        book.enter_verdict(entry.id, content)


def fit_missing(book: Logbook) -> None:
    """Fit every trial that is not fitted under the reference of the first sessions by date.

    A trial that cannot be fitted is remarked on.  An earlier session that is entered later makes the reference, and all
    fits, anew, so that the order of entry has no influence; if a file for that is gone, the reference stays.
    """
    while True:
        kept, wanted = book.reference(), _wanted(book)
        renewed = kept is None or (kept.trials != wanted and all(
            trial.there for trial in book.trials() if trial.estimated or trial.id in wanted))
        if wanted and renewed:
            _make_reference(book, wanted, None if kept is None else kept.id)
            continue
        waiting = [] if kept is None else book.unfitted()
        if not waiting:
            return
        assert kept is not None
        _fit(book, kept.id, reference_model(book), waiting)


def _wanted(book: Logbook) -> tuple[int, ...]:
    """Return the trials of the reference: of each of the first sessions by date the first usable one, by its digest."""
    found: list[int] = []
    for session in book.sessions():
        if len(found) == min(book.references, MOST_REFERENCES):
            break
        usable = [t.id for t in book.trials(session=session.id) if t.estimated or t.remark == UNFITTED]
        found += sorted(usable, key=book.digest)[:1]
    return tuple(found)


def _make_reference(book: Logbook, wanted: tuple[int, ...], after: int | None) -> None:
    """Fit the reference to the trials `wanted` and enter it; a trial that cannot be read is remarked on instead."""
    from threadpoolctl import threadpool_limits

    from estimation.path_model import PATH_MODEL
    from estimation.posterior import CLOSE
    from estimation.reference_fit import fit_reference
    from estimation.stored_fit import encoded

    recordings: list[Recording] = []
    for number in wanted:
        entry = book.trials(1, trial=number)[0]
        try:
            recordings.append(_recording_of(book.place(entry.path), entry.outcome, book.path))
            _refuse_other_outputs(recordings[-1], recordings[0].outputs)
        except InputError as error:
            book.enter_remark(number, str(error))
            return
    with threadpool_limits(1, user_api="blas"):
        made = fit_reference(PATH_MODEL, recordings, close=0.1 * CLOSE)
    book.enter_reference(CONSTANTS, wanted, encoded(made), after)


def _fit(book: Logbook, key: int, fit: ReferenceFit, waiting: list[int]) -> None:
    """Enter the sums of trials under the reference `key`, until another process has made a newer one."""
    from threadpoolctl import threadpool_limits

    from estimation.linear_sums import effect_columns, session_sums

    columns = effect_columns(fit)
    for number in waiting:
        entry = book.trials(1, trial=number)[0]
        try:
            recording = _recording_of(book.place(entry.path), entry.outcome, book.path)
            _refuse_other_outputs(recording, fit.outputs)
        except InputError as error:
            book.enter_remark(number, str(error))
            continue
        with threadpool_limits(1, user_api="blas"):
            found = session_sums(fit, columns, [recording])
        if not book.enter_sums(number, key, found):
            return


def reference_model(book: Logbook) -> ReferenceFit:
    """Return the newest reference posterior."""
    from estimation.path_model import PATH_MODEL
    from estimation.stored_fit import decoded

    kept = book.reference()
    if kept is None or kept.constants != CONSTANTS:
        raise InputError(f"{book.folder}: its reference has other constants than this version's bench model; make a "
                         "logbook anew and add the trials.")
    return decoded(kept.model, PATH_MODEL)


def _refuse_other_outputs(recording: Recording, outputs: tuple[str, ...]) -> None:
    if recording.outputs != outputs:
        raise InputError(f"{recording.source}: has the outputs {', '.join(recording.outputs)}, the reference "
                         f"sessions have {', '.join(outputs)}; enter it in a logbook of its own.")


def _recording_of(path: Path, outcome: str | None, force_path: str) -> Recording:
    """Read the inputs of the likelihood, of the force path of a trial of several; raises `InputError` if one lacks."""
    from estimation.data import integrity, scales, table
    from estimation.path_model import PATH_MODEL

    if outcome not in (None, "completed"):
        raise InputError(f"{path}: the trial is {outcome}; only completed trials are fitted.")
    if not path.exists():
        raise InputError(f"{path}: no such file; put it back, or add it again from where it is now.")
    given = table.read(path, force_path or None)
    refused = [f.text for f in (*integrity.examine(given), *scales.contradictions(given)) if f.refuses]
    if refused:
        raise InputError(f"{path}: {refused[0]}")
    plain = integrity.usable(given)
    missing = PATH_MODEL.lacking(plain)
    if missing:
        raise InputError(f"{path}: has no column {', '.join(missing)}; record it.")
    return PATH_MODEL.record(plain)


def _described(path: Path, figures: Mapping[str, Any] | None, force_path: str) -> NewTrial:
    """Return a file as the logbook keeps it; raises `InputError` for one that is neither a trial nor a table.

    `force_path`: the one of a trial of several whose figures are kept.
    """
    from estimation.data import table

    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a trial or a table.") from None
    if path.suffix.lower() != ".mcap":
        given = table.read(path, force_path or None)
        return NewTrial(path, digest, "table", None, float(given["time_s"][-1] - given["time_s"][0]), {}, {}, "")
    recorded = read.open(path)
    if force_path and names(recorded):
        recorded, figures = one_path(recorded, force_path), (figures or {}).get("paths", {}).get(force_path)
    told = dict(recorded.metadata)
    result = recorded.result or {}
    outcome = None if "imported_from" in told else str(result.get("outcome", "not closed"))
    lasts = float(recorded.time_ns[-1] - recorded.time_ns[0]) * 1e-9 if len(recorded.time_ns) else 0.0
    return NewTrial(path, digest, told.get("experiment", ""), outcome, lasts, told | _recorded_date(recorded),
                    _figures(recorded) if figures is None else {k: figures.get(k) for k in FIGURES},
                    told.get("commit", ""))


def _figures(recorded: read.Trial) -> dict[str, Any]:
    from trial import metrics
    from trial.report.setting import known, setting
    from trial.report.trial_page import NEEDED

    judged = setting(recorded)
    if judged.peak_n is None or judged.rate_hz is None or not judged.cycles or any(
            known(recorded, name) is None for name in NEEDED):
        return {}
    found = metrics.figures(recorded.columns, peak_n=judged.peak_n, rate_hz=judged.rate_hz, cycles=judged.cycles,
                            settle=judged.settle)
    return {name: found.get(name) for name in FIGURES}


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
        return session.strip()
    if "day" in described.conditions:
        return f"day {described.conditions['day']}"
    if "date" in described.conditions:
        return described.conditions["date"][:10]
    raise InputError(f"{path}: holds no date of its recording; name its session with --session, such as a date: "
                     "--session 2026-03-02.")


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
