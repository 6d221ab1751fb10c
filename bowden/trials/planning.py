"""Expected result of an experiment: a run on the nominal simulated bench, examined as a trial would be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from parameters import InputError

if TYPE_CHECKING:
    from diagnosis.evidence.planned_limits import Plan

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
    from diagnosis.evidence.planned_limits import plan as planned
    from estimation.data import table as data
    from parameters import read_toml

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
    from bowden.bench import buses, configuration
    from bowden.trials import session

    sections = configuration.read(None)
    gait = configuration.override(sections["gait"], {
        "peak_n": ("--peak", walk.peak_n), "period_s": ("--period", walk.period_s), "cycles": ("--cycles", walk.cycles),
        "settle": ("--settle", 0)})
    reference, sections["gait"], _ = session.reference(
        gait, None, None, period_given=True, peak_given=walk.peak_n is not None)
    sensor = {"noise_n": walk.noise_n}
    noisy = plant_model if walk.noise_n is None else {"start_sensor": sensor, "end_sensor": sensor}
    script = None if name == GAIT else name
    prepared = session.prepare(
        sections, reference, None, buses.simulated(serial=0, day=day, plant_model=noisy), dry_run=False, script=script)
    result = session.perform(prepared, recorded)
    if result["outcome"] != "completed":
        raise InputError(f"--plan {name}: the simulated trial stopped ({result['stop_reason']}); ask for less.")
