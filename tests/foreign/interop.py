"""Interoperability of CANopen stacks: each service, both ways, tried on the virtual bus; writes docs/interop.md.

`python -m tests.foreign.interop` needs npm's canopen, which `.ci/nightly` installs.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import logging
from collections.abc import Callable, Iterator
from typing import Any, Final

import canopen

from benchmarks.frame import DOCS, filled, markdown
from bowden.bench.buses import clock_of
from bowden.testing import CanBus
from eds.cia301 import Abort, NmtCommand
from eds.cia305 import LssAddress
from eds.dictionary import packaged, read
from master.network.link import Link
from master.network.sdo import SdoError
from master.node_access import pdo_settings
from master.node_access.lss_master import LssMaster, LssRefusalError
from tests.foreign.peers import MODULES, CanopenLocalNode, NpmNode
from tests.virtual_bus.test_virtual_python_can_suite import DIFFERENT, NAMES

PAGE: Final = DOCS / "interop.md"
NODE: Final = 5
NAME: Final = b"Bowden knee drive"
IDENTITY: Final = LssAddress(0xB0DE00, 2, 0x10000, 0)


Service = tuple[str, Callable[[Any], object]]
"""Reason of a cell if the service fails, and a function that returns whether it works."""


class LackingError(Exception):
    """A master lacks a service."""


# ---- devices: our master asks each of them ----


class DeviceOnBus:
    """A device as node 5, and our link; `emcy` and `change` let it send an EMCY and change its statusword."""

    def __init__(self, bus: CanBus, emcy: Callable[[], object], change: Callable[[], object]) -> None:
        self.bus, self.emcy, self.change = bus, emcy, change
        opened = bus.open()
        self.link = Link(opened, clock_of(opened), heartbeat_ms=None)
        bus.run(0.01)

    def frames_after(self, act: Callable[[], object], cob_id: int, seconds: float = 0.1) -> list[Any]:
        """Return the frames of an identifier that follow an action."""
        since = self.bus.now_ns
        act()
        self.link.wait(round(seconds * 1e9))
        return self.bus.frames(cob_id, since_ns=since)

    def nmt(self, command: NmtCommand) -> None:
        """Command the device's NMT state."""
        self.link.nmt(command, NODE)
        self.link.wait(1_000_000)


@contextlib.contextmanager
def our_device() -> Iterator[DeviceOnBus]:
    """Our device core behind the knee drive's EDS."""
    bus = CanBus()
    node = bus.add_node("knee_drive", NODE)
    yield DeviceOnBus(bus, lambda: node.emergency(0x4310, 8), lambda: node.__setitem__(0x6041, 0x21))


@contextlib.contextmanager
def canopen_device() -> Iterator[DeviceOnBus]:
    """python canopen's `LocalNode`."""
    bus = CanBus()
    peer = CanopenLocalNode(bus, NODE)
    yield DeviceOnBus(bus, lambda: peer.node.emcy.send(0x4310, 8),
                      lambda: peer.node.sdo[0x6041].__setattr__("raw", 0x21))


@contextlib.contextmanager
def npm_device() -> Iterator[DeviceOnBus]:
    """npm canopen's `Device`."""
    bus = CanBus()
    peer = NpmNode(bus, NODE)
    try:
        yield DeviceOnBus(bus, lambda: peer.call("device.emcy.write(0x4310)"),
                          lambda: peer.call("device.setValue(0x6041, 0x21)"))
    finally:
        peer.close()


def device_boots(on: DeviceOnBus) -> object:
    booted = on.frames_after(lambda: on.nmt(NmtCommand.RESET_COMMUNICATION), 0x700 + NODE)
    return booted and booted[0].data == b"\0"


def device_gates_sdo(on: DeviceOnBus) -> object:
    on.nmt(NmtCommand.STOP)
    with contextlib.suppress(SdoError):
        on.link.sdo_read(NODE, 0x1000)
        return False
    on.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    return on.link.sdo_read(NODE, 0x1000)


def device_beats(on: DeviceOnBus) -> object:
    beats = on.frames_after(lambda: on.link.sdo_write(NODE, 0x1017, 0, b"\x64\0"), 0x700 + NODE, 0.55)
    return len(beats) >= 5 and beats[-1].data == b"\x7f"


