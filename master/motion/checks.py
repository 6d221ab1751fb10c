"""Table of the checks that can stop a motion: signals, bound and its source, reaction, test.

Each bound is read from the constant or setting that decides, so that the table cannot differ from the checks.
`docs/safety.md` prints it with the largest value of healthy trials (`python -m benchmarks.supervision --page`).
"""

import math
from typing import Final, NamedTuple

from master.cycle import plausibility as p
from master.cycle import reception, repetition
from master.cycle.guard import LIMITED_NS
from master.cycle.inputs import END, KNEE, SERVO, START
from master.cycle.safety import NOBODY, REACTIONS, Condition, Reaction
from master.motion import home
from master.network import bus_watch
from master.settings import Limits

C = Condition
MS: Final = 1e-6
_L: Final = Limits()
_TWO: Final = f"{p.PERSIST:.0f} cycles in a row; forms and sizes of {{}}"
_MODEL: Final = _TWO.format("what homing's fit leaves of the bench")
_FOUR: Final = f"{repetition.PERSIST} phases in a row; "


class Check(NamedTuple):
    """Check that can stop a motion: compared signals, bound in words, source of the bound, condition with the place
    of the device that it names, and the test that shows it.

    `healthy`: name by which `benchmarks.supervision` measures its largest share of the bound in healthy trials.
    """

    name: str
    signals: str
    bound: str
    source: str
    condition: Condition
    place: int
    test: str
    healthy: str = ""

    @property
    def reaction(self) -> Reaction:
        """First action of the stop."""
        return REACTIONS[self.condition, self.place]


def _n(of: tuple[float, float], unit: str = "N", scale: float = 1.0) -> str:
    return f"{scale * of[0]:g} {unit} + {scale * of[1]:g} {unit} for each N of the peak"


