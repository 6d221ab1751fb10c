"""Construction of a bench from its options: plant by entry point, devices, converters, scatter, truth.

The parts of a bench are chosen here, by name; the bus has no access to them.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, cast

import eds
import nodes
from eds.bench.bench_network import Network
from eds.declaration import (
    EXTENDS,
    JOINT_ENCODER,
    LOAD_CELL,
    DeclaredBench,
    ForcePath,
    PathNodes,
    mirrored_rad,
    packaged,
    read,
)
from eds.dictionary import key
from parameters import InputError, from_table, parameter
from parameters.plugins import load
from physics.converter import Converter, SensorParameters
from physics.drive_loops import SERVO_GAINS
from physics.plant.bench_plant import BowdenPlant, Plant, PlantParameters
from virtual_bus.bench import MS, US, Bench
from virtual_bus.bus_options import Options
from virtual_bus.machine import plant_model
from virtual_bus.machine.hand import CheckingHand, Hand
from virtual_bus.machine.machine import (
    END_FEELS,
    START_FEELS,
    Feeling,
    Gauge,
    KneeEncoder,
    Machine,
    Machines,
    MountedDrive,
    Observer,
    SwitchedPlant,
)
from virtual_bus.machine.monitored import EnableLine, SensedPath, monitor
from virtual_bus.machine.plugged_plant import PluggedPlant, plant_raised
from virtual_bus.machine.scatter import DAY, Tables, scattered, stream
from virtual_bus.machine.truth import Truth
from virtual_bus.wire.faults import OF_A_DRIVE, OF_A_SENSOR, Fault, declared, wired
from virtual_bus.wire.node_station import NodeStation

PLANTS = "bowden.plants"
OWN = {"bowden": "physics.plant:create"}
GAUGES = {"start": ("start_sensor", START_FEELS), "end": ("end_sensor", END_FEELS)}
"""Ends of a force path: table of the load cell there, and index of its tension in the plant's outputs."""
GAINS = {"position_gain": key(0x60FB, 1), "position_integral": key(0x60FB, 2)}


@dataclass(frozen=True)
class Trim:
    """Gain of the servo's position loop as its maker set it; the integral gain changes in proportion."""

    position_gain: float = parameter(
        SERVO_GAINS.position_gain, "1/s", "position loop, proportional", low=1.0, high=2000.0,
        source="physics/drive_loops.py")


@dataclass(frozen=True)
class KneeEncoderError:
    """Error of the knee drive's encoder from power-on: scale by a wrong gear ratio, zero by the mounting angle."""

    scale: float = parameter(1.0, "", "angle read by true angle", low=0.5, high=2.0, source="assumed: none")
    zero_rad: float = parameter(0.0, "rad", "angle read at the true angle 0", low=-0.5, high=0.5,
                                source="assumed: none")


GROUPS: Mapping[str, type[Any]] = {
    "plant": PlantParameters, "start_sensor": SensorParameters, "end_sensor": SensorParameters, "servo_drive": Trim,
    "knee_encoder": KneeEncoderError,
}

PATH_SERIALS: Final = 1000
"""Step between the serial numbers, and noise seeds, of a bench's force paths."""
Built = Mapping[int, tuple[nodes.Device, nodes.Application]]
"""Simulated devices, and the applications behind them, by node id."""
Factory = Callable[[dict[str, float], int], Plant]