def device_keeps(on: DeviceOnBus, value: int, **options: bool) -> object:
    on.link.sdo_write(NODE, 0x6065, 0, value.to_bytes(4, "little"), **options)
    return on.link.sdo_read(NODE, 0x6065) == value.to_bytes(4, "little")


def device_uploads_blocks(on: DeviceOnBus) -> object:
    since = on.bus.now_ns
    with contextlib.suppress(SdoError):
        on.link.sdo_read(NODE, 0x1008, block=True)
    return on.bus.frames(0x580 + NODE, since_ns=since)[0].data[0] >> 5 == 6


def device_aborts(on: DeviceOnBus) -> object:
    for index, code in ((0x9999, Abort.NO_OBJECT), (0x1018, Abort.READ_ONLY)):
        try:
            on.link.sdo_write(NODE, index, int(index == 0x1018), bytes(4))
        except SdoError as error:
            if f"{code:08X}" in str(error).upper():
                continue
        return False
    return True


def device_sends_on_change(on: DeviceOnBus) -> object:
    on.nmt(NmtCommand.START)
    sent = on.frames_after(on.change, 0x180 + NODE, 0.02)
    return sent and sent[-1].data[:1] == b"\x21"


def device_sends_on_sync(on: DeviceOnBus) -> object:
    on.link.sdo_write(NODE, 0x1800, 1, (0xC0000000 | 0x180 + NODE).to_bytes(4, "little"))
    on.link.sdo_write(NODE, 0x1800, 2, b"\x01")
    on.link.sdo_write(NODE, 0x1800, 1, (0x40000000 | 0x180 + NODE).to_bytes(4, "little"))
    on.nmt(NmtCommand.START)
    return len(on.frames_after(lambda: on.link.send(0x80, b""), 0x180 + NODE, 0.02)) == 1


def device_receives(on: DeviceOnBus) -> object:
    on.nmt(NmtCommand.START)
    on.link.send(0x200 + NODE, b"\x06\0")
    on.link.wait(1_000_000)
    return on.link.sdo_read(NODE, 0x6040) == b"\x06\0"


def device_maps(on: DeviceOnBus) -> object:
    words = pdo_settings.words("6041,6064", read(packaged("knee_drive"), NODE))
    pdo_settings.configure(on.link, NODE, 0x1800, words)
    on.nmt(NmtCommand.START)
    sent = on.frames_after(on.change, 0x180 + NODE, 0.02)
    return not sent or len(sent[-1].data) == 6


def device_reports(on: DeviceOnBus) -> object:
    sent = on.frames_after(on.emcy, 0x80 + NODE, 0.02)
    return sent and sent[0].data[:2] == b"\x10\x43" and on.link.sdo_read(NODE, 0x1001) != b"\0"


def device_stores(on: DeviceOnBus) -> object:
    device_keeps(on, 2000)
    on.link.sdo_write(NODE, 0x1010, 1, b"save")
    device_keeps(on, 9)
    on.nmt(NmtCommand.RESET_NODE)
    on.link.wait(100_000_000)
    return on.link.sdo_read(NODE, 0x6065) == (2000).to_bytes(4, "little")


def device_is_selected(on: DeviceOnBus) -> object:
    master = LssMaster(on.link)
    return master.select(IDENTITY) and master.node_id() == NODE


def device_stores_bit_timing(on: DeviceOnBus) -> object:
    master = LssMaster(on.link)
    master.configure_all(True)
    master.configure_bitrate(500_000)
    master.store()
    return True


# ---- masters: each of them asks our device ----


class MasterOnBus:
    """A master on the bus of our knee drive, as the functions that a service needs."""

    def __init__(self, bus: CanBus, node: Any, **does: Callable[..., Any]) -> None:
        self.bus, self.node, self.does = bus, node, does

    def __call__(self, what: str, *given: Any) -> Any:
        if what not in self.does:
            raise LackingError("has no such service")
        return self.does[what](*given)


