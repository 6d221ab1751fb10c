"""Options of the commands, each declared once."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from parameters import InputError
from physics.effects.separating_experiments import SCRIPTED


def option(help: str, *names: str, **more: Any) -> Any:
    """Declare an option; `names` if they are not those of the parameter."""
    return typer.Option(*names, help=help, **more)


def argument(metavar: str, help: str, **more: Any) -> Any:
    """Declare an argument whose default the help does not show."""
    return typer.Argument(metavar=metavar, help=help, show_default=False, **more)


def _file(help: str, *names: str) -> Any:
    return option(help, *names, metavar="FILE")


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def effects(incomplete: str) -> list[str]:
    """Return the effects of the catalogue, and "any", that begin as typed."""
    from physics.effects.catalogue import CATALOGUE

    return _beginning(("any", *CATALOGUE), incomplete)


def experiments(incomplete: str) -> list[str]:
    """Return the experiments that begin as typed."""
    return _beginning((*SCRIPTED, "repeat"), incomplete)


def controllers(incomplete: str) -> list[str]:
    """Return the installed controllers that begin as typed."""
    from importlib.metadata import entry_points

    return _beginning(sorted(entry.name for entry in entry_points(group="bowden.controllers")), incomplete)


def serials(incomplete: str) -> list[str]:
    """Return the first twenty serials of simulated benches that begin as typed."""
    return _beginning(map(str, range(1, 21)), incomplete)


def declared_paths(incomplete: str) -> list[str]:
    """Return the force paths of ./bench.toml that begin as typed; none without a declaration that can be read."""
    from bowden.bench import configuration

    try:
        bench = configuration.read(Path("bench.toml"), any_shape=True)["network"].bench
    except InputError:
        return []
    return _beginning((path.name for path in bench.force_paths), incomplete)


Output = Annotated[Path, _file("File to write.", "-o", "--output")]
Overwrite = Annotated[bool, option("Replace an existing output file.", "--overwrite")]
Json = Annotated[bool, option("JSON on stdout, nothing else.", "--json")]
Config = Annotated[Path | None, _file("bench.toml; bowden init writes one.", "--config")]
Picture = Annotated[Path | None, _file("Draw desired, START and END force (png, svg, pdf).")]

Logbook = Annotated[Path | None, option(
    "Logbook to enter it in (default: [record] logbook of the configuration).", metavar="DIR")]
Session = Annotated[str | None, option(
    "Session of the logbook (default: the date; simulated: the day).", metavar="LABEL")]

Watched = Annotated[bool, option("Diagnose while it runs, by gait cycle; needs --healthy or a logbook.", "--watch")]
Healthy = Annotated[list[Path] | None, option("Reference trial of the healthy bench; repeatable.", metavar="TRIAL")]
StopOn = Annotated[list[str] | None, option(
    "With --watch: safe stop if this effect, or any, costs 2 % of the peak; repeatable.", metavar="EFFECT",
    autocompletion=effects)]

Peak = Annotated[float | None, option("Peak of the desired force, N (default 40).", metavar="N")]
Period = Annotated[float | None, option("Gait period, s (default 2.0, or the knee file's stride).", metavar="S")]
Cycles = Annotated[int | None, option("Gait cycles to run (default 10).", metavar="COUNT")]
Settle = Annotated[int | None, option("First cycles left out of every figure (default 1).", metavar="COUNT")]
SoftStart = Annotated[int | None, option("Gait cycles before the first, over which the peak rises (default 0).",
                                         "--soft-start", metavar="COUNT")]
Rate = Annotated[int | None, option("Control cycles per second, Hz (default 1000).", metavar="HZ")]
Controller = Annotated[str | None, option(
    "paper, none, friction, impedance, extended or module:Class (paper).", metavar="NAME", autocompletion=controllers)]
Tuning = Annotated[list[str] | None, option(
    "A parameter that the controller declares; repeatable.", "--set", metavar="NAME=VALUE")]
Knee = Annotated[Path | None, _file("Knee motion, CSV of time_s, knee_angle_rad or gait_percent, knee_angle_deg.")]
Strides = Annotated[int | None, option(
    "Strides of --knee FILE to play in random order, varied, by --seed.", metavar="COUNT")]
Stumbles = Annotated[int | None, option("Strides in which the wearer stumbles (default 0).", metavar="COUNT")]
Stops = Annotated[int | None, option("Times that the wearer stops and goes on (default 0).", metavar="COUNT")]
Sits = Annotated[int | None, option("Times that the wearer sits down and goes on (default 0).", metavar="COUNT")]
Phase = Annotated[str | None, option(
    "What the force follows: clock, or felt, from the knee alone (default with --strides).", metavar="NAME")]
Desired = Annotated[Path | None, _file(
    "Desired force, CSV of time_s or gait_percent and desired_force_n, or by knee_angle_deg, too; or module:function.")]
Calibration = Annotated[Path | None, _file("Bench model to work from (default: the packaged nominal one).")]
Script = Annotated[str | None, option(
    f"Experiment in place of the gait, to separate effects: {', '.join(SCRIPTED)}; or repeat, with --motion-of.",
    "--experiment", metavar="NAME", autocompletion=experiments)]
MotionOf = Annotated[Path | None, _file(
    "Repeat the rope and knee motion of this recorded trial, with its gait and settings (--experiment repeat).",
    "--motion-of")]
ControllerModel = Annotated[Path | None, _file("Bench model whose effects the controller compensates.")]
DryRun = Annotated[bool, option("Everything on the bus, drives never enabled.", "--dry-run")]

Serial = Annotated[int | None, option(
    "Simulated bench: its serial number (default 1).", metavar="NUMBER", autocompletion=serials)]
Day = Annotated[int | None, option("Simulated bench: number of the session (default 0).", metavar="NUMBER")]
Seed = Annotated[int | None, option("Simulated bench: seed of the noise (default 0).", metavar="NUMBER")]
Plant = Annotated[str | None, option("Simulated bench: its plant (default bowden).", metavar="NAME")]
PlantModel = Annotated[Path | None, _file("Simulated bench: bench model or plant tables, TOML.")]
SafetyMonitor = Annotated[str | None, option(
    "Safety monitor with the bounds in this file, or packaged (default: [monitor]).", metavar="FILE")]
Interface = Annotated[str | None, option(
    "python-can interface of a real bus (default: the virtual bus).", metavar="NAME")]
Channel = Annotated[str | None, option("Channel of that interface, such as can0.", metavar="NAME")]
Bitrate = Annotated[int | None, option("bit/s; default from [network].", metavar="BIT/S")]
AnyInterface = Annotated[str, option(
    "python-can interface, such as socketcan, udp_multicast or virtual.", metavar="NAME")]
Seconds = Annotated[float | None, option("End after so many seconds.", "--for", metavar="S")]
Lowpass = Annotated[float | None, option("Zero-phase low-pass on every signal.", metavar="HZ")]
Trial = Annotated[Path, argument("TRIAL", "A recorded trial.")]
RaiseLimits = Annotated[str | None, option(
    "Run with limits above the packaged ones; the trial records the reason.", "--raise-limits", metavar="REASON")]
HomingForce = Annotated[float | None, option(
    "START tension that homing may reach whatever the peak is (default 12).", "--homing-n", metavar="N")]
Extra = Annotated[list[str] | None, option("Interface option; repeatable.", "--option", metavar="K=V")]
ForcePath = Annotated[str | None, option(
    "Force path of a bench of several, or joint of an arm.", "--path", metavar="NAME", autocompletion=declared_paths)]
