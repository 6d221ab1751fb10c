"""PDO plans as rows of integers, as `cycle_code` reads them.

The rule of this file: a PDO that the law cannot send or take exactly as the device does gives no row.
"""

from __future__ import annotations

from typing import NamedTuple

from nodes import Drive, TensionSensor
from nodes.core.pdo.receive_pdo import ReceivePdo
from nodes.core.pdo.transmit_pdo import TransmitPdo
from nodes.drives.rules import RULES
from nodes.drives.set_point_law import Taker
from virtual_bus.compiled import cycle_code as law

WIDEST = 32
"""Width of the widest field, bits."""


class Taking(NamedTuple):
    """An RPDO's row, and the effect of its data."""

    row: list[int]
    taker: Taker


def sending(place: int, device: Drive | TensionSensor, pdo: TransmitPdo) -> list[int] | None:
    """Return the row of a TPDO of the node at `place`."""
    fields: list[int] = []
    for field in pdo.plan.fields:
        source = device.steady_sources.get(field.key)
        if source is None or field.code in ("", "f", "d") or field.bits > WIDEST:
            return None
        fields += [source, field.bits, int(field.signed)]
    if len(fields) > law.SEND_WIDTH - 4:
        return None
    row = [place, pdo.can_id, pdo.plan.size, len(fields) // 3, *fields]
    return row + [0] * (law.SEND_WIDTH - len(row))


def taking(place: int, device: Drive | TensionSensor, pdo: ReceivePdo, size: int, waits: bool) -> Taking | None:
    """Return the row of an RPDO of the node at `place`, for frames of `size` bytes; `waits`: it may wait for SYNC."""
    taken = pdo.steady()
    if taken is None or not isinstance(device, Drive) or taken.plan.size != size or len(taken.watched) > 1:
        return None
    if taken.synchronous and not waits:
        return None
    shift, found, begins = 0, None, 0
    for field in taken.plan.fields:
        if not field.dummy:
            if found is not None or field.code in ("", "f", "d") or field.bits > WIDEST:
                return None
            found, begins = field, shift
        shift += field.bits
    if found is None or found.key in RULES or taken.watched != (found.key,):
        return None
    taker = device.steady_taker(found.key)
    if taker is None or any(at != found.key for at, _, _ in taken.bounds):
        return None
    _, low, high = taken.bounds[0] if taken.bounds else (0, None, None)
    least = -(1 << WIDEST) if low is None else int(low)
    greatest = (1 << WIDEST) if high is None else int(high)
    row = [place, pdo.can_id, size, int(taken.synchronous), taken.deadline_ns, taker.action, begins, found.bits,
           int(found.signed), int(bool(taken.bounds)), least, greatest]
    return Taking(row, taker)
