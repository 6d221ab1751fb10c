"""The operator's release of drives whose emergency stop (STO) was active.

The rule of this file: it is asked for by a person who has looked; it enables nothing, and a drive whose input is still
active refuses it.
"""

from typing import Final, NamedTuple

from eds.bench.bench_network import WireLayout
from eds.cia301 import Abort
from eds.dictionary import key
from master.network.bringup import BringUpError, refuse_rival
from master.network.link import Link
from master.network.sdo import SdoError

RELEASE: Final = 0x2020
"""Manufacturer object through which the operator releases a drive after an emergency stop (statusword bit 8)."""
SIGNATURE: Final = b"rels"


class DriveRelease(NamedTuple):
    """One drive: "released", "nothing to release", "still active" (free the input first) or "no such object"."""

    drive: str
    became: str


def acknowledge(link: Link, wire: WireLayout) -> list[DriveRelease]:
    """Release every drive that waits for it; raises `BringUpError` for another master, or a drive that is silent."""
    refuse_rival(link)
    return [DriveRelease(wire.nodes[node].name, _release(link, wire, node)) for node in wire.drives]


def _release(link: Link, wire: WireLayout, node: int) -> str:
    entry = wire.nodes[node]
    if key(RELEASE) not in entry.dictionary.entries:
        return "no such object"
    try:
        if not any(link.sdo_read(node, RELEASE)):
            return "nothing to release"
        link.sdo_write(node, RELEASE, 0, SIGNATURE)
    except SdoError as error:
        if f"0x{Abort.DEVICE_STATE:08X}" in str(error):
            return "still active"
        raise BringUpError(f"{entry.name} (node {node}): {error}; see bowden doctor.") from None
    return "released"
