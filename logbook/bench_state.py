"""Present state of a bench: what changed since when, its constants by session, forecasts, maintenance.

The evidence of all sessions is linear in the constants: it suspects a change and dates it.  The diagnosis of the
suspicion names its cause or finds nothing: trials of one session since the change against trials of sessions before it.
A caller that can diagnose runs it (`bowden.models.logbook_entries`), and the logbook keeps the verdict.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from estimation.linear_sums import effect_columns
from estimation.path_model import PATH_MODEL
from estimation.sessions import Change, Reset, SessionSequence
from estimation.stored_fit import decoded
from logbook.database import Logbook, Note, TrialEntry
from parameters import InputError
from physics.effects.hypotheses import HYPOTHESES
from physics.forward.path_constants import FREE, NAMES, TABLE, coordinates_of, values
from physics.laws import Array
from trial.report.words import quantities, words

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


CONSTANTS: Final = tuple(NAMES[i] for i in FREE)
"""Names of the constants that a session determines."""
NEWEST: Final = 60
"""Newest sessions that changes are searched in, besides the reference sessions: bounds the cost of a long logbook."""
LEAST_REFERENCES: Final = 3
"""Reference sessions before anything is stated: two do not show how far sessions of a bench scatter."""
LEAST_CONTRADICTED: Final = 5
"""Sessions since a change from which it is stated although the diagnosis of one of them finds none.

Homing and taring of a few sessions can lie alike by chance: of 26 benches without a change two had 7 and 9 nats after
three such sessions, and none had ln 60 after more."""
ALARM_NATS: Final = math.log(60.0)
"""Log Bayes factor, averaged over all effects of the catalogue, from which a change is suspected and diagnosed.

