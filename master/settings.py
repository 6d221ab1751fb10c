"""Settings of an experiment that a user may change, declared once.

Declarations only; every number is checked on entry (`parameters.checked`), and no lower module reads a configuration
file.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

from parameters import InputError, apart, parameter


@dataclass(frozen=True)
class Gait:
    """The experiment as the paper runs it: `cycles` gait cycles, the first `settle` of them left out of figures."""

    peak_n: float = parameter(40.0, "N", "peak of the desired force, Fdp", low=1.0, high=85.0,
                              source="equation (2); 88 N is the turning point of (10)")
    period_s: float = parameter(2.0, "s", "period of one gait cycle", low=0.5, high=20.0,
                                source="assumed: not given by the paper")
    cycles: int = parameter(10, "", "gait cycles to run", low=1, high=10_000, source="ten swings in the paper")
    settle: int = parameter(1, "", "first cycles left out of every figure", low=0, high=9_999, source="assumed")
    soft_start: int = parameter(0, "", "gait cycles before the first, over which the peak rises", low=0, high=100,
                                source="assumed: none; three at a bench that has not run before")
    controller: str = parameter("paper", "", "none, friction, impedance, paper, extended, or a plug-in",
                                source="the paper; docs/controllers.md")
    tuning: str = parameter("", "", "values of the controller's own parameters, as kp=40, ki=2",
                            source="docs/controllers.md")
    co_contraction: float = parameter(
        0.5, "", "desired force of an antagonist, by that of the rope that flexes the joint", low=0.05, high=1.0,
        source="assumed: half; benches of two ropes on one joint only")
    idle_slack_m: float = parameter(3e-3, "m", "rope paid out while no force is desired", low=0.0, high=20e-3,
                                    source="assumed: keeps END below 1 N through the swing, rope on its drum")


@dataclass(frozen=True)
class Walk:
    """Settings of a gait with varied strides: how strides are drawn, and which phase the desired force follows."""

    strides: int = parameter(0, "", "strides of --knee to play in random order; 0: its first one repeats",
                             low=0, high=10_000, source="docs/walking.md")
    seed: int = parameter(0, "", "seed of the drawn order and variations", low=0, high=2**31 - 1, source="--seed")
    period_share: float = parameter(0.08, "", "a stride's period is drawn evenly within ± this share", low=0.0,
                                    high=0.3, source="assumed: people do not walk to a clock")
    amplitude_share: float = parameter(0.10, "", "a stride's amplitude is drawn evenly within ± this share", low=0.0,
                                       high=0.3, source="assumed: people do not walk a table")
    stumbles: int = parameter(0, "", "strides in which the wearer stumbles", low=0, high=1000, source="docs/walking.md")
    stops: int = parameter(0, "", "times that the wearer stops, stands for 2 s and goes on", low=0, high=1000,
                           source="docs/walking.md")
    sits: int = parameter(0, "", "times that the wearer sits down for 2 s, rises and goes on", low=0, high=1000,
                          source="docs/walking.md")
    phase: str = parameter("", "", "what the desired force follows: clock, or felt, from the knee angle alone; empty: "
                           "felt with strides, else clock", source="docs/walking.md")
    departure_rad: float = parameter(
        0.022, "rad", "standard deviation of a stride from the mean stride at equal phase", low=1e-3, high=0.2,
        source="eleven strides of one walker, in stance: 1.3 degrees; docs/strides.md")
    migration_m: float = parameter(
        6e-3, "m", "shift of the rope's zero in a trial that is followed where strides differ: a garment migrates",
        low=0.0, high=0.02, source="assumed; beyond it the trial ends")
    migration_stride_m: float = parameter(
        0.5e-3, "m", "most of it that is followed from one stride to the next", low=0.0, high=2e-3,
        source="assumed: less than what the supervision calls a slip at once")

    @property
    def migration(self) -> tuple[float, float]:
        """Return by how much the rope's zero is followed, from stride to stride and in a trial, m."""
        return (self.migration_stride_m, self.migration_m) if self.differs else (0.0, 0.0)

    @property
    def felt(self) -> bool:
        """Whether the desired force follows a felt phase; raises `InputError` for an unknown one."""
        if self.phase not in ("", "clock", "felt"):
            raise InputError(f"walk.phase = {self.phase!r}, expected clock or felt; choose one.")
        return self.phase == "felt" or (not self.phase and self.strides > 0)

    @property
    def parts(self) -> int:
        """Return the number of strides and rests, which number the gait cycles of a trial; 0 where one repeats."""
        return self.strides and self.strides + self.stops + self.sits

    @property
    def differs(self) -> bool:
        """Whether strides differ or their phase is felt: anything but one stride that repeats on the clock."""
        return self.strides > 0 or self.felt


@dataclass(frozen=True)
class Impedance:
    """Equation (15) with M neglected: H(s) = 1/(B·s + K)."""

    damping_n_s_m: float = parameter(100.0, "N·s/m", "B", low=1e-3, high=1e5, source="paper: 0.1 N·s/mm")
    stiffness_n_m: float = parameter(300.0, "N/m", "K", low=1e-3, high=1e6, source="paper: 0.3 N/mm")


class OwnLimit(NamedTuple):
    """Limit of one device, joint or force path, `[limits.<of>]` of a configuration, in place of the bench's."""

    of: str
    name: str
    value: float