@contextlib.contextmanager
def our_master(node_id: int = NODE) -> Iterator[MasterOnBus]:
    """Our link and LSS master."""
    bus = CanBus()
    node = bus.add_node("knee_drive", node_id)
    opened = bus.open()
    link = Link(opened, clock_of(opened), heartbeat_ms=None)
    lss = LssMaster(link)
    yield MasterOnBus(bus, node,
        start=lambda: (link.nmt(NmtCommand.START, NODE), link.wait(1_000_000)),
        boot_up=lambda: (link.nmt(NmtCommand.RESET_NODE, NODE), link.await_state(NODE, 0, 10**9))[1],
        state=lambda: (link.wait(300_000_000), link.beats[NODE].state)[1],
        read=lambda index, sub, block: link.sdo_read(NODE, index, sub, block=block),
        write=lambda index, data, block: link.sdo_write(NODE, index, 0, data, block=block),
        pdo=lambda: link.send(0x200 + NODE, b"\x06\0"), sync=lambda: (link.sync_start(10_000_000), link.wait(10**8)),
        received=lambda act: _link_received(link, act), emcy=lambda act: _link_emcy(link, act),
        fastscan=lambda: [*(lss.fastscan() or ())], assign=lambda new: (lss.configure_node_id(new), lss.booted(new))[1],
        select=lambda: lss.select(IDENTITY))


def _link_received(link: Link, act: Callable[[], object]) -> bytes | None:
    act()
    deadline = link.clock() + 10**8
    while (message := link.receive(deadline)) is not None:
        if message.arbitration_id == 0x180 + NODE:
            return bytes(message.data)
    return None


def _link_emcy(link: Link, act: Callable[[], object]) -> int:
    act()
    link.wait(10**7)
    return link.emergencies[-1].code


@contextlib.contextmanager
def canopen_master(node_id: int = NODE) -> Iterator[MasterOnBus]:
    """python canopen's `Network`, its waits in bus time."""
    bus = CanBus()
    node = bus.add_node("knee_drive", node_id)
    with bus.virtual_time():
        network = canopen.Network(bus.open())
        remote = network.add_node(NODE, str(packaged("knee_drive")))

        def received(act: Callable[[], object]) -> bytes:
            remote.tpdo.read()
            act()
            remote.tpdo[1].wait_for_reception(timeout=1)
            return bytes(remote.tpdo[1].data)

        def read(index: int, sub: int, block: bool) -> bytes:
            with remote.sdo.open(index, sub, "rb", block_transfer=block) as stream:
                return bytes(stream.read())

        def write(index: int, data: bytes, block: bool) -> None:
            with remote.sdo.open(index, 0, "wb", size=len(data), block_transfer=block) as stream:
                stream.write(data)

        lss = network.lss
        yield MasterOnBus(bus, node,
            start=lambda: (remote.nmt.send_command(1), bus.run(0.001)), read=read, write=write, received=received,
            boot_up=lambda: (remote.nmt.send_command(129), remote.nmt.wait_for_bootup(timeout=1), True)[-1],
            state=lambda: {"PRE-OPERATIONAL": 127}.get(remote.nmt.wait_for_heartbeat(timeout=1)),
            pdo=lambda: (remote.rpdo.read(), remote.rpdo[1][0].__setattr__("raw", 6), remote.rpdo[1].transmit()),
            sync=lambda: (network.sync.start(0.01), bus.run(0.1), network.sync.stop()),
            emcy=lambda act: (act(), bus.run(0.01), remote.emcy.wait(timeout=0.01) if not remote.emcy.log
                              else remote.emcy.log[-1])[-1].code,
            fastscan=lambda: lss.fast_scan()[1],
            assign=lambda new: (lss.configure_node_id(new), lss.send_switch_state_global(0), bus.run(0.01), True)[-1],
            select=lambda: lss.send_switch_state_selective(*IDENTITY))
        network.disconnect()


