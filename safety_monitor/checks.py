"""The checks of the safety monitor: a table of absolute bounds, and the pure step that holds its inputs against them.

Each row of `CHECKS` is one bound. A value that is no number is beyond every bound. The first row that is broken opens
the enable line; no input closes it again.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

from eds.cia301 import HEARTBEAT_BASE, Emcy, Frame, NmtState
from safety_monitor.person import Bounds

MS: Final = 1_000_000
STEP_NS: Final = MS // 4
"""Time between two steps. Longer: a stage that conducts is noticed later; each ms of it adds 10 to 15 N at END."""
WINDOW: Final = 12
"""Steps over which force rate and knee speed are taken. Fewer: the quantisation of the sensors counts as speed
(0.022 degrees in 3 ms are 7 degrees/s). More: a stage that conducts is noticed later."""
FORCE_AHEAD_S: Final = 0.01
"""Time by which a fast rise of a tension is extrapolated, s: twice the STO delay. Longer: a stiff rope's jerk trips."""
LOOK_AHEAD_S: Final = 0.03
"""Time by which the knee angle is extrapolated, s: six STO delays. Shorter: hits the end stop. Longer: a gait trips."""
ROPE_SPAN, ROPE_AHEAD = 4, 6
"""Steps between the two speeds of the rope that give its acceleration, and such spans ahead: one, and the STO delay.
Fewer: quantisation counts as speed (46 mm/s), or a conducting stage gives the drum 80 mm/s more for each span ahead."""
LOOSE_N, LOOSE_SHARE = 5.0, 1.25
"""Tension at START below which the rope is loose, and the share of its bound that it may reach then: a controller that
takes up slack gives the drum 61 m/s², a stage that conducts 70 m/s². Larger: more energy when the slack ends."""
LATE_NS: Final = 20 * MS
"""Time between two steps from which on the monitor's own computer counts as stopped."""


class PathInputs(NamedTuple):
    """The monitor's own sensors at one force path: tensions, N, the joint's angle, degrees, and rope wound in, m."""

    start_n: float
    end_n: float
    knee_deg: float
    rope_m: float


Sample = tuple[int, tuple[PathInputs, ...]]  # time of a step, ns, and the inputs of each force path then


class Heartbeat(NamedTuple):
    """The last heartbeat of a node: its time, and the NMT state in it."""

    node: int
    time_ns: int
    state: int


class MonitorState(NamedTuple):
    """State of the monitor between two steps; the defaults are the state at power-on.

    `time_ns`: of the last step. `history`: samples of the last `WINDOW` steps, oldest first. `heard`: last heartbeat of
    each node. `working_ns`: since when a drive is OPERATIONAL, -1: none. `cause`, `text`: of the opening, None: closed.
    """

    time_ns: int = -1
    history: tuple[Sample, ...] = ()
    heard: tuple[Heartbeat, ...] = ()
    working_ns: int = -1
    cause: Emcy | None = None
    text: str = ""

    @property
    def enabled(self) -> bool:
        """Whether the enable line is closed, so that the drives may give torque."""
        return self.cause is None


class Present(NamedTuple):
    """One step as the checks see it: the state before it, its sample, and those from `WINDOW` steps ago until now."""

    state: MonitorState
    time_ns: int
    paths: tuple[PathInputs, ...]
    course: tuple[Sample, ...]
    watched: tuple[int, ...]

    def rates(self, place: int, first: int = 0, last: int = WINDOW) -> list[float]:
        """Return the rate of the input at `place` in each path, per second, from one step of the course to another."""
        (began_ns, before), (ended_ns, after) = self.course[first], self.course[last]
        per_s = 1e9 / (ended_ns - began_ns)
        return [(now[place] - was[place]) * per_s for was, now in zip(before, after, strict=True)]


class Check(NamedTuple):
    """One bound: its name, the EMCY code that reports it, and the function that describes a breach ("" if none)."""

    name: str
    code: Emcy
    breach: Callable[[Present, Bounds], str]


def _above(what: str, values: Iterable[float], bound: float, unit: str) -> str:
    """Return the sentence of the first value that is above `bound` or no number."""
    return next((f"{what} {value:.4g} {unit}, bound {bound:g} {unit}" for value in values if not value <= bound), "")


def _force_rate(present: Present, bounds: Bounds) -> str:
    rising = [rate for place, bound in ((0, bounds.start_n), (1, bounds.end_n)) for path, rate in zip(
        present.paths, present.rates(place), strict=True) if not path[place] + rate * FORCE_AHEAD_S <= bound]
    return _above("a tension rises at", rising, bounds.force_rate_n_s, "N/s")


