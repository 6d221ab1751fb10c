"""Two processes with other hash seeds do the same, to the nanosecond and the byte."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import hashlib, sys, can
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.faults import Fault
faults = [Fault("drop", cob_id=0x703, probability=0.5), Fault("corrupt", node=1, probability=0.5)]
for bench in sys.argv[1:]:
    serial, seed = map(int, bench.split())
    bus, tap = BowdenBus("a", serial=serial, day=1, seed=seed, faults=faults), BowdenBus("a")
    sync = can.Message(arbitration_id=0x080, is_extended_id=False)
    bus.recv(0.01)
    bus.send(can.Message(arbitration_id=0x000, data=b"\\x01\\x00", is_extended_id=False))
    bus.send_periodic(sync, 0.001)
    for node, data in ((3, b"\\x40\\x30\\x61\\x01\\0\\0\\0\\0"), (4, b"\\x40\\x30\\x61\\x01\\0\\0\\0\\0")):
        bus.recv(0.1)
        bus.send(can.Message(arbitration_id=0x600 + node, data=data, is_extended_id=False))
    bus.recv(0.05)
    while bus.time_ns() < 100_000_000:
        bus.recv(0.05)
    digest = hashlib.sha256()
    while (m := tap.recv(0)) is not None:
        digest.update(repr((m.time_ns, m.arbitration_id, bytes(m.data), m.is_rx)).encode())
    print(digest.hexdigest())
    tap.shutdown()
    bus.shutdown()
"""


def run(hash_seed: int, *benches: str) -> list[str]:
    """Run benches, "serial seed", in one process; return the digest of each."""
    environment = {**os.environ, "PYTHONHASHSEED": str(hash_seed), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", SCRIPT, *benches], env=environment, cwd=ROOT, capture_output=True,
                          text=True, check=True)
    return done.stdout.split()


def test_another_hash_seed_changes_nothing_another_seed_or_serial_something() -> None:
    reference, another_seed, another_serial = run(1, "1 0", "1 1", "2 0")
    assert run(2, "1 0") == [reference]
    assert len({reference, another_seed, another_serial}) == 3
