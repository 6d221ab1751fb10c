"""Opening a bus: the virtual one with its simulated bench, or any python-can interface.

The rule of this file: this is where "virtual or real" is decided, once, as which bus to open and which clock
it brings; nothing after it asks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from bowden.cli.option_groups import Bus, Simulated
from parameters import InputError

VIRTUAL = "bowden"
KERNEL = "socketcan"


@dataclass(frozen=True)
class Chosen:
    """The bus that was asked for: arguments of `can.Bus`, and what identifies the bench on it."""

    arguments: dict[str, Any]
    simulated: bool
    serial: int | None

    @property
    def bench(self) -> str:
        """The bench's name in a calibration; "" where nobody told."""
        return "" if self.serial is None else f"virtual {self.serial}"


class Opened(NamedTuple):
    """The master's filtered bus, the recorder's unfiltered one, the clock, ns, of their stamps, and the computer.

    `host` is entered around the cycle and yields what the computer does not permit.
    """

    bus: Any
    tap: Any
    clock: Callable[[], int]
    host: Callable[[], AbstractContextManager[list[str]]]


def choose(asked: Bus, simulated: Simulated) -> Chosen:
    """Check what was asked for; options of simulated benches are refused with a real interface."""
    interface, channel, _, option = asked
    extra = dict(_split(text) for text in option or ())
    if interface in (None, VIRTUAL):
        serial = 1 if simulated.serial is None else simulated.serial
        for name in ("serial", "day", "seed"):
            value = getattr(simulated, name)
            if value is not None and value < 0:
                raise InputError(f"--{name} {value}: expected a whole number from 0; give another one.")
        arguments = {
            "interface": VIRTUAL, "channel": channel or "bench", "serial": serial, "day": simulated.day or 0,
            "seed": simulated.seed or 0, "plant": simulated.plant or VIRTUAL,
            "plant_model": None if simulated.plant_model is None else str(simulated.plant_model), **extra,
        }
        return Chosen(arguments, True, serial)
    for name, value in simulated._asdict().items():
        if value is not None:
            raise InputError(
                f"--{name.replace('_', '-')} belongs to simulated benches; leave it out with --interface {interface}.")
    return Chosen({"interface": interface, "channel": channel, **extra}, False, None)


def _split(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InputError(f"--option {text}: expected KEY=VALUE; write for instance --option fd=true.")
    for convert in (int, float):
        try:
            return key, convert(value)
        except ValueError:
            continue
    return key, {"true": True, "false": False}.get(value.lower(), value)


def rated(chosen: Chosen, bitrate: int, rate_hz: int) -> Chosen:
    """The same bus with its bit rate; a simulated bench also knows how often SYNC will come."""
    more = {"rate_hz": rate_hz} if chosen.simulated else {}
    return replace(chosen, arguments={**chosen.arguments, **more, "bitrate": bitrate})


@contextmanager
def opened_one(chosen: Chosen, bitrate: int, **more: Any) -> Iterator[Any]:
    """Open one bus and close it at the end; raises `InputError` where it cannot be opened."""
    import can

    arguments = {**chosen.arguments, "bitrate": bitrate, **more}
    try:
        bus = _open(arguments)
    except InputError:
        raise
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        raise InputError(
            f"interface {arguments['interface']}, channel {arguments['channel']}: cannot be opened ({error}); "
            "check the name, that it is up, and its options.") from None
    try:
        yield bus
    finally:
        with suppress(can.CanError, OSError):  # an adapter that is gone cannot be closed; the run has said so
            bus.shutdown()


def clock_of(bus: Any) -> Callable[[], int]:
    """The clock, ns, that a bus's stamps follow: its own where it has one."""
    return getattr(bus, "time_ns", time.time_ns)


def _open(arguments: dict[str, Any]) -> Any:
    """The kernel's CAN by the master's own socket, every other interface by python-can; can.conf fills what is left."""
    import can

    if arguments["interface"] != KERNEL:
        return can.Bus(**arguments)
    from master.network.socketcan import KernelBus

    given = {name: value for name, value in arguments.items() if value is not None}
    settings = dict(can.util.load_config(config=given))
    settings.pop("interface")
    return KernelBus(**settings)


@contextmanager
def opened(chosen: Chosen, *, bitrate: int, rate_hz: int, truth: Path | None) -> Iterator[Opened]:
    """Open the master's bus and the tap; both are closed at the end."""
    from master.network.host_computer import prepared
    from master.network.link import WANTED

    more = {"rate_hz": rate_hz, "truth": None if truth is None else str(truth)} if chosen.simulated else {}
    with opened_one(chosen, bitrate, **more) as bus, opened_one(chosen, bitrate) as tap:
        if chosen.simulated:
            yield Opened(bus, tap, bus.time_ns, lambda: nullcontext([]))
        else:
            bus.set_filters(WANTED)
            yield Opened(bus, tap, time.time_ns, prepared)
