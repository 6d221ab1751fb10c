"""The power drive system's table: whole, unambiguous, and enough for a master to bring a drive anywhere."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eds.cia402 import (
    COMMANDS,
    STEP,
    TRANSITIONS,
    Control,
    DriveEvent,
    Mode,
    State,
    Status,
    command_of,
    next_controlword,
    state_of,
)

WORDS = st.integers(0, 0xFFFF)
BY_ITSELF = {State.NOT_READY_TO_SWITCH_ON: DriveEvent.INITIALISED,
             State.FAULT_REACTION_ACTIVE: DriveEvent.FAULT_REACTION_DONE}
GOALS = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED)
STATUSWORDS = {
    0x0000: State.NOT_READY_TO_SWITCH_ON, 0x0250: State.SWITCH_ON_DISABLED, 0x0231: State.READY_TO_SWITCH_ON,
    0x0233: State.SWITCHED_ON, 0x1637: State.OPERATION_ENABLED, 0x0217: State.QUICK_STOP_ACTIVE,
    0x021F: State.FAULT_REACTION_ACTIVE, 0x0218: State.FAULT, 0x023F: State.FAULT_REACTION_ACTIVE, 0x0238: State.FAULT,
    0x0001: None, 0x0025: None,
}


def test_the_table_has_the_profiles_seventeen_rows():
    assert [row.number for row in TRANSITIONS] == list(range(17))
    assert {state for row in TRANSITIONS for state in (*row.sources, row.target)} == {*State, None}


def test_no_event_leads_two_ways():
    rows = [(source, event) for row in TRANSITIONS for source in row.sources for event in row.events]
    assert len(rows) == len(set(rows)) == len(STEP)


@pytest.mark.parametrize(("word", "state"), STATUSWORDS.items())
def test_statuswords_show_their_state(word, state):
    assert state_of(word) is state


@given(WORDS)
def test_a_statusword_shows_one_state_at_most(word):
    shown = [state for state in State if word & state.value[0] == state.value[1]]
    assert shown == ([state_of(word)] if state_of(word) else [])


@given(WORDS, WORDS, st.sampled_from(State))
def test_a_controlword_gives_the_command_of_its_bits(word, previous, state):
    """The bits are written out here from CiA 402-2, table 27, apart from the masks."""
    bits = Control(word & 0x8F)
    if Control.FAULT_RESET in bits:
        expected = None if previous & 0x80 else DriveEvent.FAULT_RESET
    elif Control.ENABLE_VOLTAGE not in bits:
        expected = DriveEvent.DISABLE_VOLTAGE
    elif Control.QUICK_STOP not in bits:
        expected = DriveEvent.QUICK_STOP
    elif Control.SWITCH_ON not in bits:
        expected = DriveEvent.SHUTDOWN
    elif Control.ENABLE_OPERATION in bits:
        expected = DriveEvent.ENABLE_OPERATION
    else:
        expected = DriveEvent.DISABLE_OPERATION if state is State.OPERATION_ENABLED else DriveEvent.SWITCH_ON
    assert command_of(word, previous, state) is expected


def walk(state, goal):
    """Follow `next_controlword` on the table until the goal; FAULT is preceded by 0, as its docstring asks."""
    path = [state]
    while state is not goal and len(path) < 12:
        word = next_controlword(state, goal)
        event = BY_ITSELF.get(state) or command_of(word, 0, state)
        row = STEP.get((state, event))
        assert row is not None, (state, hex(word), event)
        state = row.target
        path.append(state)
    return path


@pytest.mark.parametrize("goal", GOALS)
@pytest.mark.parametrize("state", State)
def test_a_master_reaches_every_goal_from_every_state(state, goal):
    path = walk(state, goal)
    assert path[-1] is goal
    assert len(set(path)) == len(path)


def test_a_master_stops_quickly_only_what_runs():
    assert walk(State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE) == [State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE]
    with pytest.raises(KeyError):
        next_controlword(State.SWITCHED_ON, State.FAULT)


@pytest.mark.parametrize("goal", [*GOALS, State.QUICK_STOP_ACTIVE])
def test_the_word_at_the_goal_moves_nothing(goal):
    event = command_of(next_controlword(goal, goal), 0, goal)
    assert STEP.get((goal, event)) is None


def test_a_disabled_voltage_ends_operation_from_every_powered_state():
    for state in (State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
        assert STEP[state, DriveEvent.DISABLE_VOLTAGE].target is State.SWITCH_ON_DISABLED


def test_each_command_word_is_read_as_its_command():
    for event, command in COMMANDS.items():
        assert command_of(command.word, 0, State.SWITCHED_ON) is event


def test_bits_of_6502():
    assert [mode.supported_bit for mode in (Mode.HOMING, Mode.CSP, Mode.CSV, Mode.CST)] == [0x20, 0x80, 0x100, 0x200]
    assert Mode.NONE.supported_bit == 0
    assert Status.HOMING_ATTAINED is Status.FOLLOWS_COMMAND
