"""Options that belong together, declared once; a command takes each group as one parameter.

A group is a named tuple of options with defaults and a method that applies them to a configuration; `grouped` spells
groups out for the command line and gathers them again.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_type_hints

from bowden.cli import options
from bowden.cli.terminal import CommandAnswer, answered
from parameters import InputError

if TYPE_CHECKING:
    from bowden.bench.buses import BusSettings
    from bowden.watch.file_watch import WatchedBench
    from master.network.link import Link


class WalkOptions(NamedTuple):
    """Options of the gait; None uses the configuration."""

    peak: options.Peak = None
    period: options.Period = None
    cycles: options.Cycles = None
    settle: options.Settle = None
    controller: options.Controller = None
    soft_start: options.SoftStart = None
    tuning: options.Tuning = None

    def gait(self, section: Any, controller: str | None = None) -> Any:
        """Return the configuration's `section`, overridden by the options; `controller` is the default controller."""
        return _overridden(section, {
            **self._asdict(), "controller": self.controller or controller,
            "tuning": None if self.tuning is None else ", ".join(self.tuning)})


class StrideOptions(NamedTuple):
    """Options of strides that differ; None uses the configuration."""

    strides: options.Strides = None
    stumbles: options.Stumbles = None
    stops: options.Stops = None
    sits: options.Sits = None
    phase: options.Phase = None

    def walk(self, section: Any, seed: int | None) -> Any:
        """Return the configuration's `section`, overridden by the options, drawn by `seed`."""
        from bowden.bench.configuration import drawn

        return drawn(_overridden(section, self._asdict()), seed)


def spelled(*groups: Any) -> dict[str, Any]:
    """Return the options of groups by their spelling; None for those not given."""
    return {_spelling(name): value for group in groups for name, value in group._asdict().items()}


def _spelling(name: str) -> str:
    return "--set" if name == "tuning" else f"--{name.replace('_', '-')}"


def _overridden(section: Any, given: Mapping[str, Any]) -> Any:
    from bowden.bench.configuration import override

    units = {"peak": "peak_n", "period": "period_s"}
    return override(section, {units.get(name, name): (_spelling(name), value) for name, value in given.items()})


class SimulatedOptions(NamedTuple):
    """Options of simulated benches only; None if not given."""

    serial: options.Serial = None
    day: options.Day = None
    seed: options.Seed = None
    plant: options.Plant = None
    plant_model: options.PlantModel = None


class WatchOptions(NamedTuple):
    """Diagnosis while the trial runs."""

    watch: options.Watched = False
    healthy: options.Healthy = None
    stop_on: options.StopOn = None

    def bench(self, logbook: Path | None) -> WatchedBench | None:
        """Return the bench that is watched, None where nothing is; reference trials of `logbook` where none is named.

        Raises `InputError` for what contradicts itself.
        """
        if not self.watch:
            for name, value in (("--healthy", self.healthy), ("--stop-on", self.stop_on)):
                if value:
                    raise InputError(f"{name} belongs to --watch; add --watch, or leave {name} out.")
            return None
        return watched_bench(self.healthy, logbook, self.stop_on)


def watched_bench(healthy: Sequence[Path] | None, logbook: Path | None, stop_on: Sequence[str] | None = None
                  ) -> WatchedBench:
    """Return a bench for a watch by reference trials or a logbook; raises `InputError` where neither is there."""
    from bowden.models import logbook_entries
    from bowden.watch.file_watch import WatchedBench, refuse_stop_on

    refuse_stop_on(stop_on or (), "--stop-on")
    if not healthy and logbook is None:
        raise InputError("a watch compares with reference trials; name at least one with --healthy, or a --logbook.")
    found, deviations = logbook_entries.reference_trials(logbook, healthy) if logbook else (healthy or [], None)
    return WatchedBench(tuple(found), deviations, tuple(stop_on or ()))


