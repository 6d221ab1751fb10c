"""The matrix: one row a fault, with when it begins, what it must be called, and why it may go unsaid.

The rule of this file: a row is data and one function that lays hands on the bench; how it is judged is elsewhere.
"""

from __future__ import annotations

import os
import signal
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import can

from eds.bench.bench_network import END, KNEE, SERVO, START
from physics.calibration import nominal
from tests.faults import argument, names, plants, slow
from tests.faults.plants import lying, stuck
from tests.faults.stage import Row, Scene

MS = 1_000_000
LOADED = ("ramp", "peak")
ALL = ("ramp", "peak", "idle")


# ---- hands on the bench ----


def sensed(**lies: Callable[[float, float], float]) -> Callable[[Scene], None]:
    """A sensor lies from now on; `lies` by field of `Outputs`: (true value, seconds since) → what is felt."""
    def act(scene: Scene) -> None:
        scene.plant.sense = lying(**lies)(scene.now_ns)
    return act


def frozen(*fields: str) -> Callable[[Scene], None]:
    """Signals stand still from now on; a frozen position has no speed."""
    def act(scene: Scene) -> None:
        lies: dict[str, Any] = {name: stuck() for name in fields}
        if "servo_position_m" in fields:
            lies["servo_velocity_m_s"] = lambda value, t: 0.0
        if "knee_motor_rad" in fields:
            lies["knee_motor_rad_s"] = lambda value, t: 0.0
        scene.plant.sense = lying(**lies)(scene.now_ns)
    return act


def staged(stage: plants.Stage) -> Callable[[Scene], None]:
    """A drive's power stage does something else from now on."""
    def act(scene: Scene) -> None:
        scene.plant.stage = stage
    return act


def broken(element: int, by_m: float = 1.0) -> Callable[[Scene], None]:
    """The rope snaps, or slips by a length, at an element: 0 is at the drum."""
    return lambda scene: scene.plant.snap(element, by_m)


def changed(**factors: float) -> Callable[[Scene], None]:
    """Numbers of the path are multiplied from now on."""
    def act(scene: Scene) -> None:
        was = scene.plant.parameters
        scene.plant.change(**{name: getattr(was, name) * factor for name, factor in factors.items()})
    return act


def wire(kind: str, for_s: float = 1e6, **fields: Any) -> Callable[[Scene], None]:
    """A fault of the virtual bus."""
    return lambda scene: scene.fault(kind, for_s, **fields)


def said(can_id: int, data: bytes = b"", **flags: bool) -> Callable[[Scene], None]:
    """One foreign frame."""
    return lambda scene: scene.intruder().say(can_id, data, **flags)


def repeated(period_ns: int, can_id: int, data: Callable[[int], bytes], times: int = 100_000
             ) -> Callable[[Scene], None]:
    """Foreign frames, one every so often; `data` by their number."""
    def act(scene: Scene) -> None:
        count = iter(range(times + 1))
        scene.intruder().repeat(period_ns, lambda: (can_id, data(next(count))), times)
    return act


def sdo(node: int, index: int, sub: int, value: int, size: int) -> bytes:
    """An expedited SDO download."""
    return struct.pack("<BHB", 0x23 | (4 - size) << 2, index, sub) + value.to_bytes(size, "little", signed=value < 0
                                                                                    ).ljust(4, b"\0")


def elsewhere(scene: Scene) -> None:
    """Another master's targets, each millisecond, 20 mm further in."""
    position = int(1e6 * scene.sink.rows[-1][1][2]) + 20_000
    repeated(MS, 0x201, lambda n: struct.pack("<ii", position, -28_000))(scene)


def near(scene: Scene) -> None:
    """Another master's targets 4 mm further in: below any step limit."""
    position = int(1e6 * scene.sink.rows[-1][1][2]) + 4_000
    knee = round(57295.78 * scene.sink.rows[-1][1][6])
    repeated(MS, 0x201, lambda n: struct.pack("<ii", position, knee))(scene)


def stale_targets(scene: Scene) -> None:
    """A gateway plays the targets of 150 ms before once more."""
    rows = [values for _t, values in scene.sink.rows]
    count = len(rows) - 150

    def old(n: int) -> bytes:
        row = scene.sink.rows[count + n][1] if count + n < len(scene.sink.rows) else scene.sink.rows[-1][1]
        return struct.pack("<ii", round(1e6 * row[2]), round(57295.78 * row[6]))

    repeated(MS, 0x201, old)(scene)


