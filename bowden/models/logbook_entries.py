"""Trials into a logbook: figures, conditions and the bench constants of the session, by the fitted force path.

The first two sessions' first trials are the reference model; every trial is then fitted relative to it, so that what
the model lacks is the same in every session and no change.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from logbook.database import Estimate, Logbook, NewTrial, TrialEntry, open_logbook
from logbook.session_model import CONSTANTS
from parameters import InputError
from physics.path_constants import BENCH_SD, FREE, INDEX, SESSION_SD
from trial import read

if TYPE_CHECKING:
    from bowden.bench.buses import BusSettings
    from estimation.likelihood_data import Recording
    from estimation.reference_fit import ReferenceFit

WIDTH: Final = 8.0
"""Least 1σ of a session's estimate about the reference model, in published session deviations: wide enough that a
change is measured and not held back, narrow enough that the model stays linear."""
REFERENCE_TRIALS: Final = 2
"""Number of sessions whose first trial the reference model is fitted to."""
MOST_REFERENCES: Final = 4
"""Reference trials of a diagnosis: the reference fit costs a second each and more add less than sessions scatter."""
FIGURES: Final = ("relative_rmse_percent", "relative_rmse_window_percent", "max_idle_tension_n", "peak_jump_n")


def add(folder: Path, path: Path, session: str | None = None, figures: Mapping[str, Any] | None = None
        ) -> TrialEntry:
    """Enter a trial or a table, fit it, and return its entry; acknowledged once this returns.

    `session`: its label (None: the date of the file).  A file that was entered is not entered again.
    """
    with open_logbook(folder) as book:
        number, _ = book.enter_trial(_described(path, figures), _label(path, session))
        fit_missing(book)
        return book.trials(1, trial=number)[0]


def entered(folder: Path, path: Path, session: str, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Enter a trial that was just recorded; return its number, session and whether it was fitted."""
    entry = add(folder, path, session, figures)
    return {"logbook": str(folder), "trial": entry.id, "session": entry.label, "fitted": entry.estimated,
            "remark": entry.remark}


def label(given: str | None, chosen: BusSettings) -> str:
    """Return the session of a trial that was just recorded: a simulated bench's is its day."""
    import datetime

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
    """Return the reference sessions' first trials, `MOST_REFERENCES` at most, and 1σ of each constant between sessions.

    Raises `InputError` where no reference session has a trial whose file is there.
    """
    from logbook.bench_state import measured_deviations

    with open_logbook(folder) as book:
        found: list[Path] = []
        for session in book.sessions()[:book.references]:
            fitted = [book.place(t.path) for t in reversed(book.trials(session=session.id)) if t.estimated and t.there]
            found += fitted[:1]
        deviations = measured_deviations(book)
    if not found:
        raise InputError(f"{folder}: no reference session has a fitted trial whose file is there; name reference "
                         "trials with --healthy.")
    return found[:MOST_REFERENCES], deviations


def deviations(folder: Path) -> dict[str, float] | None:
    """Return 1σ of each constant between sessions, in coordinates; None before two reference sessions."""
    from logbook.bench_state import measured_deviations

    with open_logbook(folder) as book:
        return measured_deviations(book)


def against_history(folder: Path, path: Path) -> dict[str, Any]:
    """Return how far a trial lies from its bench's own history, constant by constant; the logbook is not changed.

    `scatters`: departure over the 1σ of sessions, uncertainty of the bench included; `probability` that a healthy
    session departs as far in all constants together.  A session of the logbook is compared with the other sessions.
    """
    from logbook.database import StoredEstimate
    from logbook.session_model import departure_of, fit_sessions, sessions_of
    from physics.path_constants import TABLE

    with open_logbook(folder) as book:
        kept = reference_model(book)
        described = _described(path, None)
        own = book.session_of(described.digest)
        sessions = [] if kept is None else [s for s in sessions_of(book.estimates(kept[0], 120)) if s.id != own]
        if kept is None or len(sessions) < 2:
            raise InputError(f"{folder}: has fewer than two other fitted sessions; bowden logbook add enters trials.")
        model = fit_sessions(sessions, book.notes(), book.references)
        found = estimate(kept[1], _recording_of(path, described.outcome))
        departed = departure_of(model, sessions_of([StoredEstimate(0, 0, found)])[0])
        return {"trial": str(path), "logbook": str(folder), "sessions": len(sessions),
                "probability": departed.probability, "constants": {
                    name: {"departure": float(departed.departure[k]), "scatters": float(departed.scatters[k]),
                           "form": TABLE[FREE[k]].form, "unit": TABLE[FREE[k]].unit}
                    for k, name in enumerate(CONSTANTS)}}


