"""What the cycle supervises: signals against each other, the bus, the operator's signals, and how it tells of them."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
import signal
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eds import error_frames
from eds.bench.bench_network import END, KNEE, SERVO, START, Network, wire
from eds.cia301 import NmtCommand
from master.cycle import plausibility
from master.cycle.blame import blamed, suspected
from master.cycle.plausibility import Implausibility, Plausibility
from master.cycle.reception import ENOUGH, Reception
from master.cycle.run_safely import ENDING, interruption
from master.cycle.safety import Condition
from master.motion.experiment_run import ExperimentSetup, run
from master.network.bus_watch import FLOOD, BusWatch
from master.settings import Limits
from parameters import InputError
from physics.calibration import nominal
from physics.reference import paper_reference
from trial.record import Recorder

if TYPE_CHECKING:
    from conftest import Composer, Ran

IN_GAIT_S = 4.35
LOADED_ROW = 4000


def ratios(**broken: float) -> tuple[float, ...]:
    names = ("servo", "knee", "ratio", "force", "start", "end")
    return tuple(broken.get(name, 0.1) for name in names) + (0.0,) * (plausibility.RELATIONS - len(names))


# ---- signals against each other ----

PATH = wire(Network()).path


@pytest.mark.parametrize(("broken", "node", "words"), [
    ({"ratio": 2.0, "force": -1.5, "start": 1.2}, START, "START"),
    ({"ratio": 2.0, "end": -1.5}, END, "END"),
    ({"force": 3.0}, SERVO, "the servo's torque"),
    ({"start": -2.0, "end": -2.0}, 0, "servo position, knee angle, a rope that slipped or snapped"),
    ({"ratio": 1.4}, 0, "START or END, or a path between them that is jammed"),
])
def test_the_pattern_of_relations_names_the_suspect(broken: dict[str, float], node: int, words: str) -> None:
    relation = ("servo", "knee", "ratio", "force", "start", "end").index(next(iter(broken)))
    finding = Implausibility(relation, 5.0, 40.0, ratios(**broken))
    stop = blamed(finding, PATH)
    assert (suspected(finding).words, stop.node_id) == (stop.detail.split(":")[0], node)
    assert stop.condition is Condition.IMPLAUSIBLE
    assert words in str(stop)
    assert "expected about" in str(stop)


def test_a_motion_that_is_not_the_commanded_one_names_its_axis() -> None:
    for relation, node in ((plausibility.SERVO_TRACK, SERVO), (plausibility.KNEE_TRACK, KNEE),
                           (plausibility.STILL_SERVO, SERVO), (plausibility.STILL_KNEE, KNEE)):
        stop = blamed(Implausibility(relation, 0.1, 0.2, ratios()), PATH)
        assert (stop.condition, stop.node_id) == (Condition.OFF_TARGET, node)


@pytest.mark.parametrize(("limited_m", "found"), [(2e-3, None), (0.0, plausibility.STILL_SERVO)])
def test_a_servo_that_its_tension_bound_holds_back_may_stand_still(limited_m: float, found: int | None) -> None:
    """START is at the bound, and the target goes down by 0.6 mm from beyond the rope's position."""
    checked = Plausibility(1e-3)
    told = [checked.check(limited_m, (target, -0.5), 21.16e-3, 90.0, -0.5, 90.0 + 0.1 * (i % 2), 78.0 + 0.1 * (i % 2))
            for i, target in enumerate([21.9e-3] * 40 + [21.3e-3] * 40)]
    assert next((each.relation for each in told if each), None) == found


