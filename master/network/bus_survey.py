"""Survey of a bus by listening: its load, its errors, its nodes, whether they are the expected ones, other masters.

Nothing is sent but SDO reads of identities (0x1000, 0x1018); no node changes its state.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import can

from eds.bench.bench_network import MASTER, WireLayout
from eds.bench.bus_load import frame_bits
from eds.cia301 import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID, NmtState
from master.network.bringup import BringUpError, identify
from master.network.doctor import DoctorFinding
from master.network.link import Link
from master.network.sdo import SdoError

SURVEY_NS: Final = 1_000_000_000
LISTEN_NS: Final = 1_200_000_000
"""Time for which another master is listened for: longer than the heartbeat of 1 s that most masters send."""
_DEVICE_TYPE: Final = 0x1000
_RPDOS: Final = (0x200, 0x300, 0x400, 0x500)
"""Bases of the predefined RPDO identifiers 1 to 4 (CiA 301, 7.3.3)."""


def bus(link: Link, wire: WireLayout, listen_ns: int = SURVEY_NS) -> Iterator[DoctorFinding]:
    """Listen, then read each node's identity; raises `LinkError` if the interface fails."""
    bits, frames, before = 0, 0, link.controller.count
    rival: str | None = None
    for message in link.listen(listen_ns):
        rival = rival or master_sign(message)
        bits += frame_bits(len(message.data))
        frames += 1
    load = 100.0 * bits / (wire.network.bitrate * listen_ns * 1e-9)
    yield DoctorFinding("bus load", load <= 80.0, f"{load:.1f} % at most, {frames} frames in {listen_ns * 1e-9:g} s",
                        "find who talks so much: candump -td can0")
    errors, told = link.controller.count - before, [event.text for event in link.controller.events]
    yield DoctorFinding("error frames", not errors, "; ".join((f"{errors} in {listen_ns * 1e-9:g} s", *told)),
                        "check termination (60 Ω), wiring, ground and that every node has the same bit rate")
    yield DoctorFinding("other masters", rival is None, "none" if rival is None else f"one is there: {rival}",
                        "stop the other master first")
    for node_id in sorted(wire.nodes):
        yield _node(link, wire, node_id)
    for node_id in sorted(set(link.beats) - set(wire.nodes) - {MASTER}):
        yield DoctorFinding(f"node {node_id}", False, "beats, but is none of the bench's nodes",
                            "give it another bus, or mend node ids")


def _node(link: Link, wire: WireLayout, node_id: int) -> DoctorFinding:
    entry = wire.nodes[node_id]
    what = f"{entry.name} (node {node_id})"
    beat = link.beats.get(node_id)
    state = "no heartbeat" if beat is None else _named(beat.state)
    try:
        link.sdo_read(node_id, _DEVICE_TYPE)
        serial = identify(link, entry)
    except SdoError as error:
        return DoctorFinding(what, False, f"{state}; {error}",
                             "check its supply, its node id, its bit rate and the wiring")
    except BringUpError as error:
        return DoctorFinding(what, False, f"{state}; {error}", "connect that device, or name its EDS in bench.toml")
    described = entry.dictionary.path.rsplit("/", 1)[-1]
    return DoctorFinding(what, True, f"{state}; as {described} says, serial number {serial}")


def master_sign(message: can.Message) -> str | None:
    """Return in words what in a frame shows another master: its heartbeat, NMT, SDO requests, SYNC or RPDOs."""
    can_id = message.arbitration_id
    if can_id == HEARTBEAT_BASE + MASTER:
        return f"its heartbeat {can_id:X}h is on the bus"
    if not message.is_rx:
        return None
    if can_id == NMT_COB_ID:
        return "it sends NMT commands"
    if SDO_REQUEST_BASE < can_id <= SDO_REQUEST_BASE + 127:
        return f"it sends SDO requests to node {can_id - SDO_REQUEST_BASE}"
    if can_id == SYNC_COB_ID:
        return "it sends SYNC"
    node_id = can_id & 0x7F
    if node_id and can_id - node_id in _RPDOS:
        return f"it sends RPDO {can_id:X}h to node {node_id}"
    return None


def other_master(link: Link) -> str | None:
    """Listen for 1.2 s; return in words what shows that another master is on the bus, None where nothing does.

    A heartbeat of a node that answers no SDO counts, too, if its state allows SDO: masters are seldom SDO servers.
    """
    before = set(link.beats)
    for message in link.listen(LISTEN_NS):
        if (sign := master_sign(message)) is not None:
            return sign
    for node_id in sorted(set(link.beats) - before):
        if link.beats[node_id].state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL):
            try:
                link.sdo_read(node_id, _DEVICE_TYPE)
            except SdoError as error:
                if error.code is None:
                    return f"node {node_id} has a heartbeat and answers no SDO"
    return None


def _named(state: int) -> str:
    known = {int(s): s.name for s in NmtState} | {0: "booted"}
    return known.get(state, f"state {state}").replace("_", "-")