@contextlib.contextmanager
def npm_master(node_id: int = NODE) -> Iterator[MasterOnBus]:
    """npm canopen's `Device` as node 1 without an EDS, its timers in bus time."""
    bus = CanBus()
    node = bus.add_node("knee_drive", node_id)
    peer = NpmNode(bus, 1, None)
    call = peer.call
    call("device.nmt.setState(canopen.NmtState.OPERATIONAL);"
         "device.eds.addSdoClientParameter(5, 0x605, 0x585); device.eds.addHeartbeatConsumer(5, 300);"
         "device.eds.addEmcyConsumer(0x85); globalThis.errors = [];"
         "device.emcy.on('emergency', ({ em }) => errors.push(em.code));")

    def read(index: int, sub: int, block: bool) -> bytes:
        return bytes.fromhex(call(
            f"const read = await device.sdo.upload({{serverId: 5, index: {index}, subIndex: {sub}, timeout: 200,"
            f" blockTransfer: {json.dumps(block)}}}); return read.toString('hex');"))

    def write(index: int, data: bytes, block: bool) -> None:
        call(f"await device.sdo.download({{serverId: 5, index: {index}, timeout: 200, data: "
             f"Buffer.from('{data.hex()}', 'hex'), blockTransfer: {json.dumps(block)}}});")

    def received(act: Callable[[], object]) -> bytes:
        call("const word = device.eds.addEntry(0x2000, {parameterName: 'word', dataType: canopen.DataType.UNSIGNED16});"
             "device.eds.addReceivePdo({cobId: 0x185, transmissionType: 255, dataObjects: [word]});")
        act()
        bus.run(0.01)
        return int(call("return device.getValue(0x2000)")).to_bytes(2, "little")

    try:
        yield MasterOnBus(bus, node,
            start=lambda: call("device.nmt.startNode(5)"), read=read, write=write, received=received,
            state=lambda: call("return await device.nmt.getNodeState(5, 500)"),
            pdo=lambda: call(
                "const word = device.eds.addEntry(0x2001, {parameterName: 'command', defaultValue: 6,"
                "dataType: canopen.DataType.UNSIGNED16}); device.eds.addTransmitPdo({cobId: 0x205,"
                "transmissionType: 254, dataObjects: [word]}); device.pdo.write(0x205);"),
            sync=lambda: (call("device.eds.setSyncCobId(0x80); device.eds.setSyncCyclePeriod(10000);"
                               "device.eds.setSyncGenerationEnable(true);"), bus.run(0.1)),
            emcy=lambda act: (act(), bus.run(0.01), call("return errors.at(-1)"))[-1],
            fastscan=lambda: [*call("return await device.lss.fastscan()").values()],
            assign=lambda new: (call(f"await device.lss.configureNodeId({new}); device.lss.switchModeGlobal(0);"),
                                bus.run(0.01), True)[-1],
            select=lambda: (call(f"await device.lss.switchModeSelective({{vendorId: {IDENTITY.vendor}, productCode: 2,"
                                 f"revisionNumber: {IDENTITY.revision}, serialNumber: 0, timeout: 100}})"), True)[-1])
    finally:
        peer.close()


def master_starts(on: MasterOnBus) -> object:
    on("start")
    return on.node.state.name == "OPERATIONAL"


def master_follows_state(on: MasterOnBus) -> object:
    on("write", 0x1017, b"\x64\0", False)
    return on("state") == 127


def master_writes(on: MasterOnBus, value: int, block: bool) -> object:
    on("write", 0x6065, value.to_bytes(4, "little"), block)
    return on.node[0x6065] == value


def master_reports_abort(on: MasterOnBus) -> object:
    try:
        on("read", 0x9999, 0, False)
    except LackingError:
        raise
    except Exception as error:
        text = f"{error} {getattr(error, 'code', '')}".lower()
        return "06020000" in text or "not exist" in text or str(0x06020000) in text
    return False


def master_receives(on: MasterOnBus) -> object:
    on("start")
    return on("received", lambda: on.node.__setitem__(0x6041, 0x21))[:1] == b"\x21"


def master_sends(on: MasterOnBus) -> object:
    on("start")
    on("pdo")
    on.bus.run(0.001)
    return on.node[0x6040] == 6


def master_sends_sync(on: MasterOnBus) -> object:
    since = on.bus.now_ns
    on("sync")
    return len(on.bus.frames(0x80, since_ns=since)) >= 8


def master_scans(on: MasterOnBus) -> object:
    return on("fastscan") == [*IDENTITY] and on("assign", NODE) and on.node.node_id == NODE


