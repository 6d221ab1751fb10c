"""Constants of a rig other than the bench, with their priors: one row a constant, sized by the rig's own signals.

1σ between benches is wide, since nothing is known of such a rig.  1σ between sessions is a usual repeatability.  Size
and shares of friction are as measured on a rubber seal in five sessions.  Its share of rest is as theirs: repeats of a
seal, a cable drive and a pendulum differ by 0.1 to 0.25.  With half of it for the
shares, one of four repeats of that seal is named.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from physics.forward.constant_table import ConstantTable, ModelConstant
from physics.laws import Array

START, END, FORCE, JOINT = "tension_start_n", "tension_end_n", "servo_force_n", "knee_angle_rad"
TURNED_UNITS: Final[Mapping[str, str]] = {
    "N": "N·m", "m": "rad", "kg": "kg·m²", "N·s/m": "N·m·s/rad", "m/s": "rad/s"}
"""Unit of a linear axis → unit of the same quantity of a turning axis."""
VOLT_UNITS: Final[Mapping[str, str]] = {
    "N": "V", "N·m": "V", "m": "rad", "kg": "V·s²/rad", "N·s/m": "V·s/rad", "m/s": "rad/s"}
"""Unit of a linear axis → unit of a turning axis with the motor's voltage for its torque; torques are times R/kt.

R: resistance of the winding, kt: torque constant.  The back-EMF kt·ω is a viscous friction of the axis."""


class RigScale(NamedTuple):
    """Sizes of the signals over the reference trials, in the units of the signals.

    `stroke`: mean span of the position.  `speed`, `acceleration`, `end`: RMS.  `joint`: RMS of the joint angle about
    its mean.  `encoder_step`: least step of the position.  `spread` and `peak`: standard deviation and largest absolute
    value by output.
    """

    stroke: float
    speed: float
    acceleration: float
    end: float
    joint: float
    encoder_step: float
    spread: Mapping[str, float]
    peak: Mapping[str, float]


class RigColumns(NamedTuple):
    """Kind of a rig by its columns: `outputs`, whether the axis turns, and which other forces and angles are recorded.

    `has_end`: START and END.  `sprung`: START and a joint angle, with a spring between.  `angled`: joint angle beside
    START and END.  `loaded`: START is the load of the drive.  `volts`: the drive force is the motor's voltage.
    `joints`: joints of a serial arm from base to tip, about parallel axes; `joint`: the one whose drive this is.  An
    axis by itself is a single joint without a name.
    """

    outputs: tuple[str, ...]
    turning: bool
    has_end: bool
    sprung: bool
    angled: bool
    loaded: bool
    volts: bool = False
    joints: tuple[str, ...] = ("",)
    joint: str = ""

    @property
    def moved(self) -> tuple[str, ...]:
        """Return the links that the drive moves, each by the name of its joint, the drive's own first."""
        return self.joints[self.joints.index(self.joint):]

    def unit(self, linear: str) -> str:
        """Return the unit on this linear or turning axis of a quantity that has the unit `linear` on a linear one."""
        units: Mapping[str, str] = VOLT_UNITS if self.volts else TURNED_UNITS if self.turning else {}
        return units.get(linear, linear)


BOUNDS: Final = {
    "load_share": (-0.5, 1.5), "viscous_share": (-0.5, 1.5), "drive_load_share": (-0.5, 1.5),
    "drive_viscous_share": (-0.5, 1.5), "rest": (-0.7, 3.0), "drive_rest": (-0.7, 3.0),
    "drive_asymmetry": (-0.9, 0.9), "demand_gain": (0.3, 3.0), "drift": (-0.95, 3.0), "unbalance": (-9.0, 3.0)}
"""Bounds that keep friction positive, and that let a motor without gravity have none."""
TRAVEL: Final = 1e-2
"""Typical pre-sliding distance, relative to the stroke."""
REGRESSED: Final = frozenset({
    "friction", "drive_friction", "ratio", "offset", "spring", "stiffness", "arm", "zero", "inertia", "drive_offset",
    "unbalance", "unbalance_phase", "drive_spring", "joint_zero", "joint_ratio", "give", "give_end"})
"""Constants without a typical value; their prior is centred at the regression of the first reference trial."""
RELATIVE_SD: Final = {"inertia": 0.02, "give": 0.03, "give_end": 0.03, "joint_ratio": 0.005, "arm": 0.005}
"""1σ between sessions, relative to the value, of linear constants whose size only a fit can give."""
OF_FRICTION: Final = ("friction", "load_share", "viscous_share", "travel", "rest", "rest_speed", "asymmetry",
                      "viscous_asymmetry")
