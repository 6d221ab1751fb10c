"""Safe stops on the virtual bus: each condition, its reaction seen on the wire and in the rope."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import can
import numpy as np
import pytest

from eds.cia402 import State, state_of
from master import settings
from trial.record import Recorder, RecordingError

if TYPE_CHECKING:
    from conftest import Composer, Ran

IN_GAIT_S = 4.35
"""Bus time at which the rope is loaded in the first gait cycle of a period of 1.1 s."""
LOADED_ROW = 4000
"""A row of the same time."""


def words(ran: Ran) -> list[int]:
    """The servo's controlwords, in order, repetitions left out."""
    sent = [int(row[0]) | int(row[1]) << 8 for row in ran.sent(0x301)]
    return [word for i, word in enumerate(sent) if i == 0 or word != sent[i - 1]]


def stopped(ran: Ran, reason: str) -> None:
    assert ran.result.outcome == "stopped"
    assert ran.result.stop_reason is not None
    assert reason in ran.result.stop_reason


def servo_is_off(ran: Ran) -> None:
    """The last statusword on the bus shows no power stage, and the rope is slack but for the drum's friction."""
    last = ran.sent(0x181)[-1]
    assert state_of(int(last[0]) | int(last[1]) << 8) not in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)
    assert ran.truth.columns["true_start_n"][-1] < 5.0


def test_start_above_its_limit_unwinds_then_quick_stops(composer: Composer) -> None:
    ran = composer.run(limits=settings.Limits(start_n=47.0))
    stopped(ran, "START tension above its limit")
    assert 0x0002 in words(ran)
    servo_is_off(ran)
    at = int(np.argmax(ran.trial.columns["tension_start_n"] > 47.0))
    gone = int(np.argmax(ran.trial.columns["tension_start_n"][at:] < 2.0))
    assert 0 < gone < 150


def test_end_above_its_limit_turns_the_torque_off(composer: Composer) -> None:
    ran = composer.run(limits=settings.Limits(end_n=39.0))
    stopped(ran, "END tension above its limit")
    assert 0x0002 not in words(ran)
    servo_is_off(ran)


@pytest.mark.parametrize(("node", "name", "quick_stop"), [(2, "knee", False), (3, "start", False), (4, "end", True)])
def test_a_node_cut_off_is_named_and_the_rope_let_go(
    composer: Composer, node: int, name: str, quick_stop: bool
) -> None:
    """Without START nothing says when the rope is slack, and a knee may fall: torque off; without END it is unwound."""
    ran = composer.run(
        faults=[{"kind": "cut", "node": node, "start_s": IN_GAIT_S}], limits=settings.Limits(stale_cycles=3))
    stopped(ran, f"inputs too old: {name}")
    assert (0x0002 in words(ran)) is quick_stop
    servo_is_off(ran)


def test_the_servo_cut_off_lets_go_by_itself(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "cut", "node": 1, "start_s": IN_GAIT_S}])
    stopped(ran, "inputs too old: servo")
    assert ran.truth.columns["true_start_n"][-1] < 2.0


def test_a_lost_heartbeat_alone_stops_the_trial(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "drop", "cob_id": 0x704, "start_s": IN_GAIT_S}])
    stopped(ran, "heartbeat lost: end")
    servo_is_off(ran)


def test_a_restarted_node_stops_the_trial(composer: Composer) -> None:
    ran = composer.run(
        faults=[{"kind": "power_off", "node": 4, "start_s": IN_GAIT_S, "stop_s": IN_GAIT_S + 0.002}],
        limits=settings.Limits(stale_cycles=500))
    stopped(ran, "restarted by itself: end")
    servo_is_off(ran)


def test_an_emergency_stops_the_trial_and_is_told(composer: Composer) -> None:
    """Short targets make both drives send 0x8210; the trial stops with the first drive that says so."""
    ran = composer.run(faults=[{"kind": "shorten", "cob_id": 0x201, "size": 3, "start_s": IN_GAIT_S,
                                "stop_s": IN_GAIT_S + 0.003}])
    stopped(ran, "emergency message")
    assert any("0x8210" in text for text in ran.said("emcy"))
    servo_is_off(ran)


def test_start_stale_for_n_cycles_stops_after_n(composer: Composer) -> None:
    ran = composer.run(
        faults=[{"kind": "drop", "cob_id": 0x183, "start_s": IN_GAIT_S}], limits=settings.Limits(stale_cycles=3))
    stopped(ran, "start missed 3 cycles in a row")
    servo_is_off(ran)


