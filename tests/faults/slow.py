"""Slow faults: nothing jumps, and no cycle by itself contradicts another one.

Every row is run over six gait cycles at several periods and controllers; `SIZES` are those rows whose size an attacker
may choose, for the search of `tests.faults.stealth`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

from physics.calibration import nominal
from physics.plant.bench_plant import Outputs
from tests.faults import argument, names
from tests.faults.plants import Stage, lying
from tests.faults.stage import Row, Scene, Walk

TWICE = frozenset({(1.1, "paper"), (2.0, "extended"), (3.0, "paper"), (2.0, "none")})
"""Gaits that a fault begins in at both of its moments; in the others it begins at idle alone."""
WALKS = tuple(Walk(period_s, controller, 6, () if (period_s, controller) in TWICE else ("idle",))
              for controller in ("paper", "extended", "none", "friction", "impedance") for period_s in (1.1, 2.0, 3.0))
RAMP_S = 2.0
LOADED_SHARE = 0.8
Act = Callable[[Scene], None]


def grown(t: float, over_s: float = RAMP_S) -> float:
    """Share of a fault that has grown for `t` seconds."""
    return min(1.0, max(0.0, t / over_s))


def sensed(**lies: Callable[[float, float], float]) -> Act:
    """A sensor lies from now on; `lies` by field of `Outputs`: (true value, seconds since) → what is felt."""
    def act(scene: Scene) -> None:
        scene.plant.sense = lying(**lies)(scene.now_ns)
    return act


def start_loaded(by_n: float) -> Act:
    """START departs by up to `by_n` while the rope is loaded."""
    def lie(value: float, t: float) -> float:
        most = LOADED_SHARE * max(value, 0.0)
        return value + max(-most, min(most, by_n * grown(t)))
    return sensed(start_n=lie)


def start_gain(by: float) -> Act:
    """START's gain departs by a share."""
    return sensed(start_n=lambda value, t: value * (1.0 + by * grown(t)))


def end_gain(by: float) -> Act:
    """END's gain departs by a share."""
    return sensed(end_n=lambda value, t: value * (1.0 + by * grown(t)))


def alike(by: float) -> Act:
    """START, END and the servo's torque tell the same share too much or too little."""
    def act(scene: Scene) -> None:
        since = scene.now_ns
        share: Callable[[float], float] = lambda t: 1.0 + by * grown(t)  # noqa: E731
        scene.plant.sense = lying(start_n=lambda value, t: value * share(t), end_n=lambda value, t: value * share(t)
                                  )(since)
        stage: Stage = lambda now_ns, servo, knee: (servo / share((now_ns - since) * 1e-9), knee)  # noqa: E731
        scene.plant.stage = stage
    return act


def start_late(by_s: float) -> Act:
    """START's delay grows to `by_s` within 6 s."""
    kept: deque[tuple[float, float]] = deque()

    def lie(value: float, t: float) -> float:
        kept.append((t, value))
        at = t - by_s * grown(t, 6.0)
        while len(kept) > 1 and kept[1][0] <= at:
            kept.popleft()
        return kept[0][1]
    return sensed(start_n=lie)


def start_freezes(for_s: float) -> Act:
    """START stands still for `for_s` of every twice as long."""
    kept = [0.0]

    def lie(value: float, t: float) -> float:
        if t % (2.0 * for_s) < for_s:
            kept[0] = value
        return kept[0]
    return sensed(start_n=lie)


def start_replayed(for_s: float) -> Act:
    """START repeats its next `for_s` from then on, as a recording that is played again and again."""
    kept: list[float] = []
    began: list[float] = []

    def lie(value: float, t: float) -> float:
        if t < for_s:
            kept.append(value)
            began.append(t)
            return value
        return kept[bisect_right(began, t % for_s) - 1]
    return sensed(start_n=lie)


def swapped(scene: Scene) -> None:
    """START and END are swapped."""
    def sense(_now_ns: int, felt: Outputs) -> Outputs:
        return felt._replace(start_n=felt.end_n, end_n=felt.start_n)
    scene.plant.sense = sense


