"""Each declared fault, seen in frames; and none of them outside its window."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from eds.bench.bench_network import END, KNEE, SERVO, START
from eds.cia301 import Frame
from parameters import InputError
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.bits import frame_bits
from virtual_bus.wire.faults import KINDS, Fault, declared
from virtual_bus.wire.station import Confinement, Station


class Rig:
    """Two echoes, and SYNC from the host at each millisecond up to `cycles`; a tap hears what crosses the wire."""

    def __init__(self, echo: Any, *faults: Fault, cycles: int = 20, seed: int = 0) -> None:
        self.one, self.two = echo(1, 0x182), echo(2, 0x181)
        self.bench = Bench([self.one, self.two], faults=faults, seed=seed)
        self.tapped: list[tuple[int, Frame]] = []
        tap = Station("tap", lambda frame, now_ns: self.tapped.append((now_ns, frame)), listen_only=True)
        self.bench.wire.attach(tap)
        kernel = self.bench.kernel
        for k in range(1, cycles + 1):
            kernel.at(k * 1_000_000, 2, lambda: self.bench.host.submit(Frame(0x080), kernel.now_ns))
        kernel.run((cycles + 1) * 1_000_000)

    def cycles(self, heard: list[tuple[int, Frame]], can_id: int) -> list[int]:
        return [now_ns // 1_000_000 for now_ns, frame in heard if frame.can_id == can_id]


WINDOW: dict[str, float] = {"start_s": 0.005, "stop_s": 0.010}
INSIDE = [5, 6, 7, 8, 9]
ALL = list(range(1, 21))
OUTSIDE = [k for k in ALL if k not in INSIDE]


def test_without_faults_every_cycle_is_whole(echo: Any) -> None:
    rig = Rig(echo)
    assert rig.cycles(rig.one.heard, 0x182) == rig.cycles(rig.two.heard, 0x181) == ALL


def test_drop(echo: Any) -> None:
    rig = Rig(echo, Fault("drop", cob_id=0x181, **WINDOW))
    assert rig.cycles(rig.two.heard, 0x181) == OUTSIDE
    assert rig.cycles(rig.one.heard, 0x182) == ALL
    assert rig.bench.nodes[1].tec == 0  # it was acknowledged


def test_drop_by_transmitter(echo: Any) -> None:
    rig = Rig(echo, Fault("drop", node=1, **WINDOW))
    assert rig.cycles(rig.two.heard, 0x181) == OUTSIDE


def test_chance_is_the_seeds(echo: Any) -> None:
    runs = [Rig(echo, Fault("drop", cob_id=0x181, probability=0.5), seed=seed) for seed in (1, 1, 2)]
    first, again, other = (rig.cycles(rig.two.heard, 0x181) for rig in runs)
    assert first == again != other
    assert 0 < len(first) < 20


def test_a_further_fault_leaves_the_chances_of_those_before_it_alone(echo: Any) -> None:
    chance = Fault("drop", cob_id=0x181, probability=0.5)
    alone = Rig(echo, chance, seed=3)
    joined = Rig(echo, chance, Fault("drop", cob_id=0x182, probability=0.5), seed=3)
    assert alone.cycles(alone.two.heard, 0x181) == joined.cycles(joined.two.heard, 0x181)


def test_delay(echo: Any) -> None:
    late, punctual = Rig(echo, Fault("delay", cob_id=0x181, delay_us=300.0, **WINDOW)), Rig(echo)

    def times(rig: Rig) -> list[int]:
        return [now_ns for now_ns, frame in rig.two.heard if frame.can_id == 0x181]

    # without 181h before it 182h goes first; the bus is long idle when 181h comes 300 µs later
    assert [a - b for a, b in zip(times(late), times(punctual), strict=True)] == [
        300_000 if k in INSIDE else 0 for k in ALL]


def test_late_sync(echo: Any) -> None:
    rig = Rig(echo, Fault("late_sync", delay_us=250.0, **WINDOW))
    bits = frame_bits(Frame(0x080)) * 1_000
    late = [(now_ns - bits) % 1_000_000 for now_ns, frame in rig.one.heard if frame.can_id == 0x080]
    assert late == [250_000 if k in INSIDE else 0 for k in ALL]


def test_duplicate(echo: Any) -> None:
    rig = Rig(echo, Fault("duplicate", cob_id=0x181, **WINDOW))
    assert rig.cycles(rig.two.heard, 0x181) == sorted(ALL + INSIDE)
    assert rig.cycles(rig.tapped, 0x181) == sorted(ALL + INSIDE)


def test_corrupt_flips_one_bit_and_nobody_notices(echo: Any) -> None:
    rig, sound = Rig(echo, Fault("corrupt", cob_id=0x181, **WINDOW)), Rig(echo)
    pairs = zip(rig.two.heard, sound.two.heard, strict=True)
    flipped = [
        (a[1].data != b[1].data, (int.from_bytes(a[1].data) ^ int.from_bytes(b[1].data)).bit_count())
        for a, b in pairs if a[1].can_id == 0x181
    ]
    assert flipped == [(True, 1) if k in INSIDE else (False, 0) for k in ALL]
    assert rig.bench.wire.errors == 0


def test_shorten(echo: Any) -> None:
    rig = Rig(echo, Fault("shorten", cob_id=0x181, size=1, **WINDOW))
    sizes = [len(frame.data) for _, frame in rig.two.heard if frame.can_id == 0x181]
    assert sizes == [1 if k in INSIDE else 2 for k in ALL]


def test_disturb_repeats_until_bus_off_and_the_device_hears_of_it(echo: Any) -> None:
    rig = Rig(echo, Fault("disturb", node=1, start_s=0.005, stop_s=0.009))
    assert rig.one.log == ["power on", "bus-off", "recovered"]
    assert rig.bench.wire.errors == 32
    heard = rig.cycles(rig.two.heard, 0x181)
    assert heard[:4] == [1, 2, 3, 4]
    assert heard[-1] == 20


def test_one_disturbance_costs_one_error_frame_and_a_repetition(echo: Any) -> None:
    rig = Rig(echo, Fault("disturb", cob_id=0x181, start_s=0.005, stop_s=0.0051))
    assert rig.bench.wire.errors == 1
    assert rig.cycles(rig.two.heard, 0x181) == ALL
    assert rig.bench.nodes[1].tec == 0  # 8 for the error, one less for each of the frames since


def test_babble_holds_up_whatever_is_less_important(echo: Any) -> None:
    rig = Rig(echo, Fault("babble", cob_id=0x001, size=8, **WINDOW))
    babbled = [now_ns for now_ns, frame in rig.tapped if frame.can_id == 0x001]
    assert len(babbled) > 30
    assert rig.cycles(rig.two.heard, 0x181)[:4] == [1, 2, 3, 4]
    assert not {5, 6, 7, 8} & set(rig.cycles(rig.two.heard, 0x181))
    assert max(babbled) < 10_200_000


def test_a_babble_with_a_period_leaves_room(echo: Any) -> None:
    rig = Rig(echo, Fault("babble", cob_id=0x001, period_us=500.0, **WINDOW))
    assert rig.cycles(rig.two.heard, 0x181) == ALL
    assert len(rig.cycles(rig.tapped, 0x001)) == 10


def test_cut_off_a_node_is_unheard_and_unacknowledged(echo: Any) -> None:
    rig = Rig(echo, Fault("cut", node=1, **WINDOW))
    assert rig.cycles(rig.one.heard, 0x080) == OUTSIDE
    assert rig.cycles(rig.two.heard, 0x181) == OUTSIDE
    assert rig.bench.nodes[1].state is Confinement.ACTIVE


def test_what_a_node_wanted_to_send_while_cut_off_turns_it_passive_and_comes_late(echo: Any) -> None:
    beating = echo(1, heartbeat_ns=2_000_000)
    bench = Bench([beating, echo(2, 0x701)], faults=[Fault("cut", node=1, start_s=0.003, stop_s=0.012)])
    bench.kernel.run(11_000_000)
    assert (bench.nodes[1].state, bench.nodes[1].tec) == (Confinement.PASSIVE, 128)
    bench.kernel.run(13_000_000)
    beats = [now_ns for now_ns, frame in bench.nodes[2].device.heard if frame.can_id == 0x701]  # type: ignore[attr-defined]
    assert len(beats) == 7  # boot-up and 2 ms in time, 4 … 10 ms after the cut, 12 ms
    assert beats[2] > 12_000_000


def test_the_master_can_be_cut_off(echo: Any) -> None:
    rig = Rig(echo, Fault("cut", node=127, **WINDOW))
    assert rig.cycles(rig.one.heard, 0x080)[:4] == [1, 2, 3, 4]
    assert not {5, 6, 7, 8, 9} & set(rig.cycles(rig.one.heard, 0x080))


def test_deaf(echo: Any) -> None:
    rig = Rig(echo, Fault("deaf", node=1, **WINDOW))
    assert rig.cycles(rig.one.heard, 0x080) == OUTSIDE
    assert rig.cycles(rig.two.heard, 0x080) == ALL


def test_deaf_to_one_identifier(echo: Any) -> None:
    rig = Rig(echo, Fault("deaf", node=1, cob_id=0x182, **WINDOW))
    assert rig.cycles(rig.one.heard, 0x182) == OUTSIDE
    assert rig.cycles(rig.one.heard, 0x080) == ALL


def test_power_off_boots_again(echo: Any) -> None:
    rig = Rig(echo, Fault("power_off", node=1, **WINDOW))
    assert rig.one.log == ["power on", "power on"]
    assert rig.cycles(rig.one.heard, 0x080) == OUTSIDE
    assert rig.cycles(rig.tapped, 0x701) == [0, 10]


def test_a_node_may_boot_late(echo: Any) -> None:
    rig = Rig(echo, Fault("power_off", node=1, start_s=0.0, stop_s=0.010))
    assert rig.one.log == ["power on"]
    assert rig.cycles(rig.tapped, 0x701) == [10]


def emergencies(bus: BowdenBus, node: int) -> list[tuple[int, str]]:
    """Listen for 80 ms; return the EMCY of a node: its time in ms, and code and error register as sent."""
    heard = list(iter(lambda: bus.recv(max(0.0, 0.08 - bus.time_ns() / 1e9)), None))
    return [(m.time_ns // 1_000_000, m.data[:3].hex()) for m in heard if m.arbitration_id == 0x080 + node]


def test_a_broken_wire_is_its_sensors_to_tell() -> None:
    with BowdenBus("wire", faults=[Fault("broken_wire", node=START, start_s=0.0195, stop_s=0.0495)]) as bus:
        assert emergencies(bus, START) == [(20, "305021"), (50, "000000")]


def test_an_overload_is_its_sensors_to_tell() -> None:
    with BowdenBus("load", faults=[Fault("overload", node=END, start_s=0.0195, stop_s=0.0495)]) as bus:
        assert emergencies(bus, END) == [(20, "01f021"), (50, "000000")]


def test_an_emergency_stop_outlasts_its_cause() -> None:
    with BowdenBus("stop", faults=[Fault("emergency_stop", node=KNEE, start_s=0.020, stop_s=0.050)]) as bus:
        assert emergencies(bus, KNEE) == [(20, "415421")]


def test_an_emergency_stop_from_before_the_power_is_told_at_the_boot_up() -> None:
    with BowdenBus("stop", faults=[Fault("emergency_stop", node=SERVO)]) as bus:
        assert emergencies(bus, SERVO) == [(0, "415421")]


def test_faults_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "faults.toml"
    file.write_text('[[fault]]\nkind = "drop"\ncob_id = 0x183\nstart_s = 1.0\nstop_s = 1.5\nprobability = 0.1\n')
    assert declared(file) == (Fault("drop", cob_id=0x183, start_s=1.0, stop_s=1.5, probability=0.1),)


@pytest.mark.parametrize(("text", "says"), [
    ("", r"faults.toml: no \[\[fault\]\]"),
    ('[[fault]]\nkind = "melt"\n', r"faults.toml \[\[fault\]\] 1: kind = 'melt'"),
    ('[[fault]]\nkind = "cut"\n', "give node"),
    ('[[fault]]\nkind = "babble"\n', "give cob_id"),
    ('[[fault]]\nkind = "drop"\nstart_s = 2.0\nstop_s = 1.0\n', "stop_s"),
    ('[[fault]]\nkind = "drop"\nprobability = 2.0\n', "probability"),
    ('[[fault]]\nkind = "drop"\ncob = 3\n', "did you mean cob_id"),
])
def test_a_fault_that_cannot_be_is_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "faults.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=says):
        declared(file)


@pytest.mark.parametrize(("fault", "says"), [
    (Fault("overload", node=SERVO), r"overload at node = 1, which is no load cell .* expected one of \[3, 4\]"),
    (Fault("emergency_stop", node=START), r"which is no drive of the declared bench; expected one of \[1, 2\]"),
])
def test_a_fault_at_a_node_of_another_kind_is_one_sentence(fault: Fault, says: str) -> None:
    with pytest.raises(InputError, match=says):
        BowdenBus("misplaced", faults=[fault])


def test_every_kind_is_tested_here() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    assert [kind for kind in KINDS if f'Fault("{kind}"' not in text] == []