CHECKS: Final = (
    Check("START limit", "START", f"{_L.start_n:g} N (`limits.start_n`)", "bench.toml", C.START_LIMIT, START,
          "test_start_above_its_limit_unwinds_then_quick_stops", "START"),
    Check("END limit", "END", f"{_L.end_n:g} N (`limits.end_n`)", "bench.toml", C.END_LIMIT, END,
          "test_end_above_its_limit_turns_the_torque_off", "END"),
    Check("knee range", "knee angle", f"{math.degrees(_L.knee_low_rad):.0f}° … {math.degrees(_L.knee_high_rad):.0f}° "
          "(`limits.knee_low_rad`, `knee_high_rad`)", "bench.toml", C.OUT_OF_LIMITS, KNEE,
          "test_a_jog_beyond_the_knees_limits_moves_nothing"),
    Check("following error", "statusword bit 13", "set", "the drive's 0x6065", C.OFF_TARGET, SERVO,
          "test_a_following_error_counts_while_the_tension_bound_acts"),
    Check("internal limit", "statusword bit 11", f"set for {LIMITED_NS * MS:.0f} ms", "assumed",
          C.OFF_TARGET, SERVO, "test_tension_stops_at_its_limit"),
    Check("tension that cannot be", "START, END",
          f"{reception.TENSION_STEP_N:g} N + {1e-3 * reception.TENSION_RATE_N_S:g} N/ms from the last one, "
          f"{reception.ENOUGH} cycles in a row", "stiffest path at the drum's greatest speed",
          C.IMPLAUSIBLE, START, "test_values_that_cannot_be_are_not_taken"),
    Check("position that cannot be", "rope, knee", f"{1e3 * reception.POSITION_STEP_M:g} mm, "
          f"{math.degrees(reception.KNEE_STEP_RAD):.1f}° and the greatest speed from the last one, {reception.ENOUGH} "
          "cycles in a row", "`limits.rope_m_s`, `limits.knee_rad_s`", C.IMPLAUSIBLE, SERVO,
          "test_values_that_cannot_be_are_not_taken"),
    Check("servo", "rope position, position loop's answer to the targets",
          f"{1e3 * p.TRACK_M:g} mm + {p.TRACK_SHARE:g} of the lag", _TWO.format("a loop of 20 Hz"), C.OFF_TARGET, SERVO,
          "test_a_motion_that_is_not_the_commanded_one_names_its_axis", "servo"),
    Check("knee", "knee angle, its targets", f"{math.degrees(p.KNEE_RAD):.2f}° + {1e3 * p.KNEE_S:g} ms of its speed",
          _TWO.format("a loop of 2.5 ms"), C.OFF_TARGET, KNEE,
          "test_a_motion_that_is_not_the_commanded_one_names_its_axis", "knee"),
    Check("ratio", "START, END", f"{p.RATIO_N:g} N + 5 % + {p.RATIO_N_S_M:g} N·s/m beyond friction's bounds", _MODEL,
          C.IMPLAUSIBLE, START, "test_the_pattern_of_relations_names_the_suspect", "ratio"),
    Check("force", "servo force, START", f"{p.FORCE_N:g} N + {p.FORCE_SHARE:g} of inertia, mean of "
          f"{1e3 * p.WINDOW_S:g} ms", _MODEL, C.IMPLAUSIBLE, SERVO,
          "test_the_pattern_of_relations_names_the_suspect", "force"),
    Check("start", "rope, knee, START", f"{1e3 * p.STRETCH_M:g} mm + stretch by {p.STRETCH_N:g} N; in homing a gain of "
          f"{p.RATIO_N:g} N + 5 % + {p.RATIO_N_S_M:g} N·s/m while the rope pays out", _MODEL,
          C.IMPLAUSIBLE, NOBODY, "test_the_pattern_of_relations_names_the_suspect", "start"),
    Check("end", "rope, knee, END", f"{1e3 * p.STRETCH_M:g} mm + stretch by {p.STRETCH_N:g} N", _MODEL, C.IMPLAUSIBLE,
          END, "test_the_pattern_of_relations_names_the_suspect", "end"),
    Check("still START", "START, END", f"one value for {1e3 * p.SAME_FOR_S:g} ms while END goes {p.RATIO_N:g} N + 10 %",
          "a converter that is alive has noise", C.IMPLAUSIBLE, START, "test_every_row_keeps_its_bounds",
          "still START"),
    Check("still END", "END, START", f"one value for {1e3 * p.SAME_FOR_S:g} ms while START goes {1.5 * p.RATIO_N:g} N "
          "+ 45 %", "a converter that is alive has noise", C.IMPLAUSIBLE, END, "test_every_row_keeps_its_bounds",
          "still END"),
    Check("still servo", "rope position, position loop's answer", f"one value while that goes {1e3 * p.STILL_M:g} mm",
          _TWO.format("the encoder's step, 1 µm"), C.OFF_TARGET, SERVO,
          "test_defects_once_found_are_said_named_and_bounded", "still servo"),
    Check("still knee", "knee angle, its target", f"one value while that goes {math.degrees(p.STILL_RAD):.2f}°",
          "form and size of the encoder's step, 0.001°", C.OFF_TARGET, KNEE, "test_every_row_keeps_its_bounds",
          "still knee"),
    Check("desired", "END, the gait table's force", _n(repetition.TOLERANCES[0]),
          _FOUR + "model error of a bench that is not identified", C.IMPLAUSIBLE, NOBODY,
          "test_end_is_compared_with_the_gait_tables_force_whatever_a_controller_traces", "desired"),
    Check("first cycle", "END − desired, first gait cycle", _n(repetition.TOLERANCES[1]),
          _FOUR + "what a controller learns after its first cycle", C.IMPLAUSIBLE, NOBODY,
          "test_a_slow_change_is_found_and_named_by_which_signals_moved", "first cycle"),
    Check("second cycle", "END − desired, second gait cycle", _n(repetition.TOLERANCES[2]),
          _FOUR + "repeatability of the bench", C.IMPLAUSIBLE, NOBODY,
          "test_a_slow_change_is_found_and_named_by_which_signals_moved", "second cycle"),
    Check("rope, first cycle", "rope position, first gait cycle", _n(repetition.TOLERANCES[3], "mm", 1e3),
          _FOUR + "what a controller learns after its first cycle", C.IMPLAUSIBLE, NOBODY,
          "test_a_slow_change_is_found_and_named_by_which_signals_moved", "rope, first cycle"),
    Check("rope, second cycle", "rope position, second gait cycle", _n(repetition.TOLERANCES[4], "mm", 1e3),
          _FOUR + "repeatability of the bench", C.IMPLAUSIBLE, NOBODY,
          "test_a_slow_change_is_found_and_named_by_which_signals_moved", "rope, second cycle"),
    Check("homing: stretch", "rope, START, END", f"factor {home.STRETCH:g}, {home.STRETCH_NOMINAL:g} for the "
          "packaged calibration", "session and creep change it by a tenth", C.REFUSED, NOBODY,
          "test_a_calibration_of_another_bench_is_refused_before_motion_with_both_numbers"),
    Check("homing: rope_per_knee", "rope, knee", f"{100 * home.SWING:.0f} %, measured where it is more than "
          f"{100 * home.SWING_UNLIKE:.0f} % from the packaged one", "levers of knees", C.REFUSED, NOBODY,
          "test_a_calibration_of_another_bench_is_refused_before_motion_with_both_numbers"),
    Check("homing: START by END", "START, END", f"factor {math.exp(home.CENTRE):.2f} in the middle",
          "friction cancels out", C.REFUSED, NOBODY, "test_every_row_keeps_its_bounds"),
    Check("homing: servo force", "servo force, START", f"{home.FORCE_RMS_N:g} N rms",
          "friction and inertia fitted", C.REFUSED, NOBODY, "test_every_row_keeps_its_bounds"),
    Check("inputs too old", "PDOs", f"{_L.stale_cycles} cycles in a row (`limits.stale_cycles`)", "bench.toml", C.STALE,
          START, "test_start_stale_for_n_cycles_stops_after_n"),
    Check("SYNC missing", "SYNC, all PDOs", f"{_L.stale_cycles} cycles (`limits.stale_cycles`)", "bench.toml",
          C.SYNC_LOST, NOBODY, "test_sync_lost_turns_the_torque_off"),
    Check("heartbeat", "heartbeats", "`network.heartbeat_timeout_ms`", "bench.toml", C.NODE_LOST, END,
          "test_a_lost_heartbeat_alone_stops_the_trial"),
    Check("node's state", "heartbeats", "STOPPED or PRE-OPERATIONAL", "CiA 301", C.LEFT, KNEE,
          "test_every_row_keeps_its_bounds"),
    Check("boot-up", "boot-up messages", "any", "CiA 301", C.BOOTED, END, "test_a_restarted_node_stops_the_trial"),
    Check("emergency of the servo", "EMCY", "any", "the drive's own checks", C.EMERGENCY, SERVO,
          "test_an_emergency_stops_the_trial_and_is_told"),
    Check("emergency of the knee", "EMCY", "any", "the drive's own checks", C.EMERGENCY, KNEE,
          "test_a_knee_whose_feedback_fails_is_let_go_and_the_leg_keeps_its_bounds"),
    Check("drive not enabled", "statusword", "not OPERATION ENABLED", "CiA 402", C.NOT_ENABLED, KNEE,
          "test_every_row_keeps_its_bounds"),
    Check("foreign command", "frames of others", f"any that moves; {bus_watch.FLOOD} within "
          f"{bus_watch.FLOOD_NS * MS:.0f} ms or {bus_watch.STREAM} within {bus_watch.STREAM_NS * MS:.0f} ms",
          "bus load of one cycle", C.FOREIGN, NOBODY, "test_what_is_foreign_is_said_once_and_whether_it_moves"),
    Check("controller", "targets, trace", "raises, or a target that is not finite", "–", C.CONTROLLER, NOBODY,
          "test_a_controller_that_fails_ends_in_the_safe_stop_that_names_it"),
    Check("recording", "the trial's file", "cannot be written", "–", C.RECORDING, NOBODY,
          "test_a_full_disk_stops_the_trial"),
    Check("operator", "signals, stop button", "any", "–", C.INTERRUPTED, NOBODY, "test_a_signal_stops_as_ctrl_c_does"),
    Check("bus", "errors of the interface", "any", "–", C.BUS_LOST, NOBODY, "test_the_servo_cut_off_lets_go_by_itself"),
    Check("program", "exceptions", "any", "–", C.FAILED, NOBODY, "test_defects_once_found_are_said_named_and_bounded"),
)
"""Every check, in the order in which a control cycle makes them; then those of bring-up and of what runs beside it."""
