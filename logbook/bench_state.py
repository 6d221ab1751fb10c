"""Present state of a bench: its constants by session with intervals, changes, alarms, forecasts, maintenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from logbook.change_cause import Cause, kept_cause
from logbook.change_search import Change, Forecast, alarms, forecast, search_changes, shift_of
from logbook.database import Logbook, Note, SessionEntry
from logbook.session_model import CONSTANTS, SessionModel, fit_sessions, sessions_of
from parameters import InputError
from physics.laws import Array
from physics.path_constants import FREE, SESSION_SD, TABLE, values

NEWEST: Final = 120
"""Newest sessions that changes are searched in, besides the reference sessions: bounds the cost of a long logbook."""


CALIBRATED: Final = 10
"""Reference sessions with which the rate of false alarms was measured; with fewer there is evidence and no alarm.

With two, the evidence of a healthy simulated bench passes the threshold."""


@dataclass(frozen=True)
class ConstantCourse:
    """One constant over sessions, SI: value and 95 % interval of each; `scatter` 1σ between sessions, `published` too.

    Both scatters are departures of the value from the newest reference value.
    """

    name: str
    unit: str
    meaning: str
    value: Array
    low: Array
    high: Array
    scatter: float
    published: float


@dataclass(frozen=True)
class BenchState:
    """State of a bench; `labels` of the sessions in `sessions`; `courses` by constant; empty without an estimate.

    `changes`, `alarms`: by the linear session model, best first.  `cause`: kept diagnosis of the alarm; None if it has
    none.
    """

    name: str
    sessions: tuple[int, ...]
    labels: Mapping[int, str]
    references: int
    courses: Mapping[str, ConstantCourse]
    changes: Sequence[Change]
    alarms: Sequence[Change]
    forecasts: Sequence[Forecast]
    notes: Sequence[Note]
    model: SessionModel | None
    hours: float
    counts: Mapping[str, int]
    cause: Cause | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return {
            "bench": self.name, **{f"{what}s": count for what, count in self.counts.items()}, "hours": self.hours,
            "reference_sessions": min(self.references, len(self.sessions)), "alarms": [
                self.dated(c) | self.caused() for c in self.alarms[:1]],
            "changes": [self.told(c) for c in self.changes[:max(6, len(self.alarms))]],
            "forecasts": [f._asdict() for f in self.forecasts],
            "constants": {n: {"value": float(c.value[-1]), "low": float(c.low[-1]), "high": float(c.high[-1]),
                              "unit": c.unit, "session_sd": c.scatter, "published_session_sd": c.published}
                          for n, c in self.courses.items()},
            "notes": [{"text": n.text, "made": n.made, "after": self.labels.get(n.after), "resets": list(n.resets)}
                      for n in self.notes]}

    def told(self, change: Change) -> dict[str, Any]:
        """Return one change of the linear session model: the effect that fits it best, its evidence and its date."""
        return {"effect": change.name, "in_catalogue": change.known, **self.dated(change)}

    def caused(self) -> dict[str, Any]:
        """Return the diagnosis of the alarm; `verdict` null and the reason in `remark` if there is none."""
        cause = self.cause or Cause(None, remark="not diagnosed yet.")
        return {"verdict": cause.verdict, "among": list(cause.among), "part": cause.part,
                "remark": cause.remark or None, "session": self.labels.get(cause.session), "trials": list(cause.trials),
                "references": [self.labels.get(number) for number in cause.references]}

    def cause_told(self) -> str:
        """Return the diagnosis of the alarm as one sentence."""
        told = self.caused()
        of = f"session {told['session']} against {', '.join(map(str, told['references']))}"
        names = ", ".join(told["among"])
        return {
            None: f"Cause not diagnosed: {told['remark']}",
            "refused": f"Cause not diagnosed, {of}: {told['remark']}",
            "found": f"Diagnosis of {of}: {names} ({told['part']}).",
            "ambiguous": f"Diagnosis of {of}: one of {names} ({told['part']}); these trials do not separate them.",
            "unexplained": f"Diagnosis of {of}: unexplained, no effect of the catalogue predicts it.",
            "none": f"Diagnosis of {of}: no effect is large enough in one session to be named.",
        }[told["verdict"]]

    def dated(self, change: Change) -> dict[str, Any]:
        """Return evidence and date of a change, with the constants that the session model moves for it."""
        moved = {}
        for k in np.flatnonzero(change.departure):
            name = CONSTANTS[k]
            course = self.courses[name]
            moved[name] = {"departure": float(change.departure[k]), "departure_sd": float(change.departure_sd[k]),
                           "scatter": float(self.model.sd[k]) if self.model else None, "now": float(course.value[-1]),
                           "unit": course.unit}
        return {"nats": change.nats, "course": change.course, "since": self.labels.get(change.since),
                "since_interval": [self.labels.get(change.since_low), self.labels.get(change.since_high)],
                "constants": moved}


def state_of(book: Logbook, limits: Mapping[str, float] | None = None) -> BenchState:
    """Return the state of a bench; `limits`: values of constants, SI, that a forecast is made to."""
    for name in limits or {}:
        if name not in CONSTANTS:
            raise InputError(f"--limit {name}: is no constant of the bench; expected one of {', '.join(CONSTANTS)}.")
    entries: dict[int, SessionEntry] = {s.id: s for s in book.sessions()}
    labels = {number: entry.label for number, entry in entries.items()}
    notes, kept = book.notes(), book.reference()
    sessions = [] if kept is None else sessions_of(book.estimates(kept.id, NEWEST))
    common: dict[str, Any] = {"name": book.name, "labels": labels, "references": book.references, "notes": notes,
                              "hours": book.hours(), "counts": book.counts()}
    if kept is None or not sessions or kept.constants != CONSTANTS:
        return BenchState(sessions=(), courses={}, changes=(), alarms=(), forecasts=(), model=None, **common)
    model = fit_sessions(sessions, notes, book.references)
    changes = search_changes(model, kept.bench)
    raised = alarms(changes) if len(sessions) > CALIBRATED and book.references >= CALIBRATED else []
    ahead = forecast(model, kept.bench, changes[0], limits or {}) if raised else [
        Forecast(n, v, None, None, None) for n, v in (limits or {}).items()]
    courses = _courses(model, kept.bench, raised)
    cause = kept_cause(book, raised[0], model.sessions, notes) if raised else None
    return BenchState(sessions=model.sessions, courses=courses, changes=changes, alarms=raised, forecasts=ahead,
                      model=model, cause=cause, **common)


def measured_deviations(book: Logbook) -> dict[str, float] | None:
    """Return 1σ between sessions by constant, in coordinates, from the reference sessions; None with fewer than two."""
    kept = book.reference()
    sessions = [] if kept is None else sessions_of(book.estimates(kept.id, 0))
    if len(sessions) < 2:
        return None
    model = fit_sessions(sessions, [], book.references)
    return dict(zip(CONSTANTS, model.sd.tolist(), strict=True))


def _courses(model: SessionModel, bench_q: Array, raised: Sequence[Change]) -> dict[str, ConstantCourse]:
    means, sds = model.smoothed(shift_of(model, raised[0]) if raised else None)
    found = {}
    for k, i in enumerate(FREE):
        row = TABLE[i]
        sets = np.repeat(bench_q[:, None], means.shape[0], axis=1)

        def at(q: Array, i: int = i, sets: Array = sets) -> Array:
            moved = sets.copy()
            moved[i] += q
            return np.asarray(values(moved)[i])

        middle = at(means[:, k])
        ends = np.stack([at(means[:, k] - 1.96 * sds[:, k]), at(means[:, k] + 1.96 * sds[:, k])])

        def scatter(sd: float, at: Any = at, middle: Array = middle) -> float:
            return float(abs(at(np.full(middle.size, sd))[0] - at(np.zeros(middle.size))[0]))

        found[row.name] = ConstantCourse(row.name, row.unit, row.meaning, middle, ends.min(axis=0), ends.max(axis=0),
                                         scatter(float(model.sd[k])), scatter(float(SESSION_SD[i])))
    return found