def slips(by_m: float) -> Act:
    """The sheath slips within 2 s, so that the rope has `by_m` more to span (negative: less)."""
    def act(scene: Scene) -> None:
        since, done = scene.now_ns, [0.0]

        def sense(now_ns: int, felt: Outputs) -> Outputs:
            now = by_m * grown((now_ns - since) * 1e-9)
            scene.plant.snap(0, now - done[0])
            done[0] = now
            return felt
        scene.plant.sense = sense
    return act


def servo_creeps(by_m_s: float) -> Act:
    """The servo's encoder creeps."""
    return sensed(servo_position_m=lambda value, t: value + by_m_s * t)


def servo_by_tension(m_per_n: float) -> Act:
    """The servo's encoder errs with the tension."""
    def act(scene: Scene) -> None:
        since = scene.now_ns

        def sense(now_ns: int, felt: Outputs) -> Outputs:
            err = m_per_n * felt.start_n * grown((now_ns - since) * 1e-9)
            return felt._replace(servo_position_m=felt.servo_position_m + err)
        scene.plant.sense = sense
    return act


def knee_scale(by: float) -> Act:
    """The knee encoder's scale departs by a share."""
    return sensed(knee_motor_rad=lambda value, t: value * (1.0 + by * grown(t)))


def knee_creeps(rad_s: float) -> Act:
    """The knee's encoder creeps."""
    return sensed(knee_motor_rad=lambda value, t: value + rad_s * t)


def both_creep(rad_s: float) -> Act:
    """Knee and servo encoder creep in agreement, velocities too: the stretch of the path shows nothing."""
    def act(scene: Scene) -> None:
        swing = nominal().rope_per_knee
        sensed(knee_motor_rad=lambda value, t: value + rad_s * t, knee_motor_rad_s=lambda value, t: value + rad_s,
               servo_position_m=lambda value, t: value + swing * rad_s * t,
               servo_velocity_m_s=lambda value, t: value + swing * rad_s)(scene)
    return act


def friction(factor: float) -> Act:
    """Friction of sheath and fabric grows within 2 s."""
    def act(scene: Scene) -> None:
        was, since = scene.plant.parameters, scene.now_ns
        due = [0]

        def sense(now_ns: int, felt: Outputs) -> Outputs:
            if now_ns >= due[0]:
                due[0] = now_ns + 50_000_000
                share = 1.0 + (factor - 1.0) * grown((now_ns - since) * 1e-9)
                scene.plant.change(mu1=was.mu1 * share, mu2=was.mu2 * share)
            return felt
        scene.plant.sense = sense
    return act


def counted(act: Act) -> Act:
    """An encoder's fault that the drive's velocity shares: it is counted from the same position."""
    def begin(scene: Scene) -> None:
        act(scene)
        lie, kept = scene.plant.sense, [scene.now_ns, 0.0, 0.0]
        assert lie is not None

        def sense(now_ns: int, felt: Outputs) -> Outputs:
            told, dt_s = lie(now_ns, felt), 1e-9 * (now_ns - kept[0])
            rope, knee = told.servo_position_m - felt.servo_position_m, told.knee_motor_rad - felt.knee_motor_rad
            per_s = 1.0 / dt_s if dt_s > 0.0 else 0.0
            servo, motor = (rope - kept[1]) * per_s, (knee - kept[2]) * per_s
            kept[:] = now_ns, rope, knee
            return told._replace(servo_velocity_m_s=felt.servo_velocity_m_s + servo,
                                 knee_motor_rad_s=felt.knee_motor_rad_s + motor)
        scene.plant.sense = sense
    return begin


DEGREE = 0.017453292519943295
SENSED = (names.PARTED, names.START_ALONE, names.START_OR_PATH)
ALIKE = (names.ALIKE, names.GEOMETRY)
SERVO_ENCODER, KNEE_ENCODER = names.emergency("servo", 0x7305), names.emergency("knee", 0x7305)
WRONG_SIGN = names.emergency("servo", 0x7122)
"""A drum that gains speed against the demanded torque: two phases swapped, or an encoder that errs with the tension."""
SLOW = ("ramp", "idle")
TWO_LIE = ("two sensors and the stage that lie by the same share are one witness: what remains is the rope, by which "
           "the stretch at true tension shows, ± 1.2 mm of it in a trial's second cycle")
LEG = ("the knee's angle has one sensor; the rope shows a departure of the leg only while it is taut, by 0.7 mm for "
       "each degree: in swing the leg departs by as much as the scale does")
