"""`bowden check bench`: load cells against a known weight, the knee against a goniometer."""

import datetime
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.bench.setup import check
from bowden.cli.option_groups import Bus, SimulatedOptions
from bowden.cli.terminal import CommandAnswer
from parameters import InputError

if TYPE_CHECKING:
    pass

Checked = Annotated[Path, typer.Option("--calibration", metavar="FILE", help="Calibration to enter the checks in.")]
Weight = Annotated[float | None, typer.Option(metavar="N", help="Known weight on this load cell, N; at least 10.")]
Angle = Annotated[list[float] | None, typer.Option(
    metavar="DEG", help="Knee angle by a goniometer, degrees (flexion < 0); twice, at least 40 apart.")]


@check.command("bench")
def check_bench(
    calibration: Checked, start: Weight = None, end: Weight = None, knee: Angle = None,
    path: options.ForcePath = None, *, simulated: SimulatedOptions, reached: Bus,
) -> CommandAnswer:
    """Compare load cells with a known weight and the knee with a goniometer.

    No drive is enabled. On hardware it asks for each weight and angle in turn; on the simulated bench a hand supplies
    them. A trial with a limb declared ([record] limb) needs these checks, no older than a day.

    Example: bowden check bench --calibration calibration.toml --start 20 --end 20 --knee 0 --knee -60
    """
    from bowden.bench import buses
    from bowden.trials import commissioning, setup_checks
    from master.motion import commission
    from physics.setup_check import LEAST_N, SetupCheck, read

    asked = [(of, weight, "N") for of, weight in (("start", start), ("end", end)) if weight is not None]
    for of, weight, _ in asked:
        if not LEAST_N <= weight <= 300.0:
            raise InputError(f"--{of} {weight:g}: expected a weight from {LEAST_N:g} to 300 N; give another one.")
    asked += [("knee", math.radians(angle), "rad") for angle in knee or ()]
    if not asked:
        raise InputError("check bench: no weight and no angle is given; name some of --start, --end and --knee.")
    read(calibration)
    sections, chosen = reached.sections(), reached.chosen(simulated)
    made: list[SetupCheck] = []
    for of, reference, unit in asked:
        shown = f"{reference:g} N on {of}" if unit == "N" else f"{of} at {math.degrees(reference):g} degrees"
        if not chosen.simulated and sys.stdin.isatty():
            typer.prompt(f"{shown}, then Enter", default="", show_default=False, err=True)
        with terminal.waiting(f"reading {of}"):
            outcome, found = commissioning.perform(
                buses.handled(chosen, **{f"{of}_{'n' if unit == 'N' else 'rad'}": reference}), sections,
                commission.reading(of), path)
        if outcome.reason is not None:
            raise InputError(f"{shown}: the reading was stopped ({outcome.reason}); nothing was written.")
        made.append(SetupCheck(of, reference, found["reading"], unit,
                               datetime.datetime.now().isoformat(timespec="minutes")))
    setup_checks.enter(calibration, made)
    return CommandAnswer(
        {"calibration": str(calibration), "checks": [
            {"of": one.of, "reference": one.reference, "reading": one.reading, "deviation": one.deviation,
             "tolerance": one.tolerance, "unit": one.unit, "passed": one.passed, "date": one.date} for one in made]},
        [*(f"{'ok ' if one.passed else 'BAD'} {one.in_words()}" for one in made), f"Entered in {calibration}."],
        0 if all(one.passed for one in made) else 1)
