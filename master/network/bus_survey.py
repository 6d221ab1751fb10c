"""Survey of a bus by listening: its load, its errors, its nodes, and whether they are the expected ones.

Nothing is sent but SDO reads of identities (0x1000, 0x1018); no node changes its state.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from eds.bench.bench_network import MASTER, WireLayout
from eds.bench.bus_load import frame_bits
from eds.cia301 import NmtState
from master.network.bringup import BringUpError, identify
from master.network.doctor import DoctorFinding
from master.network.link import Link
from master.network.sdo import SdoError

LISTEN_NS: Final = 1_000_000_000
_DEVICE_TYPE: Final = 0x1000


def bus(link: Link, wire: WireLayout, listen_ns: int = LISTEN_NS) -> Iterator[DoctorFinding]:
    """Listen, then read each node's identity; raises `LinkError` if the interface fails."""
    link.rivals.clear()
    bits, frames, before = 0, 0, link.errors
    for message in link.listen(listen_ns):
        bits += frame_bits(len(message.data))
        frames += 1
    load = 100.0 * bits / (wire.network.bitrate * listen_ns * 1e-9)
    yield DoctorFinding("bus load", load <= 80.0, f"{load:.1f} % at most, {frames} frames in {listen_ns * 1e-9:g} s",
                        "find who talks so much: candump -td can0")
    errors = link.errors - before
    yield DoctorFinding("error frames", not errors, f"{errors} in {listen_ns * 1e-9:g} s",
                        "check termination (60 Ω), wiring, ground and that every node has the same bit rate")
    rival = bool(link.rivals) or MASTER in link.beats
    yield DoctorFinding(
        "other masters", not rival, f"one is there (node {MASTER} or NMT commands)" if rival else "none",
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


def _named(state: int) -> str:
    known = {int(s): s.name for s in NmtState} | {0: "booted"}
    return known.get(state, f"state {state}").replace("_", "-")
