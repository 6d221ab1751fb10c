"""The safety monitor: each bound opens the enable line for good, no frame opens, closes or silences anything."""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bowden
import eds
from bowden.bench import configuration, monitor_program
from eds.bench.bench_network import KNEE, MASTER, MONITOR, SERVO, wire
from eds.bench.bus_load import LOAD_GOAL_PERCENT, load_percent
from eds.cia301 import Emcy, Frame
from eds.declaration import SHAPES, as_tables
from parameters import InputError
from physics.plant.state_layout import SIZE, SLOT
from safety_monitor import CHECKS, MonitorNode, MonitorState, PathInputs, packaged, read, step
from safety_monitor.checks import STEP_NS, WINDOW
from safety_monitor.person import RANGES, PersonError
from virtual_bus.bus import BowdenBus

ROOT = Path(__file__).parents[2]
BOUNDS = read(packaged())
REST = PathInputs(0.0, 0.0, -20.0, 0.0)
NODES = (MASTER, SERVO, KNEE)


def run(paths: list[PathInputs], state: MonitorState | None = None, frames: Any = (), every_ns: int = STEP_NS
        ) -> MonitorState:
    """Return the state after one step for each of these inputs, `frames(n)` or the same frames with each."""
    state = state or MonitorState()
    for number, path in enumerate(paths):
        given_frames = frames(number) if callable(frames) else frames
        state = step(state, BOUNDS, MASTER, (SERVO, KNEE), max(state.time_ns, 0) + every_ns, given_frames, [path])
    return state


def beats(states: dict[int, int]) -> list[Frame]:
    """Return one heartbeat of each node with this NMT state."""
    return [Frame(0x700 + node, bytes([state])) for node, state in states.items()]


AT_WORK = beats({MASTER: 5, SERVO: 5, KNEE: 5})


@pytest.mark.parametrize(("path", "code"), [
    (REST._replace(start_n=BOUNDS.start_n + 0.1), Emcy.MONITOR_START),
    (REST._replace(start_n=-BOUNDS.start_n - 0.1), Emcy.MONITOR_START),
    (REST._replace(end_n=BOUNDS.end_n + 0.1), Emcy.MONITOR_END),
    (REST._replace(knee_deg=BOUNDS.knee_low_deg - 0.1), Emcy.MONITOR_ANGLE),
    (REST._replace(knee_deg=BOUNDS.knee_high_deg + 0.1), Emcy.MONITOR_ANGLE),
    *((REST._replace(**{name: math.nan}), code) for name, code in (
        ("start_n", Emcy.MONITOR_START), ("end_n", Emcy.MONITOR_END), ("knee_deg", Emcy.MONITOR_ANGLE),
        ("rope_m", Emcy.MONITOR_ROPE))),
    (REST._replace(end_n=math.inf), Emcy.MONITOR_END),
])
def test_a_value_beyond_its_bound_or_no_number_opens_the_line_in_one_step(path: PathInputs, code: Emcy) -> None:
    assert run([REST] * 3).enabled
    assert run([REST] * 3 + [path]).cause is code or run([path]).cause is code


def test_rates_are_bounded_over_their_window_and_a_falling_tension_is_not() -> None:
    per_step = 1e-9 * STEP_NS
    rise = [REST._replace(start_n=1.1 * BOUNDS.force_rate_n_s * per_step * n) for n in range(2 * WINDOW)]
    assert run(rise).enabled  # a stiff rope that comes taut: far from its bound
    from_n = BOUNDS.start_n - rise[-1].start_n - 1.0
    reaching = [path._replace(start_n=from_n + path.start_n) for path in rise]
    assert run(reaching).cause is Emcy.MONITOR_FORCE_RATE
    assert max(path.start_n for path in reaching) < BOUNDS.start_n
    assert run([REST._replace(start_n=50.0 - path.start_n) for path in rise]).enabled
    swing = [REST._replace(knee_deg=-60.0 + 1.1 * BOUNDS.knee_deg_s * per_step * n) for n in range(2 * WINDOW)]
    assert run(swing).cause is Emcy.MONITOR_SPEED


def test_the_rope_is_bounded_ahead_of_a_drum_that_gains_speed_and_may_pay_out_faster() -> None:
    per_step, taut = 1e-9 * STEP_NS, REST._replace(start_n=20.0)
    wound = np.cumsum(np.minimum(np.arange(400) / 200.0, 1.0)) * 0.8 * BOUNDS.rope_m_s * per_step
    assert run([taut._replace(rope_m=rope) for rope in wound]).enabled
    assert run([taut._replace(rope_m=-3.0 * rope) for rope in wound]).enabled
    assert run([taut._replace(rope_m=1.3 * rope) for rope in wound]).cause is Emcy.MONITOR_ROPE
    assert run([REST._replace(rope_m=1.3 * rope) for rope in wound]).enabled, "slack that is taken up"
    falling = [taut._replace(rope_m=0.5 * 80.0 * (per_step * n) ** 2) for n in range(80)]
    stopped = run(falling)
    assert stopped.cause is Emcy.MONITOR_ROPE
    assert stopped.time_ns <= 1_500_000, "before the drum is at 0.5 m/s when the torque goes, 5 ms later"