@dataclass(frozen=True)
class Limits:
    """Limits at which the master stops the bench; `own` are those of single devices, joints and force paths."""

    start_n: float = parameter(120.0, "N", "START tension above which the trial stops", low=1.0, high=300.0,
                               source="assumed: 60 N at END at an exponent of 0.4, and a third")
    end_n: float = parameter(90.0, "N", "END tension above which the trial stops", low=1.0, high=300.0,
                             source="assumed: 10 % of 40 N·m over 40.45 mm is 98.9 N")
    stale_cycles: int = parameter(10, "", "cycles in a row with an old input before the trial stops", low=1,
                                  high=1000, source="assumed: 10 ms at 1 kHz")
    unwound_n: float = parameter(2.0, "N", "START tension below which the rope counts as unwound", low=0.1, high=20.0,
                                 source="the bench's safe stop")
    unwind_m_s: float = parameter(0.2, "m/s", "speed at which a safe stop pays the rope out", low=0.01, high=1.0,
                                  source="assumed: 15 mm of stretch in 75 ms")
    unwind_s: float = parameter(0.3, "s", "time after which an unwinding that does not end turns the torque off",
                                low=0.05, high=10.0, source="assumed: a stop ends within half a second")
    progress_ms: float = parameter(50.0, "ms", "time in which an unwinding must take tension off, else the torque goes",
                                   low=10.0, high=1000.0, source="assumed: thrice the slowest healthy one")
    knee_low_rad: float = parameter(-1.68, "rad", "flexion beyond which the trial stops", low=-2.3, high=0.0,
                                    source="assumed: the drive's own limit is -95 degrees, and one more")
    knee_high_rad: float = parameter(0.17, "rad", "extension beyond which the trial stops", low=0.0, high=0.5,
                                     source="assumed: 10 degrees, a human knee's and a half")
    knee_rad_s: float = parameter(14.0, "rad/s", "knee speed above which the trial stops", low=0.1, high=30.0,
                                  source="assumed: the drive's own limit is 900 degrees per second, less a tenth")
    knee_n_m: float = parameter(16.0, "N·m", "torque of the knee drive, which the drive itself holds", low=0.1,
                                high=50.0, source="assumed: the packaged drive's; docs/safety.md, who holds what")
    rope_m_s: float = parameter(1.0, "m/s", "rope speed above which a position counts as impossible", low=0.01,
                                high=5.0, source="the servo's 0x6080: 480 per minute of a 40 mm drum")
    raised: str = parameter("", "", "why limits stand above the packaged ones; --raise-limits says it",
                            source="said by the operator")
    own: tuple[OwnLimit, ...] = apart(())

    def above_packaged(self) -> list[str]:
        """Return, as texts with both values, the limits of force, angle and speed beyond the packaged ones."""
        packaged, given = Limits(), [(name, name, getattr(self, name)) for name, _, _ in WIDER]
        given += [(f"{own.of}.{own.name}", own.name, own.value) for own in self.own]
        wider = {name: (unit, sense) for name, unit, sense in WIDER}
        return [f"limits.{shown} = {value:g} {wider[name][0]} (packaged {getattr(packaged, name):g})"
                for shown, name, value in given
                if name in wider and wider[name][1] * (value - getattr(packaged, name)) > 0.0]


WIDER: Final = (
    ("start_n", "N", 1.0), ("end_n", "N", 1.0), ("knee_low_rad", "rad", -1.0), ("knee_high_rad", "rad", 1.0),
    ("knee_rad_s", "rad/s", 1.0), ("knee_n_m", "N·m", 1.0), ("rope_m_s", "m/s", 1.0))
"""Limits that protect a limb: name, unit, and the sense in which one allows more."""


@dataclass(frozen=True)
class Homing:
    """Settings of homing: slow motions at the knee angle of 13 % of gait."""

    knee_rad_s: float = parameter(0.5, "rad/s", "speed of the knee while homing", low=0.01, high=3.0, source="assumed")
    rope_m_s: float = parameter(0.06, "m/s", "speed of the rope while homing", low=1e-3, high=0.2,
                                source="paper, 4.1: slower, a rope with breakaway sticks and slips")
    top_n: float = parameter(45.0, "N", "START tension that the homing loop never exceeds", low=5.0, high=80.0,
                             source="assumed: the release must slide again before it comes back to the preload")
    least_n: float = parameter(12.0, "N", "START tension that homing may reach whatever the trial's peak; --homing-n",
                               low=5.0, high=80.0, source="assumed: below, the friction loop is lost in the noise")
    reach_m: float = parameter(0.12, "m", "rope that homing may take up before it gives up", low=5e-3, high=1.0,
                               source="assumed")


@dataclass(frozen=True)
class Record:
    """Description of a trial for later readers; `bowden init` asks for it once."""

    specimen: str = parameter("", "", "who or what wears the knee", source="said by the operator")
    limb: str = parameter("", "", "person whose limb the bench moves, by a code; empty: a leg model. A trial then "
                          "needs a set-up check (bowden check bench)", source="said by the operator")
    rope: str = parameter("", "", "rope and sheath: kind, batch, days in use", source="said by the operator")
    operator: str = parameter("", "", "who runs the bench", source="said by the operator")
    notes: str = parameter("", "", "whatever else matters", source="said by the operator")
    logbook: str = parameter("", "", "folder of the logbook that trials are entered in", source="said by the operator")
