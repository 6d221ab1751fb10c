"""`bowden.testing`: nodes from an EDS, their behaviour, wire faults by count, virtual time, golden frames, reports."""

from __future__ import annotations

import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np
import pytest
from hypothesis import given, settings

from bowden.testing import CanBus, CanopenNode, assert_same_frames, assert_same_trial
from bowden.testing.conversation import SdoAnswer, SdoStep, converse
from bowden.testing.strategies import sdo_conversations
from eds.cia301 import NmtState
from eds.dictionary import read
from parameters import InputError
from trial.record import TrialContent, write

EDS = Path(__file__).with_name("own.eds")
MS = 1_000_000
AddNode = Callable[..., CanopenNode]


def started(bus: CanBus, add: AddNode) -> CanopenNode:
    """Return node 5, OPERATIONAL, 1 ms after power-on."""
    node = add("own.eds", 5)
    bus.send(0, b"\x01\x05")
    bus.run(0.001)
    assert node.state is NmtState.OPERATIONAL
    return node


def test_boot_up_and_heartbeats_are_exact(can_bus: CanBus, canopen_node: AddNode) -> None:
    canopen_node("own.eds", 5)
    can_bus.run(0.025)
    beats = can_bus.frames(0x705)
    assert [frame.data for frame in beats] == [b"\x00", b"\x7f", b"\x7f"]
    assert [beats[n].time_ns // MS for n in (1, 2)] == [10, 20]
    assert beats[2].time_ns - beats[1].time_ns == 10 * MS


def test_faults_of_an_eds_are_listed_and_the_node_boots(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = canopen_node("own.eds", 5)
    assert [fault for fault in node.eds_faults if "4711" in fault]
    assert [fault for fault in node.eds_faults if "many" in fault]
    assert node[0x2003] == 0
    assert converse(can_bus, 5, [SdoStep(0x2003, 0)]) == [SdoAnswer(b"\x00")]


def test_segmented_and_block_transfers(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = canopen_node("own.eds", 5)
    image = bytes(can_bus.random.randbytes(1500))
    for block in (False, True):
        node[0x2002] = b""
        steps = [SdoStep(0x2002, 0, image, block), SdoStep(0x2002, 0, None, block)]
        assert converse(can_bus, 5, steps)[1].data == image
        assert node["Firmware"] == image
    assert node["Manufacturer device name"] == "A device of the tests"


def test_a_lost_segment_of_a_block_is_repeated(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = canopen_node("own.eds", 5)
    node[0x2002] = bytes(range(200))
    lost = can_bus.faults.drop(cob_id=0x585, after=5)
    assert converse(can_bus, 5, [SdoStep(0x2002, 0, None, True)]) == [SdoAnswer(bytes(range(200)))]
    assert lost.struck == 1


def test_a_written_value_starts_a_function_and_its_answer_goes_out_by_pdo(
    can_bus: CanBus, canopen_node: AddNode,
) -> None:
    node = started(can_bus, canopen_node)
    node.on_write("Command", lambda value: node.__setitem__("Status", value + 1))
    can_bus.send(0x205, b"\x10\x00")
    can_bus.run(0.001)
    assert can_bus.frames(0x185)[-1].data == b"\x11\x00"
    node[0x2001] = 7
    can_bus.run(0.001)
    assert can_bus.frames(0x185)[-1].data == b"\x07\x00"


def test_time_based_behaviour(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = started(can_bus, canopen_node)
    node.on_write("Command", lambda value: can_bus.after(0.005, lambda: node.__setitem__("Status", value)))
    can_bus.send(0x205, b"\x10\x00")
    can_bus.run(0.01)
    command, status = can_bus.frames(0x205)[-1], can_bus.frames(0x185)[-1]
    assert status.data == b"\x10\x00"
    assert 5 * MS < status.time_ns - command.time_ns < 5.1 * MS


@pytest.mark.parametrize(("kind", "options", "seen"), [
    ("drop", {}, []), ("duplicate", {}, [b"\x01\x02", b"\x01\x02"]), ("corrupt", {"bit": 9}, [b"\x01\x00"]),
    ("shorten", {"size": 1}, [b"\x01"]), ("disturb", {}, [b"\x01\x02"]), ("delay", {"delay_ns": MS}, [b"\x01\x02"]),
])
def test_faults_hit_the_frames_that_they_count(
    can_bus: CanBus, kind: str, options: dict[str, int], seen: list[bytes],
) -> None:
    fault = getattr(can_bus.faults, kind)(cob_id=0x123, count=1, after=1, **options)
    other = can_bus.open()
    for _ in range(3):
        other.send(can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False))
        other.send(can.Message(arbitration_id=0x124, data=b"\x03", is_extended_id=False))
        can_bus.run(0.01)
    frames = [frame for frame in can_bus.frames(0x123) if 10 * MS <= frame.time_ns < 20 * MS]
    assert [frame.data for frame in frames] == seen
    assert len(can_bus.frames(0x124)) == 3
    assert fault.struck == 1
    assert len(can_bus.error_frames) == (kind == "disturb")
    if kind == "delay":
        assert frames[0].time_ns - can_bus.frames(0x123)[0].time_ns == 11 * MS


def test_refusals_of_the_plugin_are_one_sentence(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = canopen_node("own.eds", 5)
    for wrong in (lambda: canopen_node("own.eds", 5), lambda: canopen_node("own.eds"), lambda: node["No such"],
                  lambda: node.on_write("Status", print), lambda: node.__setitem__(0x2000, 70_000),
                  lambda: can_bus.faults.drop(count=0), lambda: can_bus.faults.corrupt(bit=64),
                  lambda: can_bus.faults.shorten(size=9), lambda: can_bus.faults.delay(delay_ns=-1),
                  lambda: can_bus.faults.drop(cob_id=0x800), lambda: CanBus(bitrate=123), lambda: node.sample(1),
                  lambda: node.refuse(0x1017), lambda: canopen_node("missing.eds", 6)):
        with pytest.raises(InputError, match=r";.*\.$"):
            wrong()


def test_power_off_silences_a_node_and_power_on_boots_it(can_bus: CanBus, canopen_node: AddNode) -> None:
    node = started(can_bus, canopen_node)
    node.power_off()
    can_bus.run(0.05)
    before = len(can_bus.frames(0x705))
    can_bus.run(0.05)
    assert len(can_bus.frames(0x705)) == before
    node.power_on()
    can_bus.run(0.001)
    assert can_bus.frames(0x705)[-1].data == b"\x00"
    assert node.state is NmtState.PRE_OPERATIONAL


# ---- virtual time ----


def test_a_connected_network_starts_no_thread_and_takes_no_wall_clock(
    can_bus: CanBus, canopen_node: AddNode,
) -> None:
    canopen_node("own.eds", 5)
    threads, real = threading.active_count(), time.sleep
    with can_bus.virtual_time():
        network = canopen.Network(can_bus.open()).connect()
        node = network.add_node(5, str(EDS))
        node.nmt.wait_for_bootup(1)
        node.nmt.state = "OPERATIONAL"
        node.tpdo.read()
        node.rpdo.read()
        began = time.monotonic_ns()
        time.sleep(60.0)
        assert time.monotonic_ns() - began == 60_000_000_000
        assert node.nmt.state == "OPERATIONAL"
        assert threading.active_count() == threads
        network.disconnect()
    assert time.sleep is real


def test_waits_end_by_what_comes_or_by_their_time_out(can_bus: CanBus) -> None:
    with can_bus.virtual_time():
        waiting: queue.Queue[int] = queue.Queue()
        can_bus.after(0.5, lambda: waiting.put(7))
        assert waiting.get(timeout=1) == 7
        assert can_bus.now_ns == 500 * MS
        with pytest.raises(queue.Empty):
            waiting.get(timeout=0.25)
        event = threading.Event()
        can_bus.after(0.25, event.set)
        assert event.wait()
        assert can_bus.now_ns == 1000 * MS
        with pytest.raises(RuntimeError, match="can never end"):
            event.clear() or event.wait()
        with pytest.raises(RuntimeError, match="nothing waited"):
            list(iter(time.monotonic, 10.0))
        other = CanBus()
        with pytest.raises(RuntimeError, match="another bus"), other.virtual_time():
            pass


def test_the_clock_of_other_threads_stays_real(can_bus: CanBus) -> None:
    seen: list[float] = []
    with can_bus.virtual_time():
        thread = threading.Thread(target=lambda: seen.append(time.time()))
        thread.start()
        while not seen:
            can_bus.run(0.001)
        assert time.time() < 1e6 < seen[0]
    thread.join()


# ---- golden, hypothesis, reports ----


def test_golden_frames_show_what_differs(can_bus: CanBus, canopen_node: AddNode, tmp_path: Path) -> None:
    canopen_node("own.eds", 5)
    can_bus.run(0.015)
    with pytest.raises(InputError, match="--golden-update"):
        can_bus.assert_golden(tmp_path / "boot.txt")
    can_bus.assert_golden(tmp_path / "boot.txt", update=True)
    can_bus.assert_golden(tmp_path / "boot.txt")
    lines = (tmp_path / "boot.txt").read_text(encoding="utf-8").splitlines()
    for change, told in ((["0.000055001 705 [1] 00", lines[1]], "came 1 ns earlier"),
                         ([lines[0], lines[1].replace("7f", "05")], "data of 705: 7f instead of 05"),
                         ([lines[0]], "expected: no further frame"),
                         ([lines[0].replace("705", "706"), lines[1]], "COB-ID 705 instead of 706")):
        (tmp_path / "boot.txt").write_text("\n".join(change) + "\n", encoding="utf-8")
        with pytest.raises(AssertionError, match=told):
            assert_same_frames(can_bus.frames(), tmp_path / "boot.txt")


def made(path: Path, error_n: float) -> Path:
    """Write a trial of two seconds, END off by `error_n`."""
    time_s = np.arange(200) / 100
    columns = {"time_s": time_s, "tension_end_n": 40 * np.sin(time_s) + error_n}
    write(path, TrialContent(np.rint(time_s * 1e9).astype(np.int64), columns), metadata={},
          result={"outcome": "completed"})
    return path


def test_golden_trials_show_what_differs(tmp_path: Path) -> None:
    one, two, off = (made(tmp_path / f"{name}.mcap", error_n) for name, error_n in (("a", 0.0), ("b", 0.0), ("c", 0.5)))
    assert_same_trial(one, two)
    with pytest.raises(AssertionError, match=r"tension_end_n: RMS 0\.5 N, largest 0\.5 N"):
        assert_same_trial(one, off)


@settings(max_examples=30, deadline=None)
@given(sdo_conversations(read(EDS, 5), max_size=6))
def test_every_step_of_a_conversation_is_answered(steps: list[SdoStep]) -> None:
    bus = CanBus()
    bus.add_node(EDS, 5)
    assert not any(answer.silent for answer in converse(bus, 5, steps))


def test_a_failed_test_shows_the_frames_and_its_seed(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(
        "def test_it(can_bus, canopen_node):\n"
        f"    canopen_node({str(EDS)!r}, 5)\n    can_bus.run(0.001)\n    assert can_bus.frames(0x999)\n",
        encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "bowden.testing.plugin", "-p", "no:cacheprovider",
               "-c", "/dev/null", "--rootdir", str(tmp_path), str(tmp_path)]
    told = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path).stdout
    assert "can_bus: 1 frames, seed " in told
    assert "0.000055000 705 [1] 00" in told


def test_the_seed_is_that_of_the_test(can_bus: CanBus, request: Any) -> None:
    import zlib

    assert can_bus.seed == zlib.crc32(request.node.nodeid.encode())