def test_the_angle_is_bounded_ahead_of_a_leg_that_moves_towards_its_end() -> None:
    per_step = 1e-9 * STEP_NS
    fast = [REST._replace(knee_deg=BOUNDS.knee_high_deg - 9.0 + 0.9 * BOUNDS.knee_deg_s * per_step * n)
            for n in range(2 * WINDOW)]
    stopped = run(fast)
    assert stopped.cause is Emcy.MONITOR_ANGLE
    assert stopped.history[-1][1][0].knee_deg < BOUNDS.knee_high_deg


def test_heartbeats_are_watched_while_a_drive_is_operational() -> None:
    late = round(1e6 * BOUNDS.heartbeat_ms / STEP_NS) + 2
    assert run([REST] * late).enabled, "a bench without a master keeps its line closed"
    state = run([REST] * 10, frames=AT_WORK)
    assert run([REST] * late, state).cause is Emcy.MONITOR_HEARTBEAT
    for silent in NODES:
        others = [frame for frame in AT_WORK if frame.can_id != 0x700 + silent]
        assert run([REST] * late, state, others).cause is Emcy.MONITOR_HEARTBEAT, silent
    assert run([REST] * late, state, beats({MASTER: 5, SERVO: 127, KNEE: 127})).enabled
    assert run([REST] * late, run([REST], state, beats({SERVO: 127, KNEE: 127}))).enabled, "a trial that has ended"


def test_a_trial_has_a_longest_time_and_the_monitor_a_longest_pause() -> None:
    state = run([REST], frames=AT_WORK)
    ended = state._replace(time_ns=state.time_ns + round(BOUNDS.trial_s * 1e9), heard=tuple(
        beat._replace(time_ns=state.time_ns + round(BOUNDS.trial_s * 1e9)) for beat in state.heard))
    assert run([REST], ended, AT_WORK).cause is Emcy.MONITOR_TRIAL_TIME
    assert run([REST], run([REST]), every_ns=21_000_000).cause is Emcy.MONITOR_OWN
    assert run([REST], run([REST]), every_ns=0).cause is Emcy.MONITOR_OWN


FRAMES = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans(), st.booleans())


@given(st.lists(st.lists(FRAMES, max_size=20), max_size=20))
def test_no_frame_closes_a_line_that_is_open(flood: list[list[Frame]]) -> None:
    opened = run([REST._replace(end_n=BOUNDS.end_n + 1.0)])
    assert run([REST] * len(flood), opened, lambda n: flood[n]) == opened


@given(st.lists(st.lists(FRAMES, max_size=20), min_size=1, max_size=20), st.sampled_from(["start_n", "end_n"]))
def test_no_frame_keeps_a_bound_from_opening_the_line(flood: list[list[Frame]], name: str) -> None:
    state = run([REST] * len(flood), frames=lambda n: flood[n])
    assert not run([REST._replace(**{name: 100.0})], state, flood[0]).enabled


def test_every_check_has_a_code_and_a_name_of_its_own() -> None:
    assert len({check.code for check in CHECKS}) == len({check.name for check in CHECKS}) == len(CHECKS)


def test_the_monitor_has_at_most_400_lines_with_its_table() -> None:
    files = [*(ROOT / "safety_monitor").glob("*.py"), packaged()]
    assert sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files) <= 400


# ---- the person's file ----


@pytest.mark.parametrize(("line", "told"), [
    ("", "end_n = None"), ("end_n = nan", "end_n = nan"), ("end_n = 1e9", "from 1 to 90 N"),
    ("end_n = true", "end_n = True"), ("end_n = 50\nknee_stop = 3", "unknown key knee_stop"),
    ("end_n = ", "is no TOML"), ("end_n = 50\nend_n = 60", "is no TOML"),
])
def test_a_persons_file_is_read_whole_or_refused_in_one_sentence(tmp_path: Path, line: str, told: str) -> None:
    path = tmp_path / "person.toml"
    text = packaged().read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(line if row.startswith("end_n") else row for row in text), encoding="utf-8")
    with pytest.raises(PersonError) as refused:
        read(path)
    assert told in str(refused.value)
    assert str(path) in str(refused.value)
    with pytest.raises(InputError, match=r"person\.toml"):
        BowdenBus(f"refused {line}", monitor=str(path))


