"""Experiments before they are run: the expected result of one, and the one that makes an ambiguity set single.

`plan` simulates an experiment on the nominal bench and examines it as a trial would be; `of_trials`, `of_logbook` and
`of_model` find the experiment that decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

from threadpoolctl import threadpool_limits

from bowden.bench import buses, configuration
from bowden.deferred import on_first_use
from bowden.models import logbook_entries
from diagnosis.evidence import decision
from diagnosis.evidence.evidence_finder import EvidenceFinder
from diagnosis.evidence.experiment_prediction import DECIDES, PlannedExperiment, predicted_experiments
from diagnosis.evidence.identical_motion import REPEAT, search_trial
from estimation.data import table as data
from estimation.data.table import Table
from estimation.likelihood_data import MOTION
from estimation.path_model import usable_table
from logbook.database import open_logbook
from parameters import InputError, read_toml
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS

with on_first_use():
    from bowden.trials import session
    from diagnosis.evidence.planned_limits import Plan
    from diagnosis.evidence.planned_limits import plan as planned

GAIT = "gait"


class WalkPlan(NamedTuple):
    """Gait of the planned experiment; None uses the configuration's default.

    `noise_n` is 1σ of both tension sensors.
    """

    peak_n: float | None = None
    period_s: float | None = None
    cycles: int | None = None
    noise_n: float | None = None


AS_CONFIGURED = WalkPlan()


def plan(name: str, walk: WalkPlan = AS_CONFIGURED, calibration: Path | None = None,
         healthy: Sequence[Path] = ()) -> Plan:
    """Simulate the experiment `name` ("gait", or one of the catalogue) and return its expected result.

    `healthy`: reference trials of the bench to be examined, `calibration` its calibration. Without both, a gait and the
    experiment itself, simulated, are the reference trials. Raises `InputError`.
    """
    with TemporaryDirectory(prefix="bowden-") as folder:
        recorded = {each: Path(folder) / f"{each}.mcap" for each in dict.fromkeys((GAIT, name))}
        wanted = [name] if healthy or calibration else list(recorded)
        for each in wanted:
            simulate(each, walk, recorded[each])
        tables = [data.read(recorded[each]) for each in wanted]
    if calibration is not None or healthy:
        known = None if calibration is None else read_toml(calibration)
        return planned(tables[0], [data.read(path) for path in healthy], known)
    return planned(tables[-1], tables)


def simulate(name: str, walk: WalkPlan, recorded: Path, *, day: int = 0,
             plant_model: Mapping[str, Any] | None = None) -> None:
    """Record the experiment on the nominal bench, or on `plant_model`, its sensors as noisy as asked for."""
    sections = configuration.read(None)
    sections["gait"] = configuration.override(sections["gait"], {
        "peak_n": ("--peak", walk.peak_n), "period_s": ("--period", walk.period_s), "cycles": ("--cycles", walk.cycles),
        "settle": ("--settle", 0)})
    sensor = {"noise_n": walk.noise_n}
    noisy = plant_model if walk.noise_n is None else {"start_sensor": sensor, "end_sensor": sensor}
    prepared = session.prepare_gait(
        sections, None, buses.simulated(serial=0, day=day, plant_model=noisy), peak_given=walk.peak_n is not None,
        period_given=True, script=None if name == GAIT else name)
    result = session.perform(prepared, recorded)
    if result["outcome"] != "completed":
        raise InputError(f"--plan {name}: the simulated trial stopped ({result['stop_reason']}); ask for less.")


SIMULATED_DAYS: Final = (0, 1, 2)
"""Sessions of a simulated bench: two of reference trials, then that of the trial with the model's effects."""


