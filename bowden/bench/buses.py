"""Opening a bus: the virtual one with its simulated bench, or any python-can interface.

The rule of this file: `simulated` and `bus` decide between virtual and real, once, as which bus to open and which
clock it brings; nothing after it asks.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, NamedTuple

from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    import can

    from bowden.model_files import tables
    from eds.bench.network import Network
    from eds.declaration import as_tables, packaged
    from master.network import doctor, host_computer, link
    from master.network.host_computer import prepared
    from master.network.recorded_bus import RecordedBus
    from master.network.socketcan import KernelBus
    from physics.bench_model import BenchModel

VIRTUAL = "bowden"
KERNEL = "socketcan"
BENCH = "bench"
"""Channel of the simulated bench."""
_NUMBERS = itertools.count()


@dataclass(frozen=True)
class BusSettings:
    """A bus to open: arguments of `can.Bus`, whether its bench is simulated, and that bench's serial number.

    `own_bench`: each opening makes a new bench, on a channel with a random name.
    """

    arguments: dict[str, Any]
    simulated: bool
    serial: int | None
    own_bench: bool = False

    @property
    def in_words(self) -> str:
        """Name of the bus in words that distinguish a simulation from a bench."""
        if self.simulated:
            return "SIMULATED"
        return " ".join(str(self.arguments[name]) for name in ("interface", "channel") if self.arguments.get(name))

    def announced(self) -> str:
        """Describe the bench, simulated or real, as a sentence before anything moves."""
        if self.simulated:
            numbers = ", ".join(f"{name} {self.arguments[name]}" for name in ("serial", "day", "seed", "plant"))
            return f"SIMULATED bench, {numbers}; --interface names a real bus."
        return f"bench on {self.in_words}."

    @property
    def bench(self) -> str:
        """Name of the bench in a calibration; "" without one."""
        return "" if self.serial is None else f"virtual {self.serial}"


class OpenBus(NamedTuple):
    """The master's bus, the recorder's monitor socket, the clock, ns, of their stamps, and the computer.

    On the kernel's CAN the bus is the monitor socket, too: it keeps every frame that it reads until the recorder
    takes them.

    `host` is entered around the cycle and yields the requests that the computer refused.
    """

    bus: Any
    tap: Any
    clock: Callable[[], int]
    host: Callable[[], AbstractContextManager[list[str]]]


def option(key: str, value: str) -> tuple[str, Any]:
    """Return key and value of an interface's option: a number, true or false, else text; raises `InputError`."""
    if not key:
        raise InputError(f"--option ={value}: has no key; write KEY=VALUE, for instance --option fd=true.")
    for convert in (int, float):
        try:
            return key, convert(value)
        except ValueError:
            continue
    return key, {"true": True, "false": False}.get(value.lower(), value)


STATED_ELSEWHERE: Final = {
    "rate_hz": "state it by --rate, or as [network] rate_hz",
    "bitrate": "state it by --bitrate, or as [network] bitrate",
    "declaration": "declare the bench in the configuration file", "monitor": "name its file by --monitor",
    "truth": "a recorded trial writes its own truth file"}
"""Options of the virtual bus that follow from the experiment, and how each is stated."""


def simulated(
    serial: int = 1, day: int = 0, seed: int = 0, *, plant: str = VIRTUAL,
    plant_model: str | Path | Mapping[str, Any] | BenchModel | None = None, channel: str | None = None, **more: Any,
) -> BusSettings:
    """Return the virtual bus with a simulated bench on it; raises `InputError` for a number below 0 or no plant model.

    `serial` draws the manufacturing tolerances, `day` the changes from session to session, `seed` the noise. `plant`
    is a name of the entry-point group bowden.plants or module:callable; `plant_model` states plant parameters and
    effects: a TOML file, its tables, or a bench model. `channel` lets other programs of this process join the bus by
    name; without one every call opens a separate bench. `more`: further options of `virtual_bus.bus_options.Options`,
    such as `faults`.
    """
    for name, value in {"serial": serial, "day": day, "seed": seed}.items():
        if not isinstance(value, int) or value < 0:
            raise InputError(f"--{name} {value}: expected a whole number from 0; give another one.")
    for name in more:
        if name in STATED_ELSEWHERE:
            raise InputError(f"{name} = {more[name]}: is no option of the simulated bench; "
                             f"{STATED_ELSEWHERE[name]}.")
    model: Any = plant_model
    if isinstance(plant_model, Path):
        model = str(plant_model)
    elif plant_model is not None and not isinstance(plant_model, str | Mapping):
        if not isinstance(plant_model, BenchModel):
            raise InputError(f"plant_model = {plant_model!r} is no file, table or bench model; name a TOML file.")
        model = tables(plant_model)
    arguments = {"interface": VIRTUAL, "channel": channel or BENCH, "serial": serial, "day": day, "seed": seed,
                 "plant": plant, "plant_model": model, **more}
    return BusSettings(arguments, True, serial, own_bench=channel is None)


def handled(chosen: BusSettings, **does: float) -> BusSettings:
    """Return a bus whose simulated bench is held at a reference, as in a set-up check by hand; a real bus unchanged.

    `does`: start_n, end_n or knee_rad.
    """
    return replace(chosen, arguments={**chosen.arguments, "hand": does}) if chosen.simulated else chosen


