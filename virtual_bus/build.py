"""Makes a bench from its options: plant by entry point, devices, converters, scatter, truth.

The rule of this file: what a bench is made of is chosen here, by name; nothing of it is told to the bus.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import eds
import nodes
from eds.bench.bench_network import SERVO, Network
from eds.declaration import JOINT_ENCODER, DeclaredBench, packaged, read
from eds.dictionary import key
from parameters import InputError, from_table, parameter
from parameters.plugins import load
from physics.converter import Converter, SensorParameters
from physics.drive_loops import SERVO_GAINS
from physics.plant.bench_plant import Plant, PlantParameters
from virtual_bus.bench import MS, US, Bench
from virtual_bus.bus_options import Options
from virtual_bus.machine import plant_model
from virtual_bus.machine.hand import Hand
from virtual_bus.machine.machine import (
    END_FEELS,
    START_FEELS,
    Feeling,
    Gauge,
    Machine,
    MountedDrive,
    Observer,
    Tension,
    TickedDrive,
)
from virtual_bus.machine.plugged_plant import PluggedPlant, plant_raised
from virtual_bus.machine.scatter import DAY, Tables, scattered, stream
from virtual_bus.machine.truth import Truth
from virtual_bus.wire.faults import OF_A_DRIVE, Fault, declared
from virtual_bus.wire.node_station import NodeStation
from virtual_bus.wire.outages import wired

PLANTS = "bowden.plants"
OWN = {"bowden": "physics.plant:create"}
GAUGES = {"start": ("start_sensor", START_FEELS), "end": ("end_sensor", END_FEELS)}
"""Ends of a force path: the table of the load cell there, and the place of its tension in the plant's outputs."""
GAINS = {"position_gain": key(0x60FB, 1), "position_integral": key(0x60FB, 2)}


@dataclass(frozen=True)
class Trim:
    """The servo's position loop as its maker trimmed it; the integral gain goes with the proportional one."""

    position_gain: float = parameter(
        SERVO_GAINS.position_gain, "1/s", "position loop, proportional", low=1.0, high=2000.0,
        source="physics/drive_loops.py")


GROUPS: Mapping[str, type[Any]] = {
    "plant": PlantParameters, "start_sensor": SensorParameters, "end_sensor": SensorParameters, "servo_drive": Trim,
}

Factory = Callable[[dict[str, float], int], Plant]


def build(options: Options, channel: str) -> Bench:
    """Make the bench that `options` describe, switched on at 0 ns of its own time; raises `InputError`."""
    model = plant_model.read(options.plant_model)
    faults = (*(declared(options.faults) if options.faults else ()), *model.faults)
    tables = model.at_work(scattered(
        nominal(model.tables, model.where), options.serial, options.day, steady(options.steady)))
    plant = made_plant(options.plant, tables["plant"], options.seed)
    declaration = _declared(options)
    _refuse_no_drive(faults, declaration)
    network = Network(bitrate=options.bitrate, rate_hz=options.rate_hz, bench=declaration)
    wire = trimmed(eds.wire(network), tables["servo_drive"])
    built = {node_id: nodes.build(node_id, wire) for node_id in wire.nodes}

    def machine(bench: Bench) -> Machine:
        (path,), (joint,) = declaration.force_paths, declaration.joints
        cells = {end: declaration.named(name).node_id for end in GAUGES if (name := getattr(path, end))}

        def mounted(name: str) -> MountedDrive:
            node = declaration.named(name).node_id
            return MountedDrive(bench.nodes[node], cast(TickedDrive, built[node][1]))

        knee = mounted(joint.driven_by) if joint.driven_by else Hand(wire, 1e-3 * options.hand_lag_ms)
        gauges = [_gauge(end, bench.nodes[n], cast(Tension, built[n][1]), tables, options.seed)
                  for end, n in cells.items()]
        observers = [Observer(bench.nodes[device.node_id], cast(Feeling, built[device.node_id][1]))
                     for device in (*declaration.followed, *declaration.observers)
                     if device.type is JOINT_ENCODER or device.type.application is not None]
        made = Machine(bench.kernel, plant, mounted(path.actuator), knee, gauges, observers)
        if isinstance(knee, Hand):
            bench.wire.attach(knee)
        wired(bench.kernel, faults, made.trouble)
        if options.truth is not None:
            made.truth = Truth(options.truth, plant, _metadata(options, tables))
            bench.wire.attach(made.truth)
        return made

    return Bench(
        [device for device, _ in built.values()], channel=channel, bitrate=options.bitrate, faults=faults,
        seed=options.seed, master_turnaround_ns=options.master_turnaround_us * US,
        node_turnaround_ns=options.node_turnaround_us * US, tx_queue=options.tx_queue,
        restart_ns=options.restart_ms * MS, machine=machine,
    )


