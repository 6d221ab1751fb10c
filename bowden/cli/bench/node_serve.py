"""`bowden node guard`, `serve`, `apply`, `export`: node guarding, any EDS as a node, bus.yml files of ros2_canopen."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from typing import Annotated

from bowden.bench import buses
from bowden.cli import options, terminal
from bowden.cli.bench.bench import served
from bowden.cli.bench.node import Eds, Force, Name, node, node_id_of
from bowden.cli.options import Bus, argument, keyed, option
from bowden.cli.terminal import CommandAnswer
from bowden.deferred import on_first_use
from parameters import InputError

with on_first_use():
    from bowden.testing import CanBus
    from eds.files import bus_yml
    from master.node_access import bus_setup, node_scan, remote_node
    from nodes import Application, GenericDrive, IoModule


@node.command(example="bowden node guard 1 --for 1 || true")
def guard(
    name: Name, reached: Bus,
    period: Annotated[int, option("Guard time.", "MS", min=1, max=65_535)] = 100,
    life: Annotated[int, option("Number of unanswered remote frames that count as a loss.", "N", min=1, max=255)] = 3,
    seconds: Annotated[float, option("Time to guard.", "S", "--for", min=0.0)] = 10.0,
) -> CommandAnswer:
    """Guard a node that has no heartbeat by remote frames; exit status 1 if it is lost."""
    node_id = node_id_of(name, reached)
    events: list[dict[str, object]] = []
    with reached.linked() as link:
        guarded = remote_node.NodeGuard(link, node_id, period * 1_000_000, life)
        for time_s, text in guarded.events(seconds):
            events.append({"time_s": time_s, "event": text})
            if not terminal.quiet():
                print(f"{time_s:8.3f}  {text}")
    return CommandAnswer(
        {"node": node_id, "asked": guarded.asked, "unanswered": guarded.unanswered, "events": events},
        f"{guarded.asked} remote frames, {guarded.unanswered} unanswered.",
        1 if guarded.ever_lost or guarded.state is None else 0)


@node.command(
    example="bowden node serve knee_drive --node-id 5 --interface udp_multicast --channel 239.74.163.2 --for 1")
def serve(
    file: Annotated[str, argument("FILE", "EDS or DCF, or the name of a packaged one.")],
    node_id: Annotated[int, option("Node id 1 … 127; 255: LSS gives it one.", "ID", show_default=False)],
    reached: Bus,
    profile: Annotated[int | None, option(
        "402: a drive; 401: inputs and outputs; without it, the objects alone.", "NUMBER")] = None,
    settings: Annotated[list[str] | None, option(
        "Value of an object at start; repeatable.", "OBJECT=VALUE", "--set")] = None,
    faults: Annotated[list[str] | None, option(
        "drop, delay, corrupt, duplicate or shorten frames: drop=585,count=2,after=10; delay=185,ms=5; repeatable.",
        "KIND=COBID,…", "--fault")] = None,
    serial: Annotated[int | None, option("Serial number, 1018:04.", "NUMBER")] = None,
    store: Annotated[Path | None, option("File of what 0x1010 and LSS store.", "FILE")] = None,
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
    keyed("--set", settings, "OBJECT=VALUE; write for instance 6064=1000", made.set_text)
    counted = keyed("--fault", faults, "KIND=COBID with count=N, after=N, and ms=, bit= or size= for delay, corrupt "
                    "and shorten; write for instance drop=585,count=2", own_bus.faults.add)
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


@node.command(example="bowden node export -o bus.yml && bowden node apply bus.yml")
def apply(
    file: Annotated[Path, argument("FILE", "bus.yml of ros2_canopen.")], reached: Bus, force: Force = False,
) -> CommandAnswer:
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