def test_start_lost_is_felt_by_the_servo_before_the_master_gives_up(composer: Composer) -> None:
    """The servo has START's tension from the bus itself, with a deadline of five cycles; START is named."""
    ran = composer.run(faults=[{"kind": "cut", "node": 3, "start_s": IN_GAIT_S}])
    stopped(ran, "inputs too old: start missed 5 cycles in a row (servo: 0x8250, RPDO time-out)")
    servo_is_off(ran)


def test_nodes_that_hear_no_sync_are_stopped(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "drop", "cob_id": 0x080, "start_s": IN_GAIT_S}])
    stopped(ran, "SYNC missing: no node has answered it")
    assert words(ran)[-1] == 0x0000


class Acting(Recorder):
    """A recorder beside which something happens at a row of the rope's load."""

    rows = 0
    act: Callable[[], None]

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        super().cycle(time_ns, values)
        self.rows += 1
        if self.rows == LOADED_ROW:
            self.act()


def acting(act: Callable[[], None]) -> Callable[[Recorder], Recorder]:
    def wrap(recorder: Recorder) -> Recorder:
        recorder.__class__ = Acting
        recorder.act = act  # type: ignore[attr-defined]
        return recorder

    return wrap


def test_sync_lost_turns_the_torque_off(composer: Composer) -> None:
    ran = composer.run(wrap=acting(lambda: composer.open[-1].stop_all_periodic_tasks()))
    stopped(ran, "SYNC missing")
    assert 0x0002 not in words(ran)
    assert words(ran)[-1] == 0x0000
    assert len(ran.trial.time_ns) == LOADED_ROW + 1


def test_ctrl_c_unwinds_and_closes_the_trial(composer: Composer) -> None:
    before = signal.getsignal(signal.SIGINT)
    ran = composer.run(wrap=acting(lambda: signal.raise_signal(signal.SIGINT)))
    stopped(ran, "interrupted")
    servo_is_off(ran)
    assert signal.getsignal(signal.SIGINT) is before


class Full(Recorder):
    """A recorder whose disk is full from a row on."""

    rows = 0

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        self.rows += 1
        if self.rows >= LOADED_ROW:
            raise RecordingError("trial.mcap: recording stopped (No space left on device)")
        super().cycle(time_ns, values)


def test_a_full_disk_stops_the_trial(composer: Composer) -> None:
    def fill(recorder: Recorder) -> Recorder:
        recorder.__class__ = Full
        return recorder

    ran = composer.run(wrap=fill)
    stopped(ran, "recording failed: trial.mcap")
    assert len(ran.trial.time_ns) == LOADED_ROW - 1
    assert ran.truth.columns["true_start_n"][-1] < 2.0


def test_a_broken_wire_of_start_stops_the_trial(composer: Composer) -> None:
    """The sensor says that it has no value; the servo takes that for START lost, whatever the master does."""
    ran = composer.run(faults=[{"kind": "broken_wire", "node": 3, "start_s": IN_GAIT_S}])
    stopped(ran, "emergency message: start: 0x5030")
    servo_is_off(ran)


def test_an_emergency_stop_in_the_gait_stops_the_trial(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "emergency_stop", "node": 1, "start_s": IN_GAIT_S}])
    stopped(ran, "emergency message: servo: 0x5441")
    servo_is_off(ran)


def test_a_drive_that_awaits_its_release_is_refused_with_what_to_do(composer: Composer) -> None:
    """The emergency stop was pressed and is free again before the master came; nobody has released the drive."""
    ran = composer.run(faults=[{"kind": "emergency_stop", "node": 1, "stop_s": 0.05}])
    stopped(ran, "say: bowden acknowledge")
    servo_is_off(ran)


def test_a_start_without_a_value_never_reaches_a_step(composer: Composer) -> None:
    """Switched off (0x6112 = 0) it sends the least integer, −327 N as it stands; the rope is let go instead."""
    off = can.Message(arbitration_id=0x603, data=bytes.fromhex("2f12610100000000"), is_extended_id=False)
    ran = composer.run(wrap=acting(lambda: composer.open[-2].send(off)))
    stopped(ran, "foreign command on the bus: an SDO write of 6112:01 to start from somebody else")
    assert b"\x00\x80" in {bytes(row[:2]) for row in ran.sent(0x183)}
    columns = ran.trial.columns
    assert columns["tension_start_n"].min() > -2.0
    assert np.abs(np.diff(columns["servo_target_m"][LOADED_ROW - 500:])).max() < 1.5e-3
    servo_is_off(ran)