def _declared(options: Options) -> DeclaredBench:
    """Return the declared bench; raises `InputError` for one that is not of one force path and one joint."""
    if options.declaration is None:
        return packaged()
    bench = read(options.declaration, where="declaration")
    if len(bench.force_paths) != 1 or len(bench.joints) != 1:
        raise InputError(f"declaration: {len(bench.force_paths)} force paths and {len(bench.joints)} joints are "
                         "declared; the simulated bench has one of each.")
    return bench


def _refuse_no_drive(faults: Sequence[Fault], bench: DeclaredBench) -> None:
    """Raise `InputError` for an emergency stop of a node that is no drive of the declared bench."""
    drives = [device.node_id for device in bench.devices if device.type.taken]
    for place, fault in enumerate(faults, start=1):
        if fault.kind in OF_A_DRIVE and fault.node not in drives:
            raise InputError(f"[[fault]] {place}: {fault.kind} at node = {fault.node}, which is no drive of the "
                             f"declared bench; expected one of {drives}.")


def factory(name: str) -> Factory:
    """Return the plant factory of that name in the group `bowden.plants`, or the one at "module:callable".

    The current folder is searched after the module path.  Raises `InputError` for what is neither installed nor
    importable.
    """
    return cast(Factory, load("plant", name, PLANTS, OWN))


def made_plant(name: str, parameters: dict[str, float], seed: int) -> Plant:
    """Return the plant of that name; raises `InputError` if a plug-in's factory raises."""
    if name in OWN:
        return factory(name)(parameters, seed)
    try:
        return PluggedPlant(name, factory(name)(parameters, seed))
    except InputError:
        raise
    except Exception as error:  # a plug-in may raise anything
        raise plant_raised(name, error, "when it was made") from None


def nominal(given: Mapping[str, Any] | None, where: str = "plant_model") -> Tables:
    """Return the tables of nominal parameters, the `given` ones in their place; `where` begins what is refused."""
    given = given or {}
    for group in given:
        if group not in GROUPS:
            raise InputError(f"{where}: unknown table {group}; expected one of {', '.join(plant_model.NAMES)} or "
                             f"{', '.join(GROUPS)}.")
    return {
        group: dataclasses.asdict(from_table(cls, given.get(group, {}), where=f"{where} [{group}]"))
        for group, cls in GROUPS.items()
    }


def steady(given: str | Sequence[str]) -> frozenset[str]:
    """Return the names that the day is to leave alone; raises `InputError` for one that no day changes."""
    names = frozenset(filter(None, map(str.strip, given.split(",")))) if isinstance(given, str) else frozenset(given)
    known = [spread.label for spread in DAY]
    for name in sorted(names.difference(known)):
        raise InputError(f"steady: {name} is nothing that a day changes; expected any of {', '.join(known)}.")
    return names


def trimmed(wire: eds.WireLayout, gains: Mapping[str, float]) -> eds.WireLayout:
    """Return the wire with the servo as its maker trimmed it: the loop's gains in its dictionary scaled alike."""
    servo = wire.nodes[SERVO]
    ratio = gains["position_gain"] / SERVO_GAINS.position_gain
    entries = dict(servo.dictionary.entries)
    for place in GAINS.values():
        entry = entries[place]
        entries[place] = dataclasses.replace(entry, default=round(cast(int, entry.initial) * ratio))
    dictionary = dataclasses.replace(servo.dictionary, entries=entries)
    return eds.WireLayout(wire.network, {**wire.nodes, SERVO: servo._replace(dictionary=dictionary)})


def _gauge(end: str, station: NodeStation, sensor: Tension, tables: Tables, seed: int) -> Gauge:
    group, feels = GAUGES[end]
    parameters = from_table(SensorParameters, tables[group], where=group)
    noise = int(stream(f"{group} noise", seed).integers(2**63))
    return Gauge(station, sensor, Converter(parameters, noise), feels)


def _metadata(options: Options, tables: Tables) -> dict[str, str]:
    numbers = {name: str(getattr(options, name)) for name in ("serial", "day", "seed", "plant")}
    values = {f"{group}.{name}": repr(value) for group, table in tables.items() for name, value in table.items()}
    return numbers | values
