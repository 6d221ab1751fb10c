"""Whole control cycles against event by event, for benches and troubles drawn by seed: every byte must be the same.

    python -m benchmarks.steady_proof               # 40 seeds
    python -m benchmarks.steady_proof --seeds 3 7   # these

Each seed draws serial, day, noise, rate, bit rate, controller, up to two faults of any kind at any time, and SDO reads,
second sockets and odd frames at any cycle.  Exits with 1 where a seed differs.
"""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
from pathlib import Path

from eds.bench.bench_network import END, KNEE, SERVO, START
from tests.virtual_bus.steady_cases import Case, Hook, Ran, fault, odd_send, pause, quick_stop, ran, read, second_socket
from virtual_bus.compiled.compiled_cycles import SWITCH
from virtual_bus.wire.faults import KINDS, OF_A_DRIVE, OF_A_NODE, OF_A_SENSOR, Fault

SEEDS = 40
CYCLES = 500


def drawn(seed: int) -> Case:
    """Draw a case."""
    chance = random.Random(seed)
    rate_hz = chance.choice((100, 200, 250, 500, 1000))
    bitrate = 1_000_000 if rate_hz > 250 else chance.choice((500_000, 1_000_000))
    options = {"serial": chance.randrange(50), "day": chance.randrange(5), "seed": chance.randrange(1000),
               "bitrate": bitrate}
    faults = tuple(each for _ in range(chance.randrange(3)) for each in _fault(chance, CYCLES / rate_hz))
    if chance.random() < 0.3:
        return Case(options, rate_hz, faults=faults, controller=chance.choice(("paper", "extended", "none")))
    hooks: list[Hook] = [read(START, 0x7130, 1), read(SERVO, 0x6064), read(KNEE, 0x6041), read(END, 0x6130, 1),
                         second_socket(chance.randrange(1, 30)), odd_send, pause, quick_stop]
    script = {chance.randrange(CYCLES): chance.choice(hooks) for _ in range(chance.randrange(8))}
    return Case(options, rate_hz, script=script, cycles=CYCLES, faults=faults)


def _fault(chance: random.Random, span_s: float) -> tuple[Fault, ...]:
    kind = chance.choice(sorted(KINDS))
    start_s = round(0.8 + chance.random() * span_s, 7)
    node = chance.choice((START, END) if kind in OF_A_SENSOR else (SERVO, KNEE) if kind in OF_A_DRIVE else (
        SERVO, KNEE, START, END))
    more: dict[str, float] = {"node": node} if kind in OF_A_NODE else {"probability": chance.choice((0.2, 1.0))}
    if kind == "babble":
        more = {"cob_id": chance.choice((0x050, 0x190, 0x7F0)), "size": chance.randrange(9), "period_us": 700.0}
    return fault(kind, start_s, start_s + chance.choice((0.003, 0.02, 0.2)), delay_us=300.0, **more)


def both(case: Case) -> tuple[Ran, Ran]:
    """Run a case with whole cycles, and without."""
    made = []
    for switch in ("1", "0"):
        os.environ[SWITCH] = switch
        with tempfile.TemporaryDirectory() as folder:
            made.append(ran(case, Path(folder)))
    return made[0], made[1]


def main() -> None:
    """Run all seeds; one line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(SEEDS)))
    different = 0
    for seed in parser.parse_args().seeds:
        case = drawn(seed)
        on, off = both(case)
        same = on.digest == off.digest and not off.complete_cycles
        different += not same
        troubles = ", ".join(each.kind for each in case.faults) or "no fault"
        print(f"seed {seed:3d}: {'same' if same else 'DIFFERENT'}, {on.complete_cycles:5d} complete cycles, "
              f"{case.rate_hz} Hz, {troubles}; {on.reason or 'completed'}", flush=True)
    print(f"{different} differ")
    sys.exit(1 if different else 0)


if __name__ == "__main__":
    main()