"""Constants of friction, at START and, with `drive_` before it, of the drive."""
SHARES: Final = ("load_share", "viscous_share")
REPEATED: Final = frozenset({"inertia", "unbalance", "stiffness"})
"""Constants beside friction whose scatter between sessions the reference trials show.

Not the gain of the force: where friction is most of it, trials of one day do not separate the two."""
LINK, BETWEEN, WEIGHT, WEIGHT_ANGLE = "link_", "between_", "weight_", "weight_angle_"
"""Beginnings of the names of an arm's constants; one joint follows, or two."""


def is_of_friction(name: str) -> bool:
    """Return whether a constant is one of friction."""
    return name.removeprefix("drive_") in OF_FRICTION


def is_regressed(name: str) -> bool:
    """Return whether a constant has no typical value, so that its prior is centred at a regression."""
    return name in REGRESSED or name.startswith((LINK, BETWEEN, WEIGHT))


def table_of(rig: RigColumns, scale: RigScale) -> ConstantTable:
    """Return the constants that the outputs of a rig need, in units of rotation if the axis turns."""
    rows: list[ModelConstant] = []
    if START in rig.outputs and rig.has_end:
        rows += [*_friction("", START, True, scale), *_tension(scale)]
    if rig.sprung:
        rows += _spring(scale)
    if FORCE in rig.outputs:
        rows += [*_friction("drive_", FORCE, rig.turning or rig.loaded, scale), *_drive(rig, scale)]
    if rig.angled:
        rows += _joint(scale)
    # a motor turns by 10 rad and more, and its pre-sliding distance may be 1 mrad; below a step nothing shows it, and a
    # tribometer slides by no more than it
    least = float(np.log(max(scale.encoder_step, 1e-5 * scale.stroke) / (TRAVEL * scale.stroke)))
    travels = {name: (min(least, -1.0), float(-np.log(TRAVEL))) for name in ("travel", "drive_travel")}
    return ConstantTable([row._replace(unit=rig.unit(row.unit)) for row in rows], {**BOUNDS, **travels})


def session_sd(table: ConstantTable, q: Array) -> Array:
    """Return 1σ between sessions of each constant, in coordinates, of a rig at coordinates `q`."""
    sd, given = table.session_sd.copy(), table.named(q)
    for name, at in table.index.items():
        share = RELATIVE_SD.get("inertia" if name.startswith((LINK, BETWEEN)) else name)
        if share is not None:
            least, rounding = 1e-3 * table.bench_sd[at], table.rows[at].rounding
            # where an inertia is about 0 the prior of a trial is lifted by 0.8 of the rounding
            sd[at] = max(share * abs(given[name]), rounding if abs(given[name]) < 2.0 * rounding else least)
        if name.endswith(SHARES):
            # parts that scatter alike change a share s by s·(1 − s) times that, which is 0.1 at a half
            part = min(max(given[name], 0.05), 0.95)
            sd[at] = 4.0 * table.session_sd[at] * part * (1.0 - part)
    return sd


def _friction(prefix: str, output: str, load: bool, scale: RigScale) -> Sequence[ModelConstant]:
    row = ModelConstant
    rows = [
        row(prefix + "friction", "N", scale.spread[output], "log", 1.5, 0.08, "friction at the RMS of load and speed"),
        row(prefix + "load_share", "", 0.0, "linear", 0.4 if load else 0.0, 0.1, "share of it that load carries",
            step=0.02),
        row(prefix + "viscous_share", "", 0.0, "linear", 0.4, 0.1, "share of it that speed carries"),
        row(prefix + "travel", "m", TRAVEL * scale.stroke, "log", 2.0, 0.2, "pre-sliding distance"),
        row(prefix + "rest", "", 0.0, "linear", 0.4, 0.1, "static over sliding friction, less 1"),
        row(prefix + "rest_speed", "m/s", 0.2 * scale.speed, "log", 1.0, 0.1, "Stribeck speed"),
    ]
    if not prefix:  # between two tensions an asymmetry is confounded with ratio and offset
        return [*rows, row("drift", "", 0.0, "linear", 0.1, 0.05, "change over the recording")]
    return [*rows, *(row(prefix + name, "", 0.0, "linear", 0.1, 0.02, f"{kind} friction more one way")
                     for name, kind in (("asymmetry", "dry"), ("viscous_asymmetry", "viscous")))]


def _tension(scale: RigScale) -> Sequence[ModelConstant]:
    row, size, peak = ModelConstant, scale.spread[START], scale.peak[START]
    return [
        row("lead", "m/N", 1e-2 * scale.stroke / peak, "log", 2.0, 0.1, "compliance between drive and sheath"),
        row("ratio", "", 1.0, "linear", 0.2, 0.005, "START over END without friction"),
        row("ratio_slope", "", 0.0, "linear", 0.1, 0.005, "relative change of the ratio over the stroke"),
        row("offset", "N", 0.0, "linear", 0.1 * peak, 0.003 * peak, "difference of the sensors' zeros"),
        row("spring", "N/m", 0.0, "linear", size / scale.stroke, 0.05 * size / scale.stroke,
            "force between the tensions by position"),
        row("start_lag", "s", 0.0, "linear", 5e-3, 5e-4, "lag of START behind motion and END"),
    ]


