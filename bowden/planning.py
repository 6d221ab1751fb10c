"""What an experiment would show: it is run on the nominal simulated bench, then looked at as a trial would be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from parameters import InputError

if TYPE_CHECKING:
    from diagnosis.judgement.plan import Plan

GAIT = "gait"


def plan(name: str, asked: Mapping[str, Any], calibration: Path | None, healthy: Sequence[Path]) -> Plan:
    """Simulate the experiment `name` and say what it would show; `asked` are options by their names, None: default."""
    from diagnosis.data import table as data
    from diagnosis.judgement.plan import plan as planned
    from parameters import read_toml

    with TemporaryDirectory(prefix="bowden-") as folder:
        recorded = Path(folder) / f"{name}.mcap"
        simulate(name, asked, recorded)
        table = data.read(recorded)
    known = None if calibration is None else read_toml(calibration)
    return planned(table, [data.read(path) for path in healthy], known)


def simulate(name: str, asked: Mapping[str, Any], recorded: Path) -> None:
    """Run the experiment on the nominal bench, its sensors as noisy as asked for."""
    from bowden import configuration, session
    from bowden.cli.option_groups import Bus, Simulated, Walk

    sections = configuration.read(None)
    gait = Walk(asked["--peak"], asked["--period"], asked["--cycles"]).gait(sections["gait"])
    gait = configuration.override(gait, {"settle": ("--settle", 0)})
    reference, sections["gait"], _ = session.reference(
        gait, None, None, period_given=True, peak_given=asked["--peak"] is not None)
    chosen = Bus().chosen(Simulated(serial=0))
    noise = asked["--noise"]
    if noise is not None:
        sensor = {"noise_n": noise}
        chosen.arguments["plant_model"] = {"start_sensor": sensor, "end_sensor": sensor}
    script = None if name == GAIT else name
    prepared = session.prepare(sections, reference, None, chosen, dry_run=False, script=script)
    result = session.perform(prepared, recorded, None, overwrite=False, quiet=True)
    if result["outcome"] != "completed":
        raise InputError(f"--plan {name}: the simulated trial stopped ({result['stop_reason']}); ask for less.")
