"""SDO writes that give a node its part in the network.

The rule of this file: the order is the standard's. A PDO is invalid while its map changes, its map is
empty while its entries change (CiA 301, 7.5.2.36 and 7.5.2.38), and unused PDOs end invalid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from eds import cia301
from eds.dictionary import Dictionary, key
from parameters import InputError

Write = tuple[int, int, int | bytes]
"""(index, sub-index, value) of one SDO download; the object's data type gives its length."""

RPDO, TPDO = 0x1400, 0x1800
_MAPPING: Final = 0x200
PDOS: Final = 4
"""Number of PDOs of each direction in the pre-defined connection set; the setup writes only these."""


@dataclass(frozen=True, slots=True)
class Pdo:
    """One PDO as a node is to hold it; `base` is `RPDO` or `TPDO`, `number` from 1; `deadline_ms` is sub-index 5."""

    base: int
    number: int
    cob_id: int
    mapping: Sequence[int]
    transmission_type: int
    deadline_ms: int = 0

    def writes(self, dictionary: Dictionary) -> Iterator[Write]:
        """Yield the writes in the standard's order, whether the device has the objects or not."""
        communication = self.base + self.number - 1
        mapping = communication + _MAPPING
        flags = cia301.COB_ID_NO_RTR if self.base == TPDO else 0
        yield communication, 1, self.cob_id | flags | cia301.COB_ID_INVALID
        yield communication, 2, self.transmission_type
        if self.deadline_ms or key(communication, 5) in dictionary.entries:
            yield communication, 5, self.deadline_ms
        yield mapping, 0, 0
        for sub, word in enumerate(self.mapping, 1):
            yield mapping, sub, word
        yield mapping, 0, len(self.mapping)
        yield communication, 1, self.cob_id | flags


def pdo_writes(dictionary: Dictionary, pdos: Sequence[Pdo]) -> Iterator[Write]:
    """Yield the writes after which a node has exactly these PDOs: every other one is made invalid first."""
    used = {(pdo.base, pdo.number) for pdo in pdos}
    for base in (RPDO, TPDO):
        for number in range(1, PDOS + 1):
            entry = dictionary.entries.get(key(base + number - 1, 1))
            if entry is not None and (base, number) not in used:
                yield base + number - 1, 1, dictionary.initial(base + number - 1, 1) | cia301.COB_ID_INVALID
    for pdo in pdos:
        yield from pdo.writes(dictionary)


def interpolation_period(period_us: int) -> tuple[int, int]:
    """Return 0x60C2:01 and :02 for a period: value × 10^index seconds; `InputError` where one byte cannot hold it."""
    value, index = _decimal(period_us)
    if not fits_one_byte(period_us):
        raise InputError(f"rate_hz: a cycle of {period_us} µs does not fit 0x60C2; choose 1000, 500, 250 or 100 Hz.")
    return value, index


def fits_one_byte(period_us: int) -> bool:
    """Return whether 0x60C2:01, one byte, can express a period."""
    return 1 <= _decimal(period_us)[0] <= 255


def _decimal(period_us: int) -> tuple[int, int]:
    """Return the period as value and power of ten, in seconds, with the smallest value."""
    value, index = period_us, -6
    while value % 10 == 0 and index < 0:
        value, index = value // 10, index + 1
    return value, index