def own_socket(can_id: int, data: bytes) -> Callable[[Scene], None]:
    """Another program on the master's own computer sends a frame."""
    return lambda scene: scene.tap.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


def sync_stops(scene: Scene) -> None:
    """The kernel's periodic SYNC ends."""
    scene.bus.stop_all_periodic_tasks()


def raised(error: Exception) -> Callable[[Scene], None]:
    """Something inside a cycle raises."""
    def act(scene: Scene) -> None:
        scene.sink.raising = error
    return act


def signalled(number: int) -> Callable[[Scene], None]:
    """The process is sent a signal."""
    return lambda scene: os.kill(os.getpid(), number)


def decimals(scene: Scene) -> None:
    """START's decimals are changed by somebody else: a tenth of every value from now on."""
    said(0x603, sdo(START, 0x6132, 1, 1, 1))(scene)


def corrupt_once(can_id: int, data: bytes) -> Callable[[Scene], None]:
    """One frame of a node is replaced on the wire by another payload, with a CRC that agrees."""
    def act(scene: Scene) -> None:
        scene.bench.wire._judge = _Replacing(can_id, data)
    return act


class _Replacing:
    """Replaces the payload of one frame."""

    def __init__(self, can_id: int, data: bytes) -> None:
        self.can_id, self.data, self.left = can_id, data, 1

    def ready(self, station: Any, frame: Any, ready_ns: int) -> int:
        return ready_ns

    def heard(self, entry: Any, now_ns: int) -> Any:
        frame = entry[3]
        if frame.can_id != self.can_id or not self.left:
            return frame
        self.left -= 1
        return frame._replace(data=frame.data[:len(frame.data) - len(self.data)] + self.data)


def calibrated(**factors: float) -> Callable[[Any], Any]:
    """An experiment with a calibration whose numbers are multiplied, and which claims to be this bench's."""
    def alter(given: Any) -> Any:
        was = nominal()
        return replace(given, calibration=replace(
            was, label="wrong.toml", **{name: getattr(was, name) * factor for name, factor in factors.items()}))
    return alter


def halved(scene: Scene) -> None:
    """START, END and the servo's torque read half of what there is."""
    sensed(start_n=GAIN(0.5), end_n=GAIN(0.5))(scene)
    scene.plant.stage = lambda _now_ns, servo, knee: (2.0 * servo, knee)


def nothing(scene: Scene) -> None:
    """The fault is in what was asked for."""


KNEE_LET_GO = (argument.LYING_KNEE, argument.KNEE_STAGE)
COASTS = "a leg in swing coasts on when its drive lets go, and nothing else that is trusted can brake it"
FRICTION = "START and END differ by friction: within its band, wider while the rope moves, no error of START shows"
LET_GO: dict[str, Any] = {
    "unstoppable": "the fault itself takes the knee's torque: a leg in swing coasts on, and no stop can brake it",
    "excused": ("off_deg",)}


def of(action: argument.UnsafeAction, *rows: Row) -> tuple[Row, ...]:
    """Rows whose fault makes this control action unsafe."""
    coasts = {"unstoppable": COASTS, "excused": ("off_deg",)} if action in KNEE_LET_GO else {}
    return tuple(replace(row, action=action, **({} if row.unstoppable else coasts)) for row in rows)


