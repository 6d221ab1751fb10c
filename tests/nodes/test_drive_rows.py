"""The rows of CiA 402-2, figure 4, that a controlword takes, written out as numbers: no table of ours is asked.

The masks are those of table 29 (statusword) and the words those of table 27 (controlword).
"""

from __future__ import annotations

import pytest

from tests.nodes.drive_rig import NodeBus

SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP, DISABLE = 0x06, 0x07, 0x0F, 0x00, 0x02, 0x07
DISABLED, READY, ON, ENABLED = 0x40, 0x21, 0x23, 0x27
MASK = {DISABLED: 0x4F, READY: 0x6F, ON: 0x6F, ENABLED: 0x6F}

TO = {DISABLED: (), READY: (SHUTDOWN,), ON: (SHUTDOWN, SWITCH_ON), ENABLED: (SHUTDOWN, SWITCH_ON, ENABLE)}
ROWS = [
    (2, DISABLED, SHUTDOWN, READY),
    (3, READY, SWITCH_ON, ON),
    (4, ON, ENABLE, ENABLED),
    (5, ENABLED, DISABLE, ON),
    (6, ON, SHUTDOWN, READY),
    (7, READY, DISABLE_VOLTAGE, DISABLED),
    (7, READY, QUICK_STOP, DISABLED),
    (8, ENABLED, SHUTDOWN, READY),
    (9, ENABLED, DISABLE_VOLTAGE, DISABLED),
    (10, ON, DISABLE_VOLTAGE, DISABLED),
    (10, ON, QUICK_STOP, DISABLED),
]


def shows(bus: NodeBus, state: int) -> bool:
    return int(bus.read(0x6041)) & MASK[state] == state


def stand_still(bus: NodeBus) -> None:
    """Give the drive 50 ms to find that it stands."""
    bus.bus.run(0.05)


@pytest.mark.parametrize("node_id", [1, 2])
@pytest.mark.parametrize(("row", "before", "word", "after"), ROWS)
def test_a_controlword_takes_the_profiles_row(node_id: int, row: int, before: int, word: int, after: int) -> None:
    bus = NodeBus(node_id)
    bus.setup()
    bus.send(0x77F, b"\x05")
    for step in TO[before]:
        bus.write(0x6040, 0, step)
    assert shows(bus, before), row
    bus.write(0x6040, 0, word)
    stand_still(bus)
    assert shows(bus, after), row
