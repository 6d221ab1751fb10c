"""PDO settings of any node: read with names, and changed in the order that CiA 301 asks for (7.5.2.36).

The rule of this file: a mapping that the node refuses is taken back, so that the PDO is as it was.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from eds.cia301 import COB_ID_INVALID
from eds.dictionary import Dictionary
from eds.dictionary import key as key_of
from master.network.link import Link
from master.network.sdo import SdoError
from master.node_access import object_text
from parameters import InputError

RPDO, TPDO = 0x1400, 0x1800
_NAME: Final = re.compile(r"([rt])pdo(\d{1,3})", re.IGNORECASE)
_OBJECT: Final = re.compile(r"(.*?)(?:/(\d{1,2}))?")
PARAMETERS: Final = {"cob_id": (1, 4), "type": (2, 1), "inhibit": (3, 2), "event_timer": (5, 2)}
"""Sub-index and bytes of the communication parameters; inhibit in 100 µs, event timer in ms."""
PROBED: Final = 8
"""PDOs of each direction that are looked for where no EDS lists them."""


def _transmission(kind: int) -> str:
    """Return a transmission type in words (CiA 301, table 70)."""
    if kind == 0:
        return "at SYNC after a change"
    if kind <= 240:
        return "every SYNC" if kind == 1 else f"every {kind} SYNCs"
    return "event-driven" if kind >= 254 else "on remote request"


class PdoState(NamedTuple):
    """One PDO: its communication parameters (None: absent) and its mapping words."""

    object: int
    parameters: Mapping[str, int | None]
    mapping: tuple[int, ...]

    @property
    def name(self) -> str:
        """Name of the PDO, such as tpdo1."""
        return f"{'t' if self.object >= TPDO else 'r'}pdo{(self.object & 0x1FF) + 1}"

    def in_words(self) -> str:
        """Return the communication parameters, such as "tpdo1  181h on, type 1 (every SYNC)"."""
        cob_id, kind, inhibit, timer = (self.parameters[name] for name in ("cob_id", "type", "inhibit", "event_timer"))
        state = "off" if (cob_id or 0) & COB_ID_INVALID else "on"
        return (f"{self.name}  {(cob_id or 0) & 0x7FF:03X}h {state}"
                + ("" if kind is None else f", type {kind} ({_transmission(kind)})")
                + (f", inhibit {inhibit / 10:g} ms" if inhibit else "")
                + (f", event timer {timer} ms" if timer else ""))

    @property
    def valid(self) -> bool:
        """True if the PDO is in use: bit 31 of its COB-ID is 0."""
        return not (self.parameters["cob_id"] or COB_ID_INVALID) & COB_ID_INVALID


def index_of(name: str) -> int:
    """Return the communication parameter's index of `tpdo1` or `rpdo4`; `InputError` for another word."""
    match = _NAME.fullmatch(name.strip())
    if match is None or not 1 <= int(match[2]) <= 512:
        raise InputError(f"{name!r}: is no PDO; give rpdo1 … rpdo512 or tpdo1 … tpdo512.")
    return (TPDO if match[1].lower() == "t" else RPDO) + int(match[2]) - 1


def words(text: str, dictionary: Dictionary | None) -> list[int]:
    """Return the mapping words of `6041,6064,6077`: objects of the EDS, or `6041/16` with the bits without an EDS.

    Raises `InputError` for an object that is not mappable, an unknown length, or more than 64 bits.
    """
    found = []
    for part in filter(None, (one.strip() for one in text.split(","))):
        match = _OBJECT.fullmatch(part)
        assert match is not None
        at = object_text.find(dictionary, match[1])
        entry = dictionary.entries.get(at) if dictionary is not None else None
        if dictionary is not None and at >> 8 >= 0x1000 and (entry is None or not entry.mappable):
            raise InputError(f"mapping {part}: {dictionary.path} has no mappable object {object_text.shown_key(at)}; "
                             "map another one.")
        bits = int(match[2]) if match[2] else entry.data_type.bits if entry is not None else 0
        if not 1 <= bits <= 64:
            raise InputError(f"mapping {part}: its length is not known; write {part}/BITS or give the device's EDS.")
        found.append(at << 8 | bits)
    if (total := sum(word & 0xFF for word in found)) > 64:
        raise InputError(f"mapping {text}: has {total} bits, a PDO holds 64; map less.")
    return found