def test_the_digest_is_that_of_the_files_bytes_and_changes_with_any_of_them(tmp_path: Path) -> None:
    path = tmp_path / "person.toml"
    path.write_bytes(packaged().read_bytes())
    assert read(path) == BOUNDS
    path.write_bytes(packaged().read_bytes() + b"\n")
    assert read(path).sha256 != BOUNDS.sha256
    assert set(RANGES) < set(BOUNDS.__dataclass_fields__)


# ---- on the simulated bench, over the wire ----


def heard(bus: BowdenBus, seconds: float) -> list[can.Message]:
    """Let bus time pass and return every frame."""
    until, found = bus.time_ns() + round(seconds * 1e9), []
    while (left := until - bus.time_ns()) > 0:
        message = bus.recv(left * 1e-9)
        if message is not None:
            found.append(message)
    return found


def test_the_monitor_boots_beats_and_reports_the_digest_of_its_file() -> None:
    with BowdenBus("monitored", monitor=str(packaged())) as bus:
        frames = heard(bus, 0.5)
    own = [frame for frame in frames if frame.arbitration_id & 0x7F == MONITOR]
    assert [frame.data[0] for frame in own if frame.arbitration_id == 0x700 + MONITOR] == [0, 5, 5, 5, 5]
    (digest,) = [bytes(frame.data) for frame in own if frame.arbitration_id == 0x180 + MONITOR]
    assert digest == bytes.fromhex(BOUNDS.sha256)[:8]


@pytest.mark.parametrize("shape", SHAPES)
def test_one_path_out_of_its_bounds_opens_the_line_of_every_drive_on_every_packaged_bench(shape: str) -> None:
    declaration = as_tables(configuration.read(Path(eds.__file__).parent / f"{shape}.toml")["network"].bench)
    with BowdenBus(f"shape {shape}", declaration=declaration, monitor=str(packaged()), rate_hz=500) as bus:
        machine = bus.bench.machine
        machines = getattr(machine, "machines", (machine,))
        heard(bus, 0.2)
        assert all(one.plant.enabled for one in machines)
        memory = np.zeros(SIZE)
        machines[-1].plant.adopt(memory)
        memory[SLOT.free] = -0.1  # the rope is 100 mm shorter: taut at once
        heard(bus, 0.1)
        assert not any(one.plant.enabled for one in machines)
        assert all(axis.drive.awaits_release for one in machines for axis in one.axes)


def test_no_frame_disables_the_monitor_on_the_bus() -> None:
    """NMT stop and reset, SDO writes, the monitor's own identifiers: the line opens on a knee out of range."""
    attacks = [(0x000, bytes([command, node])) for command in (2, 128, 129, 130) for node in (0, MONITOR)]
    attacks += [(0x600 + MONITOR, bytes([0x2F, 0x17, 0x10, 0, 0, 0, 0, 0])), (0x700 + MONITOR, b"\x05"),
                (0x080 + MONITOR, bytes(8)), (0x180 + MONITOR, bytes(8)), (0x7E5, bytes([4, 1, 0, 0, 0, 0, 0, 0])),
                (0x700 + MASTER, b"\x05"), (0x700 + SERVO, b"\x7f"), (0x700 + KNEE, b"\x7f")]
    with BowdenBus("attacked", monitor=str(packaged()),
                   plant_model={"plant": {"start_knee_rad": math.radians(BOUNDS.knee_high_deg - 1.0)}}) as bus:
        machine = bus.bench.machine
        heard(bus, 0.3)
        for can_id, data in attacks * 40:
            with suppress(can.CanOperationError):  # equal identifiers at one instant end bus-off, as on a real bus
                bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False), timeout=0.1)
            heard(bus, 0.0013)
        assert machine.plant.enabled
        memory = np.zeros(SIZE)
        machine.plant.adopt(memory)
        memory[SLOT.leg_q] = memory[SLOT.motor_q] = math.radians(BOUNDS.knee_high_deg + 2.0)
        heard(bus, 0.2)
        assert not machine.plant.enabled
        assert all(axis.drive.awaits_release for axis in machine.axes)
    node = bus.bench.nodes[MONITOR].device
    assert node.state.cause is Emcy.MONITOR_ANGLE


def test_a_monitor_without_supply_opens_the_line_and_power_on_does_not_release_the_drives() -> None:
    faults = [{"kind": "power_off", "node": MONITOR, "start_s": 0.1, "stop_s": 0.2}]
    with BowdenBus("unpowered", monitor=str(packaged()), faults=faults) as bus:
        machine = bus.bench.machine
        heard(bus, 0.15)
        assert not machine.plant.enabled
        heard(bus, 0.15)
        assert machine.plant.enabled
        assert all(axis.drive.awaits_release for axis in machine.axes)


