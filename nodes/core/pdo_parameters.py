"""Rules for writing PDO parameters by SDO: 0x1400–, 0x1600–, 0x1800–, 0x1A00– (CiA 301, 7.5.2.35–38).

The order is disable (bit 31), sub-index 0 := 0, entries, sub-index 0 := n, enable; whatever departs from it is
refused, and a write that changes nothing is not a departure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING

from eds.cia301 import SYNC_MAX, Abort, pdo_type_allowed
from eds.datatype import Value
from eds.dictionary import Entry, key
from eds.pdo_plan import FIRST_OBJECT, MAX_BITS, PdoPlan, compile_plan
from nodes.core import cob_id
from nodes.core.objects import Objects
from nodes.core.parts import Check
from parameters import InputError

if TYPE_CHECKING:
    from nodes.core.device import Device

_RPDO_ACCESS = frozenset({"wo", "rw", "rww"})
_TPDO_ACCESS = frozenset({"ro", "rw", "rwr", "const"})


def word_refused(objects: Objects, word: int, receive: bool) -> Abort | None:
    """Return the abort for one mapping word (index << 16 | sub-index << 8 | bits), None if it may be mapped."""
    at = word >> 8
    if at >> 8 >= FIRST_OBJECT:
        missing = objects.missing(at)
        if missing:
            return missing
        entry = objects.entries[at]
        if not entry.mappable or entry.access not in (_RPDO_ACCESS if receive else _TPDO_ACCESS):
            return Abort.NOT_MAPPABLE
    elif not receive or at & 0xFF:
        return Abort.NOT_MAPPABLE
    try:
        compile_plan(objects.dictionary, (word,), 0)
    except InputError:
        return Abort.NOT_MAPPABLE
    return None


def mapping_refused(objects: Objects, words: Sequence[int], receive: bool) -> Abort | None:
    """Return the abort for a whole mapping, None if it may be used."""
    for word in words:
        refusal = word_refused(objects, word, receive)
        if refusal:
            return refusal
    return Abort.PDO_LENGTH if sum(word & 0xFF for word in words) > MAX_BITS else None


def packer(plan: PdoPlan) -> Callable[[dict[int, Value]], bytes]:
    """Return the function that packs a TPDO from the values of a device."""
    pack, keys = plan.pack, plan.keys
    if not keys:
        return lambda values: pack()
    if len(keys) == 1:
        only = keys[0]
        return lambda values: pack(values[only])
    pick = itemgetter(*keys)
    return lambda values: pack(*pick(values))


def process_output(entry: Entry) -> bool:
    """Return whether an RPDO may write `entry`: it is process data then, not a parameter."""
    return entry.mappable and entry.access in _RPDO_ACCESS


def mapping_words(objects: Objects, index: int) -> tuple[int, ...]:
    """Return the mapping words in force at 0x16xx or 0x1Axx."""
    return tuple(objects.number(key(index, sub)) for sub in range(1, min(objects.number(key(index)), 64) + 1))


def rule(device: Device, index: int) -> Check:
    """Return the check of one communication or mapping parameter of `device`."""
    check = _mapping if index & 0x200 else _communication
    return lambda subindex, value: check(device, index, subindex, int(value))


def _communication(device: Device, index: int, subindex: int, value: int) -> Abort | None:
    objects = device.objects
    if subindex == 1:
        # a PDO without a mapping could only be enabled by mistake (decision 11)
        if cob_id.exists(value) and not objects.number(key(index + 0x200)):
            return Abort.INVALID_VALUE
        return cob_id.check(device, key(index, 1), value)
    if subindex == 2:
        return None if pdo_type_allowed(value) else Abort.INVALID_VALUE
    # inhibit time and SYNC start value change only while the PDO does not exist (CiA 301, 7.5.2.37)
    if subindex in (3, 6) and _exists(objects, index) and value != objects.number(key(index, subindex)):
        return Abort.INVALID_VALUE
    return Abort.INVALID_VALUE if subindex == 6 and value > SYNC_MAX else None


def _mapping(device: Device, index: int, subindex: int, value: int) -> Abort | None:
    objects = device.objects
    # a master that writes its configuration twice is not wrong (decision 11)
    if value == objects.number(key(index, subindex)):
        return None
    if _exists(objects, index - 0x200) or (subindex and objects.number(key(index))):
        return Abort.INVALID_VALUE
    receive = index < 0x1A00
    if subindex:
        return word_refused(objects, value, receive) if value else None
    if value and key(index, value) not in objects.entries:
        return Abort.PDO_LENGTH
    return mapping_refused(objects, [objects.number(key(index, sub)) for sub in range(1, value + 1)], receive)


def _exists(objects: Objects, index: int) -> bool:
    return cob_id.exists(objects.number(key(index, 1)))
