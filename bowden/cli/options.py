"""Command-line options that several commands share, each declared once, and the decorator that gives them to a command.

- A group, such as `WalkOptions`, is a named tuple of options. A command takes it as one parameter and calls its method,
  which returns the table of the configuration with the options of the command line in it.
- `new_file` declares an option that names a file to write.
- `grouped` wraps a command function for Typer. It replaces each group by its single options, adds --json, and adds
  --overwrite where a file is written. Before the command it refuses unusable output files; after it, it prints the
  answer.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial, wraps
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_type_hints

import typer

from bowden import output_files
from bowden.bench import buses, configuration
from bowden.bench.configuration import drawn, override
from bowden.cli.terminal import CommandAnswer, answered
from bowden.deferred import on_first_use
from parameters import InputError
from physics.effects.separating_experiments import SCRIPTED

with on_first_use():
    from bowden.bench.any_node import linked
    from bowden.models import logbook_entries
    from bowden.watch.file_watch import WatchedBench, refuse_stop_on
    from master.network.doctor import other_master
    from master.network.link import Link
    from physics.effects import catalogue


T = TypeVar("T")


def option(help: str, metavar: str | None = None, *names: str, **more: Any) -> Any:
    """Declare an option; `names` if they are not those of the parameter; without a `metavar` it is a flag."""
    return typer.Option(*names, help=help, metavar=metavar, **more)


def argument(metavar: str, help: str, **more: Any) -> Any:
    """Declare an argument whose default the help does not show."""
    return typer.Argument(metavar=metavar, help=help, show_default=False, **more)


def _file(help: str, *names: str) -> Any:
    return option(help, "FILE", *names)


def new_file(help: str = "File to write.", content: str = "", *endings: str, name: str = "--output") -> Any:
    """Declare an option for a file to write; `grouped` checks the file before the command begins.

    `content`: of the file, as an error sentence names it; `endings` that it may have, any without.
    """
    declared = _file(help, *(("-o", name) if name == "--output" else (name,)))
    declared.output_file = (content, endings)
    return declared


def parsed(option: str, text: str, sentence: str, read: Callable[[str], T]) -> T:
    """Return `read(text)`, the value of an option; raises `InputError` with `sentence` if `read` fails."""
    try:
        return read(text)
    except InputError:
        raise
    except (ValueError, KeyError):
        raise InputError(f"{option} {text}: {sentence}.") from None


def keyed(option: str, texts: Iterable[str] | None, expected: str, read: Callable[[str, str], T]) -> list[T]:
    """Return `read(key, value)` of each KEY=VALUE that a repeatable option was given; raises as `parsed`."""
    def pair(text: str) -> T:
        key, value = text.split("=", 1)
        return read(key, value)

    return [parsed(option, text, f"expected {expected}", pair) for text in texts or ()]


def below(limit: int, number: int) -> int:
    """Return a number from 0 to less than `limit`; raises ValueError for another one."""
    if not 0 <= number < limit:
        raise ValueError
    return number


def refuse_given(given: Mapping[str, Any], sentence: str) -> None:
    """Raise `InputError` for the first option of `given` that has a value; `sentence` has {} for its name."""
    for name, value in given.items():
        if value is not None and value is not False and value != []:
            raise InputError(sentence.format(name))


def completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return the shell completion of an option's value: the `names` that begin with the typed text."""
    def beginning(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return beginning


effects = completing(lambda: ("any", *catalogue.CATALOGUE))
experiments = completing(lambda: (*SCRIPTED, "repeat"))
controllers = completing(lambda: sorted(entry.name for entry in entry_points(group="bowden.controllers")))
serials = completing(lambda: map(str, range(1, 21)))
declared_paths = completing(lambda: configuration.force_paths(Path("bench.toml")))

PICTURE = ("a picture", *output_files.PICTURES)
PAGE = ("a page", ".html", ".htm")
RECORDING = ("a recording", ".mcap")
NewRecording = Annotated[Path, new_file("File to write.", *RECORDING)]
Output = Annotated[Path, new_file()]
Page = Annotated[Path, new_file("File to write.", *PAGE)]
Overwrite = Annotated[bool, option("Replace an existing output file.")]
Json = Annotated[bool, option("JSON on stdout, nothing else.")]
Config = Annotated[Path | None, _file("bench.toml; bowden init writes one.", "--config")]
Picture = Annotated[Path | None, new_file(
    "Draw desired, START and END force (png, svg, pdf).", *PICTURE, name="--picture")]

Logbook = Annotated[Path | None, option(
    "Logbook to enter it in (default: [record] logbook of the configuration).", "DIR")]
Session = Annotated[str | None, option("Session of the logbook (default: the date; simulated: the day).", "LABEL")]

Healthy = Annotated[list[Path] | None, option("Reference trials of the healthy bench, one or several.", "TRIAL...")]

Peak = Annotated[float | None, option("Peak of the desired force, N (default 40).", "N")]
Period = Annotated[float | None, option("Gait period, s (default 2.0, or the knee file's stride).", "S")]
Cycles = Annotated[int | None, option("Gait cycles to run (default 10).", "COUNT")]
Rate = Annotated[int | None, option("Control cycles per second, Hz (default 1000).", "HZ")]
Knee = Annotated[Path | None, _file("Knee motion, CSV of time_s, knee_angle_rad or gait_percent, knee_angle_deg.")]
Desired = Annotated[Path | None, _file(
    "Desired force, CSV of time_s or gait_percent and desired_force_n, or by knee_angle_deg, too; or module:function.")]
Calibration = Annotated[Path | None, _file("Bench model to work from (default: the packaged nominal one).")]

SafetyMonitor = Annotated[str | None, option(
    "Safety monitor with the bounds in this file, or packaged (default: [monitor]).", "FILE")]
Interface = Annotated[str | None, option("python-can interface of a real bus (default: the virtual bus).", "NAME")]
Channel = Annotated[str | None, option("Channel of that interface, such as can0.", "NAME")]
Bitrate = Annotated[int | None, option("bit/s; default from [network].", "BIT/S")]
AnyInterface = Annotated[str, option("python-can interface, such as socketcan, udp_multicast or virtual.", "NAME")]
Seconds = Annotated[float | None, option("End after so many seconds.", "S", "--for")]
Lowpass = Annotated[float | None, option("Zero-phase low-pass on every signal.", "HZ")]
Trial = Annotated[Path, argument("TRIAL", "A recorded trial.")]
HomingForce = Annotated[float | None, option(
    "START tension that homing may reach whatever the peak is (default 12).", "N", "--homing-n")]
Extra = Annotated[list[str] | None, option("Interface option; repeatable.", "K=V", "--option")]
ForcePath = Annotated[str | None, option(
    "Force path of a bench of several, or joint of an arm.", "NAME", "--path", autocompletion=declared_paths)]


class WalkOptions(NamedTuple):
    """Options of the gait; None uses the configuration."""

    peak: Peak = None
    period: Period = None
    cycles: Cycles = None
    settle: Annotated[int | None, option("First cycles left out of every figure (default 1).", "COUNT")] = None
    controller: Annotated[str | None, option(
        "paper, none, friction, impedance, extended or module:Class (paper).", "NAME",
        autocompletion=controllers)] = None
    soft_start: Annotated[int | None, option(
        "Gait cycles before the first, over which the peak rises (default 0).", "COUNT")] = None
    tuning: Annotated[list[str] | None, option(
        "A parameter that the controller declares; repeatable.", "NAME=VALUE", "--set")] = None

    def gait(self, section: Any, controller: str | None = None) -> Any:
        """Return the configuration's `section`, overridden by the options; `controller` is the default controller."""
        return _overridden(section, {
            **self._asdict(), "controller": self.controller or controller,
            "tuning": None if self.tuning is None else ", ".join(self.tuning)})


class StrideOptions(NamedTuple):
    """Options of strides that differ; None uses the configuration."""

    strides: Annotated[int | None, option(
        "Strides of --knee FILE to play in random order, varied, by --seed.", "COUNT")] = None
    stumbles: Annotated[int | None, option("Strides in which the wearer stumbles (default 0).", "COUNT")] = None
    stops: Annotated[int | None, option("Times that the wearer stops and goes on (default 0).", "COUNT")] = None
    sits: Annotated[int | None, option("Times that the wearer sits down and goes on (default 0).", "COUNT")] = None
    phase: Annotated[str | None, option(
        "What the force follows: clock, or felt, from the knee alone (default with --strides).", "NAME")] = None

    def walk(self, section: Any, seed: int | None) -> Any:
        """Return the configuration's `section`, overridden by the options, drawn by `seed`."""
        return drawn(_overridden(section, self._asdict()), seed)


def spelled(*groups: Any) -> dict[str, Any]:
    """Return the values of option groups by option, such as --peak; None for options that the command line lacks."""
    return {_spelling(name): value for group in groups for name, value in group._asdict().items()}


def _spelling(name: str) -> str:
    return "--set" if name == "tuning" else f"--{name.replace('_', '-')}"


def _overridden(section: Any, given: Mapping[str, Any]) -> Any:
    units = {"peak": "peak_n", "period": "period_s"}
    return override(section, {units.get(name, name): (_spelling(name), value) for name, value in given.items()})


class SimulatedOptions(NamedTuple):
    """Options of simulated benches only; None if not given."""

    serial: Annotated[int | None, option(
        "Simulated bench: its serial number (default 1).", "NUMBER", autocompletion=serials)] = None
    day: Annotated[int | None, option("Simulated bench: number of the session (default 0).", "NUMBER")] = None
    seed: Annotated[int | None, option("Simulated bench: seed of the noise (default 0).", "NUMBER")] = None
    plant: Annotated[str | None, option("Simulated bench: its plant (default bowden).", "NAME")] = None
    plant_model: Annotated[Path | None, _file("Simulated bench: bench model or plant tables, TOML.")] = None


class WatchOptions(NamedTuple):
    """Diagnosis while the trial runs."""

    watch: Annotated[bool, option("Diagnose while it runs, by gait cycle; needs --healthy or a logbook.")] = False
    healthy: Healthy = None
    stop_on: Annotated[list[str] | None, option(
        "With --watch: safe stop if this effect, or any, costs 2 % of the peak; repeatable.", "EFFECT",
        autocompletion=effects)] = None

    def bench(self, logbook: Path | None) -> WatchedBench | None:
        """Return the bench that is watched, None where nothing is; reference trials of `logbook` where none is named.

        Raises `InputError` for what contradicts itself.
        """
        if not self.watch:
            refuse_given({"--healthy": self.healthy, "--stop-on": self.stop_on},
                         "{0} belongs to --watch; add --watch, or leave {0} out.")
            return None
        return watched_bench(self.healthy, logbook, self.stop_on)


def watched_bench(healthy: Sequence[Path] | None, logbook: Path | None, stop_on: Sequence[str] | None = None
                  ) -> WatchedBench:
    """Return a bench for a watch by reference trials or a logbook; raises `InputError` where neither is there."""
    refuse_stop_on(stop_on or (), "--stop-on")
    if not healthy and logbook is None:
        raise InputError("a watch compares with reference trials; name at least one with --healthy, or a --logbook.")
    found, deviations = logbook_entries.reference_trials(logbook, healthy)
    return WatchedBench(tuple(found), deviations, tuple(stop_on or ()))


class Bus(NamedTuple):
    """The bus that the bench is on, the virtual one where no interface is named; and the bench's declaration."""

    interface: Interface = None
    channel: Channel = None
    bitrate: Bitrate = None
    option: Extra = None
    raise_limits: Annotated[str | None, option(
        "Run with limits above the packaged ones; the trial records the reason.", "REASON")] = None
    config: Config = None

    def sections(self, rate: int | None = None) -> dict[str, Any]:
        """Return the checked sections of the configuration, the network overridden by the given options."""
        sections = configuration.read(self.config)
        sections["network"] = configuration.override(
            sections["network"], {"rate_hz": ("--rate", rate), "bitrate": ("--bitrate", self.bitrate)})
        sections["limits"] = configuration.override(
            sections["limits"], {"raised": ("--raise-limits", self.raise_limits)})
        configuration.refuse_raised(sections["limits"], str(self.config))
        configuration.refuse_unheld(sections, str(self.config))
        return sections

    def network(self) -> Any:
        """Return the network of the configuration, overridden by the given options."""
        return self.sections()["network"]

    @contextmanager
    def linked(self, *, acts: bool = False) -> Iterator[Link]:
        """Open the bus, a simulated one as the configuration declares it, and a link that sends no heartbeat.

        One that `acts` on nodes raises `InputError` while another master is on the bus.
        """
        with linked(self.configured(), self.network().bitrate) as link:
            if acts and (seen := other_master(link)):
                raise InputError(f"another master runs this bus: {seen}; stop it, or add --force.")
            yield link

    def configured(self) -> buses.BusSettings:
        """Return the bus to open; a simulated bench is the one that the configuration declares."""
        network = self.network()
        return buses.rated(self.chosen(), network.bitrate, network)

    def chosen(self, simulated: SimulatedOptions | None = None, *, always_simulated: bool = False) -> buses.BusSettings:
        """Return the bus to open; raises `InputError` for contradictory options.

        --channel or --option without --interface is refused: the user means a real bus, and a simulated one would be
        opened. A command that is `always_simulated` accepts them.
        """
        options = dict(keyed("--option", self.option, "KEY=VALUE; write for instance --option fd=true", buses.option))
        simulated = simulated or SimulatedOptions()
        if self.interface is None and not always_simulated:
            for name, value in (("--channel", self.channel), ("--option", self.option and self.option[0])):
                if value:
                    raise InputError(f"{name} {value}: without --interface nothing but a simulation would run; add "
                                     "--interface socketcan (or another), or --interface "
                                     f"{buses.VIRTUAL} for the simulated bench.")
        if self.interface in (None, buses.VIRTUAL):
            asked: dict[str, Any] = {name: value for name, value in simulated._asdict().items() if value is not None}
            return buses.simulated(**{**asked, "channel": self.channel or buses.BENCH, **options})
        refuse_given(spelled(simulated),
                     f"{{}} belongs to simulated benches; leave it out with --interface {self.interface}.")
        return buses.bus(**{"interface": self.interface, "channel": self.channel, **options})


BusAlone = Annotated[Bus, "interface", "channel", "bitrate", "option"]
"""Options of a bus for a command that reads no configuration: without --config and --raise-limits."""
BusConfigured = Annotated[Bus, *BusAlone.__metadata__, "config"]
"""Options of a bus for a command whose limits are those of the configuration: without --raise-limits."""


_options_of = cache(partial(get_type_hints, include_extras=True))
"""Options of a group by name, kept since the evaluation of annotations takes long."""


def grouped(command: Callable[..., CommandAnswer | int]) -> Callable[..., int]:
    """Return a command as the command line calls it: with spelt-out options, checked output files, a printed answer.

    An annotated group has the options that the annotation names, others all.  A command that declares --overwrite
    receives its value.
    """
    hints = get_type_hints(command, include_extras=True)
    del hints["return"]
    groups = {name: (kind, getattr(kind, "__metadata__", kind._fields)) for name, kind in hints.items()
              if hasattr(kind, "_field_defaults")}
    outputs = {name: declared.output_file for name, hint in hints.items()
               for declared in getattr(hint, "__metadata__", ()) if hasattr(declared, "output_file")}
    spelt: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name in groups:
            kind, fields = groups[parameter.name]
            offered = _options_of(getattr(kind, "__origin__", kind))
            spelt += [_option_of(field, kind._field_defaults[field], offered[field]) for field in fields]
        else:
            spelt.append(_option_of(parameter.name, parameter.default, hints[parameter.name]))
    if outputs and "overwrite" not in hints:
        spelt.append(_option_of("overwrite", False, Overwrite))
    spelt.append(_option_of("json", False, Json))

    @wraps(command)
    def gathered(**given: Any) -> int:
        json = given.pop("json")
        if outputs:
            _refuse_outputs(outputs, given)
            if "overwrite" not in hints:
                del given["overwrite"]
        made = {name: getattr(kind, "__origin__", kind)(**{field: given.pop(field) for field in fields})
                for name, (kind, fields) in groups.items()}
        return answered(lambda: command(**given, **made), json=json)

    # the command line reads a command's options from its annotations and its signature
    gathered.__annotations__ = {parameter.name: parameter.annotation for parameter in spelt}
    gathered.__signature__ = inspect.Signature(spelt)  # type: ignore[attr-defined]
    return gathered


def _refuse_outputs(outputs: Mapping[str, tuple[str, Sequence[str]]], given: Mapping[str, Any]) -> None:
    """Raise `InputError` for an output file that is also an input, has a wrong ending, or exists already.

    Existence comes last: --overwrite is suggested only for a file that it would let the command replace.
    """
    files = [given[name] for name in outputs]
    inputs = [path for name, value in given.items() if name not in outputs
              for path in (value if isinstance(value, list | tuple) else (value,)) if isinstance(path, Path)]
    output_files.refuse_inputs(files, inputs)
    for name, (content, endings) in outputs.items():
        if endings:
            output_files.refuse_ending(given[name], *endings, what=content)
    output_files.refuse(files, overwrite=given["overwrite"])


def _option_of(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    if getattr(annotation, "__origin__", None) is bool:
        declared, = annotation.__metadata__
        if declared.default is ...:  # Typer has a first name there; without a name it adds --no-…
            declared.param_decls = (f"--{name.replace('_', '-')}",)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