def add_verdict(folder: Path, path: Path, content: Mapping[str, Any]) -> None:
    """Enter the verdict on a trial; the trial is entered, too, if it is new."""
    entry = add(folder, path)
    with open_logbook(folder) as book:
        book.enter_verdict(entry.id, content)


def fit_missing(book: Logbook) -> None:
    """Fit every trial that was entered but not fitted; a trial that cannot be fitted is remarked on."""
    waiting = book.unfitted()
    while waiting:
        number = waiting.pop(0)
        entry = book.trials(1, trial=number)[0]
        try:
            recording = _recording(book.place(entry.path), entry)
        except InputError as error:
            book.enter_remark(number, str(error))
            continue
        reference = _reference(book, number, recording)
        if reference is None:
            waiting = book.unfitted()
            continue
        key, model = reference
        if not book.enter_estimate(number, key, estimate(model, recording)):
            waiting = book.unfitted()


def estimate(model: ReferenceFit, recording: Recording) -> Estimate:
    """Return the constants of one trial relative to the reference model, under a wide prior of the session alone."""
    from threadpoolctl import threadpool_limits

    from estimation.posterior import Gaussian, mode

    count = len(FREE)
    session = np.diag(model.prior.covariance - model.bench.covariance).copy()
    prior_sd = session_prior()
    session[:count] = prior_sd**2
    origin = model.origin.copy()
    origin[list(FREE)] += model.bench.mean[:count]
    middle = np.concatenate([np.zeros(count), model.bench.mean[count:]])
    with threadpool_limits(1, user_api="blas"):
        found = mode(model.observe(recording), Gaussian(origin, middle, np.diag(session)))
        whole = found.factor @ np.linalg.solve(_inner(found), found.factor.T)
    left = float(np.sqrt(np.mean(found.residual**2)))
    return Estimate(found.x[:count], whole[:count, :count], prior_sd, left)


def _inner(found: Any) -> Any:
    """Return I + LᵀHᵀWHL of a mode from its Cholesky factor."""
    factor, lower = found.inner
    triangle = np.tril(factor) if lower else np.triu(factor)
    return triangle @ triangle.T if lower else triangle.T @ triangle


def session_prior() -> Any:
    """Return 1σ of a session's departure from the reference model: of its scatter or of the largest likely effect."""
    from physics.effects.hypotheses import HYPOTHESES
    from physics.path_constants import named

    nominal = named(np.zeros(len(SESSION_SD)))
    likely = np.zeros(len(SESSION_SD))
    for hypothesis in HYPOTHESES.values():
        for variant in hypothesis.variants(nominal):
            for direction in variant.directions:
                for name, share in direction.along.items():
                    likely[INDEX[name]] = max(likely[INDEX[name]], abs(share) * direction.sd)
    wide = np.maximum(WIDTH * SESSION_SD, likely)
    return np.minimum(wide, np.maximum(BENCH_SD, likely))[list(FREE)]


def bench_coordinates(model: ReferenceFit) -> Any:
    """Return the coordinates of the reference model, shape (len(TABLE),)."""
    q = model.origin.copy()
    q[list(FREE)] += model.bench.mean[:len(FREE)]
    return q


def reference_model(book: Logbook) -> tuple[int, ReferenceFit] | None:
    """Return number and content of the newest reference model; None before the first one."""
    kept = book.reference()
    if kept is None:
        return None
    if kept.constants != CONSTANTS:
        raise InputError(f"{book.folder}: its reference model has other constants than this version's bench model; "
                         "make a logbook anew and add the trials.")
    return kept.id, decoded(kept.model)


def _reference(book: Logbook, number: int, recording: Recording) -> tuple[int, ReferenceFit] | None:
    """Return the reference model, fitted again if this trial belongs to it; None if another process fitted it first.

    Only the first trial of a session that has none in the model yet is taken into it.
    """
    from estimation.path_model import PATH_MODEL
    from estimation.posterior import CLOSE
    from estimation.reference_fit import fit_reference

    kept = book.reference()
    taken: list[int] = [] if kept is None else list(kept.trials)
    sessions = {book.trials(1, trial=one)[0].session for one in taken}
    due = len(taken) < REFERENCE_TRIALS and book.trials(1, trial=number)[0].session not in sessions
    if kept is not None and not due:
        key, model = reference_model(book) or (0, None)
        assert model is not None
        if recording.outputs != model.outputs:
            raise InputError(f"{recording.source}: has the outputs {', '.join(recording.outputs)}, the reference "
                             f"sessions have {', '.join(model.outputs)}; enter it in a logbook of its own.")
        return key, model
    recordings = [recording]
    for one in taken:
        entry = book.trials(1, trial=one)[0]
        recordings.insert(0, _recording(book.place(entry.path), entry))
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        # every later session is compared with it: its distance from the mode, or a discrepancy too small for what
        # sessions differ by, would be a change of them all
        made = fit_reference(PATH_MODEL, recordings, close=0.1 * CLOSE, shares=(1.0,))
    book.enter_reference(CONSTANTS, [*taken, number], bench_coordinates(made), encoded(made),
                         None if kept is None else kept.id)
    return None