@pytest.mark.parametrize(("limited_m", "found"), [(2e-3, None), (0.0, plausibility.SERVO_TRACK)])
def test_a_servo_that_was_held_back_needs_time_to_make_up_for_it(limited_m: float, found: int | None) -> None:
    """The bound of its force ends while the position is 3.5 mm from the targets, which it reaches in 10 ms."""
    checked = Plausibility(1e-3)
    ways = [(limited_m, 0.0)] * 20 + [(0.0, 3.5e-3 * 0.8**i) for i in range(40)]
    told = [checked.check(limited, (0.01, -0.5), 0.01 - behind, 40.0, -0.5, 20.0 + 0.1 * (i % 2), 18.0 + 0.1 * (i % 2))
            for i, (limited, behind) in enumerate(ways)]
    assert next((each.relation for each in told if each), None) == found


@pytest.mark.parametrize(("strides", "rad_s", "found_ms"), [(True, 0.1, 32), (True, 2.0, 4), (False, 0.1, 18)])
def test_a_knee_that_turns_back_may_stick_where_strides_differ(strides: bool, rad_s: float, found_ms: int) -> None:
    """The encoder repeats one value while the target turns back at a speed."""
    checked = Plausibility(1e-3)
    if strides:
        checked.expect_strides()
    told = [checked.check(0.0, (0.01, -0.5 - 1e-3 * rad_s * max(0, i - 40)), 0.01 + 1e-6 * (i % 2), 0.0, -0.5,
                          0.1 * (i % 2), 0.1 * (i % 2)) for i in range(80)]
    found = [i - 40 for i, one in enumerate(told) if one and one.relation == plausibility.STILL_KNEE]
    assert found[0] == found_ms


def test_a_swing_that_does_not_fit_is_told_with_both_numbers() -> None:
    finding = Implausibility(plausibility.BY_START, 3e-3, 11e-3, ratios(start=-2.0, end=-2.0), 0.0809, 0.0405)
    stop = blamed(finding, PATH)
    assert "rope_per_knee = 0.0809 m/rad, 0.0405 would fit" in str(stop)


@pytest.mark.parametrize(("changed", "plant", "said"), [
    ({"rope_per_knee": 2.0}, None, r"its rope_per_knee is 0\.08\d\d m/rad, homing found 0\.04\d\d m/rad"),
    ({"rope_per_knee": 0.5}, None, r"its rope_per_knee is 0\.02\d\d m/rad, homing found 0\.0[34]\d\d m/rad"),
    ({"stiffness_a": 0.5, "stiffness_b": 0.5, "cable_compliance": 0.5}, None,
     r"stretch by 3\.22 mm from 10 to 40 N, homing found 6\.\d\d mm"),
    ({"rope_per_knee": 1.5}, {"rope_per_knee": 0.0600}, None),
])
def test_a_calibration_of_another_bench_is_refused_before_motion_with_both_numbers(
    composer: Composer, changed: dict[str, float], plant: dict[str, float] | None, said: str | None
) -> None:
    """The last row is a bench that has the unusual lever: it is measured, found right, and walked on."""
    packaged = nominal()
    wrong = dataclasses.replace(packaged, label="wrong.toml", **{
        name: factor * getattr(packaged, name) for name, factor in changed.items()})
    ran = composer.run(cycles=1, experiment={"calibration": wrong},
                       **({} if plant is None else {"plant_model": {"plant": plant}}))
    if said is None:
        assert ran.result.stop_reason is None
        return
    assert re.search(said, ran.result.stop_reason or "")
    assert "identify this bench" in (ran.result.stop_reason or "")
    assert not np.any(ran.trial.columns["desired_force_n"] > 0.0)  # no gait was begun
    # homing pulls until START reads 45 N, here and in every healthy trial; nothing pulled beyond
    assert ran.truth.columns["true_start_n"].max() < 50.0


def slid(force_n: Callable[[float], float], seconds: float, viscous: float = 10.0) -> list[tuple[float, float]]:
    """Force, N, and position, m, of a sled of 2.4 kg each millisecond; force acts a millisecond after it is told."""
    step, speed, place, rows = 1e-4, 0.0, -1.0, []
    for i in range(round(seconds / step)):
        if i % 10 == 0:
            rows.append((force_n(i * step), place))
        speed += step * (force_n(i * step - 1e-3) - viscous * speed) / 2.4
        place += step * speed
    return rows