def build(options: Options, channel: str) -> Bench:
    """Make the bench that `options` describe, switched on at 0 ns of bench time; raises `InputError`."""
    declaration = packaged() if options.declaration is None else read(options.declaration, where="declaration")
    wire = eds.wire(Network(bitrate=options.bitrate, rate_hz=options.rate_hz, bench=declaration))
    made = [_made(options, wire, number) for number in range(len(declaration.force_paths))]
    faults = (*(declared(options.faults) if options.faults else ()), *(fault for one in made for fault in one.faults))
    _refuse_misplaced(faults, declaration)
    for one in made:
        wire = trimmed(wire, one.nodes.servo, one.tables["servo_drive"])
    built = {node_id: nodes.build(node_id, wire) for node_id in wire.nodes}
    line = EnableLine(options.sto_us * US)
    guard = None if options.monitor is None else monitor(options.monitor, wire, line)

    def machine(bench: Bench) -> Machine | Machines:
        machines: list[Machine] = []
        for one in made:
            leads = (machine for machine, other in zip(machines, made, strict=False)
                     if other.path.joint == one.path.joint)
            lead = next(leads, None)
            machines.append(_machine(one, options, wire, bench, built, lead))
        truth = None
        if options.truth is not None:
            truth = Truth(options.truth, {"" if len(made) == 1 else f"{one.path.name}.": one.plant for one in made},
                          _metadata(options, {f"{one.path.name}." * (len(made) > 1) + group: table
                                              for one in made for group, table in one.tables.items()}))
            bench.wire.attach(truth)
        if len(machines) == 1:
            machines[0].truth = truth
        if guard is not None:
            line.join(bench.kernel, [SensedPath(one.path, cast(SwitchedPlant, one.plant)) for one in made], machines)
            bench.nodes[guard.node_id].unpowered = guard.power_off
        for each in machines:
            wired(bench.kernel, [f for f in faults if len(machines) == 1 or f.node in each.felt], each.trouble)
        return machines[0] if len(machines) == 1 else Machines(machines, truth)

    return Bench(
        [*(device for device, _ in built.values()), *(() if guard is None else (guard,))],
        channel=channel, bitrate=options.bitrate, faults=faults,
        seed=options.seed, master_turnaround_ns=options.master_turnaround_us * US,
        node_turnaround_ns=options.node_turnaround_us * US, tx_queue=options.tx_queue,
        restart_ns=options.restart_ms * MS, machine=machine,
    )


class SimulatedPath(NamedTuple):
    """One force path of the simulated bench: its parameters, faults of its plant model, nodes, plant and noise seed."""

    path: ForcePath
    tables: Tables
    faults: tuple[Fault, ...]
    nodes: PathNodes
    plant: Plant
    seed: int


def _made(options: Options, wire: eds.WireLayout, number: int) -> SimulatedPath:
    """Make a force path's plant; that of path `number` is drawn as the only path of bench `serial` + 1000 `number`."""
    path, own = wire.network.bench.force_paths[number], PATH_SERIALS * number
    model = plant_model.read(options.plant_model, wire.paths[number],
                             path.name if len(wire.paths) > 1 else "")
    tables = model.at_work(scattered(
        nominal(model.tables, model.where), options.serial and options.serial + own, options.day,
        steady(options.steady)))
    if path.acts == EXTENDS:
        if options.plant not in OWN:
            raise InputError(f"plant {options.plant}: an antagonist's joint is another path's, which a plug-in's plant "
                             f"cannot follow; leave out force_path {path.name}, or the plant.")
        tables["plant"]["start_knee_rad"] = mirrored_rad(path, tables["plant"]["start_knee_rad"])
    seed = options.seed + own
    plant = made_plant(options.plant, tables["plant"], seed)
    if model.terms:
        if not isinstance(plant, BowdenPlant):
            raise InputError(f"plant {options.plant}: {model.where} has terms, which a plug-in's plant cannot follow; "
                             "remove [[terms]], or leave out the plant.")
        plant.extend(model.terms, model.where)
    return SimulatedPath(path, tables, model.faults, wire.paths[number], plant, seed)


