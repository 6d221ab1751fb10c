"""False alarms of a control cycle's checks in healthy trials: `python -m benchmarks.supervision`.

`--healthy N` runs N trials over serials,
days, peaks, periods, rates and controllers.  Half of them are on the bench's own plant, a quarter on the structures
of `tests/hidden`, a quarter on the family of `tests/plants`.  It prints how many were stopped, by which check, and how
near to its tolerance each relation came.  All start from the packaged calibration, which is another bench's.  One that
homing refuses before it moves, or that is stopped, is identified and run again, and counts by that second trial.  One
that the monitor stops even then runs once more with bounds from another session of the bench.  The numbers of those
that were stopped are printed.  `--kept FILE` keeps each trial as a line of JSON: trials that are in it
are not run again, and an interrupted run goes on.  `--page` writes the table of the checks into docs/safety.md,
with the largest share of each bound from docs/healthy.csv (`make healthy`).

Two bounds of the false-alarm rate are printed, each the upper end of a 95 % interval: by count (no model; a run without
an alarm shows 3.0 by its hours), and by the tail of the greatest share of a tolerance that each trial reached (a Pareto
law through the upper tenth, Hill's estimate of its exponent).
"""

import argparse
import csv
import dataclasses
import json
import math
import multiprocessing
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import safety_monitor
from benchmarks.frame import DOCS, put
from bowden.bench import buses, monitor_bounds
from bowden.models import identification
from eds.bench.bench_network import Network
from master import settings
from master.cycle import exchange, plausibility, repetition
from master.cycle.safety import Reaction
from master.motion import experiment_run
from master.motion.checks import CHECKS
from master.network.link import Link
from physics.calibration import nominal
from physics.reference import paper_reference
from tests.plants import stack
from trial.record import Recorder
from virtual_bus.bus import BowdenBus

SHORT = {Reaction.UNWIND: "unwind", Reaction.RELEASE: "servo off", Reaction.RELEASE_BOTH: "both off",
         Reaction.ABANDON: "0x6007"}
"""Words of a reaction in the table."""