def watched(rows: list[tuple[float, float]], unfelt_n: float = 0.0) -> Implausibility | None:
    """What is found of a sled with a slack rope, after a homing at 0.05 m/s; `unfelt_n`: tension that START misses."""
    watch, found = Plausibility(1e-3), None
    watch.begin_learning(rope_per_knee=0.0, knee_home=0.0, compliance=0.0)
    slow = slid(lambda t: 0.6 * math.cos(4.0 * t), 4.0)
    for force, place in slow:
        assert watch.check(1.0, (place, 0.0), place, force, 0.0, 0.0, 0.0) is None
    watch.learn(0.0, 1e-3)
    watch.restart()
    for force, place in rows:
        found = found or watch.check(1.0, (place, 0.0), place, force + unfelt_n, 0.0, 0.0, 0.0)
    return found


def test_a_leap_of_torque_on_a_fast_sled_is_no_finding_and_a_tension_that_start_misses_is() -> None:
    def leap(t: float) -> float:
        return 0.0 if t < 0.02 else 190.0 if t < 0.025 else -190.0 if t < 0.03 else 0.0

    assert watched(slid(leap, 0.1)) is None
    still = watched(slid(lambda t: 0.0, 0.1), unfelt_n=15.0)
    assert still is not None
    assert still.relation == plausibility.FORCE


def test_drive_friction_that_bends_beyond_homings_speed_is_no_finding() -> None:
    fast = slid(lambda t: 5.0 * math.sin(10.0 * t), 0.32, viscous=-20.0)
    assert max(abs(after - before) for (_, before), (_, after) in itertools.pairwise(fast)) > 0.4e-3
    assert watched(fast) is None


@pytest.mark.parametrize(("speed_m_s", "found"), [(0.25, False), (0.0, True)])
def test_the_drag_of_a_rope_that_is_much_too_long_is_no_finding(speed_m_s: float, found: bool) -> None:
    """5 N at START with 20 mm of slack: drag where the rope is pulled fast, and a lie where it stands."""
    watch = Plausibility(1e-3)
    watch.begin_learning(rope_per_knee=0.0, knee_home=0.0, compliance=0.0)
    for i in range(2000):
        place = 2.5e-3 * (1.0 - math.cos(3.14e-3 * i))
        watch.check(1.0, (place, 0.0), place, 8e3 * place, 0.0, 8e3 * place, 8e3 * place)
    watch.learn(0.0, 1.25e-4)
    watch.restart()
    findings = []
    for i in range(60):
        place, start = -0.04 + 1e-3 * speed_m_s * i, 5.0 if i > 40 else 0.0
        findings.append(watch.check(1.0, (place, 0.0), place, start, 0.0, start, 0.0))
    assert [f.relation for f in findings if f][:1] == ([plausibility.BY_START] if found else [])


@pytest.mark.parametrize(("leg_m_s", "found"), [(0.0, False), (0.06, True)])
def test_a_rope_that_pays_out_in_homing_gains_no_tension_on_a_leg_that_stands(leg_m_s: float, found: bool) -> None:
    """A pull of 40 N and its release; in the release the leg leaves the angle that its frozen encoder gives."""
    watch, findings = Plausibility(1e-3), []
    watch.begin_learning(rope_per_knee=0.0414, knee_home=-0.5, compliance=0.0)
    for i in range(1000):
        place = 2.5e-3 * (1.0 - math.cos(2e-3 * math.pi * i))
        tension = 8e3 * (place + leg_m_s * max(0.0, 1e-3 * (i - 700)))
        findings.append(watch.check(1.0, (place, -0.5), place, tension, -0.5, 1.1 * tension, tension / 1.1))
    assert [f.relation for f in findings if f][:1] == ([plausibility.BY_START] if found else [])