def _recording(path: Path, entry: TrialEntry) -> Recording:
    """Read a trial of the logbook; raises `InputError` where it is not there or cannot be fitted."""
    return _recording_of(path, entry.outcome)


def _recording_of(path: Path, outcome: str | None) -> Recording:
    """Read the inputs of the likelihood; raises `InputError` if one is missing."""
    from estimation.data import integrity, scales, table
    from estimation.path_model import PATH_MODEL

    if outcome not in (None, "completed"):
        raise InputError(f"{path}: the trial is {outcome}; only completed trials are fitted.")
    if not path.exists():
        raise InputError(f"{path}: no such file; put it back, or add it again from where it is now.")
    given = table.read(path)
    refused = [f.text for f in (*integrity.examine(given), *scales.contradictions(given)) if f.refuses]
    if refused:
        raise InputError(f"{path}: {refused[0]}")
    plain = integrity.usable(given)
    missing = PATH_MODEL.lacking(plain)
    if missing:
        raise InputError(f"{path}: has no column {', '.join(missing)}; record it.")
    return PATH_MODEL.record(plain)


def _described(path: Path, figures: Mapping[str, Any] | None) -> NewTrial:
    """Return a file as the logbook keeps it; raises `InputError` for one that is neither a trial nor a table."""
    from estimation.data import table

    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a trial or a table.") from None
    if path.suffix.lower() != ".mcap":
        given = table.read(path)
        return NewTrial(path, digest, "table", None, float(given["time_s"][-1] - given["time_s"][0]), {}, {}, "")
    recorded = read.open(path)
    told = dict(recorded.metadata)
    result = recorded.result or {}
    lasts = float(recorded.time_ns[-1] - recorded.time_ns[0]) * 1e-9 if len(recorded.time_ns) else 0.0
    return NewTrial(path, digest, told.get("experiment", ""), str(result.get("outcome", "not closed")), lasts, told,
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


def _label(path: Path, session: str | None) -> str:
    import datetime

    if session is not None:
        if not session.strip():
            raise InputError("--session: expected a label, such as a date; leave it out for the file's date.")
        return session.strip()
    try:
        return datetime.date.fromtimestamp(path.stat().st_mtime).isoformat()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the path of a trial or a table.") from None


def encoded(model: ReferenceFit) -> bytes:
    """Return a reference model as bytes: arrays as npz, their structure as JSON; no code is in it."""
    arrays: dict[str, Any] = {}

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            arrays[f"a{len(arrays)}"] = value
            return {"array": f"a{len(arrays) - 1}"}
        if is_dataclass(value):
            return {"fields": {f.name: plain(getattr(value, f.name)) for f in fields(value) if f.name != "model"}}
        if hasattr(value, "_asdict"):
            return {"fields": {k: plain(v) for k, v in value._asdict().items()}}
        if isinstance(value, tuple | list):
            return {"tuple": [plain(v) for v in value]}
        if isinstance(value, Mapping):
            return {"mapping": {k: plain(v) for k, v in value.items()}}
        return value

    structure = json.dumps(plain(model))
    arrays["structure"] = np.frombuffer(structure.encode(), np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def decoded(content: bytes) -> ReferenceFit:
    """Return the reference model of `encoded`; raises `InputError` for one that another version wrote."""
    from estimation.path_model import PATH_MODEL
    from estimation.posterior import Gaussian
    from estimation.reference_fit import Reach, ReferenceFit, Scaling

    kinds: dict[str, Any] = {"bench": Gaussian, "prior": Gaussian, "scaling": Scaling, "reach": Reach}
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        held = {name: arrays[name] for name in arrays.files}

    def built(value: Any, name: str = "") -> Any:
        if not isinstance(value, dict):
            return value
        if "array" in value:
            return held[value["array"]]
        if "tuple" in value:
            return tuple(built(v) for v in value["tuple"])
        if "mapping" in value:
            return {k: built(v) for k, v in value["mapping"].items()}
        given = {k: built(v, k) for k, v in value["fields"].items()}
        return kinds[name](**given) if name else ReferenceFit(PATH_MODEL, **{"reach": None, **given})

    try:
        made: ReferenceFit = built(json.loads(held["structure"].tobytes()))
    except (KeyError, TypeError):
        raise InputError("the reference model of this logbook was written by another version; make a logbook anew "
                         "and add the trials.") from None
    return made