class Bus(NamedTuple):
    """The bus that the bench is on, the virtual one where no interface is named; and the bench's declaration."""

    interface: options.Interface = None
    channel: options.Channel = None
    bitrate: options.Bitrate = None
    option: options.Extra = None
    raise_limits: options.RaiseLimits = None
    config: options.Config = None

    def sections(self, rate: int | None = None) -> dict[str, Any]:
        """Return the checked sections of the configuration, the network overridden by the given options."""
        from bowden.bench import configuration

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

    def linked(self) -> AbstractContextManager[Link]:
        """Open the bus, a simulated one as the configuration declares it, and a link that sends no heartbeat."""
        from bowden.bench.any_node import linked

        return linked(self.configured(), self.network().bitrate)

    def configured(self) -> BusSettings:
        """Return the bus to open; a simulated bench is the one that the configuration declares."""
        from bowden.bench.buses import rated

        network = self.network()
        return rated(self.chosen(), network.bitrate, network)

    def chosen(self, simulated: SimulatedOptions | None = None, *, always_simulated: bool = False) -> BusSettings:
        """Return the bus to open; raises `InputError` for contradictory options.

        A channel or an option without an interface means a real bus that would not be opened: it is refused, but
        where a command is `always_simulated`.
        """
        from bowden.bench.buses import BENCH, VIRTUAL, bus
        from bowden.bench.buses import simulated as virtual

        options = dict(_option(text) for text in self.option or ())
        asked: dict[str, Any] = {
            name: value for name, value in (simulated or SimulatedOptions())._asdict().items() if value is not None}
        if self.interface is None and not always_simulated:
            for name, value in (("--channel", self.channel), ("--option", self.option and self.option[0])):
                if value:
                    raise InputError(f"{name} {value}: without --interface nothing but a simulation would run; add "
                                     f"--interface socketcan (or another), or --interface {VIRTUAL} for the simulated "
                                     "bench.")
        if self.interface in (None, VIRTUAL):
            return virtual(**{**asked, "channel": self.channel or BENCH, **options})
        for name in asked:
            raise InputError(f"--{name.replace('_', '-')} belongs to simulated benches; leave it out with "
                             f"--interface {self.interface}.")
        return bus(**{"interface": self.interface, "channel": self.channel, **options})


def _option(text: str) -> tuple[str, Any]:
    """Return key and value of an interface's option: a number, true or false, else text."""
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InputError(f"--option {text}: expected KEY=VALUE; write for instance --option fd=true.")
    for convert in (int, float):
        try:
            return key, convert(value)
        except ValueError:
            continue
    return key, {"true": True, "false": False}.get(value.lower(), value)


BusAlone = Annotated[Bus, "interface", "channel", "bitrate", "option"]
"""The bus without a bench's declaration: its named options alone."""


def grouped(command: Callable[..., CommandAnswer | int]) -> Callable[..., int]:
    """Replace each option group in a command's signature by the group's options, add --json, and print the answer.

    An annotated group has the options that the annotation names, others all.
    """
    hints = get_type_hints(command, include_extras=True)
    del hints["return"]
    groups = {name: (kind, getattr(kind, "__metadata__", kind._fields)) for name, kind in hints.items()
              if hasattr(kind, "_field_defaults")}
    spelt: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name in groups:
            kind, fields = groups[parameter.name]
            offered = get_type_hints(getattr(kind, "__origin__", kind), include_extras=True)
            spelt += [_option_of(field, kind._field_defaults[field], offered[field]) for field in fields]
        else:
            spelt.append(_option_of(parameter.name, parameter.default, hints[parameter.name]))
    spelt.append(_option_of("json", False, options.Json))

    @wraps(command)
    def gathered(**given: Any) -> int:
        json = given.pop("json")
        made = {name: getattr(kind, "__origin__", kind)(**{field: given.pop(field) for field in fields})
                for name, (kind, fields) in groups.items()}
        return answered(lambda: command(**given, **made), json=json)

    # the command line reads a command's options from its annotations and its signature
    gathered.__annotations__ = {parameter.name: parameter.annotation for parameter in spelt}
    gathered.__signature__ = inspect.Signature(spelt)  # type: ignore[attr-defined]
    return gathered


def _option_of(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