def test_a_gap_is_no_finding() -> None:
    """Cycles without inputs are coasted over: the targets go on, and the first whole cycle is judged by them."""
    checked = Plausibility(1e-3)
    for cycle in range(400):
        target = 1e-4 * cycle
        if cycle % 3 == 2:
            checked.coast((target, 0.0))
        else:
            late = max(0.0, target - 2e-4 - 0.8e-3)
            assert checked.check(0.0, (target, 0.0), late, 3.0, 0.0, 0.0, 0.0) is None


@pytest.mark.exhaustive
def test_healthy_trials_raise_nothing(composer: Composer) -> None:
    for options in ({"serial": 3, "day": 2}, {"serial": 0, "plant": "tests.hidden.plugin:healthy", "seed": 5}):
        ran = composer.run(peak_n=60.0, **options)
        assert ran.result.stop_reason is None
        assert not [event for event in ran.trial.events if event.kind in ("safety", "bus", "miss")]


# ---- values that cannot be ----


def test_values_that_cannot_be_are_not_taken() -> None:
    reception = Reception(1e-3, Limits())
    assert reception.accepts(1, (0x27, -0.5), False)
    for wrong in (-0.6, 0.5, 4.0e4, float("nan"), float("inf")):
        reception.begin()
        assert not reception.accepts(1, (0x27, wrong), False)
    assert reception.refused[1] == ENOUGH
    assert reception.accepts(1, (0x27, -0.49), False)
    assert reception.refused == [0, 0, 0, 0]


_REAL = st.floats(allow_nan=True, allow_infinity=True)
_CYCLES = st.lists(st.tuples(_REAL | st.floats(-2e-3, 2e-3), _REAL | st.floats(-0.03, 0.03), _REAL | st.floats(-40, 40),
                             _REAL | st.floats(-40, 40)), max_size=12)


@given(_CYCLES)
def test_four_values_at_once_are_taken_as_one_by_one(cycles: list[tuple[float, float, float, float]]) -> None:
    once, singly = Reception(1e-3, Limits()), Reception(1e-3, Limits())
    for servo, knee, start, end in cycles:
        frames = (0x27, servo, 0.0), (0x27, knee), (start,), (end,)
        singly.begin()
        taken = [singly.accepts(i, values, False) for i, values in enumerate(frames)]
        if once.takes_all(servo, knee, start, end):
            assert all(taken)
        else:
            once.begin()
            assert [once.accepts(i, values, False) for i, values in enumerate(frames)] == taken
        assert once.refused == singly.refused
        for i in range(4):
            assert once.refusal(i) == singly.refusal(i)


def test_a_position_that_is_counted_from_elsewhere_is_taken() -> None:
    reception = Reception(1e-3, Limits())
    assert reception.accepts(0, (0x27, 0.0, 0.0), False)
    reception.begin()
    assert not reception.accepts(0, (0x27, 0.05, 0.0), False)
    assert reception.accepts(0, (0x27, 0.05, 0.0), True)


def test_one_corrupt_frame_is_a_counted_miss_and_no_more(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "corrupt", "cob_id": 0x182, "start_s": IN_GAIT_S, "stop_s": IN_GAIT_S + 0.001}],
                       seed=4)
    assert np.isfinite(ran.trial.columns["knee_angle_rad"]).all()
    assert ran.trial.columns["knee_angle_rad"].min() > -1.7


# ---- the bus ----


def test_states_and_counters_of_the_controller_are_events_of_the_trial(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "disturb", "node": 127, "start_s": IN_GAIT_S, "stop_s": IN_GAIT_S + 0.0019}])
    violation, passive, active, number = [text for text in ran.said("bus") if text.startswith("CAN controller")]
    assert violation.endswith("in CRC while sending; transmit error counter 8, receive error counter 0.")
    assert passive == "CAN controller: ERROR-PASSIVE; transmit error counter 128, receive error counter 0."
    assert active == "CAN controller: ERROR-ACTIVE; transmit error counter 127, receive error counter 0."
    assert re.search(r"while sending, \d+ times\.$", number)
    assert ran.result.stop_reason is None


