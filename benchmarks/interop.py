"""Interoperability of CANopen stacks: each service, both ways, tried on the virtual bus; writes docs/interop.md.

`python -m benchmarks.interop` prints the page, `--write` writes it. npm's canopen is needed (of `.ci/nightly`).
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import canopen

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

PAGE: Final = Path(__file__).parents[1] / "docs" / "interop.md"
NODE: Final = 5
NAME: Final = b"Bowden knee drive"
IDENTITY: Final = LssAddress(0xB0DE00, 2, 0x10000, 0)


class LackingError(Exception):
    """A stack lacks a service; the text is the reason in the table."""


def demand(fulfilled: object, otherwise: str) -> None:
    """Raise `LackingError` with the reason where a demand is not fulfilled."""
    if not fulfilled:
        raise LackingError(otherwise)


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


def d_boot_up(on: DeviceOnBus) -> None:
    booted = on.frames_after(lambda: on.nmt(NmtCommand.RESET_COMMUNICATION), 0x700 + NODE)
    demand(booted and booted[0].data == b"\0", "sends no boot-up after a reset")


def d_nmt(on: DeviceOnBus) -> None:
    on.nmt(NmtCommand.STOP)
    with contextlib.suppress(SdoError):
        on.link.sdo_read(NODE, 0x1000)
        raise LackingError("answers SDO in STOPPED")
    on.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    on.link.sdo_read(NODE, 0x1000)


def d_heartbeat(on: DeviceOnBus) -> None:
    beats = on.frames_after(lambda: on.link.sdo_write(NODE, 0x1017, 0, b"\x64\0"), 0x700 + NODE, 0.55)
    demand(len(beats) >= 5 and beats[-1].data == b"\x7f", "sends no heartbeat of the period in 0x1017")


def d_expedited(on: DeviceOnBus) -> None:
    on.link.sdo_write(NODE, 0x6065, 0, (2000).to_bytes(4, "little"))
    demand(on.link.sdo_read(NODE, 0x6065) == (2000).to_bytes(4, "little"), "does not keep the value")


def d_segmented(on: DeviceOnBus) -> None:
    demand(on.link.sdo_read(NODE, 0x1008) == NAME, "reads another text")


def d_block_upload(on: DeviceOnBus) -> None:
    since = on.bus.now_ns
    with contextlib.suppress(SdoError):
        demand(on.link.sdo_read(NODE, 0x1008, block=True) == NAME, "reads another text")
    demand(on.bus.frames(0x580 + NODE, since_ns=since)[0].data[0] >> 5 == 6, "answers by the segmented transfer")


def d_block_download(on: DeviceOnBus) -> None:
    on.link.sdo_write(NODE, 0x6065, 0, (3000).to_bytes(4, "little"), block=True)
    demand(on.link.sdo_read(NODE, 0x6065) == (3000).to_bytes(4, "little"), "does not keep the value")


def d_abort(on: DeviceOnBus) -> None:
    for index, code in ((0x9999, Abort.NO_OBJECT), (0x1018, Abort.READ_ONLY)):
        try:
            on.link.sdo_write(NODE, index, int(index == 0x1018), bytes(4))
        except SdoError as error:
            demand(f"{code:08X}" in str(error).upper(), f"refuses with another code than {code:08X}h ({code.text})")
        else:
            raise LackingError(f"takes a write that {code:08X}h ({code.text}) refuses")


def d_tpdo_on_change(on: DeviceOnBus) -> None:
    on.nmt(NmtCommand.START)
    sent = on.frames_after(on.change, 0x180 + NODE, 0.02)
    demand(sent and sent[-1].data[:1] == b"\x21", "sends no TPDO when a mapped object changes (type 255)")


def d_tpdo_on_sync(on: DeviceOnBus) -> None:
    on.link.sdo_write(NODE, 0x1800, 1, (0xC0000000 | 0x180 + NODE).to_bytes(4, "little"))
    on.link.sdo_write(NODE, 0x1800, 2, b"\x01")
    on.link.sdo_write(NODE, 0x1800, 1, (0x40000000 | 0x180 + NODE).to_bytes(4, "little"))
    on.nmt(NmtCommand.START)
    demand(len(on.frames_after(lambda: on.link.send(0x80, b""), 0x180 + NODE, 0.02)) == 1, "sends no TPDO at SYNC")


def d_rpdo(on: DeviceOnBus) -> None:
    on.nmt(NmtCommand.START)
    on.link.send(0x200 + NODE, b"\x06\0")
    on.link.wait(1_000_000)
    demand(on.link.sdo_read(NODE, 0x6040) == b"\x06\0", "an RPDO does not reach the dictionary")


def d_mapping(on: DeviceOnBus) -> None:
    words = pdo_settings.words("6041,6064", read(packaged("knee_drive"), NODE))
    pdo_settings.configure(on.link, NODE, 0x1800, words)
    on.nmt(NmtCommand.START)
    sent = on.frames_after(on.change, 0x180 + NODE, 0.02)
    demand(not sent or len(sent[-1].data) == 6, "sends the old mapping after a new one was written")


def d_emcy(on: DeviceOnBus) -> None:
    sent = on.frames_after(on.emcy, 0x80 + NODE, 0.02)
    demand(sent and sent[0].data[:2] == b"\x10\x43", "sends no EMCY")
    demand(on.link.sdo_read(NODE, 0x1001) != b"\0", "an EMCY does not set 0x1001")


def d_store(on: DeviceOnBus) -> None:
    on.link.sdo_write(NODE, 0x6065, 0, (2000).to_bytes(4, "little"))
    on.link.sdo_write(NODE, 0x1010, 1, b"save")
    on.link.sdo_write(NODE, 0x6065, 0, (9).to_bytes(4, "little"))
    on.nmt(NmtCommand.RESET_NODE)
    on.link.wait(100_000_000)
    demand(on.link.sdo_read(NODE, 0x6065) == (2000).to_bytes(4, "little"), "0x1010 stores nothing")


def d_lss(on: DeviceOnBus) -> None:
    master = LssMaster(on.link)
    demand(master.select(IDENTITY), "does not confirm its selection by identity (44h)")
    demand(master.node_id() == NODE, "does not tell its node id")


def d_lss_store(on: DeviceOnBus) -> None:
    master = LssMaster(on.link)
    master.configure_all(True)
    master.configure_bitrate(500_000)
    master.store()


# ---- masters: each of them asks our device ----


class MasterOnBus:
    """A foreign or own master on the bus of our knee drive, node 5, as the functions that a service needs."""

    def __init__(self, **does: Callable[..., Any]) -> None:
        self.does = does

    def __call__(self, what: str, *given: Any) -> Any:
        if what not in self.does:
            raise LackingError("has no such service")
        return self.does[what](*given)


@contextlib.contextmanager
def our_master(node_id: int = NODE) -> Iterator[tuple[CanBus, Any, MasterOnBus]]:
    """Our link and LSS master."""
    bus = CanBus()
    node = bus.add_node("knee_drive", node_id)
    opened = bus.open()
    link = Link(opened, clock_of(opened), heartbeat_ms=None)
    lss = LssMaster(link)
    yield bus, node, MasterOnBus(
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
def canopen_master(node_id: int = NODE) -> Iterator[tuple[CanBus, Any, MasterOnBus]]:
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
        yield bus, node, MasterOnBus(
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
def npm_master(node_id: int = NODE) -> Iterator[tuple[CanBus, Any, MasterOnBus]]:
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
        yield bus, node, MasterOnBus(
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


def m_start(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    master("start")
    demand(node.state.name == "OPERATIONAL", "the command does not arrive")


def m_boot_up(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    demand(master("boot_up"), "no boot-up is noticed")


def m_heartbeat(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    master("write", 0x1017, b"\x64\0", False)
    demand(master("state") == 127, "does not tell the state that the heartbeats carry")


def m_expedited(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    master("write", 0x6065, (2000).to_bytes(4, "little"), False)
    demand(master("read", 0x6065, 0, False) == (2000).to_bytes(4, "little"), "reads another value")


def m_segmented(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    demand(master("read", 0x1008, 0, False) == NAME, "reads another text")


def m_block_upload(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    demand(master("read", 0x1008, 0, True) == NAME, "reads another text")


def m_block_download(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    master("write", 0x6065, (3000).to_bytes(4, "little"), True)
    demand(node[0x6065] == 3000, "another value arrives")


def m_abort(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    try:
        master("read", 0x9999, 0, False)
    except LackingError:
        raise
    except Exception as error:
        text = f"{error} {getattr(error, 'code', '')}".lower()
        demand("06020000" in text or "not exist" in text or str(0x06020000) in text, f"reports {error}")
        return
    raise LackingError("does not report the abort")


def m_tpdo(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    master("start")
    demand(master("received", lambda: node.__setitem__(0x6041, 0x21))[:1] == b"\x21", "no TPDO is received")


def m_rpdo(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    master("start")
    master("pdo")
    bus.run(0.001)
    demand(node[0x6040] == 6, "the RPDO does not arrive")


def m_sync(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    since = bus.now_ns
    master("sync")
    demand(len(bus.frames(0x80, since_ns=since)) >= 8, "sends no SYNC of 10 ms")


def m_emcy(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    demand(master("emcy", lambda: node.emergency(0x4310, 8)) == 0x4310, "no EMCY is noticed")


def m_select(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    demand(master("select"), "the selection is not confirmed")


def m_fastscan(bus: CanBus, node: Any, master: MasterOnBus) -> None:
    demand(master("fastscan") == [*IDENTITY], "finds another identity")
    demand(master("assign", NODE) and node.node_id == NODE, "the device gets no node id")


DEVICES: Final = {"bowden": our_device, "canopen (Python)": canopen_device, "canopen (npm)": npm_device}
DEVICE_SERVICES: Final = {
    "boot-up after NMT reset": d_boot_up, "NMT states gate SDO": d_nmt, "heartbeat producer": d_heartbeat,
    "SDO expedited": d_expedited, "SDO segmented": d_segmented, "SDO block upload": d_block_upload,
    "SDO block download": d_block_download, "SDO abort codes": d_abort, "TPDO on change": d_tpdo_on_change,
    "TPDO at SYNC": d_tpdo_on_sync, "RPDO": d_rpdo, "PDO mapping by SDO": d_mapping, "EMCY and 0x1001": d_emcy,
    "store 0x1010": d_store, "LSS selection": d_lss, "LSS bit timing and store": d_lss_store,
}
MASTERS: Final = {"bowden": our_master, "canopen (Python)": canopen_master, "canopen (npm)": npm_master}
MASTER_SERVICES: Final = {
    "NMT commands": m_start, "boot-up noticed": m_boot_up, "heartbeat consumer": m_heartbeat,
    "SDO expedited": m_expedited, "SDO segmented": m_segmented, "SDO block upload": m_block_upload,
    "SDO block download": m_block_download, "SDO abort codes": m_abort, "TPDO received": m_tpdo,
    "RPDO sent": m_rpdo, "SYNC producer": m_sync, "EMCY consumer": m_emcy, "LSS selection": m_select,
    "LSS fastscan and node id": m_fastscan,
}


def outcome(tried: Callable[[], object]) -> str:
    """Return "yes", or the reason why a service failed."""
    try:
        tried()
    except LackingError as reason:
        return f"no: {reason}"
    except (SdoError, LssRefusalError) as refused:
        return f"no: {str(refused).rpartition(': ')[2] or refused}"
    except Exception as error:
        return f"no: {type(error).__name__}: {error}".splitlines()[0].replace("|", "/")
    return "yes"


def device_cell(device: Callable[[], Any], service: Callable[[DeviceOnBus], None]) -> str:
    """Try a service of a device on a bus of its own."""
    def tried() -> None:
        with device() as on:
            service(on)

    return outcome(tried)


def master_cell(master: Callable[..., Any], service: Callable[[CanBus, Any, MasterOnBus], None]) -> str:
    """Try a service of a master on a bus of its own."""
    def tried() -> None:
        with master(*((255,) if service is m_fastscan else ())) as (bus, node, on):
            service(bus, node, on)

    return outcome(tried)


def table(head: str, stacks: dict[str, Any], services: dict[str, Any], cell: Callable[[Any, Any], str]) -> list[str]:
    """Return the Markdown lines of a table of services by stacks."""
    return [f"| {head} | {' | '.join(stacks)} |", "|---|" + "---|" * len(stacks),
            *(f"| {name} | {' | '.join(cell(stack, service) for stack in stacks.values())} |"
              for name, service in services.items())]


def page() -> str:
    """Return the page."""
    logging.disable(logging.CRITICAL)
    npm = json.loads((MODULES / "canopen" / "package.json").read_text(encoding="utf-8"))["version"]
    versions = f"canopen {importlib.metadata.version('canopen')} (Python), canopen {npm} (npm)"
    return "\n".join([
        "# Interoperability", "",
        "```console", "$ python -m benchmarks.interop --write", "```", "",
        f"The command writes this page. Each cell is tried on the virtual bus with {versions} and",
        f"python-can {importlib.metadata.version('python-can')}. A cell that is not \"yes\" gives the reason.", "",
        "## Devices, asked by our master", "",
        *table("device", DEVICES, DEVICE_SERVICES, device_cell), "",
        "## Masters, which ask our device", "",
        *table("master", MASTERS, MASTER_SERVICES, master_cell), "",
        "## python-can's own tests of two buses on one wire, on ours", "",
        "`tests/virtual_bus/test_virtual_python_can_suite.py` runs them from python-can's source distribution.", "",
        "| test | bowden |", "|---|---|",
        *(f"| `{name}` | {'no: ' + DIFFERENT[name] if name in DIFFERENT else 'yes'} |" for name in NAMES), ""])


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/interop.md")
    text = page()
    if parser.parse_args().write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
