"""Fits of a logbook's trials: the reference posterior of its first sessions, and the sums of each trial under it."""

from pathlib import Path
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimation.joint_fit import fit_reference
from estimation.likelihood_data import Recording
from estimation.linear_sums import effect_columns, motion_spread, session_sums
from estimation.path_model import PATH_MODEL, usable_table
from estimation.posterior import CLOSE
from estimation.stored_fit import decoded, encoded
from logbook.bench_state import CONSTANTS
from logbook.database import UNFITTED, Logbook, ReferenceModel
from parameters import InputError
from trial.read import open_file, path_names

MOST_REFERENCES: Final = 4
"""Trials of the reference fit, and of the reference of a diagnosis: each costs seconds, and more add less than sessions
scatter."""


def fit_missing(book: Logbook) -> None:
    """Fit every trial that is not fitted under the reference of the first sessions by date.

    A trial that cannot be fitted is remarked on.  An earlier session that is entered later makes the reference, and all
    fits, anew, so that the order of entry has no influence; if a file for that is gone, the reference stays.
    """
    with threadpool_limits(1, user_api="blas"):
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
            _fit(book, kept, waiting)


def _wanted(book: Logbook) -> tuple[int, ...]:
    """Return the numbers of the reference trials: one usable trial, of the least digest, of each of the first sessions.

    Sessions are in the order of their dates.
    """
    found: list[int] = []
    for session in book.sessions():
        if len(found) == min(book.references, MOST_REFERENCES):
            break
        usable = [t.id for t in book.trials(session=session.id) if t.estimated or t.remark == UNFITTED]
        found += sorted(usable, key=book.digest)[:1]
    return tuple(found)


def _make_reference(book: Logbook, wanted: tuple[int, ...], after: int | None) -> None:
    """Fit the reference to the trials `wanted` and enter it; a trial that cannot be read is remarked on instead."""
    recordings: list[Recording] = []
    for number in wanted:
        try:
            recordings.append(_entered(book, number, recordings[0].outputs if recordings else None))
        except InputError as error:
            _remark(book, number, error)
            return
    made = fit_reference(PATH_MODEL, recordings, close=0.1 * CLOSE)
    motions = np.array([motion_spread(each) for each in recordings])
    book.enter_reference(CONSTANTS, wanted, motions, encoded(made), after)


def _fit(book: Logbook, kept: ReferenceModel, waiting: list[int]) -> None:
    """Enter the sums of trials under the reference `kept`, until another process has made a newer one."""
    if kept.constants != CONSTANTS:
        raise InputError(f"{book.folder}: its reference has other constants than this version's bench model; make a "
                         "logbook anew and add the trials.")
    fit = decoded(kept.model, PATH_MODEL)
    columns = effect_columns(fit)
    for number in waiting:
        try:
            recording = _entered(book, number, fit.outputs)
        except InputError as error:
            _remark(book, number, error)
            continue
        if not book.enter_sums(number, kept.id, session_sums(fit, columns, recording, kept.motions)):
            return


def _remark(book: Logbook, number: int, error: InputError) -> None:
    """Enter why a trial cannot be fitted, without its path, which the logbook has."""
    path = book.place(book.trials(1, trial=number)[0].path)
    book.enter_remark(number, str(error).removeprefix(f"{path}: "))


def _entered(book: Logbook, number: int, outputs: tuple[str, ...] | None) -> Recording:
    """Read a trial of the logbook; raises `InputError` if it has other `outputs` than the reference sessions."""
    entry = book.trials(1, trial=number)[0]
    recording = recording_of(book.place(entry.path), entry.outcome, book.path)
    if outputs is not None and recording.outputs != outputs:
        raise InputError(f"{recording.source}: has the outputs {', '.join(recording.outputs)}, the reference "
                         f"sessions have {', '.join(outputs)}; enter it in a logbook of its own.")
    return recording


def recording_of(path: Path, outcome: str | None, force_path: str) -> Recording:
    """Read the inputs of the likelihood, of the force path of a trial of several; raises `InputError` if one lacks."""
    if outcome not in (None, "completed"):
        raise InputError(f"{path}: the trial is {outcome}; only completed trials are fitted.")
    if not path.exists():
        raise InputError(f"{path}: no such file; put it back, or add it again from where it is now.")
    if not force_path and path.suffix.lower() == ".mcap" and (names := path_names(open_file(path))):
        raise InputError(f"{path}: records the force paths {', '.join(names)}, and a logbook follows one; say bowden "
                         f"logbook init DIR --path {names[0]}, and add it there.")
    return PATH_MODEL.record(usable_table(path, force_path or None))