@pytest.mark.parametrize(("can_id", "data", "text"), [
    (0x204, "00 0c 00 00 00 00 60 00", "ERROR-WARNING; transmit error counter 96, receive error counter 0"),
    (0x240, "00 00 00 00 00 00 f8 00", "BUS-OFF; transmit error counter 248, receive error counter 0"),
    (0x020, "00 00 00 00 00 00 00 00", "no acknowledge"),
    (0x004, "00 01 00 00 00 00 00 00", "receive overflow"),
    (0x08C, "00 20 84 0a 00 00 88 00",
     "ERROR-PASSIVE, stuff error in data while sending; transmit error counter 136, receive error counter 0"),
    (0x100, "", "ERROR-ACTIVE, controller restarted"),
])
def test_error_frames_read_as_the_kernel_defines_them(can_id: int, data: str, text: str) -> None:
    assert str(error_frames.decode(can_id, bytes.fromhex(data))) == text


def heard(*frames: tuple[int, bytes], own: bool = False) -> BusWatch:
    watch = BusWatch(wire(Network()))
    watch.sent(0x201, bytes(8))
    watch.hear(can.Message(arbitration_id=0x080, is_extended_id=False, is_rx=False), False)  # the master's own SYNC
    for n, (can_id, data) in enumerate(frames):
        watch.hear(can.Message(1.0 + 1e-4 * n, can_id, False, data=data, is_rx=not own), False)
    return watch


@pytest.mark.parametrize(("can_id", "data", "text", "moves"), [
    (0x201, b"\1" + bytes(7), "targets (201h) from another master", True),
    (0x201, bytes(8), "as the master sent it, a second time", False),
    (0x301, bytes(4), "controlwords (301h) from another master", True),
    (0x000, bytes((NmtCommand.STOP, 1)), "NMT STOP to servo", True),
    (0x080, b"", "SYNC from somebody else", True),
    (0x602, bytes.fromhex("2381600000000000"), "SDO write of 6081:00 to knee", True),
    (0x602, bytes.fromhex("4081600000000000"), "an SDO read of 6081:00 to knee", False),
    (0x77F, b"\5", "heartbeat of another master", True),
    (0x7E5, bytes(8), "LSS", True),
    (0x709, b"\5", "heartbeat of node 9", False),
    (0x123, b"", "identifier 123h, which nobody here owns", False),
])
def test_what_is_foreign_is_said_once_and_whether_it_moves(can_id: int, data: bytes, text: str, moves: bool) -> None:
    watch = heard((can_id, data), (can_id, data))
    assert [(text in stranger.text, stranger.moves) for stranger in watch.found] == [(True, moves)]


def test_the_nodes_own_frames_are_nobodys_business() -> None:
    watch = heard((0x181, bytes(8)), (0x184, bytes(2)), (0x701, b"\5"), (0x083, bytes(8)), (0x582, bytes(8)))
    assert not watch.found
    assert not heard((0x080, b""), own=True).found


def test_a_babbler_is_said_to_be_one() -> None:
    watch = heard(*[(0x7F0, b"\x55")] * FLOOD)
    assert watch.flooded
    assert watch.found[-1].moves
    assert "babbler" in watch.found[-1].text
    assert watch.summary() == [f"7F0h came {FLOOD} times"]