ROTOR = "the rotor still winds in when the fault is shown, and its momentum adds to what END had then"
TWO_CREEP = ("two encoders in agreement are one witness: 20° of the leg change START and END by 1 N, less than a "
             "healthy gait cycle; a second knee angle, as the safety monitor has it, shows it")

CREPT: Final[Mapping[str, Any]] = {
    "beyond": TWO_CREEP, "excused": ("stop_end_n", "off_deg", "over_deg_s"),
    "unstoppable": "two encoders in agreement are one witness: after 17 s the leg is 30° off, when it "
                   "comes to its end stop and no longer follows its targets; the safety monitor's own knee angle "
                   "shows it before"}


def _row(name: str, act: Act, named: tuple[str, ...], moments: tuple[str, ...] = SLOW, **more: Any) -> Row:
    action = argument.SLOW_KNEE if name.startswith("knee") else argument.SLOW_LIE
    return Row(name, act, named, moments, walks=WALKS, gradual=True, action=action,
               **{"unstoppable": ROTOR, "excused": ("stop_end_n",), **more})


ROWS: tuple[Row, ...] = (
    _row("START − 8.5 N while loaded, within 2 s", start_loaded(-8.5), SENSED),
    _row("START + 8.5 N while loaded, within 2 s", start_loaded(8.5), SENSED),
    _row("START's gain − 18.75 % within 2 s", start_gain(-0.1875), SENSED),
    _row("START, END and torque − 33 % within 2 s", alike(-1.0 / 3.0), ALIKE, beyond=TWO_LIE),
    _row("START's delay grows to 13 ms", start_late(0.013), SENSED),
    _row("START freezes 20 of 40 ms", start_freezes(0.020), SENSED),
    _row("START plays its last 1.1 s again and again", start_replayed(1.1), SENSED),
    _row("START and END swapped", swapped, SENSED, ("idle",)),
    _row("END's gain − 20 % within 2 s", end_gain(-0.2), (names.PARTED, names.END_OR_ROPE, names.BETWEEN)),
    _row("sheath slips by 2 mm within 2 s", slips(0.002), ALIKE),
    _row("sheath slips by − 2 mm within 2 s", slips(-0.002), ALIKE),
    _row("sheath slips by − 4 mm within 2 s", slips(-0.004), ALIKE),
    _row("servo encoder creeps by 0.31 mm/s", servo_creeps(0.31e-3), ALIKE),
    _row("servo encoder creeps by − 0.31 mm/s", servo_creeps(-0.31e-3), ALIKE),
    _row("servo encoder errs by 0.05 mm/N within 2 s", servo_by_tension(0.05e-3), (SERVO_ENCODER,)),
    _row("servo encoder and its velocity err by 0.05 mm/N within 2 s", counted(servo_by_tension(0.05e-3)),
         (*ALIKE, WRONG_SIGN)),
    _row("knee encoder's scale + 13 % within 2 s", knee_scale(0.13), (KNEE_ENCODER,)),
    _row("knee encoder's scale and its velocity + 13 % within 2 s", counted(knee_scale(0.13)), ALIKE, beyond=LEG),
    _row("knee encoder creeps by 0.6°/s", knee_creeps(0.6 * DEGREE), ALIKE, beyond=LEG),
    _row("knee and servo encoder creep in agreement by 2°/s", both_creep(2.0 * DEGREE), (*ALIKE, names.KNEE_OFF),
         **CREPT),
    _row("knee and servo encoder creep in agreement by − 2°/s", both_creep(-2.0 * DEGREE), (*ALIKE, names.KNEE_OFF),
         **CREPT),
    _row("friction × 2.5 within 2 s", friction(2.5), (names.PARTED, names.START_OR_PATH, names.BETWEEN)),
)

VELOCITY: tuple[Row, ...] = (
    Row("servo's velocity feedback reversed", sensed(servo_velocity_m_s=lambda value, t: -value),
        (SERVO_ENCODER, WRONG_SIGN)),
    Row("servo's velocity feedback zero", sensed(servo_velocity_m_s=lambda value, t: 0.0), (SERVO_ENCODER,)),
    Row("servo's velocity feedback × 0.5", sensed(servo_velocity_m_s=lambda value, t: 0.5 * value), (SERVO_ENCODER,)),
)