def bus(interface: str, channel: str | None = None, **options: Any) -> BusSettings:
    """Return a real bus: a python-can interface, its channel and its own options; raises `InputError`.

    The bit rate is the configuration's (`[network] bitrate`, or `Experiment(bitrate=…)`).
    """
    if interface == VIRTUAL:
        raise InputError(f"interface {VIRTUAL}: is the virtual bus; call bowden.simulated().")
    return BusSettings({"interface": interface, "channel": channel, **options}, False, None)


def rated(chosen: BusSettings, bitrate: int, network: Network) -> BusSettings:
    """Return the bus with its bit rate; a simulated bench also with what follows from the configuration."""
    more = simulating(network) if chosen.simulated else {}
    return replace(chosen, arguments={**chosen.arguments, **more, "bitrate": bitrate})


def simulating(network: Network) -> dict[str, Any]:
    """Return the options of a simulated bench that follow from the configuration; its devices are this project's."""
    bench = network.bench.bare
    return {"rate_hz": network.rate_hz, "declaration": None if bench == packaged() else as_tables(bench),
            "monitor": network.monitor or None}


@contextmanager
def opened_one(chosen: BusSettings, bitrate: int, **more: Any) -> Iterator[Any]:
    """Open one bus and close it at the end; raises `InputError` where it cannot be opened."""
    arguments = {**chosen.arguments, "bitrate": bitrate, **more}
    try:
        bus = _open(arguments)
    except InputError:
        raise
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        needed = missing_library(str(arguments["interface"]))
        if needed:
            raise InputError(f"interface {arguments['interface']}: needs {needed[0]}; say {needed[1]}.") from None
        channel = arguments["channel"]
        named, lacking = ("", "; no --channel was given") if channel is None else (f", channel {channel}", "")
        raise InputError(f"interface {arguments['interface']}{named}: cannot be opened ({error}); check the name, that "
                         f"it is up, and its options{lacking}.") from None
    try:
        yield bus
    finally:
        with suppress(can.CanError, OSError):  # an adapter that is gone cannot be closed; the run has said so
            bus.shutdown()


LIBRARIES = {  # of python-can's interfaces: (module, what it is called, what installs it)
    "slcan": ("serial", "pyserial"), "serial": ("serial", "pyserial"), "robotell": ("serial", "pyserial"),
    "seeedstudio": ("serial", "pyserial"), "gs_usb": ("gs_usb", "gs_usb"), "udp_multicast": ("msgpack", "msgpack"),
    "canalystii": ("canalystii", "canalystii"), "cantact": ("cantact", "cantact"), "neovi": ("ics", "python-ics"),
    "nican": ("nixnet", "nixnet"), "socketcand": ("socket", ""),
}


def missing_library(interface: str) -> tuple[str, str] | None:
    """Return the library that an interface of python-can needs and lacks here, and what installs it; None if none."""
    module, name = LIBRARIES.get(interface, ("", ""))
    if not name or find_spec(module) is not None:
        return None
    return name, f"pip install {name}"


def listened(bus: can.BusABC, take: Callable[[can.Message], object], over: Callable[[], bool], look_s: float
             ) -> str | None:
    """Pass the messages of a bus to `take` until `over()`, which is asked at least every `look_s`.

    Returns a failure of the bus in words, None without one.
    """
    try:
        while not over():
            message = bus.recv(look_s)
            if message is not None:
                take(message)
    except (can.CanError, OSError) as error:
        return str(error)
    return None


def clock_of(bus: Any) -> Callable[[], int]:
    """Return the clock, ns, of a bus's time stamps: the bus's own clock if it has one."""
    return getattr(bus, "time_ns", time.time_ns)


def _open(arguments: dict[str, Any]) -> Any:
    """Open the kernel's CAN by the master's own socket, every other interface by python-can; can.conf gives the
    defaults."""
    if arguments["interface"] != KERNEL:
        return can.Bus(**arguments)
    if not host_computer.IS_LINUX:
        raise InputError(f"interface {KERNEL}: is a part of Linux alone; {doctor.OTHER_INTERFACE}.")
    kind = RecordedBus if arguments.pop("recorded", False) else KernelBus
    given = {name: value for name, value in arguments.items() if value is not None}
    settings = dict(can.util.load_config(config=given))
    settings.pop("interface")
    return kind(**settings)


@contextmanager
def opened(chosen: BusSettings, network: Network, *, truth: Path | None = None) -> Iterator[OpenBus]:
    """Open the master's bus and the tap; both are closed at the end."""
    bitrate = network.bitrate
    if chosen.arguments["interface"] == KERNEL:
        with opened_one(chosen, bitrate, recorded=True) as bus:
            bus.set_filters(link.WANTED)
            yield OpenBus(bus, bus, time.time_ns, prepared)
        return
    if chosen.own_bench:
        chosen = replace(chosen, arguments={**chosen.arguments, "channel": f"{BENCH} {next(_NUMBERS)}"})
    more = {**simulating(network), "truth": None if truth is None else str(truth)} if chosen.simulated else {}
    with opened_one(chosen, bitrate, **more) as bus, opened_one(chosen, bitrate) as tap:
        if chosen.simulated:
            yield OpenBus(bus, tap, bus.time_ns, lambda: nullcontext([]))
        else:
            bus.set_filters(link.WANTED)
            yield OpenBus(bus, tap, time.time_ns, prepared)
