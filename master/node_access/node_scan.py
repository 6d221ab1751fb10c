"""Nodes 1 to 127 of a bus: heartbeats heard, and the answers to one SDO read each."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from eds import dictionary
from eds.cia301 import SDO_REQUEST_BASE, SDO_RESPONSE_BASE
from eds.dictionary import PACKAGED, Dictionary, key, packaged
from eds.files.notation import number
from master.network.doctor import LISTEN_NS
from master.network.link import Link
from master.network.sdo import SdoError
from master.node_access.remote_node import MASTER, NodeAccess, state_name
from parameters import InputError

ASK_1000: Final = bytes((0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0))
ANSWER_NS: Final = 500_000_000
"""Time for the answers to all requests: more than the 0.3 s that a single one is given."""


class FoundNode(NamedTuple):
    """A node: NMT state (None: no heartbeat), identity (None: no SDO answer), and the EDS that fits it."""

    node_id: int
    state: str | None
    identity: Mapping[str, int] | None
    dictionary: Dictionary | None

    @property
    def name(self) -> str:
        """The product's name in its EDS; empty without one."""
        found = self.dictionary
        return "" if found is None else found.info.get("productname") or Path(found.path).stem


def scan(link: Link, files: Sequence[Path]) -> list[FoundNode]:
    """Listen for 1.2 s, ask every node id for 0x1000 at once, then those that answered for 0x1018."""
    for _ in link.listen(LISTEN_NS):
        pass
    asked = range(1, 128)
    for node_id in asked:
        link.forget_response(SDO_RESPONSE_BASE + node_id)
    for node_id in asked:
        link.send(SDO_REQUEST_BASE + node_id, ASK_1000)
    link.wait(ANSWER_NS)
    answered = {node_id for node_id in asked if SDO_RESPONSE_BASE + node_id in link.responses}
    heard = {node_id for node_id in link.beats if node_id in asked and node_id != MASTER}
    return [_found(link, node_id, node_id in answered, files) for node_id in sorted(answered | heard)]


def _found(link: Link, node_id: int, answers: bool, files: Sequence[Path]) -> FoundNode:
    beat = link.beats.get(node_id)
    identity = None
    if answers:
        try:
            identity = NodeAccess(link, node_id).identity()
        except SdoError:
            identity = None
    fits = None if identity is None else fitting(identity, files, node_id)
    return FoundNode(node_id, None if beat is None else state_name(beat.state), identity, fits)


def files_of(path: Path | None) -> list[Path]:
    """Return the EDS and DCF files of a folder, the file itself, or the packaged ones where none is named.

    Raises `InputError` for a folder without any.
    """
    if path is None:
        return [packaged(name) for name in PACKAGED]
    if not path.is_dir():
        return [path]
    found = sorted(each for each in path.iterdir() if each.suffix.lower() in (".eds", ".dcf"))
    if not found:
        raise InputError(f"{path}: has no .eds or .dcf file; give the folder of the devices' files.")
    return found


def fitting(identity: Mapping[str, int], files: Sequence[Path], node_id: int) -> Dictionary | None:
    """Return the first dictionary whose device type, vendor and product are the node's; None where none fits.

    A file that cannot be read does not fit. A file whose revision is the node's goes before one without.
    """
    best: tuple[int, Dictionary] | None = None
    for path in files:
        try:
            one = dictionary.read(path, node_id)
        except InputError:
            continue
        score = _score(one, identity)
        if score > 0 and (best is None or score > best[0]):
            best = score, one
    return None if best is None else best[1]


def _score(one: Dictionary, identity: Mapping[str, int]) -> int:
    """Return how many of vendor, product and revision agree; 0 where vendor or product differ or are not stated."""
    score = 0
    for sub, name, info in ((1, "vendor", "vendornumber"), (2, "product", "productnumber"), (3, "revision", "")):
        entry = one.entries.get(key(0x1018, sub))
        stated = entry.initial if entry is not None else 0
        if not stated and info in one.info:
            stated = number(one.info[info]) or 0
        if stated and stated == identity.get(name):
            score += 1
        elif name != "revision" and (stated or name == "product"):
            return 0
    return score