def _machine(one: SimulatedPath, options: Options, wire: eds.WireLayout, bench: Bench, built: Built,
             lead: Machine | None) -> Machine:
    """Join a path's plant with its devices; the joint of an antagonist is that of the machine `lead`."""
    def mounted(node: int) -> MountedDrive:
        return MountedDrive(bench.nodes[node], cast(nodes.Drive, built[node][1]))

    declaration = wire.network.bench
    joint = next(joint for joint in declaration.joints if joint.name == one.path.joint)
    knee: MountedDrive | Hand | Machine | None = lead
    if knee is None:
        knee = mounted(one.nodes.knee) if joint.driven_by else Hand(wire, 1e-3 * options.hand_lag_ms)
    gauges = [_gauge(end, bench.nodes[n], cast(nodes.TensionSensor, built[n][1]), one.tables, one.seed)
              for end, n in (("start", one.nodes.start), ("end", one.nodes.end)) if n]
    observers = [Observer(bench.nodes[device.node_id], cast(Feeling, built[device.node_id][1]))
                 for device in (*declaration.followed, *declaration.observers)
                 if device.type is JOINT_ENCODER or device.type.application is not None]
    first = one.path is declaration.force_paths[0]
    made = Machine(bench.kernel, one.plant, mounted(one.nodes.servo), knee, gauges, observers if first else (),
                   KneeEncoder(**one.tables["knee_encoder"]), CheckingHand(options.hand) if options.hand else None)
    if isinstance(knee, Hand):
        bench.wire.attach(knee)
    return made


def _refuse_misplaced(faults: Sequence[Fault], bench: DeclaredBench) -> None:
    """Raise `InputError` for a fault of a drive, or of a load cell, at a node that the declared bench does not have."""
    drives = [device.node_id for device in bench.devices if device.type.taken]
    cells = [device.node_id for device in bench.devices if device.type is LOAD_CELL]
    for place, fault in enumerate(faults, start=1):
        for kinds, fit, what in ((OF_A_DRIVE, drives, "drive"), (OF_A_SENSOR, cells, "load cell")):
            if fault.kind in kinds and fault.node not in fit:
                raise InputError(f"[[fault]] {place}: {fault.kind} at node = {fault.node}, which is no {what} of the "
                                 f"declared bench; expected one of {fit}.")


def factory(name: str) -> Factory:
    """Return the plant factory of that name in the group `bowden.plants`, or the one at "module:callable".

    The current folder is searched after the module path. Raises `InputError` for a name that is neither installed nor
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
    """Return the tables of nominal parameters, updated by those `given`; `where` begins the text of an error."""
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
    """Return the names that the session does not change; raises `InputError` for one that no session changes."""
    names = frozenset(filter(None, map(str.strip, given.split(",")))) if isinstance(given, str) else frozenset(given)
    known = [spread.label for spread in DAY]
    for name in sorted(names.difference(known)):
        raise InputError(f"steady: {name} is nothing that a day changes; expected any of {', '.join(known)}.")
    return names


def trimmed(wire: eds.WireLayout, node_id: int, gains: Mapping[str, float]) -> eds.WireLayout:
    """Return the wire with all loop gains of a servo scaled by the ratio of `gains` to the packaged position gain."""
    servo = wire.nodes[node_id]
    ratio = gains["position_gain"] / SERVO_GAINS.position_gain
    entries = dict(servo.dictionary.entries)
    for place in GAINS.values():
        entry = entries[place]
        entries[place] = dataclasses.replace(entry, default=round(cast(int, entry.initial) * ratio))
    dictionary = dataclasses.replace(servo.dictionary, entries=entries)
    return eds.WireLayout(wire.network, {**wire.nodes, node_id: servo._replace(dictionary=dictionary)})


def _gauge(end: str, station: NodeStation, sensor: nodes.TensionSensor, tables: Tables, seed: int) -> Gauge:
    group, feels = GAUGES[end]
    parameters = from_table(SensorParameters, tables[group], where=group)
    noise = int(stream(f"{group} noise", seed).integers(2**63))
    return Gauge(station, sensor, Converter(parameters, noise), feels)


def _metadata(options: Options, tables: Tables) -> dict[str, str]:
    numbers = {name: str(getattr(options, name)) for name in ("serial", "day", "seed", "plant")}
    values = {f"{group}.{name}": repr(value) for group, table in tables.items() for name, value in table.items()}
    return numbers | values
