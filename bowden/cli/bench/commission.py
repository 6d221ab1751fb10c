"""`bowden home`, `tare`, `jog`, `release`, `acknowledge`: a bench before and between trials."""

from __future__ import annotations

import math
from typing import Annotated

from bowden.bench import buses, configuration
from bowden.cli import ending, options, terminal
from bowden.cli.app import app
from bowden.cli.options import Bus, argument, option
from bowden.cli.terminal import AnswerTable, CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.trials import setup_checks
    from eds.bench.bench_network import wire
    from master.motion import commission
    from master.motion.commission import Procedure
    from master.network import acknowledge as acknowledging
    from master.network import bringup, link
    from master.own_limits import of_path
    from master.settings import Limits
    from physics.calibration import nominal, read

Sensor = Annotated[str, argument("SENSOR", "start, end, or a declared load cell.")]
Axis = Annotated[str, argument("AXIS", "servo or knee, or a declared drive.")]
By = Annotated[float, option("mm of rope (pulling > 0) or degrees of knee (flexion < 0).", metavar="X")]
Speed = Annotated[float, option("mm/s or degrees/s at most (default 10).", metavar="V", show_default=False)]
SPEED = 10.0
REMEDY = "free the emergency stop (STO) first, then say this again"


@app.command()
def home(
    calibration: options.Calibration = None, rate: options.Rate = None, path: options.ForcePath = None,
    homing_n: options.HomingForce = None, *, reached: Bus,
) -> CommandAnswer:
    """Find the encoder zero at the preload.

    The rope is left slack.

    Example: bowden home --interface socketcan --channel can0
    """
    bench = _Bench(reached, rate, path)
    measured = nominal() if calibration is None else read(calibration)
    homing = configuration.homing(bench.sections["homing"], homing_n)
    return bench.perform("home", commission.home(measured, homing, bench.sections["gait"].idle_slack_m),
                         pulls=commission.home_pulls(homing))


@app.command()
def tare(
    sensor: Sensor, rate: options.Rate = None, path: options.ForcePath = None, *, reached: Bus,
) -> CommandAnswer:
    """Zero a tension sensor.

    The rope must be slack, and no drive is enabled.

    Example: bowden tare start --interface socketcan --channel can0
    """
    bench = _Bench(reached, rate, path)
    return bench.perform(f"tare {sensor}", commission.tare(bench.place(sensor)))


@app.command()
def jog(
    axis: Axis, by: By, speed: Speed = SPEED, rate: options.Rate = None, path: options.ForcePath = None, *,
    reached: Bus,
) -> CommandAnswer:
    """Move one axis slowly, alone; the other drive stays off.

    Example: bowden jog servo --by -2 --speed 5 --interface socketcan --channel can0
    """
    bench = _Bench(reached, rate, path)
    place = bench.place(axis)
    unit = math.radians(1.0) if place == "knee" else 1e-3
    limits = bench.limits()
    return bench.perform(f"jog {axis}", commission.jog(place, by * unit, speed * unit, limits),
                         pulls=commission.jog_pulls(limits))


@app.command()
def release(rate: options.Rate = None, path: options.ForcePath = None, *, reached: Bus) -> CommandAnswer:
    """Take the tension off.

    The servo alone unwinds the rope until START is slack.

    Example: bowden release --interface socketcan --channel can0
    """
    bench = _Bench(reached, rate, path)
    return bench.perform("release", commission.release(bench.sections["homing"], bench.limits()))


class _Bench:
    """The bench that the options name: its bus, its configuration and a force path."""

    def __init__(self, reached: Bus, rate: int | None, path: str | None) -> None:
        self.sections = reached.sections(rate)
        self.chosen, self.path = reached.chosen(), path

    def place(self, name: str) -> str:
        """Return the role of a declared device on its force path: servo, knee, start or end; else the name itself.

        If one path alone has the device, that path is chosen.
        """
        bench = self.sections["network"].bench
        joints = {joint.name: joint.driven_by for joint in bench.joints}
        places = [(one.name, place) for one in bench.force_paths for place, device in (
            ("servo", one.actuator), ("knee", joints.get(one.joint, "")), ("start", one.start), ("end", one.end))
            if device and device == name and self.path in (None, one.name)]
        if len(places) == 1 and self.path is None:
            self.path = places[0][0]
        return places[0][1] if places else name

    def limits(self) -> Limits:
        """Return the limits of the force path; raises `InputError` for a path that is missing or not declared."""
        bench = self.sections["network"].bench
        return of_path(self.sections["limits"], bench, setup_checks.named(bench, self.path))

    def perform(self, what: str, procedure: Procedure, *, pulls: str = "") -> CommandAnswer:
        """Run one procedure and return its result; `pulls` is the largest force that it may pull, as a sentence."""
        if pulls and not terminal.quiet():
            terminal.remark(pulls)
        with terminal.waiting(what):
            outcome, found = setup_checks.perform(self.chosen, self.sections, procedure, self.path)
        result = {"procedure": what, "outcome": "completed" if outcome.reason is None else "stopped",
                  "stop_reason": outcome.reason, "missed_cycles": outcome.missed_cycles, **found}

        return CommandAnswer(result, [
            *([AnswerTable(what, ("figure", "value"), [
                (name, terminal.number(value, 4)) for name, value in found.items()])] if found else []),
            f"{what}, {self.chosen.in_words}: {result['outcome']}"
            + (f": {outcome.reason}" if outcome.reason else "."),
        ], ending.status_of(str(result["outcome"]), outcome.reason))


@app.command()
def acknowledge(reached: Bus) -> CommandAnswer:
    """Release drives after an emergency stop.

    A drive that had its emergency stop (STO) stays off until an operator releases it; nothing is enabled by this.

    Example: bowden acknowledge --interface socketcan --channel can0
    """
    network = reached.network()
    with buses.opened_one(reached.chosen(), network.bitrate) as opened:
        try:
            silent = link.Link(opened, buses.clock_of(opened), heartbeat_ms=None)
            found = acknowledging.acknowledge(silent, wire(network))
        except (bringup.BringUpError, link.LinkError) as error:
            raise InputError(str(error)) from None
    active = [one for one in found if one.became == "still active"]
    return CommandAnswer({one.drive: one.became for one in found}, [
        f"{one.drive}: {one.became}" + (f"; {REMEDY}." if one in active else ".") for one in found],
        1 if active else 0)