# ---- as a program on a bus ----


class ScriptedBoard:
    """Sensors that follow a script by the number of the step; remembers every state of the line."""

    def __init__(self, values: list[PathInputs]) -> None:
        self.values, self.states = values, []

    def sensors(self, now_ns: int) -> list[PathInputs]:
        """Return the next value; the last one for ever."""
        return [self.values.pop(0) if len(self.values) > 1 else self.values[0]]

    def line(self, closed: bool) -> None:
        """Remember the state."""
        self.states.append(closed)


def test_the_program_opens_the_line_on_a_bound_and_at_its_end() -> None:
    board = ScriptedBoard([REST] * 20 + [REST._replace(end_n=70.0)] + [REST])
    with BowdenBus("program") as bus, BowdenBus("program") as other:
        node = MonitorNode(MONITOR, BOUNDS, MASTER, (SERVO, KNEE), board.sensors, board.line)
        found = monitor_program.run(bus, node, bus.time_ns, lambda: bus.time_ns() > 300_000_000)
        codes = []
        while (message := other.recv(0)) is not None:
            if message.arbitration_id == 0x080 + MONITOR:
                codes.append(int.from_bytes(message.data[:2], "little"))
    assert board.states == [True, False, False]
    assert (found.cause, codes) == ("END 70 N, bound 55 N", [Emcy.MONITOR_END])


def test_a_bus_that_fails_costs_heartbeats_alone() -> None:
    """Every call of the bus raises: the monitor goes on with its own sensors."""
    class Gone:
        def recv(self, timeout: float) -> None:
            raise can.CanOperationError("network is down")

        send = recv

    board = ScriptedBoard([REST] * 5 + [REST._replace(start_n=90.0)])
    times = itertools.count(0, STEP_NS)
    node = MonitorNode(MONITOR, BOUNDS, MASTER, (SERVO, KNEE), board.sensors, board.line)
    found = monitor_program.run(Gone(), node, lambda: next(times), lambda: not node.state.enabled)
    assert found.cause == "START 90 N, bound 65 N"
    assert found.lost >= 1
    assert board.states[-1] is False


# ---- in a trial ----


def test_a_monitored_bench_gives_the_same_frames_twice() -> None:
    def frames(channel: str) -> list[tuple[int, int, bytes]]:
        with BowdenBus(channel, monitor=str(packaged()), seed=4) as bus:
            return [(frame.time_ns, frame.arbitration_id, bytes(frame.data)) for frame in heard(bus, 0.3)]

    first = frames("once")
    assert first == frames("again")
    assert any(can_id == 0x700 + MONITOR for _time, can_id, _data in first)


def test_the_file_and_its_digest_stand_in_the_trial_and_the_bus_load_counts_the_monitor(tmp_path: Path) -> None:
    (tmp_path / "person.toml").write_bytes(packaged().read_bytes().replace(b'"packaged"', b'"P-017"'))
    config = tmp_path / "bench.toml"
    config.write_text('[monitor]\nfile = "person.toml"\n', encoding="utf-8")
    trial = bowden.run(bowden.Experiment(configuration=config, period_s=1.1, cycles=1, settle=0, dry_run=True))
    recorded = trial.recorded
    assert trial.outcome == "completed"
    assert recorded.metadata["monitor_person"] == "P-017"
    assert recorded.metadata["monitor_sha256"] == read(tmp_path / "person.toml").sha256
    assert recorded.attachments["person.toml"] == (tmp_path / "person.toml").read_bytes()
    network = configuration.read(config)["network"]
    bare = replace(network, monitor="")
    assert load_percent(wire(bare)) + 0.07 < load_percent(wire(network)) <= LOAD_GOAL_PERCENT


def test_a_trial_is_refused_where_the_monitor_on_the_bus_has_another_file_or_is_missing(tmp_path: Path) -> None:
    other = tmp_path / "other.toml"
    other.write_bytes(packaged().read_bytes() + b"\n")
    with BowdenBus("has another", monitor=str(packaged())) as bus:
        monitor_program.refuse_other(bus, bus.time_ns, str(packaged()))
        with pytest.raises(InputError, match="give both the same file"):
            monitor_program.refuse_other(bus, bus.time_ns, str(other))
    with BowdenBus("has none") as bus:
        monitor_program.refuse_other(bus, bus.time_ns, "")
        with pytest.raises(InputError, match="no safety monitor"):
            monitor_program.refuse_other(bus, bus.time_ns, str(other))


def test_a_missing_person_is_refused_in_one_sentence(tmp_path: Path) -> None:
    config = tmp_path / "bench.toml"
    config.write_text('[monitor]\nfile = "nobody.toml"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"nobody\.toml: cannot be read"):
        configuration.read(config)
