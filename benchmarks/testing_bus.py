"""Repeat one test of `bowden.testing` and print how often its frames differed, and how long a run takes.

    python -m benchmarks.testing_bus --runs 10000
    ../shared/run_in_vm.sh -b uml -- python -m benchmarks.testing_bus --runs 20 --vcan vcan0

With `--vcan`, the same test runs on that channel too, in wall time: node and master in two processes of one kernel.
"""

from __future__ import annotations

import argparse
import hashlib
import logging
import multiprocessing
import time
from typing import Any

import can
import canopen

from bowden.testing import CanBus
from eds.cia301 import Frame
from eds.dictionary import packaged, read
from nodes import Application, Device

DICTIONARY = read(packaged("tension_sensor"), 9)
LOST_COB_ID = 0x589


def conversation(network: Any, lose: Any) -> None:
    """Await the boot-up, lose an SDO answer, read again, start the node and take its PDOs for 0.5 s."""
    node = network.add_node(9, canopen.ObjectDictionary())
    node.nmt.wait_for_bootup(1)
    lose()
    try:
        node.sdo.upload(0x1000, 0)
    except canopen.SdoCommunicationError:
        node.sdo.upload(0x1000, 0)
    node.nmt.state = "OPERATIONAL"
    time.sleep(0.5)


def run() -> tuple[str, int]:
    """Run the test on a virtual bus; return a digest of all frames and the bus time, ns."""
    bus = CanBus()
    bus.add_node(DICTIONARY)
    with bus.virtual_time():
        network = canopen.Network(bus.open())
        conversation(network, lambda: bus.faults.drop(cob_id=LOST_COB_ID))
        network.disconnect()
    frames = "\n".join(map(str, bus.frames()))
    return hashlib.sha256(frames.encode()).hexdigest(), bus.now_ns


def serve(channel: str, begin: Any, end: Any) -> None:
    """Be the node on a kernel's channel: it boots when `begin` is set, and loses its first SDO answer."""
    device = Device(DICTIONARY, 9, Application())
    with can.Bus(channel, interface="socketcan") as bus:
        begin.wait()
        begin.clear()
        device.power_on(time.monotonic_ns())
        lost = False
        while not end.is_set():
            while device.outbox:
                frame = device.outbox.popleft()
                if frame.can_id == LOST_COB_ID and not lost:
                    lost = True
                else:
                    bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))
            due_ns = device.next_ns()
            message = bus.recv(min(0.05, max(0.0, ((due_ns or 1 << 62) - time.monotonic_ns()) / 1e9)))
            if message is not None:
                device.receive(Frame(message.arbitration_id, bytes(message.data)), time.monotonic_ns())
            device.poll(time.monotonic_ns())


def run_on_kernel(channel: str) -> float:
    """Run the test on a kernel's CAN; return its wall time, s, without the start of processes."""
    begin, end = multiprocessing.Event(), multiprocessing.Event()
    node = multiprocessing.Process(target=serve, args=(channel, begin, end))
    node.start()
    network = canopen.Network()
    network.connect(channel=channel, interface="socketcan")
    began = time.perf_counter()
    begin.set()
    conversation(network, lambda: None)
    network.disconnect()
    took_s = time.perf_counter() - began
    end.set()
    node.join()
    return took_s


def main() -> None:
    """Print runs, differing runs, wall time a run, bus time a run, and with `--vcan` the wall time there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--vcan", metavar="CHANNEL", help="run it on this channel of the kernel, too")
    given = parser.parse_args()
    logging.disable(logging.CRITICAL)
    first, bus_ns = run()
    began = time.perf_counter()
    differing = sum(run()[0] != first for _ in range(given.runs))
    each_s = (time.perf_counter() - began) / given.runs
    print(f"{given.runs} runs, {differing} differ from the first; {1e3 * each_s:.2f} ms of wall time and "
          f"{bus_ns / 1e6:.1f} ms of bus time a run: {bus_ns * 1e-9 / each_s:.0f} times faster than the bus")
    if given.vcan:
        there_s = min(run_on_kernel(given.vcan) for _ in range(5))
        print(f"{given.vcan}: {1e3 * there_s:.1f} ms of wall time a run: the virtual bus is "
              f"{there_s / each_s:.0f} times faster")


if __name__ == "__main__":
    main()
