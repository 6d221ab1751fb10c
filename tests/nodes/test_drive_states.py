"""The CiA 402 state machine, row by row and word by word, from the bus."""

from __future__ import annotations

import itertools
import random

import pytest

import nodes
from eds.cia301 import Emcy, NmtCommand
from eds.cia402 import STEP, TRANSITIONS, DriveEvent, State, Status, Stop, command_of, state_of
from tests.nodes.drive_rig import KNEE, SERVO, DriveRig

AUTOMATIC = (DriveEvent.QUICK_STOP_DONE, DriveEvent.FAULT_REACTION_DONE)
"""Events that a drive may have ready at once after a command, where its option code is "disable"."""

SWITCHED_ON, ENABLED, QUICK_STOP, FAULT = (
    State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT)


def knee_in(state: State) -> DriveRig:
    """A knee drive in `state`, spinning where the drive function is on, with stops that take their time."""
    rig = DriveRig(KNEE)
    rig.write(0x605A, 0, Stop.QUICK_STOP_RAMP_HOLD)
    rig.run(1)
    if state in (QUICK_STOP, State.FAULT_REACTION_ACTIVE):
        rig.to(ENABLED)
        rig.plant.velocity = 1.0
        rig.run(0.25)
    if state is QUICK_STOP:
        rig.control(0x02)
    elif state is State.FAULT_REACTION_ACTIVE:
        lose_the_master(rig)
    elif state is FAULT:
        rig.to(ENABLED)
        lose_the_master(rig)
        rig.run(600)
    else:
        rig.to(state)
    assert rig.state() is state
    return rig


def lose_the_master(rig: DriveRig) -> None:
    """A fault that any drive can be given from the bus: its master's heartbeat stops (0x6007 = 1)."""
    rig.write(0x6007, 0, 1)
    rig.write(0x1016, 1, 127 << 16 | 10)
    rig.send(0x77F, b"\x05")
    velocity = rig.plant.velocity
    rig.bus.run(0.011)
    rig.settle()
    rig.plant.velocity = velocity


def test_power_on_goes_through_rows_0_and_1() -> None:
    assert nodes.ServoDrive().state is None
    rig = DriveRig(SERVO)
    assert rig.state() is State.SWITCH_ON_DISABLED


def test_reset_node_begins_at_switch_on_disabled() -> None:
    rig = knee_in(SWITCHED_ON)
    rig.nmt(NmtCommand.RESET_NODE)
    assert rig.state() is State.SWITCH_ON_DISABLED
    assert rig.read(0x6040) == 0


COMMANDED = (
    (2, State.SWITCH_ON_DISABLED, 0x06, State.READY_TO_SWITCH_ON),
    (3, State.READY_TO_SWITCH_ON, 0x07, SWITCHED_ON),
    (4, SWITCHED_ON, 0x0F, ENABLED),
    (5, ENABLED, 0x07, SWITCHED_ON),
    (6, SWITCHED_ON, 0x06, State.READY_TO_SWITCH_ON),
    (7, State.READY_TO_SWITCH_ON, 0x00, State.SWITCH_ON_DISABLED),
    (7, State.READY_TO_SWITCH_ON, 0x02, State.SWITCH_ON_DISABLED),
    (8, ENABLED, 0x06, State.READY_TO_SWITCH_ON),
    (9, ENABLED, 0x00, State.SWITCH_ON_DISABLED),
    (10, SWITCHED_ON, 0x00, State.SWITCH_ON_DISABLED),
    (10, SWITCHED_ON, 0x02, State.SWITCH_ON_DISABLED),
    (11, ENABLED, 0x02, QUICK_STOP),
    (12, QUICK_STOP, 0x00, State.SWITCH_ON_DISABLED),
    (15, FAULT, 0x80, State.SWITCH_ON_DISABLED),
    (16, QUICK_STOP, 0x0F, ENABLED),
)
"""(row, state, controlword, state after it), as CiA 402-2 has them: written out, so that a wrong table is seen."""


@pytest.mark.parametrize(("row", "source", "word", "target"), COMMANDED)
def test_each_commanded_row_is_taken_on_its_command(row: int, source: State, word: int, target: State) -> None:
    rig = knee_in(source)
    rig.write(0x605C, 0, 0)
    rig.write(0x605B, 0, 0)
    if row == 15:
        rig.control(0x00)
    rig.control(word)
    assert rig.state() is target


def test_enable_operation_goes_from_ready_to_enabled() -> None:
    rig = knee_in(State.READY_TO_SWITCH_ON)
    rig.control(0x0F)
    assert rig.state() is ENABLED