def read(link: Link, node_id: int, index: int) -> PdoState | None:
    """Read one PDO's settings; None if the node lacks the PDO."""
    def number(at: int, sub: int) -> int | None:
        try:
            return int.from_bytes(link.sdo_read(node_id, at, sub), "little")
        except SdoError:
            return None

    cob_id = number(index, 1)
    if cob_id is None:
        return None
    settings = {name: number(index, sub) for name, (sub, _) in PARAMETERS.items()} | {"cob_id": cob_id}
    count = number(index + 0x200, 0) or 0
    mapped = [number(index + 0x200, sub) or 0 for sub in range(1, min(count, 64) + 1)]
    return PdoState(index, settings, tuple(mapped))


def read_all(link: Link, node_id: int, dictionary: Dictionary | None) -> Iterator[PdoState]:
    """Read the settings of every PDO that the EDS lists; without one, of the first `PROBED` of each direction."""
    for base in (RPDO, TPDO):
        listed = range(base, base + PROBED) if dictionary is None else [
            index for index in range(base, base + 0x200) if key_of(index, 1) in dictionary.entries]
        for index in listed:
            state = read(link, node_id, index)
            if state is not None:
                yield state


def configure(
    link: Link, node_id: int, index: int, mapping: Sequence[int] | None = None,
    parameters: Mapping[str, int] | None = None,
) -> PdoState:
    """Change a PDO: invalid by bit 31, parameters, count 0, mapping words, count, valid again; return the new state.

    Raises `InputError` where the node refuses a step; the PDO is then as before.
    """
    before = read(link, node_id, index)
    if before is None:
        raise InputError(f"node {node_id}: has no {PdoState(index, {}, ()).name}; bowden node pdo {node_id} lists its "
                         "PDOs.")
    given = dict(parameters or {})
    cob_id = given.pop("cob_id", before.parameters["cob_id"] or 0) & ~COB_ID_INVALID
    cob_id |= (before.parameters["cob_id"] or 0) & 0x40000000
    try:
        _write(link, node_id, index, before, before.mapping if mapping is None else mapping, given, cob_id,
               mapping is not None)
    except SdoError as error:
        old = {name: value for name, value in before.parameters.items() if name in given and value is not None}
        try:
            _write(link, node_id, index, before, before.mapping, old, before.parameters["cob_id"] or 0,
                   mapping is not None)
        except SdoError as again:
            raise InputError(f"{before.name}: {error}; taking it back failed too ({again}): the PDO is off.") from None
        raise InputError(f"{before.name}: {error}; the PDO is as it was.") from None
    after = read(link, node_id, index)
    assert after is not None
    return after


def _write(link: Link, node_id: int, index: int, before: PdoState, mapping: Sequence[int],
           parameters: Mapping[str, int], cob_id: int, remap: bool) -> None:
    old = before.parameters["cob_id"] or 0
    link.sdo_write(node_id, index, 1, (old | COB_ID_INVALID).to_bytes(4, "little"))
    for name, value in parameters.items():
        sub, size = PARAMETERS[name]
        link.sdo_write(node_id, index, sub, value.to_bytes(size, "little"))
    if remap:
        link.sdo_write(node_id, index + 0x200, 0, b"\0")
        for sub, word in enumerate(mapping, 1):
            link.sdo_write(node_id, index + 0x200, sub, word.to_bytes(4, "little"))
        link.sdo_write(node_id, index + 0x200, 0, bytes((len(mapping),)))
    link.sdo_write(node_id, index, 1, cob_id.to_bytes(4, "little"))