SET_UP = "it is there in homing and in every gait cycle alike; a set-up check against a known weight or angle shows it"
CONDUCTS = "the stage conducts by itself: the wired emergency stop alone ends that"
UNSTABLE = "a reversed stage makes the drive's loop unstable: the leg has its speed before two cycles show it"
BUSY = "the bus is taken: the drives act by the watchdog of the master's heartbeat alone, after 250 ms"
GAIN, OFFSET = (lambda k: lambda value, t: k * value), (lambda b: lambda value, t: value + b)
ROWS: tuple[Row, ...] = (
    *of(
        argument.LYING_TENSION,
        Row("START stuck at 0", sensed(start_n=lambda value, t: 0.0), (names.START_ALONE, names.START_OR_PATH),
            unstoppable=slow.ROTOR, excused=("stop_end_n",)),
        Row("START stuck at its value", frozen("start_n"), (names.START_ALONE, names.START_OR_PATH),
            unstoppable=slow.ROTOR, excused=("stop_end_n",)),
        Row("START × 0.5", sensed(start_n=GAIN(0.5)), (names.START_ALONE, names.START_OR_PATH),
            unstoppable=slow.ROTOR, excused=("stop_end_n",)),
        Row("START × 2", sensed(start_n=GAIN(2.0)), (names.START_ALONE, names.START_OR_PATH, names.BETWEEN)),
        Row("START × −1", sensed(start_n=GAIN(-1.0)), (names.emergency("start", 0xF001), names.START_OR_PATH)),
        Row("START + 15 N", sensed(start_n=OFFSET(15.0)), (names.START_OR_PATH, names.BETWEEN)),
        Row("START − 15 N", sensed(start_n=OFFSET(-15.0)), (names.START_ALONE, names.BETWEEN, names.TORQUE_OR_START)),
        Row("START drifts by + 20 N/s", sensed(start_n=lambda value, t: value + 20.0 * t), (names.START_ALONE,),
            ("ramp", "idle"), beyond=FRICTION),
        Row("START drifts by − 20 N/s", sensed(start_n=lambda value, t: value - 20.0 * t), (names.BETWEEN,),
            ("ramp", "idle"), beyond=FRICTION),
        Row("START at full scale", sensed(start_n=lambda value, t: 190.0), (names.implausible("start"),)),
        Row("START noisy, 8 N rms", sensed(start_n=lambda value, t: value + 11.3 * __import__("math").sin(4e4 * t)),
            (), LOADED, silent="zero-mean noise above the control band moves END by less than its bound"),
    ),
    *of(
        argument.NO_INPUT,
        Row("START's wire broken", wire("broken_wire", node=START), (names.emergency("start", 0x5030),)),
        Row("START's converter at its end", wire("overload", node=START), (names.emergency("start", 0xF001),)),
        Row("START's PDO lost", wire("drop", cob_id=0x183), (names.old("start"),)),
        Row("START cut off", wire("cut", node=START), (names.old("start"),)),
        Row("START without supply", wire("power_off", node=START), (names.old("start"),)),
        Row("START restarts", wire("power_off", 0.004, node=START), (names.old("start"),), ("peak",)),
        Row("START's PDO shortened", wire("shorten", cob_id=0x183, size=1), (names.old("start"),), ("peak", "idle")),
    ),
    *of(
        argument.FOREIGN,
        Row("START's decimals changed by somebody", decimals,
            (names.foreign("an SDO write of 6132:01 to start from somebody else"),)),
    ),
    *of(
        argument.LYING_TENSION,
        Row("END stuck at 0", sensed(end_n=lambda value, t: 0.0), (names.END_OR_ROPE,)),
        Row("END stuck at its value", frozen("end_n"), (names.END_OR_ROPE, names.BETWEEN)),
        Row("END × 0.5", sensed(end_n=GAIN(0.5)), (names.END_OR_ROPE,)),
        Row("END × 2", sensed(end_n=GAIN(2.0)), (names.END_OR_ROPE, names.BETWEEN)),
        Row("END + 15 N", sensed(end_n=OFFSET(15.0)), (names.END_OR_ROPE, names.BETWEEN, names.DESIRED)),
        Row("END at full scale", sensed(end_n=lambda value, t: 190.0), ("END tension above its limit: # N of # N",
            names.implausible("end"))),
    ),
    *of(
        argument.NO_INPUT,
        Row("END's wire broken", wire("broken_wire", node=END), (names.emergency("end", 0x5030),), ("peak", "idle")),
        Row("END's PDO lost", wire("drop", cob_id=0x184), (names.old("end"),), ("peak", "idle")),
        Row("END cut off", wire("cut", node=END), (names.old("end"),), ("peak", "idle")),
        Row("END's heartbeat lost", wire("drop", cob_id=0x704), ("heartbeat lost: end",), ("peak",)),
        Row("END restarts", wire("power_off", 0.002, node=END), ("restarted by itself: end",), ("peak",)),
    ),
    *of(
        argument.LYING_ROPE,
        Row("servo encoder frozen", frozen("servo_position_m"), (names.SERVO_OFF,), unstoppable=slow.ROTOR,
            excused=("stop_end_n",)),
        Row("servo encoder + 5 mm", sensed(servo_position_m=OFFSET(5e-3)), (names.emergency("servo", 0x7305),)),
        Row("servo encoder − 5 mm", sensed(servo_position_m=OFFSET(-5e-3)), (names.emergency("servo", 0x7305),)),
        Row("servo encoder creeps by 10 mm/s", sensed(servo_position_m=lambda value, t: value - 0.010 * t),
            (names.emergency("servo", 0x7305),), LOADED),
        Row("servo encoder reversed", sensed(servo_position_m=GAIN(-1.0), servo_velocity_m_s=GAIN(-1.0)),
            (names.emergency("servo", 0x7305),)),
        Row("servo encoder × 1.2", sensed(servo_position_m=GAIN(1.2), servo_velocity_m_s=GAIN(1.2)),
            (names.emergency("servo", 0x7305),), ALL),
    ),
    *of(
        argument.LYING_KNEE,
        Row("knee encoder frozen", frozen("knee_motor_rad"), (names.KNEE_OFF,)),
        Row("knee encoder sign flipped", sensed(knee_motor_rad=GAIN(-1.0), knee_motor_rad_s=GAIN(-1.0)),
            (names.emergency("knee", 0x7305),)),
        Row("knee's velocity feedback reversed", sensed(knee_motor_rad_s=GAIN(-1.0)),
            (names.emergency("knee", 0x7305),)),
        Row("knee's velocity feedback + 5 rad/s", sensed(knee_motor_rad_s=OFFSET(5.0)),
            (names.emergency("knee", 0x7305),)),
        Row("knee encoder + 10°", sensed(knee_motor_rad=OFFSET(0.1745)), (names.emergency("knee", 0x7305),)),
        Row("knee encoder creeps by 20°/s", sensed(knee_motor_rad=lambda value, t: value + 0.35 * t),
            (names.emergency("knee", 0x7305),), ("peak",)),
    ),
    *of(
        argument.STAGE,
        Row("servo stage dead", staged(plants.dead), (names.TORQUE_OR_START,)),
        Row("servo stage reversed", staged(plants.reversed_servo), (names.TORQUE_OR_START, slow.WRONG_SIGN)),
        Row("servo stage at a quarter", staged(plants.weak), (names.TORQUE_OR_START,), ("ramp", "peak"),
            silent="the drive's loop makes up for a weak stage as long as its bound allows"),
        Row("servo stage shorted at 4 N·m", staged(plants.shorted), (names.TORQUE_OR_START, slow.WRONG_SIGN),
            unstoppable=CONDUCTS),
    ),
    *of(
        argument.KNEE_STAGE,
        Row("knee stage dead", staged(plants.knee_dead), (names.KNEE_OFF,)),
        Row("knee stage reversed", staged(plants.knee_reversed), (names.KNEE_OFF,), unstoppable=UNSTABLE),
        Row("knee stage runs away", staged(plants.knee_runaway), (names.KNEE_OFF,), unstoppable=CONDUCTS),
    ),
    *of(
        argument.STOP,
        Row("servo's STO pressed", wire("emergency_stop", node=SERVO), (names.emergency("servo", 0x5441),)),
        Row("knee's STO pressed", wire("emergency_stop", node=KNEE), (names.emergency("knee", 0x5441),), **LET_GO),
    ),
    *of(
        argument.PATH,
        Row("rope snapped at the drum", broken(0), (names.GEOMETRY,), LOADED),
        Row("rope slips by 8 mm in its clamp", broken(0, 0.008), (names.END_OR_ROPE, names.GEOMETRY), LOADED),
        Row("rope jammed in its sheath", changed(mu1=8.0), (names.START_OR_PATH,), ("ramp", "peak")),
        Row("fabric jammed on the knee", changed(mu2=8.0), (names.BETWEEN, names.START_OR_PATH), ("ramp", "peak")),
        Row("fabric twice as stiff", changed(stiffness_scale=0.5), (names.GEOMETRY,), ("ramp",)),
    ),
    *of(
        argument.NO_INPUT,
        Row("servo cut off", wire("cut", node=SERVO), (names.old("servo"),)),
        Row("servo without supply", wire("power_off", node=SERVO), (names.old("servo"),)),
    ),
    *of(
        argument.TARGETS,
        Row("servo hears no targets", wire("deaf", node=SERVO, cob_id=0x201), (names.SERVO_OFF,)),
    ),
    *of(
        argument.NO_INPUT,
        Row("servo's PDO lost", wire("drop", cob_id=0x181), (names.old("servo"),)),
        Row("knee cut off", wire("cut", node=KNEE), (names.old("knee"),)),
        Row("knee without supply", wire("power_off", node=KNEE), (names.old("knee"),), **LET_GO),
    ),
    *of(
        argument.TARGETS,
        Row("knee hears no targets", wire("deaf", node=KNEE, cob_id=0x201), (names.KNEE_OFF,)),
    ),
    *of(
        argument.NO_INPUT,
        Row("knee's PDO lost", wire("drop", cob_id=0x182), (names.old("knee"),)),
    ),
    *of(
        argument.TARGETS,
        Row("master cut off", wire("cut", node=127), ("SYNC missing: none for # ms",)),
        Row("SYNC lost to all nodes", wire("drop", cob_id=0x080),
            ("SYNC missing: no node has answered it for # cycles",)),
        Row("SYNC's sender stops", sync_stops, ("SYNC missing: none for # ms",)),
        Row("SYNC doubled", wire("duplicate", cob_id=0x080), (names.foreign("SYNC"),)),
        Row("SYNC late by 2 ms", wire("late_sync", delay_us=2000.0), (), ("peak",),
            silent="every cycle is as late as the other: the drives hold their last targets, nothing moves"),
        Row("targets lost", wire("drop", cob_id=0x201),
            ("motion not as commanded: targets that do not reach the drives, or both drives", names.KNEE_OFF)),
        Row("targets corrupt", wire("corrupt", cob_id=0x201), (names.emergency("servo", 0x8612),), ("ramp", "peak")),
        Row("targets shortened", wire("shorten", 0.003, cob_id=0x201, size=3), (names.emergency("servo", 0x8210),)),
        Row("targets late by 3 ms", wire("delay", cob_id=0x201, delay_us=3000.0), (), ("ramp",),
            silent="3 ms of delay let END lag by less than its bound; the misses are counted"),
        Row("master's heartbeat lost", wire("drop", cob_id=0x77F), (names.emergency("servo", 0x8130),),
            ("peak", "idle")),
    ),
    *of(
        argument.NO_INPUT,
        Row("one in ten PDOs of START lost", wire("drop", cob_id=0x183, probability=0.1), (names.old("start"),),
            ("ramp",),
            silent="lost inputs are marked and held: by design"),
    ),
    *of(
        argument.TARGETS,
        Row("bus disturbed for 3 ms", wire("disturb", 0.003), (), ("peak",),
            silent="frames are repeated by their senders: by design"),
    ),
    *of(
        argument.FOREIGN,
        Row("another master's targets", elsewhere, (names.foreign("targets"),)),
        Row("another master's targets nearby", near, (names.foreign("targets"),)),
        Row("targets replayed stale", stale_targets, (names.foreign("targets"),), LOADED),
        Row("another program's targets on this computer", own_socket(0x201, bytes(8)), (names.foreign("targets"),)),
        Row("foreign controlword: disable voltage", said(0x301, bytes(4)), (names.foreign("controlwords"),), **LET_GO),
        Row("foreign controlword: quick stop", said(0x301, b"\2\0\x0f\0"), (names.foreign("controlwords"),)),
        Row("foreign NMT stop", said(0x000, b"\2\1"), (names.foreign("NMT STOP to servo from another master"),)),
        Row("foreign NMT reset", said(0x000, b"\x81\0"),
            (names.foreign("NMT RESET NODE to all nodes from another master"),), **LET_GO),
        Row("foreign NMT pre-operational", said(0x000, b"\x80\3"),
            (names.foreign("NMT ENTER PRE OPERATIONAL to start from another master"),)),
        Row("foreign SYNC", repeated(7 * MS, 0x080, lambda n: b""), (names.foreign("SYNC from somebody else"),)),
        Row("second master's heartbeat", said(0x77F, b"\5"), (names.foreign("heartbeat of another master"),),
            ("peak", "idle")),
        Row("foreign SDO write of 60B0", said(0x601, sdo(1, 0x60B0, 0, 8000, 4)),
            (names.foreign("an SDO write of 60B0:00 to servo from somebody else"),)),
        Row("foreign SDO write of the gain × 8", said(0x601, sdo(1, 0x60FB, 1, 1_000_000, 4)),
            (names.foreign("an SDO write of 60FB:01 to servo from somebody else"),)),
        Row("foreign SDO write of the tension limit", said(0x601, sdo(1, 0x2012, 0, 0, 2)),
            (names.foreign("an SDO write of 2012:00 to servo from somebody else"),), ("peak",)),
        Row("foreign SDO write to the knee", said(0x602, sdo(2, 0x607D, 2, 90_000, 4)),
            (names.foreign("an SDO write of 607D:02 to knee from somebody else"),),
            ("peak",)),
        Row("foreign SDO read", said(0x601, bytes.fromhex("4000100000000000")),
            ("an SDO read of 1000:00 to servo from somebody else",),
            ("peak",), event=True),
        Row("a second START", repeated(MS, 0x183, lambda n: struct.pack("<h", 1000)),
            (names.foreign("the inputs of start"), names.START_OR_PATH), ("peak", "idle")),
        Row("a second servo's PDO", repeated(MS, 0x181, lambda n: bytes(8)), ("drive left OPERATION ENABLED: servo",),
            ("peak",)),
        Row("unknown identifier, once", said(0x123, b"abc"), ("identifier 123h",), ("peak",), event=True),
        Row("unknown node's heartbeat", said(0x721, b"\5"), ("heartbeat of node 33",), ("idle",), event=True),
        Row("extended frame", said(0x12345, b"\1", extended=True), ("extended frame 12345h",), ("idle",), event=True),
        Row("remote frame", said(0x181, b"", remote=True), ("remote frame 181h",), ("idle",), event=True),
        Row("LSS command", said(0x7E5, bytes(8)), (names.foreign("LSS command from somebody else"),), ("idle",)),
        Row("babbler of the highest identifier", wire("babble", cob_id=0x001, size=8), (names.foreign("babbler"),)),
        Row("babbler of the lowest identifier", wire("babble", cob_id=0x7F0, size=8), (names.foreign("babbler"),)),
        Row("babbler of NMT", wire("babble", cob_id=0x000, size=2),
            (names.foreign("NMT 55h to node 85 from another master"),)),
        Row("babbler of targets", wire("babble", cob_id=0x201, size=8), (names.foreign("targets"),),
            ("peak", "idle"), unstoppable=BUSY),
    ),
    *of(
        argument.ALTERED,
        Row("one knee frame of 2·10⁹ mdeg", corrupt_once(0x182, struct.pack("<i", 2_000_000_000)),
            ("knee: # degrees",), ("ramp", "peak", "idle"), event=True),
        Row("one servo frame 50 mm off", corrupt_once(0x181, struct.pack("<ih", 60_000, 0)),
            ("servo: # mm right after # mm; not taken",),
            ("peak",), event=True),
        Row("one START frame of 150 N", corrupt_once(0x183, struct.pack("<h", 15_000)),
            ("start: # N right after # N; not taken",), ("idle",),
            event=True),
        Row("one END frame of −200 N", corrupt_once(0x184, struct.pack("<h", -20_000)),
            ("end: # N right after # N; not taken",), ("peak",),
            event=True),
        Row("one target frame 30 mm off", corrupt_once(0x201, struct.pack("<ii", 60_000, -28_000)),
            (names.emergency("servo", 0x8612),), ("peak",)),
        Row("START's values corrupt, a bit each", wire("corrupt", cob_id=0x183), (names.implausible("start"),),
            ("peak", "idle")),
    ),
    *of(
        argument.STOP,
        Row("an error inside a cycle", raised(OverflowError("cannot convert float infinity to integer")),
            ("program failed: OverflowError",)),
        Row("SIGTERM", signalled(signal.SIGTERM), ("interrupted: by SIGTERM",), ("peak", "idle")),
        Row("SIGHUP", signalled(signal.SIGHUP), ("interrupted: by SIGHUP",), ("peak",)),
        Row("SIGQUIT", signalled(signal.SIGQUIT), ("interrupted: by SIGQUIT",), ("peak",)),
        Row("Ctrl-C", signalled(signal.SIGINT), ("interrupted: by the operator",), ("ramp", "peak")),
    ),
    *of(
        argument.OTHER_BENCH,
        Row("calibration: stiffness × 0.5", nothing, ("refused: calibration wrong.toml: its rope and fabric stretch",),
            ("start",),
            experiment=calibrated(stiffness_a=0.5, stiffness_b=0.5, cable_compliance=0.5)),
        Row("calibration: stiffness × 2", nothing, ("refused: calibration wrong.toml: its rope and fabric stretch",),
            ("start",),
            experiment=calibrated(stiffness_a=2.0, stiffness_b=2.0, cable_compliance=2.0)),
        Row("calibration: swing × 2", nothing, ("refused: calibration wrong.toml: its rope_per_knee",), ("start",),
            experiment=calibrated(rope_per_knee=2.0)),
        Row("calibration: swing × 0.5", nothing, ("refused: calibration wrong.toml: its rope_per_knee",), ("start",),
            experiment=calibrated(rope_per_knee=0.5)),
        Row("START × 0.5 from power-on", sensed(start_n=GAIN(0.5)), (names.TORQUE_OR_START,), ("start",),
            unstoppable=slow.ROTOR, excused=("stop_end_n",)),
        Row("END × 0.4 from power-on", sensed(end_n=GAIN(0.4)), ("refused: homing: pulled and released, START",),
            ("start",)),
        Row("servo stage dead from power-on", staged(plants.dead), (names.SERVO_OFF, names.TORQUE_OR_START),
            ("start",)),
        Row("servo stage reversed from power-on", staged(plants.reversed_servo), (slow.WRONG_SIGN,), ("start",)),
        Row("knee stage reversed from power-on", staged(plants.knee_reversed), (names.KNEE_OFF,), ("start",),
            unstoppable=UNSTABLE),
        Row("power_on_start_gain: START − 20 %", sensed(start_n=GAIN(0.8)), (), ("start",), silent=SET_UP),
        Row("power_on_start_end_gain: START and END − 20 % alike", sensed(start_n=GAIN(0.8), end_n=GAIN(0.8)), (),
            ("start",), silent=SET_UP),
        Row("power_on_force_gain: START, END and torque − 50 %", halved, (), ("start",), silent=SET_UP),
        Row("power_on_knee_zero: knee − 10°", sensed(knee_motor_rad=OFFSET(-0.1745)), (), ("start",), silent=SET_UP),
        Row("power_on_knee_scale: knee + 15 %", sensed(knee_motor_rad=GAIN(1.15), knee_motor_rad_s=GAIN(1.15)), (),
            ("start",), silent=SET_UP),
        Row("rope snapped before the start", broken(0), ("refused: servo: # mm of rope and START",), ("start",)),
        Row("another master from the start", repeated(50 * MS, 0x77F, lambda n: b"\5"), ("refused: another master",),
            ("start",)),
        Row("somebody's SYNC from the start", repeated(MS, 0x080, lambda n: b""),
            ("refused: somebody sends SYNC already: another master, or what an aborted run left; stop it first",),
            ("start",)),
    ),
    *of(
        argument.NO_INPUT,
        Row("START's heartbeat says STOPPED", repeated(50 * MS, 0x703, lambda n: b"\4"),
            ("node left OPERATIONAL: start",), ("peak", "idle")),
        Row("knee's heartbeat says PRE-OPERATIONAL", repeated(50 * MS, 0x702, lambda n: b"\x7f"),
            ("node left OPERATIONAL: knee",), ("peak",), unstoppable=COASTS, excused=("off_deg",)),
    ),
    *of(
        argument.ALTERED,
        Row("a knee PDO of 8 bytes", said(0x182, bytes(8)), ("knee: a PDO of # bytes",), ("peak",), event=True),
    ),
    *of(
        argument.FOREIGN,
        Row("foreign frames each 0.55 ms", repeated(550_000, 0x123, lambda n: b"abc"), (names.foreign("babbler"),),
            ("ramp",)),
    ),
    *of(argument.LYING_VELOCITY, *slow.VELOCITY),
    *slow.ROWS,
)
