"""COB-ID objects: which identifiers a device may be given, and when.

The rule of this file: an identifier changes only while its object does not exist, and never to one that CiA 301
reserves or that this device already uses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from eds.cia301 import COB_ID_EXTENDED, COB_ID_INVALID, COB_ID_NO_RTR, Abort, restricted

if TYPE_CHECKING:
    from nodes.core.device import Device
    from nodes.core.objects import Objects

CAN_ID: Final = 0x7FF
INVALID: Final = COB_ID_INVALID
_EXTENDED_BITS: Final = 0x1FFFF800
_IDENTITY: Final = COB_ID_EXTENDED | _EXTENDED_BITS | CAN_ID


def exists(cob_id: int) -> bool:
    """Return whether an EMCY or PDO COB-ID entry is valid."""
    return not cob_id & COB_ID_INVALID


def in_use(objects: Objects, at: int) -> int:
    """Return the identifier of the EMCY or PDO COB-ID at key `at`; 0 while it is invalid or absent."""
    word = objects.number(at, INVALID)
    return word & CAN_ID if exists(word) else 0


def check(device: Device, at: int, new: int) -> Abort | None:
    """Return the abort for writing `new` to the EMCY or PDO COB-ID at key `at`, else None."""
    old = device.objects.number(at)
    if new & (COB_ID_EXTENDED | _EXTENDED_BITS):
        return Abort.INVALID_VALUE
    if not exists(new):
        return None
    if restricted(new & CAN_ID) or (exists(old) and (old ^ new) & _IDENTITY):
        return Abort.INVALID_VALUE
    return Abort.INCOMPATIBLE if device.taken(at, new & CAN_ID) else None


def check_sync(device: Device, at: int, new: int) -> Abort | None:
    """Return the abort for writing `new` to 0x1005 at key `at`; bit 30 set makes the device the SYNC producer."""
    if new & (COB_ID_EXTENDED | _EXTENDED_BITS) or restricted(new & CAN_ID):
        return Abort.INVALID_VALUE
    old = device.objects.number(at)
    if old & new & COB_ID_NO_RTR and (old ^ new) & _IDENTITY:
        return Abort.INVALID_VALUE
    return Abort.INCOMPATIBLE if device.taken(at, new & CAN_ID) else None