def rope_ahead(present: Present) -> list[float]:
    """Return the speed at which each rope is about to wind in, m/s."""
    before = present.rates(3, WINDOW - 1 - ROPE_SPAN, WINDOW - ROPE_SPAN)
    return [(now + (now - was) * ROPE_AHEAD) / (LOOSE_SHARE if path.start_n < LOOSE_N else 1.0)
            for path, was, now in zip(present.paths, before, present.rates(3, WINDOW - 1), strict=True)]


def _angle(present: Present, bounds: Bounds) -> str:
    for path, speed in zip(present.paths, present.rates(2), strict=True):
        ahead = path.knee_deg + speed * LOOK_AHEAD_S
        if not (bounds.knee_low_deg <= min(path.knee_deg, ahead) and max(path.knee_deg, ahead) <= bounds.knee_high_deg):
            return (f"knee {path.knee_deg:.4g} degrees at {speed:.4g} degrees/s, bounds {bounds.knee_low_deg:g} and "
                    f"{bounds.knee_high_deg:g} degrees")
    return ""


def _heartbeats(present: Present, bounds: Bounds) -> str:
    last = {heard.node: heard.time_ns for heard in present.state.heard}
    ages = (((present.time_ns - last.get(node, present.state.working_ns)) / MS, node) for node in present.watched
            if present.state.working_ns >= 0)
    return next((f"heartbeat of node {node} {age:.0f} ms old, bound {bounds.heartbeat_ms:g} ms"
                 for age, node in ages if age > bounds.heartbeat_ms), "")


def _own_time(present: Present, bounds: Bounds) -> str:
    late = present.state.time_ns >= 0 and not 0 < present.time_ns - present.state.time_ns <= LATE_NS
    return f"{(present.time_ns - present.state.time_ns) / MS:.0f} ms between two steps" if late else ""


CHECKS: Final = (
    Check("the monitor's own steps", Emcy.MONITOR_OWN, _own_time),
    Check("tension at START", Emcy.MONITOR_START, lambda present, bounds: _above(
        "START", (abs(path.start_n) for path in present.paths), bounds.start_n, "N")),
    Check("tension at END", Emcy.MONITOR_END, lambda present, bounds: _above(
        "END", (abs(path.end_n) for path in present.paths), bounds.end_n, "N")),
    Check("rise of a tension", Emcy.MONITOR_FORCE_RATE, _force_rate),
    Check("speed of the rope", Emcy.MONITOR_ROPE, lambda present, bounds: _above(
        "rope about to wind in at", rope_ahead(present), bounds.rope_m_s, "m/s")),
    Check("angle of the knee", Emcy.MONITOR_ANGLE, _angle),
    Check("speed of the knee", Emcy.MONITOR_SPEED, lambda present, bounds: _above(
        "knee speed", map(abs, present.rates(2)), bounds.knee_deg_s, "degrees/s")),
    Check("heartbeats of master and drives", Emcy.MONITOR_HEARTBEAT, _heartbeats),
    Check("time of a trial", Emcy.MONITOR_TRIAL_TIME, lambda present, bounds: _above(
        "drives OPERATIONAL for", [(present.time_ns - began_ns) * 1e-9 for began_ns in [present.state.working_ns]
                                   if began_ns >= 0], bounds.trial_s, "s")),
)
"""In the order in which they are checked; the first that is broken is reported."""


def step(state: MonitorState, bounds: Bounds, master: int, drives: Sequence[int], time_ns: int,
         frames: Iterable[Frame], paths: Sequence[PathInputs]) -> MonitorState:
    """Return the state after one step: the frames since the last one, and the monitor's own sensors now.

    `master` and `drives` are the node ids whose heartbeats are watched. A state with an open line is returned as is.
    """
    if not state.enabled:
        return state  # what broke a bound may be gone by now; whether the limb moves again is for a person to decide
    watched = (master, *drives)
    now = tuple(PathInputs(*map(float, path)) for path in paths)
    last = {beat.node: beat for beat in state.heard}
    for frame in frames:
        node = frame.can_id - HEARTBEAT_BASE
        if node in watched and len(frame.data) == 1 and not (frame.extended or frame.remote or frame.error):
            last[node] = Heartbeat(node, time_ns, frame.data[0] & 0x7F)  # bit 7: toggle of node guarding (CiA 301)
    at_work = any(beat.node in drives and beat.state == NmtState.OPERATIONAL for beat in last.values())
    working_ns = -1 if not at_work else state.working_ns if state.working_ns >= 0 else time_ns
    state = state._replace(heard=tuple(last.values()), working_ns=working_ns)
    course = (*(state.history or ((time_ns - n * STEP_NS, now) for n in range(WINDOW, 0, -1))), (time_ns, now))
    present = Present(state, time_ns, now, course, watched)
    broken = next(((check.code, text) for check in CHECKS if (text := check.breach(present, bounds))), None)
    state = state._replace(time_ns=time_ns, history=course[-WINDOW:])
    return state if broken is None else state._replace(cause=broken[0], text=broken[1])