def test_no_number_of_foreign_frames_hides_a_command() -> None:
    """300 extended identifiers at 4 ms and 700 of 11 bits, then targets and SDO writes: the commands are all logged."""
    watch = BusWatch(wire(Network()))
    own = {watch_id for base in (0x080, 0x180, 0x580, 0x700) for watch_id in range(base, base + 5)}
    unknown = [(0x10000 + n, True) for n in range(300)] + [(n, False) for n in range(0x080, 0x580) if n not in own]
    for n, (can_id, extended) in enumerate(unknown):
        watch.hear(can.Message(4e-3 * n, can_id, extended, data=bytes(8)), False)
    assert len(watch.found) < 10
    assert len(watch.counts) < 2050
    watch.found.clear()
    for n, index in enumerate(range(0x2000, 0x2190), start=len(unknown)):
        write = b"\x2b" + index.to_bytes(2, "little") + bytes(5)
        watch.hear(can.Message(4e-3 * n, 0x601, False, data=write), False)
    assert len(watch.found) == 400
    assert all(stranger.moves for stranger in watch.found)
    assert any("2012:00" in stranger.text for stranger in watch.found)


def test_foreign_targets_behind_unknown_identifiers_are_said() -> None:
    unknown = [(0x480 + n, b"") for n in range(256)]
    watch = heard(*unknown, (0x201, b"\1" + bytes(7)))
    assert "targets (201h) from another master" in watch.found[-1].text


# ---- what is told ----


def test_equal_misses_are_told_once_with_how_many_they_were(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "drop", "cob_id": 0x184, "start_s": IN_GAIT_S, "stop_s": IN_GAIT_S + 0.007}])
    assert ran.result.stop_reason is None
    assert ran.said("miss") == ["no inputs of end.", "no inputs of end, 7 cycles in a row."]


def test_a_stop_tells_its_cause_once_and_no_thousand_events(composer: Composer) -> None:
    ran = composer.run(faults=[{"kind": "cut", "node": 4, "start_s": IN_GAIT_S}])
    after = [event for event in ran.trial.events if event.time_ns >= IN_GAIT_S * 1e9]
    assert len(after) < 12
    assert "inputs too old: end" in str(ran.result.stop_reason)


# ---- limits of motion ----


def test_a_motion_beyond_the_knees_limits_is_refused_before_a_frame_is_sent(composer: Composer) -> None:
    link, tap = composer.link()
    for limits, text in ((Limits(knee_low_rad=-0.5), "knee would move from"), (Limits(knee_rad_s=2.0), "rad/s")):
        with pytest.raises(InputError, match=text):
            run(link, tap, None, ExperimentSetup(paper_reference(40.0, 1.1), limits=limits))
    assert link.clock() == 0


# ---- signals of the operating system ----


class Acting(Recorder):
    """A recorder beside which something happens at a row of the rope's load."""

    rows = 0
    act: Callable[[], None]

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        super().cycle(time_ns, values)
        self.rows += 1
        if self.rows == LOADED_ROW:
            self.act()


def signalled(composer: Composer, number: int) -> Ran:
    def wrap(recorder: Recorder) -> Recorder:
        recorder.__class__ = Acting
        recorder.act = lambda: signal.raise_signal(number)  # type: ignore[attr-defined]
        return recorder

    return composer.run(wrap=wrap)


@pytest.mark.parametrize("name", [
    "SIGTERM", *(pytest.param(name, marks=pytest.mark.exhaustive) for name in ("SIGHUP", "SIGQUIT"))])
def test_a_signal_stops_as_ctrl_c_does(composer: Composer, name: str) -> None:
    number = getattr(signal, name)
    before = signal.getsignal(number)
    ran = signalled(composer, number)
    assert ran.result.stop_reason == f"interrupted: by {name}"
    assert ran.result.signal == number
    assert ran.truth.columns["true_start_n"][-1] < 5.0
    assert signal.getsignal(number) is before


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interruption() as asked:
            signal.raise_signal(signal.SIGHUP)
            assert asked() == 0
            signal.raise_signal(signal.SIGTERM)
            assert asked() == signal.SIGTERM
            signal.raise_signal(signal.SIGQUIT)
            assert asked() == signal.SIGTERM
    finally:
        signal.signal(signal.SIGHUP, before)
    assert set(ENDING) >= {signal.SIGINT, signal.SIGTERM}
