"""`bowden node guard`, `serve`, `apply`, `export`: node guarding, any EDS as a node, bus.yml files of ros2_canopen."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from bowden.bench import buses
from bowden.cli import options, terminal
from bowden.cli.bench.bench import served
from bowden.cli.bench.node import Eds, Force, Name, node, node_id_of
from bowden.cli.options import Bus, argument, keyed, option
from bowden.cli.terminal import CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.testing import CanBus, CanopenNode
    from eds.datatype import decode
    from eds.files import bus_yml
    from master.node_access import bus_setup, node_scan, object_text, remote_node
    from nodes import Application, GenericDrive, IoModule

FAULTS = {"drop": None, "delay": "ms", "corrupt": "bit", "duplicate": None, "shorten": "size"}
"""Kinds of faults of `--fault`, each with the key whose number it needs; None: it needs no number."""


@node.command(example="bowden node guard 1 --for 1 || true")
def guard(
    name: Name, reached: Bus,
    period: Annotated[int, option("Guard time.", "--period", metavar="MS", min=1, max=65_535)] = 100,
    life: Annotated[int, option(
        "Number of unanswered remote frames that count as a loss.", "--life", metavar="N", min=1, max=255)] = 3,
    seconds: Annotated[float, option("Time to guard.", "--for", metavar="S", min=0.0)] = 10.0,
) -> CommandAnswer:
    """Guard a node that has no heartbeat by remote frames; exit status 1 if it is lost."""
    node_id = node_id_of(name, reached)
    events: list[dict[str, object]] = []
    lost = False
    with reached.linked() as link:
        guarded = remote_node.NodeGuard(link, node_id, period * 1_000_000, life)
        began_ns = link.clock()
        while link.clock() - began_ns < seconds * 1e9:
            event = guarded.poll()
            lost = lost or guarded.lost
            if event is not None:
                text = remote_node.state_name(guarded.state or 0) if event == "state" else event
                events.append({"time_s": (guarded.asked_ns - began_ns) / 1e9, "event": text})
                if not terminal.quiet():
                    print(f"{(guarded.asked_ns - began_ns) / 1e9:8.3f}  {text}")
    return CommandAnswer(
        {"node": node_id, "asked": guarded.asked, "unanswered": guarded.unanswered, "events": events},
        f"{guarded.asked} remote frames, {guarded.unanswered} unanswered.", 1 if lost or guarded.state is None else 0)


@node.command(
    example="bowden node serve knee_drive --node-id 5 --interface udp_multicast --channel 239.74.163.2 --for 1")
def serve(
    file: Annotated[str, argument("FILE", "EDS or DCF, or the name of a packaged one.")],
    node_id: Annotated[int, option(
        "Node id 1 … 127; 255: LSS gives it one.", "--node-id", metavar="ID", show_default=False)],
    reached: Bus,
    profile: Annotated[int | None, option(
        "402: a drive; 401: inputs and outputs; without it, the objects alone.", metavar="NUMBER")] = None,
    settings: Annotated[list[str] | None, option(
        "Value of an object at start; repeatable.", "--set", metavar="OBJECT=VALUE")] = None,
    faults: Annotated[list[str] | None, option(
        "drop, delay, corrupt, duplicate or shorten frames: drop=585,count=2,after=10; delay=185,ms=5; repeatable.",
        "--fault", metavar="KIND=COBID,…")] = None,
    serial: Annotated[int | None, option("Serial number, 1018:04.", metavar="NUMBER")] = None,
    store: Annotated[Path | None, option("File of what 0x1010 and LSS store.", metavar="FILE")] = None,
    seconds: options.Seconds = None,
) -> CommandAnswer | int:
    """Serve a node on a bus from any EDS, in wall time until Ctrl-C.

    It has the services of its EDS: SDO, PDO, NMT, heartbeat, EMCY, SYNC, LSS, store and restore.
    """
    if reached.interface is None:
        raise InputError("node serve: a node is for other programs' bus; add --interface socketcan --channel can0 (or "
                         "another).")
    own_bus = CanBus()
    made = own_bus.add_node(file, node_id, profile=_application(profile), serial=serial, store=store)
    keyed("--set", settings, "OBJECT=VALUE; write for instance 6064=1000", partial(_set, made))
    counted = keyed("--fault", faults, "KIND=COBID with count=N, after=N, and ms=, bit= or size= for delay, corrupt "
                    "and shorten; write for instance drop=585,count=2", partial(_fault, own_bus))
    for fault in made.eds_faults:
        terminal.remark(fault)
    chosen = reached.chosen()
    with buses.opened_one(chosen, reached.network().bitrate) as bus:
        return served(f"node {node_id}", chosen, seconds, partial(own_bus.serve, bus), lambda figures: {
            "node": made.node_id, "state": made.state.name, "received": figures.received, "sent": figures.sent,
            "lost": figures.lost, "faults": [one.struck for one in counted]})


def _application(profile: int | None) -> Application | None:
    if profile not in (None, 401, 402):
        raise InputError(f"--profile {profile}: is none of 401 and 402; give one of them, or leave it out.")
    return None if profile is None else GenericDrive() if profile == 402 else IoModule()


def _set(made: CanopenNode, place: str, value: str) -> None:
    at = object_text.find(made.dictionary, place)
    entry = made.dictionary.entries.get(at)
    if entry is None:
        raise InputError(f"--set {place}={value}: {made.dictionary.path} has no such object; give one of its own.")
    made[at >> 8, at & 0xFF] = decode(
        entry.data_type, object_text.encoded(entry.data_type, value, f"--set {place}={value}"))


def _fault(served: CanBus, kind: str, rest: str) -> Any:
    cob_id, *more = rest.split(",")
    numbers = {key: int(value) for key, _, value in (one.partition("=") for one in more)}
    needed = FAULTS[kind]
    if set(numbers) - {"count", "after", needed} or (needed is not None and needed not in numbers):
        raise ValueError
    count, after, number = numbers.get("count"), numbers.get("after", 0), numbers.get(needed or "")
    options: dict[Any, int] = {} if number is None else {needed: number}
    if "ms" in options:
        options = {"delay_ns": options["ms"] * 1_000_000}
    return getattr(served.faults, kind)(int(cob_id, 16), count, after=after, **options)


File = Annotated[Path, argument("FILE", "bus.yml of ros2_canopen.")]


@node.command(example="bowden node export -o bus.yml && bowden node apply bus.yml")
def apply(file: File, reached: Bus, force: Force = False) -> CommandAnswer:
    """Write the SDO list, heartbeats and PDOs of a bus.yml into its nodes."""
    devices = bus_yml.read(file).devices
    with reached.linked(acts=not force) as link:
        done = {one.name: bus_setup.apply(link, one, file.parent) for one in devices}
    return CommandAnswer(
        {"file": str(file), "devices": [
            {"name": one.name, "node": one.node_id, "done": done[one.name]} for one in devices]},
        [f"{one.name}, node {one.node_id}: {'; '.join(done[one.name]) or 'nothing to write'}." for one in devices])


@node.command(example="bowden node export -o bus.yml")
def export(output: options.Output, reached: Bus, eds: Eds = None) -> CommandAnswer:
    """Write the nodes of a bus, with their PDOs as they are set, as a bus.yml of ros2_canopen."""
    files = node_scan.files_of(eds)
    with reached.linked() as link:
        devices = [bus_setup.described(link, one) for one in node_scan.scan(link, files)]
    for path in {path for path in files for one in devices if path.name == one.eds}:
        if not (output.parent / path.name).exists():
            shutil.copy(path, output.parent / path.name)
    bus_yml.write(output, bus_yml.of_devices(devices, {
        "node_id": 127, "driver": "ros2_canopen::MasterDriver", "package": "canopen_master_driver",
        "baudrate": reached.network().bitrate // 1000}), overwrite=True)
    return CommandAnswer({"file": str(output), "nodes": [one.node_id for one in devices]},
                         f"{output}: {len(devices)} nodes.", 0 if devices else 1)