def _spring(scale: RigScale) -> Sequence[ModelConstant]:
    row, size, stroke = ModelConstant, scale.spread[START], scale.stroke
    return [
        row("stiffness", "N/m", size / (0.3 * stroke), "log", 2.0, 0.03, "spring between drive and joint"),
        row("arm", "m/rad", 0.0, "linear", stroke / scale.joint, 0.002 * stroke / scale.joint,
            "position by joint angle at constant stretch"),
        row("zero", "m", 0.0, "linear", 10.0 * stroke, 10.0 * stroke, "position at which the spring is loose"),
        row("cubic", "", 0.0, "linear", 0.3, 0.02, "share of the cubic term at a tenth of the stroke"),
        row("damping", "N·s/m", 0.0, "linear", size / scale.speed, 0.1 * size / scale.speed, "damping of the spring"),
        row("start_lag", "s", 0.0, "linear", 5e-3, 5e-4, "lag of START behind motion"),
    ]


def _drive(rig: RigColumns, scale: RigScale) -> Sequence[ModelConstant]:
    row, size = ModelConstant, scale.spread[FORCE]
    heavy, stiff = size / scale.acceleration, size / scale.stroke
    rows = [
        row("inertia", "kg", 0.0, "positive", 3.0 * heavy, RELATIVE_SD["inertia"] * heavy, "mass that the drive moves",
            0.01 * heavy),
        row("drive_offset", "N", 0.0, "linear", size, 0.003 * scale.peak[FORCE], "constant force"),
        row("drive_lag", "s", 0.0, "linear", 5e-3, 5e-4, "lag of the force behind the motion"),
        # the bench is identified in the drive's own units; magnets lose 0.2 % a kelvin from session to session
        row("demand_gain", "", 1.0, "linear", 0.005, 0.02, "force that it gives over what it reports", step=0.01),
    ]
    if rig.turning:
        return [*rows, row("unbalance", "N·m", size, "log", 1.5, 0.02, "largest torque of gravity"),
                row("unbalance_phase", "rad", 0.0, "linear", 2.0, 0.02, "angle of the mass from below at 0; session: "
                    "zero of the encoder"), *_arm(rig, scale)]
    return [*rows, row("drive_spring", "N/m", 0.0, "linear", stiff, 0.05 * stiff, "force by position")]


def links_of(rig: RigColumns) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the links of an arm that the drive moves with a constant of their own, and the coupled pairs of links.

    A link is named by its joint.  The first link's inertia is the constant `inertia`.
    """
    pairs = [(a, b) for k, b in enumerate(rig.joints) for a in rig.joints[:k] if b in rig.moved]
    return [name for name in rig.moved if name != rig.joints[0]], pairs


def gravity_of(name: str, rig: RigColumns) -> tuple[str, str]:
    """Return the constants of gravity on the link `name` of an arm: its largest torque, and the angle of its mass."""
    if name == rig.joint:
        return "unbalance", "unbalance_phase"
    return WEIGHT + name, WEIGHT_ANGLE + name


def _arm(rig: RigColumns, scale: RigScale) -> Sequence[ModelConstant]:
    row, size = ModelConstant, scale.spread[FORCE]
    heavy = size / scale.acceleration
    links, pairs = links_of(rig)
    rows = [row(LINK + name, "kg", 0.0, "linear", heavy, RELATIVE_SD["inertia"] * heavy,
                f"inertia of link {name} about its joint", step=0.01 * heavy) for name in links]
    rows += [row(f"{BETWEEN}{a}_{b}", "kg", 0.0, "linear", heavy, RELATIVE_SD["inertia"] * heavy,
                 f"inertia that couples links {a} and {b}", step=0.01 * heavy) for a, b in pairs]
    for name in rig.moved[1:]:
        weight, phase = gravity_of(name, rig)
        rows += [row(weight, "N·m", size, "log", 1.5, 0.02, f"largest torque of gravity on link {name}"),
                 row(phase, "rad", 0.0, "linear", 2.0, 0.02, f"angle of the mass of link {name} from below")]
    return rows


def _joint(scale: RigScale) -> Sequence[ModelConstant]:
    row, spread, stroke = ModelConstant, scale.spread[JOINT], scale.stroke
    give = spread / max(scale.spread[START], 1e-9)
    return [
        row("joint_zero", "rad", 0.0, "linear", 10.0, 10.0, "joint angle at position 0 without load"),
        row("joint_ratio", "rad/m", 0.0, "linear", spread / stroke * 10.0, 0.002 * spread / stroke,
            "joint angle by position"),
        row("give", "rad/N", 0.0, "linear", give, RELATIVE_SD["give"] * give, "joint angle by START"),
        row("give_end", "rad/N", 0.0, "linear", give, RELATIVE_SD["give_end"] * give, "joint angle by END"),
    ]
