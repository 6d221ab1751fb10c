"""PDO plans as rows of integers, as `cycle_code` reads them.

A PDO that the compiled cycle cannot process exactly as the device does gives no row.
"""

from typing import NamedTuple

from nodes import Drive, TensionSensor
from nodes.core.pdos import ReceivePdo, TransmitPdo
from nodes.drives.axis_law import RpdoEffect
from nodes.drives.drive import RULES
from virtual_bus.compiled import cycle_code as law

WIDEST = 32
"""Width of the widest field, bits."""


class RpdoRow(NamedTuple):
    """An RPDO's row, and the effect of its data."""

    row: list[int]
    effect: RpdoEffect


def tpdo_row(place: int, device: Drive | TensionSensor, pdo: TransmitPdo) -> list[int] | None:
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


def rpdo_row(place: int, device: Drive | TensionSensor, pdo: ReceivePdo, size: int, waits: bool) -> RpdoRow | None:
    """Return the row of an RPDO of the node at `place`, for frames of `size` bytes; `waits`: it may wait for SYNC."""
    reception = pdo.steady()
    if reception is None or not isinstance(device, Drive) or reception.plan.size != size or len(reception.watched) > 1:
        return None
    if reception.synchronous and not waits:
        return None
    shift, mapped, begins = 0, None, 0
    for field in reception.plan.fields:
        if not field.dummy:
            if mapped is not None or field.code in ("", "f", "d") or field.bits > WIDEST:
                return None
            mapped, begins = field, shift
        shift += field.bits
    if mapped is None or mapped.key in RULES or reception.watched != (mapped.key,):
        return None
    effect = device.rpdo_effect(mapped.key)
    if effect is None or any(at != mapped.key for at, _, _ in reception.bounds):
        return None
    _, low, high = reception.bounds[0] if reception.bounds else (0, None, None)
    least = -(1 << WIDEST) if low is None else int(low)
    greatest = (1 << WIDEST) if high is None else int(high)
    row = [place, pdo.can_id, size, int(reception.synchronous), reception.deadline_ns, effect.action, begins,
           mapped.bits, int(mapped.signed), int(bool(reception.bounds)), least, greatest]
    return RpdoRow(row, effect)