def table() -> str:
    """Return the lines of the table."""
    with (DOCS / "healthy.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["check"]: row for row in csv.DictReader(file)}
    trials = max(row["trials"] for row in rows.values())
    lines = [f"| check | signals | bound | bound from | reaction | most of {trials} healthy trials | test |",
             "|---|---|---|---|---|---|---|"]
    lines += [f"| {check.name} | {check.signals} | {check.bound} | {check.source} | {SHORT[check.reaction]} | "
              f"{rows[check.healthy]['share'] if check.healthy else '–'} | `{check.test}` |" for check in CHECKS]
    return "\n".join(lines)


PEAKS, PERIODS, CYCLES = (40.0, 60.0, 25.0, 75.0), (1.1, 2.0, 0.8, 3.0), 4
FAMILY_PEAKS = (40.0, 50.0, 25.0)
"""Peaks that the START tension of every bench of the family allows (`tests.plants.draws.MOST_START_N`, at 60 N)."""
DAYS = 3
REFUSED = "identify this bench"
"""Words of a refusal before the bench moves."""
CONTROLLERS = ("paper", "extended", "none", "friction", "impedance")
NAMES = ("servo", "knee", "ratio", "force", "start", "end", "still START", "still END", "still servo", "still knee",
         "START", "END")
COMPARED = ("desired", "first cycle", "second cycle", "rope, first cycle", "rope, second cycle")
LEAST_TAIL = 20
"""Healthy trials from which the tail of their shares is fitted: two lie in its largest tenth."""


class Job(NamedTuple):
    """One healthy trial."""

    number: int
    bench: dict[str, Any]
    peak_n: float
    period_s: float
    controller: str
    rate_hz: int
    cycles: int
    monitored: bool = True


class Ended(NamedTuple):
    """End of a trial, greatest normalised residual of each relation, and the end by the packaged calibration.

    `packaged`: why the bench had to be identified and run again; None if it had not.  `monitored`: whether a safety
    monitor watched it.  `person`: why bounds of the person's file had to be set from a trial of the bench, and which;
    None if they had not.
    `trial_s`: its length from the silent bus to the end, s; `gait_s`: that of its gait cycles.
    """

    number: int
    reason: str | None
    ratios: list[float]
    packaged: str | None
    compared: list[float]
    trial_s: float
    gait_s: float
    monitored: bool = False
    person: str | None = None


def jobs(count: int, cycles: int) -> Iterator[Job]:
    """Draw the trials: own plant, a structure of `tests/hidden`, own plant, a bench of the family, and so on."""
    for n in range(count):
        bench: dict[str, Any] = {"seed": n}
        peak = PEAKS[n // 2 % 4]
        if n % 4 == 1:
            bench |= {"serial": 0, "plant": "tests.hidden.plugin:healthy"}
        elif n % 4 == 3:
            bench |= family(n // 4)
            peak = FAMILY_PEAKS[n // 4 % 3]
        else:
            bench |= {"serial": n // 2, "day": n // 2 % 9}
        rate = 1000 if n % 10 else (500, 200)[n // 10 % 2]
        yield Job(n, bench, peak, PERIODS[n // 3 % 4], CONTROLLERS[n % 5], rate, cycles)


def family(place: int, day: int | None = None) -> dict[str, Any]:
    """Return the bus options of bench number `place` of the family; serials that are set aside are not counted."""
    serial = place // 2 * 3 + place % 2
    return {"serial": 0, "plant": stack.plant_name(serial, place % DAYS if day is None else day),
            "plant_model": stack.plant_model(serial)}


def identified(job: Job) -> Any:
    """Identify the job's bench on its day 0 and return the calibration."""
    bench = job.bench | (family(job.number // 4, 0) if job.number % 4 == 3 else {"day": 0})
    sections = {"network": Network(), "limits": settings.Limits(), "homing": settings.Homing()}
    chosen = buses.simulated(bench["serial"], bench.get("day", 0), job.number,
                             plant=bench.get("plant", buses.VIRTUAL), plant_model=bench.get("plant_model"),
                             channel=f"identify-{job.number}")
    with tempfile.TemporaryDirectory() as folder:
        (found,) = identification.perform("all", sections, None, chosen, Path(folder, "all.mcap"), date="")
    if found.calibration is None:
        raise StoppedError(found.reason)
    return found.calibration


class StoppedError(Exception):
    """An identification was stopped, for this reason."""


def ran(job: Job) -> Ended:
    """Run one trial; where it is refused or stopped by the packaged calibration, identify and run again.

    Where the monitor stops that trial, set the bounds that are the bench's from another session of it and run again.
    """
    ended = walked(job, nominal())
    if ended.reason is None:
        return ended
    packaged = ended.reason
    try:
        calibration = identified(job)
    except StoppedError as error:
        return ended._replace(reason=f"identification: {error}", packaged=packaged)
    ended = walked(job, calibration)._replace(packaged=packaged)
    if not opened(ended.reason):
        return ended
    with tempfile.TemporaryDirectory() as folder:
        bounds, person = of_bench(job, calibration, Path(folder))
        told = ", ".join(f"{bound.key} {bound.after:.3g}" for bound in bounds if bound.after > bound.before)
        return walked(job, calibration, person)._replace(packaged=packaged, person=f"{ended.reason}; set: {told}")


def of_bench(job: Job, calibration: Any, folder: Path) -> tuple[list[monitor_bounds.BenchBound], Path]:
    """Return the bounds by `bowden monitor-bounds` from a trial of another session of the job's bench, and their file.
    """
    place = job.number // 4
    other = family(place, (place + 1) % DAYS) if job.number % 4 == 3 else {"day": job.bench.get("day", 0) + 1}
    recording, person = folder / "bench.mcap", folder / "P.toml"
    walked(job._replace(bench=job.bench | other, monitored=False), calibration, recording=recording)
    bounds, text = monitor_bounds.of_trials([recording], person_of(job.peak_n, job.period_s, folder))
    person.write_text(text, encoding="utf-8")
    return bounds, person


def walked(job: Job, calibration: Any, person: Path | None = None, recording: Path | None = None) -> Ended:
    """Run one trial, under a safety monitor if it has one, without a recorder unless it is to be recorded.

    `person`: the person's file in place of the packaged one for the job's peak and period.
    No monitor socket drains the bus: it would only cost time, and the master counts targets as sent by its own record.
    """
    worst, limits = np.zeros(len(NAMES)), settings.Limits()

    class Watched(plausibility.Plausibility):
        def check(self, *given: Any, **named: Any) -> Any:
            found = super().check(*given, **named)
            ratios = self.s[plausibility.RATIOS:plausibility.RATIOS + plausibility.RELATIONS]
            np.maximum(worst, [*np.abs(ratios), given[5] / limits.start_n, given[6] / limits.end_n], out=worst)
            return found

    exchange.Plausibility = Watched  # type: ignore[misc]
    watches = []

    class Kept(repetition.Repetition):
        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(*given, **named)
            watches.append(self)

    experiment_run.Repetition = Kept  # type: ignore[misc]
    with tempfile.TemporaryDirectory() as folder:
        person = person or person_of(job.peak_n, job.period_s, Path(folder))
        monitor = {"monitor": str(person)} if job.monitored else {}
        bus = BowdenBus(f"healthy-{job.number}", rate_hz=job.rate_hz, **monitor, **job.bench)
    asked = experiment_run.ExperimentSetup(
        paper_reference(job.peak_n, job.period_s), network=Network(rate_hz=job.rate_hz),
        calibration=calibration,
        gait=settings.Gait(
            peak_n=job.peak_n, period_s=job.period_s, cycles=job.cycles, settle=0, controller=job.controller))
    recorder = None if recording is None else Recorder(recording, metadata={}, attachments={}, threaded=False)
    result = experiment_run.run(Link(bus, bus.time_ns), None, recorder, asked)
    bus.shutdown()
    if recorder is not None:
        recorder.close(dataclasses.asdict(result))
    return Ended(job.number, result.stop_reason, worst.tolist(), None, list(watches[-1].shares) if watches else [],
                 result.duration_s, job.cycles * job.period_s, job.monitored)


def person_of(peak_n: float, period_s: float, folder: Path) -> Path:
    """Write the packaged person's file with bounds scaled to another gait: forces by the peak, speeds by the period."""
    by = peak_n / 40.0
    text = safety_monitor.packaged().read_text(encoding="utf-8")
    for key, factor in {"start_n": by, "end_n": by, "force_rate_n_s": max(1.0, by) * max(1.0, 1.1 / period_s),
                        # the rope's speed counts with its acceleration, which grows with the square
                        "rope_m_s": max(1.0, by) * max(1.0, 1.1 / period_s) ** 2,
                        "knee_deg_s": max(1.0, 1.1 / period_s)}.items():
        top = safety_monitor.person.RANGES[key][2]
        text = re.sub(rf"(?m)^{key} = ([\d.]+)",
                      lambda m, key=key, factor=factor, top=top:
                      f"{key} = {min(top, factor * float(m[1])):.3g}", text)
    path = folder / f"person-{peak_n:g}-{period_s:g}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def write(path: Path, whole: list[Ended]) -> None:
    """Write the largest share of its bound that each check reached, and in how many trials, as a table file."""
    shares = [*np.max([ended.ratios for ended in whole], axis=0), *np.max([ended.compared for ended in whole], axis=0)]
    lines = [f'"{name}",{share:.2f},{len(whole)}' for name, share in zip((*NAMES, *COMPARED), shares, strict=True)]
    path.write_text("\n".join(["check,share,trials", *lines, ""]), encoding="utf-8")


def healthy(count: int, first: int, workers: int, cycles: int, monitored: int,
            kept: Path | None, table: Path | None = None) -> int:
    """Run `count` trials from number `first` on that `kept` lacks, print what all raised; returns how many stopped.

    Trials before number `monitored` have a safety monitor, with which they take three times as long.
    """
    drawn = {job.number: job._replace(monitored=job.number < monitored)
             for job in jobs(first + count, cycles) if job.number >= first}
    lines = kept.read_text(encoding="utf-8").splitlines() if kept is not None and kept.exists() else []
    found = {ended.number: ended for ended in sorted((Ended(**json.loads(line)) for line in lines),
                                                     key=lambda ended: ended.monitored)}
    told = [ended for ended in found.values()
            if ended.number in drawn and ended.monitored >= drawn[ended.number].monitored]
    left = [job for job in drawn.values() if job.number not in {ended.number for ended in told}]
    with multiprocessing.get_context("fork").Pool(workers) as pool:
        for ended in pool.imap_unordered(ran, left):
            told.append(ended)
            if kept is not None:
                with kept.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(ended._asdict()) + "\n")
            if ended.reason is not None:
                print(f"{drawn[ended.number]}: {ended.reason}", file=sys.stderr, flush=True)
            if len(told) % 10 == 0:
                print(f"{len(told)} of {len(drawn)}, {sum(e.reason is not None for e in told)} stopped, "
                      f"{sum(e.packaged is not None for e in told)} identified", file=sys.stderr, flush=True)
    show(told)
    if table is not None:
        write(table, [ended for ended in told if ended.reason is None])
    return sum(ended.reason is not None for ended in told)


def show(told: list[Ended]) -> None:
    """Print what healthy trials raised, how near they came, and what that bounds."""
    stopped = [ended for ended in told if ended.reason is not None]
    whole = [ended for ended in told if ended.reason is None]
    refused = [ended.number for ended in told if ended.packaged is not None and REFUSED in ended.packaged]
    again = [ended.number for ended in told if ended.packaged is not None and REFUSED not in ended.packaged]
    print(f"{len(told)} healthy trials, {len(stopped)} stopped; by the packaged calibration {len(refused)} benches "
          f"were refused and {len(again)} stopped {again}, then identified")
    print(f"{sum(ended.monitored for ended in told)} of them had a safety monitor, which opened its line in "
          f"{sum(map(opened, (ended.reason for ended in told)))}; by the packaged calibration in "
          f"{sum(map(opened, (ended.packaged for ended in told)))}")
    for ended in told:
        if ended.person is not None:
            print(f"  {ended.number}, by the packaged bounds: {ended.person}")
    for reason, often in Counter(ended.reason for ended in stopped).most_common(20):
        numbers = [ended.number for ended in stopped if ended.reason == reason]
        print(f"  {often} × {reason} {numbers[:6]}")
    if not whole:
        return
    ratios = np.array([ended.ratios for ended in whole])
    print("greatest residual by its tolerance, single cycles among them (a stop needs two in a row): " + ", ".join(
        f"{name} {value:.2f}" for name, value in zip(NAMES, ratios.max(axis=0), strict=True)))
    shares = np.array([ended.compared for ended in whole])
    print("greatest departure of a gait cycle by its tolerance: " + ", ".join(
        f"{name} {value:.2f}" for name, value in zip(COMPARED, shares.max(axis=0), strict=True)))
    hours = sum(ended.trial_s for ended in told) / 3600.0
    gait = sum(ended.gait_s for ended in told) / 3600.0
    most = most_alarms(len(stopped))
    print(f"{hours:.2f} trial hours, {gait:.2f} of them gait; by count at most one false alarm in {hours / most:.2g} "
          f"trial hours, one in {len(told) / most:.3g} trials (95 %)")
    if len(shares) < LEAST_TAIL:
        return
    share, exponent, high = tail(shares.max(axis=1))
    print(f"by the tail of the comparisons of gait cycles: one in {1.0 / share:.3g} trials, at most one in "
          f"{1.0 / high:.3g} (95 %; exponent {exponent:.1f})")


def opened(reason: str | None) -> bool:
    """Return whether a stop is one by the safety monitor: its own EMCY, or that of a drive whose line it opened."""
    return reason is not None and ("(STO)" in reason or "0xFF1" in reason)


def most_alarms(seen: int) -> float:
    """Return the upper end of the one-sided 95 % interval of a Poisson mean of which `seen` were counted."""
    from scipy.stats import chi2

    return float(0.5 * chi2.ppf(0.95, 2 * (seen + 1)))


def tail(greatest: Any) -> tuple[float, float, float]:
    """Return the probability that a trial's greatest share passes 1, the exponent, and the probability's upper end."""
    ordered = np.sort(greatest)[::-1]
    count = max(2, len(ordered) // 10)
    exponent = 1.0 / float(np.mean(np.log(ordered[:count] / ordered[count])))

    def beyond(power: float) -> float:
        return count / len(ordered) * float(ordered[count]) ** power

    return beyond(exponent), exponent, beyond(exponent * (1.0 - 1.645 / math.sqrt(count)))


def main() -> int:
    """Run the measurements that the arguments name."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--healthy", type=int, default=500, metavar="N")
    asked.add_argument("--first", type=int, default=0, help="number of the first trial; trials are drawn by number")
    asked.add_argument("--cycles", type=int, default=CYCLES)
    asked.add_argument("--monitored", type=int, default=0, metavar="N", help="the first N trials have a safety monitor")
    asked.add_argument("--kept", type=Path)
    asked.add_argument("--table", type=Path, help="table file of the largest share of each check")
    asked.add_argument("--jobs", type=int, default=2)
    asked.add_argument("--page", action="store_true", help="write the table of the checks into docs/safety.md")
    given = asked.parse_args()
    if given.page:
        put(DOCS / "safety.md", "checks", table())
        return 0
    return int(bool(healthy(
        given.healthy, given.first, given.jobs, given.cycles, given.monitored, given.kept, given.table)))


if __name__ == "__main__":
    sys.exit(main())
