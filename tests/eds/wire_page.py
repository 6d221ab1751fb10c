"""Generator of docs/wire.md from the declarations of the wire: `python -m tests.eds.wire_page [FILE]`.

Values come from the code; this module adds only the sentences between them.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from eds.bench import bus_load
from eds.bench.bench_network import MASTER, TPDO, Network, Pdo, WireLayout, wire
from eds.bench.bus_load import Kind
from eds.pdo_plan import PdoPlan

_HEAD = """\
# The wire

For whoever reads or sends frames of this bench: what goes over the bus, with the default
`[network]`. Generated from `eds/` by `python -m tests.eds.wire_page docs/wire.md`; change the declarations,
not this page.

Node ids: {nodes}. The master makes the SYNC. Every node and the master send a heartbeat
every {heartbeat} ms; each node misses the master's after {timeout} ms (0x1016).
"""
_CYCLE = """
## A cycle

SYNC k latches every input; four TPDOs follow; the master steps; its targets are taken over at SYNC k+1 and first seen
in the inputs of k+2. With every frame at its longest, a cycle of {period} µs holds:

| from SYNC, at worst | µs | made of |
|---|---|---|
| the last input is there | {inputs} | SYNC, {turnaround} of the nodes, four TPDOs; before each, a frame already begun |
| it is due | {deadline} | {period} less {targets} (a frame already begun, the targets) and {compute} for the master |

A network whose inputs can come later than they are due is refused. The chain counts the sustained traffic; an EMCY or
an SDO may cost one cycle its deadline, which the master counts as a miss. The sustained load is **{load:.2f} %** of the
bus ({cyclic} bits each cycle, heartbeats and EMCY at their periods), the goal {goal:g} %.

## Frames

`bits` is the longest frame of its size, 55 + 10·n with the interframe space. `response` bounds the time from queueing
to the end of the frame with everything on the bus at once, EMCY and SDO too (Davis et al. 2007).

| COB-ID | frame | bytes | bits | sent | response, µs |
|---|---|---|---|---|---|
"""
_PLANS = """
## Payloads

Little-endian, objects in the order shown, nothing between them.

| COB-ID | from | objects (bits), SI per count |
|---|---|---|
"""
_PDOS = """
A drive maps the other's half of a shared frame as a dummy, so that one frame carries both targets, and one both
controlwords. `deadline` is 0x14xx:05; past it the drive acts by itself (EMCY 8250h, 0x6007). The servo takes START's
tension straight from START's own TPDO, and so holds the tension limit whatever the master does.

| node | PDO | COB-ID | type | deadline, ms | mapping words |
|---|---|---|---|---|---|
"""
_UNITS = """
## Units on the wire

Servo: drum radius 20 mm; position user unit 1 µm of rope (0x608F 131072 inc/rev, 0x6091 1:1, 0x6092 1256637 µm per
10 rev, 0x60A8 0xFA010000); torque in ‰ of 0x6076 = 2000 mN·m, so that 0x6077 steps 0.1 N of rope force.
Knee: 0x608F 4000 inc/motor rev, 0x6091 20:1, 0x6092 360000 per rev, 0x60A8 0xFD410000: user unit 1 mdeg of the knee.
Sensors: 0x6131 newton (0x00210000), 0x6132 = 2 decimals, so that 0x7130 and 0x9130 count 0.01 N. Velocity user units:
µm/s and mdeg/s.
"""


def page(network: Network = Network()) -> str:  # noqa: B008
    """Return the whole page for a network."""
    built = wire(network)
    return "".join((_head(built), _cycle(built), _plans(built), _pdos(built), _UNITS))


def _head(built: WireLayout) -> str:
    network = built.network
    nodes = ", ".join((*(f"{entry.name} {node}" for node, entry in built.nodes.items()), f"master {MASTER}"))
    return _HEAD.format(nodes=nodes, heartbeat=network.heartbeat_ms, timeout=network.heartbeat_timeout_ms)


def _cycle(built: WireLayout) -> str:
    network, found = built.network, bus_load.budget(built)
    cyclic = sum(stream.bits() for stream, _ in found.responses if stream.kind is Kind.CYCLIC)
    text = _CYCLE.format(
        period=network.period_us, inputs=found.inputs_ns // 1000, turnaround=network.node_turnaround_us,
        deadline=found.deadline_ns // 1000, targets=found.targets_ns // 1000, compute=found.compute_ns // 1000,
        load=found.load_percent, cyclic=cyclic, goal=bus_load.LOAD_GOAL_PERCENT)
    return text + "".join(
        f"| {s.can_id:03X}h | {s.name} | {s.size} | {s.bits()} | {s.kind.value} | "
        f"{'no bound' if response is None else response // 1000} |\n" for s, response in found.responses)


def _plans(built: WireLayout) -> str:
    rows: Sequence[tuple[str, PdoPlan]] = (
        *((built.nodes[plan.cob_id & 0x7F].name, plan) for plan in built.tpdo.values()),
        *(("master", plan) for plan in (*built.target_frames, *built.controlword_frames)),
    )
    return _PLANS + "".join(f"| {plan.cob_id:03X}h | {sender} | {_fields(plan)} |\n" for sender, plan in rows)


def _fields(plan: PdoPlan) -> str:
    return " · ".join(
        f"{f.key >> 8:04X}:{f.key & 0xFF:02X} {f.name} ({f.bits})" + (f", {f.scale:.6g}" if f.scale != 1.0 else "")
        for f in plan.fields)


def _pdos(built: WireLayout) -> str:
    return _PDOS + "".join(_pdo(built.nodes[node].name, pdo) for node in built.drives for pdo in built.pdos(node))


def _pdo(name: str, pdo: Pdo) -> str:
    way = "TPDO" if pdo.base == TPDO else "RPDO"
    words = " ".join(f"{word:08X}" for word in pdo.mapping)
    return (f"| {name} | {way}{pdo.number} | {pdo.cob_id:03X}h | {pdo.transmission_type} | {pdo.deadline_ms or '—'} "
            f"| {words} |\n")


if __name__ == "__main__":
    Path(sys.argv[1] if len(sys.argv) > 1 else "docs/wire.md").write_text(page(), encoding="utf-8")