@dataclass(frozen=True)
class ExperimentPlan:
    """Experiments that decide between the effects `among`: `experiments`, the most promising first; `by_hand` in
    words.

    `verdict` of the trials so far; `tried`: experiments among them, which are not proposed again.
    """

    verdict: str
    among: tuple[str, ...]
    experiments: tuple[PlannedExperiment, ...]
    tried: tuple[str, ...]
    by_hand: dict[str, str]

    @property
    def proposed(self) -> PlannedExperiment | None:
        """The experiment to run; None where none that the bench runs by itself is likely to decide."""
        return next(self._deciding(), None)

    @property
    def proposed_beside(self) -> PlannedExperiment | None:
        """The experiment to diagnose together with the trials; a repeated motion is diagnosed alone."""
        return next((one for one in self._deciding() if one.name != REPEAT), None)

    def _deciding(self) -> Iterator[PlannedExperiment]:
        return (one for one in self.experiments if one.best >= DECIDES)

    def advice(self, good: str) -> Iterator[str]:
        """Yield what to run, or to do by hand; `good` is the reference trial whose motion a repetition follows."""
        proposed = self.proposed
        if proposed is None:
            yield "None of them is likely to decide."
            yield from (f"By hand: {name}: {text}." for name, text in self.by_hand.items())
        elif proposed.name == REPEAT:
            yield (f"Run: bowden trial --motion-of {good} -o repeat.mcap, then diagnose it alone, with the same "
                   "--healthy.")
        else:
            if proposed.sure < proposed.with_reference:
                yield (f"First, with nothing wrong: bowden trial --experiment {proposed.name} -o "
                       f"{proposed.name}_good.mcap; give it with --healthy.")
            yield (f"Run: bowden trial --experiment {proposed.name} -o {proposed.name}.mcap, then diagnose it beside "
                   "the trial.")

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        proposed = self.proposed
        return {"verdict": self.verdict, "class": list(self.among), "tried": list(self.tried),
                "proposed": None if proposed is None else proposed.name,
                "experiments": [asdict(one) | {"pair": list(one.pair)} for one in self.experiments],
                "by_hand": self.by_hand}


def of_trials(trials: Sequence[Path], healthy: Sequence[Path], session_sd: Mapping[str, float] | None = None,
              path: str | None = None) -> ExperimentPlan:
    """Plan for trials of one session against reference trials; `path`: the force path of several.  Raises `InputError`.
    """
    if not healthy:
        raise InputError("no reference trial beside the trials themselves; name another one with --healthy, or a "
                         "--logbook.")
    given, known = ([usable_table(file, path, MOTION) for file in group] for group in (trials, healthy))
    return _planned(given, known, session_sd)


def of_logbook(folder: Path) -> ExperimentPlan:
    """Return the plan for the change that `bowden logbook show` states.

    If it states none, the plan is for the newest trial with an ambiguous verdict, and its session's experiments.
    """
    healthy, deviations = logbook_entries.reference_trials(folder)
    with open_logbook(folder) as book:
        change = logbook_entries.change_trials(book)
        if change is not None:
            return of_trials(change.trials, change.references, change.session_sd, book.path or None)
        for entry in book.trials():
            told = book.verdicts(entry.id)
            if told and told[-1].get("verdict") == "ambiguous":
                same = [t for t in book.trials(session=entry.session)
                        if t.there and (t.id == entry.id or t.experiment not in ("", "gait"))]
                return of_trials([book.place(t.path) for t in same], healthy, deviations, book.path or None)
    raise InputError(f"{folder}: states no change, and no verdict of it is ambiguous; bowden diagnose TRIAL "
                     f"--logbook {folder} enters verdicts.")


def of_model(model: Path) -> ExperimentPlan:
    """Plan for a bench model with effects: its bench is simulated without and with them; raises `InputError`."""
    tables = read_toml(model)
    if not tables.get("effects"):
        raise InputError(f"{model}: states no effect; give a model that bowden diagnose -o wrote, or trials.")
    without = {name: value for name, value in tables.items() if name != "effects"}
    with TemporaryDirectory(prefix="bowden-") as folder:
        paths = [Path(folder) / f"{day}.mcap" for day in SIMULATED_DAYS]
        for day, path in zip(SIMULATED_DAYS, paths, strict=True):
            simulate(GAIT, AS_CONFIGURED, path, day=day,
                     plant_model=tables if day == SIMULATED_DAYS[-1] else without)
        return of_trials(paths[-1:], paths[:-1])


def _planned(trials: Sequence[Table], healthy: Sequence[Table], session_sd: Mapping[str, float] | None
             ) -> ExperimentPlan:
    tried = tuple(sorted({t.experiment for t in trials} - {"", "gait"}))
    with threadpool_limits(1, user_api="blas"):
        finder = EvidenceFinder(healthy, session_sd)
        reference = finder.reference(trials)
        walked, given = ([finder.recording(t, reference.outputs) for t in group] for group in (healthy, trials))
        found, pair = search_trial(reference, walked, reference.observe(*given))
        if pair is not None:
            tried = (*tried, REPEAT)
        decided = decision.decide(found)
        experiments = predicted_experiments(found, decided.among, reference, tried, walked)
    return ExperimentPlan(decided.verdict, decided.among, tuple(experiments), tried, _by_hand(decided.among))


def _by_hand(among: Sequence[str]) -> dict[str, str]:
    """Return, by experiment, the work of an operator in experiments that concern an effect of the set."""
    named = [CATALOGUE[name].experiment for name in among]
    return {name: f"{EXPERIMENTS[name].by_hand}; {EXPERIMENTS[name].around}" for name in named
            if EXPERIMENTS[name].by_hand}
