"""Rules for writing PDO parameters by SDO: 0x1400–, 0x1600–, 0x1800–, 0x1A00– (CiA 301, 7.5.2.35–38).

The rule of this file: the order is disable (bit 31), sub-index 0 := 0, entries, sub-index 0 := n, enable; whatever
departs from it is refused, and a write that changes nothing is not a departure.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eds.cia301 import SYNC_MAX, Abort, pdo_type_allowed
from eds.dictionary import key
from nodes.core import cob_id
from nodes.core.objects import Objects
from nodes.core.parts import Check
from nodes.core.pdo.pdo_mapping import mapping_refused, word_refused

if TYPE_CHECKING:
    from nodes.core.device import Device


def words(objects: Objects, index: int) -> tuple[int, ...]:
    """Return the mapping words in force at 0x16xx or 0x1Axx."""
    return tuple(objects.number(key(index, sub)) for sub in range(1, min(objects.number(key(index)), 64) + 1))


class Rules:
    """The checks of one device's PDO parameters."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def check(self, index: int) -> Check:
        """Return the check of one communication or mapping parameter."""
        if index & 0x200:
            return lambda subindex, value: self._mapping(index, subindex, int(value))
        return lambda subindex, value: self._communication(index, subindex, int(value))

    def _communication(self, index: int, subindex: int, value: int) -> Abort | None:
        if subindex == 1:
            return self._cob_id(index, value)
        if subindex == 2:
            return None if pdo_type_allowed(value) else Abort.INVALID_VALUE
        if subindex in (3, 6) and self._exists(index) and value != self._device.objects.number(key(index, subindex)):
            return Abort.INVALID_VALUE
        return Abort.INVALID_VALUE if subindex == 6 and value > SYNC_MAX else None

    def _cob_id(self, index: int, new: int) -> Abort | None:
        objects, at = self._device.objects, key(index, 1)
        refusal = cob_id.check(objects.number(at), new)
        if refusal or not cob_id.exists(new):
            return refusal
        # a PDO without a mapping could only be enabled by mistake (decision 11)
        if not objects.number(key(index + 0x200)):
            return Abort.INVALID_VALUE
        return Abort.INCOMPATIBLE if self._device.taken(at, new & cob_id.CAN_ID) else None

    def _mapping(self, index: int, subindex: int, value: int) -> Abort | None:
        objects = self._device.objects
        # a master that writes its configuration twice is not wrong (decision 11)
        if value == objects.number(key(index, subindex)):
            return None
        if self._exists(index - 0x200) or (subindex and objects.number(key(index))):
            return Abort.INVALID_VALUE
        receive = index < 0x1A00
        if subindex:
            return word_refused(objects, value, receive) if value else None
        if value and key(index, value) not in objects.entries:
            return Abort.PDO_LENGTH
        return mapping_refused(objects, [objects.number(key(index, sub)) for sub in range(1, value + 1)], receive)

    def _exists(self, index: int) -> bool:
        return cob_id.exists(self._device.objects.number(key(index, 1)))
