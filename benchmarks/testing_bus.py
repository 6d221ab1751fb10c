"""Repeat one test of `bowden.testing` and print how often its frames differed, and how long a run takes.

    python -m benchmarks.testing_bus --runs 10000
"""

from __future__ import annotations

import argparse
import hashlib
import logging
import time

import canopen

from bowden.testing import CanBus
from eds.dictionary import packaged, read

DICTIONARY = read(packaged("tension_sensor"), 9)


def run() -> tuple[str, int]:
    """Boot a node, read, lose an answer, start it, receive PDOs; return a digest of all frames and the bus time, ns."""
    bus = CanBus()
    bus.add_node(DICTIONARY)
    with bus.virtual_time():
        network = canopen.Network(bus.open())
        node = network.add_node(9, canopen.ObjectDictionary())
        node.nmt.wait_for_bootup(1)
        bus.faults.drop(cob_id=0x589)
        try:
            node.sdo.upload(0x1000, 0)
        except canopen.SdoCommunicationError:
            node.sdo.upload(0x1000, 0)
        node.nmt.state = "OPERATIONAL"
        time.sleep(0.5)
        network.disconnect()
    frames = "\n".join(map(str, bus.frames()))
    return hashlib.sha256(frames.encode()).hexdigest(), bus.now_ns


def main() -> None:
    """Print runs, differing runs, wall time a run and bus time a run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    runs = parser.parse_args().runs
    logging.disable(logging.CRITICAL)
    first, bus_ns = run()
    began = time.perf_counter()
    differing = sum(run()[0] != first for _ in range(runs))
    each_s = (time.perf_counter() - began) / runs
    print(f"{runs} runs, {differing} differ from the first; {1e3 * each_s:.2f} ms of wall time and "
          f"{bus_ns / 1e6:.1f} ms of bus time a run: {bus_ns * 1e-9 / each_s:.0f} times faster than the bus")


if __name__ == "__main__":
    main()