At most one bench in 60 without a change reaches it in any session (Ville's inequality), if its sessions depart as the
model has it.  Of 26 such benches three did (9, 7 and 4.1 nats), of one serial, when three sessions had followed the
reference.
"""
SET_SHARE: Final = 0.5
"""Share of the best log Bayes factor from which an effect is in the ambiguity set, as in a single diagnosis."""
CANNOT, UNCHANGED, CHANGED = "cannot tell yet", "unchanged", "changed"


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

    @property
    def departure(self) -> float:
        """Distance of the newest value from the first one, over the scatter between sessions."""
        return abs(float(self.value[-1] - self.value[0])) / max(self.scatter, 1e-300)

    def newest(self, *more: float) -> tuple[list[str], str]:
        """Return the newest value, its interval, both scatters and `more` values as texts in one unit, and that unit.
        """
        return quantities((*(float(each[-1]) for each in (self.value, self.low, self.high)), self.scatter,
                           self.published, *more), self.unit)


class Forecast(NamedTuple):
    """Sessions from now until a constant reaches a limit: middle and 95 % interval; None: not within the data."""

    constant: str
    limit: float
    sessions: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class BenchState:
    """State of a bench; `sessions`: numbers of the fitted sessions by date; `labels` of all sessions.

    `changes`: evidence of each effect, best first.  `suspected`: ambiguity set of a suspected change, empty without
    one.  `cause`: its diagnosis (None: it has none).  `scatter`: 1σ between sessions by constant, in coordinates; of a
    suspected change, between those before it.
    """

    name: str
    sessions: tuple[int, ...]
    labels: Mapping[int, str]
    references: int
    notes: Sequence[Note]
    hours: float
    counts: Mapping[str, int]
    courses: Mapping[str, ConstantCourse]
    changes: Sequence[DatedChange] = ()
    suspected: Sequence[DatedChange] = ()
    forecasts: Sequence[Forecast] = ()
    scatter: Mapping[str, float] | None = None
    cause: Cause | None = None

    @property
    def alarms(self) -> Sequence[DatedChange]:
        """Return the ambiguity set of the change that is stated, with the effects of its diagnosis first; or nothing.

        A diagnosis that finds nothing contradicts a change of fewer than `LEAST_CONTRADICTED` sessions.
        """
        if self.cause is None or self.cause.verdict != "none":
            among = () if self.cause is None else self.cause.among
            return sorted(self.suspected, key=lambda change: change.effect not in among)
        several = self.suspected[0].since in self.sessions[:len(self.sessions) - LEAST_CONTRADICTED + 1]
        return self.suspected if several else ()

    @property
    def verdict(self) -> str:
        """Return the verdict on the bench: `CHANGED`, `UNCHANGED` or `CANNOT`."""
        if self.alarms:
            return CHANGED
        return UNCHANGED if len(self.sessions) > self.needed else CANNOT

    @property
    def needed(self) -> int:
        """Number of reference sessions before a statement is made."""
        return max(self.references, LEAST_REFERENCES)

    def as_json(self) -> dict[str, Any]:
        """Return the state as plain values."""
        return {
            "bench": self.name, "verdict": self.verdict, "told": self.sentences(),
            **{f"{what}s": count for what, count in self.counts.items()}, "hours": self.hours,
            "reference_sessions": min(self.references, len(self.sessions)),
            "alarms": [self.dated(c) | self.caused() for c in self.alarms[:1]],
            "changes": [{"effect": c.effect} | self.dated(c) for c in self.changes[:max(6, len(self.alarms))]],
            "forecasts": [f._asdict() for f in self.forecasts],
            "constants": {n: {"value": float(c.value[-1]), "low": float(c.low[-1]), "high": float(c.high[-1]),
                              "unit": c.unit, "session_sd": c.scatter, "published_session_sd": c.published}
                          for n, c in self.courses.items()},
            "notes": [{"text": n.text, "made": n.made, "after": self.labels.get(n.after), "resets": list(n.resets)}
                      for n in self.notes]}

    def sentences(self) -> list[str]:
        """Return what changed, since when and by which evidence, in sentences; the most important one first."""
        if self.verdict == CANNOT:
            fitted = "1 session is" if len(self.sessions) == 1 else f"{len(self.sessions)} sessions are"
            told = [f"Cannot tell yet: {fitted} fitted; a change is stated from "
                    f"{self.needed + 1} on, {self.needed} of them the reference."]
            if without := self.counts["session"] - len(self.sessions):
                told.append(f"{without} more {'session has' if without == 1 else 'sessions have'} no trial that could "
                            "be fitted; bowden logbook show --trial NUMBER says why.")
            return told
        if self.verdict == UNCHANGED:
            unchanged = (f"No change in {len(self.sessions)} sessions beyond their scatter; the first "
                         f"{self.needed} are the reference.")
            return [unchanged, *self._contradicted()]
        best, names = self.alarms[0], ", ".join(words(c.effect) for c in self.alarms)
        low, high = (self.labels.get(s) for s in (best.since_low, best.since_high))
        when = f"session {self.labels.get(best.since)}" + ("" if low == high else f" (95 %: {low} … {high})")
        first = (f"Changed since {when}, as a {best.course}: {', '.join(map(words, self.named()))}; "
                 f"{best.nats:.0f} nats over all sessions.")
        cause = self.cause or Cause(None, remark="not diagnosed yet.")
        of = f"session {self.labels.get(cause.session)} against {', '.join(map(str, self._referred(cause)))}"
        if cause.named:
            return [first, f"Diagnosis of {of}:", *cause.card]
        because = {None: cause.remark, "refused": f"{of}: {cause.remark}",
                   "unexplained": f"{of}: no effect of the catalogue predicts it",
                   "none": f"{of}: no effect is large enough in one session alone"}[cause.verdict]
        return [first, f"Named by the evidence of all sessions ({names}). No diagnosis of one session: "
                       f"{because.rstrip('.')}."]

    def _contradicted(self) -> list[str]:
        if not self.suspected or self.cause is None:
            return []
        since, session = (self.labels.get(n) for n in (self.suspected[0].since, self.cause.session))
        return [f"A change since session {since} has {self.suspected[0].nats:.0f} nats, but the diagnosis of session "
                f"{session} finds none. A change of {LEAST_CONTRADICTED} sessions is stated all the same."]

    def named(self) -> tuple[str, ...]:
        """Return the effects of the change: by the diagnosis if it names one, else by the evidence of all sessions.

        Of the diagnosis' ambiguity set those with evidence in all sessions come first, the largest evidence first.
        """
        suspected = [change.effect for change in self.suspected]
        if self.cause is not None and self.cause.named:
            return tuple(sorted(self.cause.among, key=lambda name: (
                suspected.index(name) if name in suspected else len(suspected))))
        return tuple(c.effect for c in self.alarms)

    def caused(self) -> dict[str, Any]:
        """Return the diagnosis of the alarm; without one `verdict` is null and `remark` the reason."""
        cause = self.cause or Cause(None, remark="not diagnosed yet.")
        named = self.named()
        return {"effects": list(named), "verdict": cause.verdict, "among": list(cause.among),
                "part": HYPOTHESES[named[0]].part if named and named[0] in HYPOTHESES else cause.part,
                "card": list(cause.card), "remark": cause.remark or None, "session": self.labels.get(cause.session),
                "trials": list(cause.trials), "references": self._referred(cause)}

    def _referred(self, cause: Cause) -> list[str | None]:
        return [self.labels.get(number) for number in cause.references]

    def dated(self, change: DatedChange) -> dict[str, Any]:
        """Return evidence and date of a change, with the constants that it moves."""
        moved = {}
        for k in np.flatnonzero(change.departure):
            course = self.courses[CONSTANTS[k]]
            moved[CONSTANTS[k]] = {"now": float(course.value[-1]), "before": float(course.value[0]),
                                   "unit": course.unit}
        return {"nats": change.nats, "course": change.course, "since": self.labels.get(change.since),
                "since_interval": [self.labels.get(change.since_low), self.labels.get(change.since_high)],
                "constants": moved}


def state_of(book: Logbook, limits: Mapping[str, float] | None = None) -> BenchState:
    """Return the state of a bench; `limits`: values of constants, SI, that a forecast is made to."""
    for name in limits or {}:
        if name not in CONSTANTS:
            raise InputError(f"--limit {name}: is no constant of the bench; expected one of {', '.join(CONSTANTS)}.")
    labels = {entry.id: entry.label for entry in book.sessions()}
    common: dict[str, Any] = {"name": book.name, "labels": labels, "references": book.references,
                              "notes": book.notes(), "hours": book.hours(), "counts": book.counts()}
    followed = sequence_of(book)
    if followed is None:
        return BenchState(sessions=(), courses={}, forecasts=[Forecast(n, v, None, None, None)
                                                              for n, v in (limits or {}).items()], **common)
    numbers, sequence = followed
    with threadpool_limits(1, user_api="blas"):
        changes, variance = sequence.search(), sequence.scatter()
        among = _suspected(changes)
        scatter = _deviations(sequence, among, variance)
    suspected = [_dated(sequence, numbers, change) for change in among]
    state = BenchState(
        sessions=numbers, courses={}, changes=[_dated(sequence, numbers, change) for change in changes],
        suspected=suspected, scatter=scatter,
        cause=kept_cause(book, suspected[0], numbers, common["notes"]) if suspected else None, **common)
    with threadpool_limits(1, user_api="blas"):
        courses = _courses(sequence, variance)
    return replace(state, courses=courses, forecasts=[
        _forecast(sequence, among if state.alarms else [], courses, n, v) for n, v in (limits or {}).items()])


def _suspected(changes: Sequence[Change]) -> list[Change]:
    """Return the effects of a suspected change that are as likely as the best one."""
    if not changes or averaged_nats(changes) < ALARM_NATS:
        return []
    return [change for change in changes if change.nats >= SET_SHARE * changes[0].nats]


def _deviations(sequence: SessionSequence, suspected: Sequence[Change], variance: Array) -> dict[str, float]:
    """Return 1σ between sessions by constant, in coordinates; of a suspected change, between those before it."""
    if suspected:
        variance = sequence.until(min(change.since for change in suspected)).scatter()
    return dict(zip(CONSTANTS, np.sqrt(variance).tolist(), strict=True))


def averaged_nats(changes: Sequence[Change | DatedChange]) -> float:
    """Return the log of the Bayes factor of a change, averaged over its effects."""
    return float(logsumexp([change.nats for change in changes])) - math.log(len(changes))


def sequence_of(book: Logbook, without: int | None = None) -> tuple[tuple[int, ...], SessionSequence] | None:
    """Return the numbers of the fitted sessions by date, and their sequence; None if none is fitted.

    `without`: session that is left out.
    """
    kept = book.reference()
    if kept is None or kept.constants != CONSTANTS:
        return None
    order = [s.id for s in book.sessions() if s.id != without]
    fitted = book.sums(kept.id, list(dict.fromkeys([*order[:book.references], *order[-NEWEST:]])))
    if not fitted:
        return None
    numbers, fit = tuple(n for n in order if n in fitted), decoded(kept.model, PATH_MODEL)
    resets = {Reset(CONSTANTS.index(name), _before(order, numbers, note.after)) for note in book.notes()
              for name in note.resets if name in CONSTANTS}
    return numbers, SessionSequence(fit, effect_columns(fit), [fitted[n] for n in numbers],
                                    max(book.references, LEAST_REFERENCES), sorted(resets))


def measured_deviations(book: Logbook) -> dict[str, float] | None:
    """Return 1σ between sessions by constant, in coordinates; None with fewer than two sessions.

    A change of the bench does not count as scatter.
    """
    followed = sequence_of(book)
    if followed is None or followed[1].count < 2:
        return None
    with threadpool_limits(1, user_api="blas"):
        return _deviations(followed[1], _suspected(followed[1].search()), followed[1].scatter())


def _before(order: Sequence[int], numbers: Sequence[int], after: int) -> int:
    """Return the number of fitted sessions up to the session `after` of a note."""
    done = set(order[:order.index(after) + 1]) if after in order else set()
    return sum(n in done for n in numbers)


def _dated(sequence: SessionSequence, numbers: Sequence[int], change: Change) -> DatedChange:
    since, low, high = (numbers[row] for row in (change.since, change.since_low, change.since_high))
    return DatedChange(change.effect, change.nats, change.course, since, low, high, change.departure)


def _courses(sequence: SessionSequence, variance: Array) -> dict[str, ConstantCourse]:
    means, sds = sequence.constants(variance)
    mean = sequence.fit.prior.coordinates(PATH_MODEL.constants)
    found = {}
    for k, i in enumerate(FREE):
        row = TABLE[i]

        def at(q: Array, i: int = i) -> Array:
            sets = np.repeat(mean[:, None], q.size, axis=1)
            sets[i] += q
            return np.asarray(values(sets)[i])

        ends = np.stack([at(means[:, k] - 1.96 * sds[:, k]), at(means[:, k] + 1.96 * sds[:, k])])
        scatter, published = (float(abs(np.diff(at(np.array([0.0, sd])))[0]))
                              for sd in np.sqrt([variance[k], sequence.published[k]]))
        found[row.name] = ConstantCourse(row.name, row.unit, row.meaning, at(means[:, k]), ends.min(axis=0),
                                         ends.max(axis=0), scatter, published)
    return found


def _forecast(sequence: SessionSequence, changes: Sequence[Change], courses: Mapping[str, ConstantCourse], name: str,
              limit: float) -> Forecast:
    """Return when a constant reaches a limit if a ramp of any of the stated `changes` that moves it goes on.

    The interval is over these, with the 95 % intervals of the departure and of the first session: slow paces began
    early.
    """
    k, ends = CONSTANTS.index(name), []
    goal, now = (coordinates_of(_with(sequence, k, value))[FREE[k]] for value in (limit, courses[name].value[-1]))
    for change in changes:
        if change.course == "ramp" and change.departure[k]:
            departure, sd = change.departure[k], change.departure_sd[k]
            paces = (departure + np.array([1.96, 0.0, -1.96]) * np.sign(departure) * sd) / (
                sequence.count - np.array([change.since_high, change.since, change.since_low]))
            ends.append([(goal - now) / pace if (goal - now) * pace > 0.0 else math.inf for pace in paces])
    if not ends:
        return Forecast(name, limit, None, None, None)
    low, middle, high = np.min(ends, axis=0)[0], np.median(ends, axis=0)[1], np.max(ends, axis=0)[2]
    return Forecast(name, limit, *(float(each) if np.isfinite(each) else None for each in (middle, low, high)))


def _with(sequence: SessionSequence, k: int, value: float) -> Array:
    constants = values(sequence.fit.bench_coordinates())
    constants[FREE[k]] = value
    return np.asarray(constants)


PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "cable": ("cable", "bend", "load", "viscous", "dry", "cable_travel", "breakaway", "stribeck_speed",
              "stribeck_memory", "sharpness", "cable_compliance", "fabric_share", "zero"),
    "fabric": ("fabric", "wrap", "fabric_travel", "fabric_breakaway", "sharpness", "stiffness", "curve2", "curve3",
               "fabric_share", "prompt", "slow", "creep_compliance", "creep_time", "zero"),
    "knee": ("play", "gap", "arm", "arm2", "arm3", "zero"),
    "start": ("start_gain", "start_offset", "start_lag"),
    "end": ("end_gain", "end_offset", "end_lag"),
    "drive": ("drive_coulomb", "drive_viscous", "drive_inertia", "drive_offset", "drive_asymmetry",
              "drive_viscous_asymmetry", "drive_travel", "demand_gain", "zero"),
}
"""Constants that maintenance of a part of the bench changes."""


def constants_of(parts: Sequence[str]) -> tuple[str, ...]:
    """Return the constants of parts or of single constants; raises `InputError` for a name that is neither."""
    named: list[str] = []
    for name in parts:
        if name.lower() not in PARTS and name not in CONSTANTS:
            raise InputError(f"--part {name}: is neither a part ({', '.join(PARTS)}) nor a constant; "
                             "bowden logbook show --all lists the constants.")
        named += PARTS.get(name.lower(), (name,))
    return tuple(c for c in dict.fromkeys(named) if c in CONSTANTS)