DEVICES: Final = {"bowden": our_device, "canopen (Python)": canopen_device, "canopen (npm)": npm_device}
DEVICE_SERVICES: Final[dict[str, Service]] = {
    "boot-up after NMT reset": ("sends no boot-up after a reset", device_boots),
    "NMT states gate SDO": ("answers SDO in STOPPED", device_gates_sdo),
    "heartbeat producer": ("sends no heartbeat of the period in 0x1017", device_beats),
    "SDO expedited": ("does not keep the value", lambda on: device_keeps(on, 2000)),
    "SDO segmented": ("reads another text", lambda on: on.link.sdo_read(NODE, 0x1008) == NAME),
    "SDO block upload": ("answers by the segmented transfer", device_uploads_blocks),
    "SDO block download": ("does not keep the value", lambda on: device_keeps(on, 3000, block=True)),
    "SDO abort codes": ("accepts the write, or refuses it with another code", device_aborts),
    "TPDO on change": ("sends no TPDO when a mapped object changes (type 255)", device_sends_on_change),
    "TPDO at SYNC": ("sends no TPDO at SYNC", device_sends_on_sync),
    "RPDO": ("an RPDO does not reach the dictionary", device_receives),
    "PDO mapping by SDO": ("sends the old mapping after a new one was written", device_maps),
    "EMCY and 0x1001": ("an EMCY does not set 0x1001", device_reports),
    "store 0x1010": ("0x1010 stores nothing", device_stores),
    "LSS selection": ("does not confirm its selection by identity (44h)", device_is_selected),
    "LSS bit timing and store": ("", device_stores_bit_timing),
}
MASTERS: Final = {"bowden": our_master, "canopen (Python)": canopen_master, "canopen (npm)": npm_master}
MASTER_SERVICES: Final[dict[str, Service]] = {
    "NMT commands": ("the command does not arrive", master_starts),
    "boot-up noticed": ("no boot-up is noticed", lambda on: on("boot_up")),
    "heartbeat consumer": ("does not report the state that the heartbeats carry", master_follows_state),
    "SDO expedited": ("another value arrives", lambda on: master_writes(on, 2000, False)),
    "SDO segmented": ("reads another text", lambda on: on("read", 0x1008, 0, False) == NAME),
    "SDO block upload": ("reads another text", lambda on: on("read", 0x1008, 0, True) == NAME),
    "SDO block download": ("another value arrives", lambda on: master_writes(on, 3000, True)),
    "SDO abort codes": ("does not report the abort", master_reports_abort),
    "TPDO received": ("no TPDO is received", master_receives),
    "RPDO sent": ("the RPDO does not arrive", master_sends),
    "SYNC producer": ("sends no SYNC of 10 ms", master_sends_sync),
    "EMCY consumer": ("no EMCY is noticed", lambda on: on("emcy", lambda: on.node.emergency(0x4310, 8)) == 0x4310),
    "LSS selection": ("the selection is not confirmed", lambda on: on("select")),
    "LSS fastscan and node id": ("finds another identity, or the device gets no node id", master_scans),
}


def cell(stack: Callable[..., Any], service: Service) -> str:
    """Try a service of a device or a master on a bus of its own; return "yes", or why it failed."""
    otherwise, works = service
    try:
        with stack(*((255,) if works is master_scans else ())) as on:
            return "yes" if works(on) else f"no: {otherwise}"
    except LackingError as reason:
        return f"no: {reason}"
    except (SdoError, LssRefusalError) as refused:
        return f"no: {str(refused).rpartition(': ')[2] or refused}"
    except Exception as error:
        return f"no: {type(error).__name__}: {error}".splitlines()[0].replace("|", "/")


def tables() -> dict[str, str]:
    """Return the tables of docs/interop.md by their marks."""
    logging.disable(logging.CRITICAL)
    npm = json.loads((MODULES / "canopen" / "package.json").read_text(encoding="utf-8"))["version"]
    version = importlib.metadata.version
    kinds = (("device", DEVICES, DEVICE_SERVICES), ("master", MASTERS, MASTER_SERVICES))
    return {
        "versions": (f"canopen {version('canopen')} (Python), canopen {npm} (npm), python-can {version('python-can')}"),
        **{kind: markdown((kind, *stacks), [  # type: ignore[misc]
            (name, *(cell(stack, service) for stack in stacks.values())) for name, service in services.items()])
           for kind, stacks, services in kinds},
        "python-can": markdown(("test", "bowden"), [
            (f"`{name}`", f"no: {DIFFERENT[name]}" if name in DIFFERENT else "yes") for name in NAMES])}


def main() -> None:
    """Write the tables of docs/interop.md and print the page."""
    text = filled(PAGE, tables())
    PAGE.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