def test_every_row_has_its_test() -> None:
    assert {row.number for row in TRANSITIONS} == {0, 1, 13, 14, *(row for row, *_ in COMMANDED)}


def test_row_12_is_taken_by_itself_at_rest() -> None:
    rig = DriveRig(SERVO)
    rig.run(1)
    rig.to(ENABLED)
    rig.plant.velocity = 0.05
    rig.run(0.25)
    rig.control(0x02)
    assert rig.state() is QUICK_STOP
    rig.run(100)
    assert rig.state() is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    "source", [State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, SWITCHED_ON, ENABLED, QUICK_STOP])
def test_rows_13_and_14_from_each_state(source: State) -> None:
    rig = knee_in(source)
    before = rig.state()
    if source is State.SWITCH_ON_DISABLED:
        assert STEP[source, DriveEvent.FAULT_DETECTED].target is State.FAULT_REACTION_ACTIVE
        rig.application.fault(Emcy.OVERTEMPERATURE, rig.now_ns)
        rig.settle()
    else:
        lose_the_master(rig)
    moving = before in (ENABLED, QUICK_STOP)
    assert rig.state() is (State.FAULT_REACTION_ACTIVE if moving else FAULT)
    rig.run(600)
    assert rig.state() is FAULT


def reachable(state: State, word: int, previous: int) -> set[State]:
    """What the table allows after one controlword: its row, then rows that follow at once."""
    event = command_of(word, previous, state)
    found, queue = {state}, [state]
    while queue:
        here = queue.pop()
        events = [e for e in (event, *AUTOMATIC) if e is not None]
        if here is not state and event is not DriveEvent.ENABLE_OPERATION:
            events = list(AUTOMATIC)
        for e in events:
            row = STEP.get((here, e))
            if row is not None and row.target not in found:
                found.add(row.target)
                queue.append(row.target)
    return found


@pytest.mark.parametrize("state", [State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, SWITCHED_ON, ENABLED, QUICK_STOP,
                                   State.FAULT_REACTION_ACTIVE, FAULT])
def test_no_word_does_what_the_table_does_not_say(state: State) -> None:
    for low, reset in itertools.product(range(16), (0, 0x80)):
        rig = knee_in(state)
        previous = int(rig.read(0x6040))
        word = low | reset
        rig.control(word)
        assert rig.state() in reachable(state, word, previous), f"{word:04X} in {state}"


def test_any_sequence_of_words_stays_in_the_table() -> None:
    draw = random.Random(402)
    rig = DriveRig(KNEE)
    rig.write(0x605A, 0, Stop.QUICK_STOP_RAMP_HOLD)
    rig.run(1)
    seen = set()
    for _ in range(1500):
        before, previous = rig.state(), int(rig.read(0x6040))
        word = draw.choice((0, 2, 6, 7, 15, 0x80, 0x86, 0x8F, draw.randrange(1 << 16)))
        rig.control(word)
        after = rig.state()
        assert after in reachable(before, word, previous), f"{word:04X} in {before}"
        seen.add((before, after))
        rig.run(0.25)
        later = rig.state()
        assert later is after or any((after, e) in STEP and STEP[after, e].target is later for e in DriveEvent)
    assert len(seen) > 15


def test_fault_reset_acts_on_the_edge_only() -> None:
    rig = knee_in(ENABLED)
    rig.control(0x8F)
    assert rig.state() is ENABLED
    lose_the_master(rig)
    rig.run(600)
    assert rig.read(0x603F) == 0x8130
    rig.control(0x80)
    rig.control(0x8F)
    assert rig.state() is FAULT
    rig.control(0x00)
    assert rig.state() is FAULT
    rig.control(0x80)
    assert rig.state() is State.SWITCH_ON_DISABLED
    assert rig.read(0x603F) == 0


def test_statusword_shows_voltage_remote_and_state() -> None:
    rig = knee_in(ENABLED)
    word = rig.statusword()
    assert word & Status.VOLTAGE_ENABLED
    assert word & Status.REMOTE
    assert state_of(word) is ENABLED
    assert not word & (Status.WARNING | Status.STO_ACTIVE | Status.INTERNAL_LIMIT)


def test_statusword_goes_out_by_event_when_the_state_changes() -> None:
    rig = DriveRig(KNEE)
    rig.nmt(NmtCommand.START)
    rig.run(1)
    rig.forget()
    rig.send(0x202, b"\x06\x00")
    words = [int.from_bytes(data[:2], "little") for data in rig.frames(0x182)]
    assert [state_of(word) for word in words] == [State.READY_TO_SWITCH_ON]
