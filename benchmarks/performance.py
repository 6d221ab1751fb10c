"""Processor time of operations of this package and of the usual library for each, and their ratio.

    python -m benchmarks.performance                     # `make bench`: prints the table and writes it into the page
    python -m benchmarks.performance --rows cycle pdo    # these rows alone, printed

Both work on the same data, in turns, in two processes (`benchmarks.frame`), so that a busy machine slows both alike.
Rows without a library to compare with have one figure.  No figure fails a build.
"""

import argparse
import importlib
import itertools
import json
import os
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import can
import canopen
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory
from scipy.integrate import solve_ivp

import bowden
import nodes
import trial
from benchmarks.frame import DOCS, ROOT, Row, Turn, compare, map_pdo, put, quartiles, repeated
from diagnosis.finder import Finder
from eds.bench import bus_load
from eds.bench.bench_network import DRIVES, FILES, RPDO, SERVO, Network, wire
from eds.cia301 import SYNC_COB_ID
from eds.declaration import packaged as packaged_bench
from eds.dictionary import packaged
from eds.pdo_plan import JoinedUnpacker
from estimation.data import table
from master.cycle.log import Log
from master.motion.experiment_run import ExperimentSetup, run
from master.network.bringup import bring_up
from master.network.link import WANTED, Link
from master.settings import Gait
from physics.plant.bench_plant import create
from physics.plant.components import KNEE_AT_FIT
from physics.reference import paper_reference
from tests.bowden.test_law_seam import saturating
from tests.hidden import cases
from tests.physics.test_physics_plant_accuracy import KNEE_NM, SECONDS, SERVO_NM, Equations
from trial.mcap_file import cdr
from trial.record import Recorder
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.wire.bit_counts import bits_of
from virtual_bus.wire.bits import INTERMISSION_BITS

PAGE = DOCS / "performance.md"
BOWDEN = str(Path(sys.executable).with_name("bowden"))
HEAD = ("what", "here", "peer", "peer's", "ratio (quartiles)")
SEED = 60_000
"""Seed of the diagnosed trials in `tests.hidden`."""
UNITS = 200
PEAK_N, PERIOD_S = 40.0, 2.0
SKIP = 4000
"""Cycles before the first turn: bring-up, homing, approach."""


class Paced:
    """Recorder that ends a turn every `UNITS` control cycles of the gait trial."""

    def __init__(self, recorder: Recorder, turn: Turn) -> None:
        self.frame, self.event = recorder.frame, recorder.event
        self.frames = recorder.frames
        self._record, self._turn, self._left = recorder.cycle, turn, SKIP

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        """Record one control cycle."""
        self._record(time_ns, values)
        self._left -= 1
        if not self._left:
            self._left = UNITS
            self._turn()


def simulated_cycles(turn: Turn) -> None:
    """Run a trial as `bowden trial` does: controller, recorder, wire, devices, plant, truth file."""
    network, reference = Network(), paper_reference(PEAK_N, PERIOD_S)
    experiment = ExperimentSetup(reference, network, gait=Gait(peak_n=PEAK_N, period_s=PERIOD_S, cycles=200, settle=0))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bus = BowdenBus("cycle", rate_hz=network.rate_hz, truth=str(folder / "truth.mcap"))
        tap = BowdenBus("cycle")
        bus.set_filters(WANTED)
        recorder = Recorder(folder / "trial.mcap", metadata={}, attachments={}, threaded=False)
        try:
            result = run(Link(bus, bus.time_ns), tap, Paced(recorder, turn), experiment)  # type: ignore[arg-type]
            raise RuntimeError(f"the trial ended before enough was measured: {result.stop_reason}")
        finally:
            tap.shutdown()
            bus.shutdown()


def stock(turn: Turn, *, threads: bool = True) -> None:
    """Run canopen by its manual: SYNC, four TPDOs, a frame of targets, a notifier's thread for each network.

    On python-can's `virtual` interface, without plant, control, log and bus time.  Without `threads` all devices are on
    one network, and one thread pumps both networks by hand.
    """
    described, answered, count = wire(Network()), threading.Semaphore(0), itertools.count()

    def answer(pdo: Any, *_: object) -> None:
        for variable in pdo.map:
            variable.raw = next(count) & 0x3FFF
        pdo.transmit()

    master, together = _network(threads), _network(False)
    benches = [_network(True) for _ in FILES] if threads else [together] * len(FILES)
    remote = []
    for (node_id, file), bench in zip(FILES.items(), benches, strict=True):
        near, far = master.add_node(node_id, str(packaged(file))), canopen.LocalNode(node_id, str(packaged(file)))
        bench.add_node(far)
        for pdo in (pdo for pdo in described.pdos(node_id) if pdo.number == 1):
            for end in (far, near):
                map_pdo((end.rpdo if pdo.base == RPDO else end.tpdo)[1], pdo)
        near.tpdo[1].add_callback(lambda _pdo: answered.release())
        bench.subscribe(SYNC_COB_ID, partial(answer, far.tpdo[1]))
        if node_id in DRIVES:
            far.rpdo[1].add_callback(lambda pdo: [variable.raw for variable in pdo.map])
        remote.append(near)
    inputs, targets = [node.tpdo[1] for node in remote], remote[0].rpdo[1]

    def pump(*networks: Any) -> None:
        for network in () if threads else networks:
            while (message := network.bus.recv(0)) is not None:
                network.notify(message.arbitration_id, message.data, message.timestamp)

    def unit() -> None:
        master.sync.transmit()
        pump(together, master)
        for _ in inputs:
            if not answered.acquire(timeout=1.0):
                raise RuntimeError("a device of canopen's does not answer")
        values = [[variable.raw for variable in pdo.map] for pdo in inputs]
        targets.map[0].raw, targets.map[1].raw = values[0][1], values[1][1]
        targets.transmit()
        pump(together)

    repeated(turn, unit, UNITS)


def _network(threads: bool) -> Any:
    network = canopen.Network()
    if threads:
        return network.connect(interface="virtual", channel="stock")
    network.bus = can.Bus(interface="virtual", channel="stock")
    return network


def plant() -> Iterator[Row]:
    """Pulling and flexing, by the plant and by SciPy's integrator at a tolerance that is no more exact than needed."""
    times = np.linspace(0.0, SECONDS, 11)
    made = create({"start_knee_rad": KNEE_AT_FIT, "start_slack_m": 0.0}, 0)
    made.reset(0)
    equations = Equations(made)

    def solved(rtol: float) -> np.ndarray:
        solution = solve_ivp(equations, (0.0, SECONDS), equations.start, "LSODA", t_eval=times, rtol=rtol,
                             atol=rtol * 1e-2)
        return np.array(solution.y[0])

    def stepped() -> np.ndarray:
        made.reset(0)
        return np.array([made.advance(round(t * 1e9), SERVO_NM, KNEE_NM).servo_position_m for t in times])

    exact = solved(1e-9)
    error = float(np.abs(stepped() - stepped()[0] - exact + exact[0]).max())
    rtol = next((each for each in (1e-3, 1e-4, 1e-5, 1e-6) if np.abs(solved(each) - exact).max() <= error), 1e-7)

    yield compare("plant alone, a millisecond of it, µs", partial(repeated, unit=stepped, units=4),
                  f"SciPy `solve_ivp`, LSODA, rtol {rtol:g}: both within {error:.0e} m",
                  partial(repeated, unit=lambda: solved(rtol), units=4), units=4 * round(SECONDS * 1e3), turns=20)


def diagnosis() -> Iterator[Row]:
    """A diagnosis of ten gait cycles beside two healthy trials, compiled and warm."""
    single = cases.Job("one", SEED + 1, ("cable_friction",))
    pair = cases.Job("two", SEED + 1, ("end_gain", "presliding"))
    _diagnosed(single, 5)
    for what, job in (("one effect", single), ("two effects", pair)):
        reference_s, beside_s = _diagnosed(job, 10)
        yield (f"diagnosis of ten gait cycles, {what}, s of CPU", f"{beside_s:.1f}",
               "fit of its two reference trials, s of CPU", f"{reference_s:.1f}", f"{reference_s / beside_s:.1f}")


def _diagnosed(job: cases.Job, cycles: int) -> tuple[float, float]:
    """Return the processor seconds of the fit of two healthy trials, and of the diagnosis of one trial by it."""
    case, began = cases.case(job, cycles=cycles), time.process_time()
    finder = Finder().examine([table.table(f"healthy {i}", columns) for i, columns in enumerate(case.healthy)])
    trial = [table.table("trial", case.trial)]
    finder.diagnose(trial)
    whole, began = time.process_time() - began, time.process_time()
    finder.diagnose(trial)
    beside = time.process_time() - began
    return whole - beside, beside


def discovery() -> Iterator[Row]:
    """Measure a law search in ten gait cycles of docs/laws.md's example beside two reference trials."""
    with tempfile.TemporaryDirectory() as folder:
        walks = [f"{folder}/{name}.mcap" for name in ("good1", "good2", "trial")]
        model = saturating(Path(folder), "end_gain", -0.2)
        for path, options in zip(walks, ("--seed 1", "--seed 2 --peak 50", f"--seed 3 --plant-model {folder}/{model}"),
                                 strict=True):
            used(f"trial --serial 3 --cycles 10 --period 1.3 {options} -o {path}")
        whole_s = used(f"discover {walks[2]} --healthy {walks[0]} --healthy {walks[1]} --json")[0]
        began = time.process_time()
        Finder().fit(walks[:2])
        yield ("`bowden discover`, ten gait cycles, s of CPU", f"{whole_s:.1f}",
               "of which the fit of its two reference trials", f"{time.process_time() - began:.1f}", "–")


FRAMES = 8
Step = Callable[[int, list[float], list[bytes]], None]


def whole_cycle() -> Iterator[Row]:
    """Compare the whole simulated cycle with stock canopen, and with canopen without its threads."""
    for name, threads in (("stock canopen, µs", True), ("canopen pumped by hand, µs", False)):
        yield compare("one simulated control cycle, µs", simulated_cycles, name, partial(stock, threads=threads),
                      units=UNITS, turns=60)


def pdos() -> Iterator[Row]:
    """Decode four TPDOs, encode the targets."""
    described = wire(Network())
    plans = [plan for _, plan in sorted(described.tpdo.items())]
    frames = [plan.pack(*range(1, 1 + len(plan.keys))) for plan in plans]
    together, block = JoinedUnpacker(plans), b"".join(struct.pack("<q8s", 0, frame) for frame in frames)
    unpack, pack = together.unpack, described.targets.pack
    to_si, from_si = together.unpack_si, described.targets.pack_si

    def own() -> None:
        unpack(block)
        pack(10_000, -11_459)

    def own_si() -> None:
        to_si(block)
        from_si(0.01, -0.2)

    network = canopen.Network()
    known = {n: network.add_node(n, str(packaged(name))) for n, name in FILES.items()}
    for number, node in known.items():
        map_pdo(node.tpdo[1], described.pdos(number)[0])
    map_pdo(known[SERVO].rpdo[1], described.pdos(SERVO)[1])
    inputs, targets = [node.tpdo[1] for node in known.values()], known[SERVO].rpdo[1]

    def peer() -> None:
        for pdo, frame in zip(inputs, frames, strict=True):
            pdo.data = bytearray(frame)
            _ = [variable.raw for variable in pdo.map]
        targets.map[0].raw, targets.map[1].raw = 10_000, -11_459

    for name, unit in (("decoded and encoded", own),
                       ("decoded to SI and encoded from it, as in the cycle", own_si)):
        yield compare(f"PDOs of a cycle: {name}, µs", partial(repeated, unit=unit, units=500),
                      "canopen `PdoVariable.raw`", partial(repeated, unit=peer, units=500), units=500, turns=30)


def exchanged(name: str, turn: Turn) -> None:
    """Run cycles of a packaged declaration on the virtual bus: wire, devices, inputs to SI, targets; no plant."""
    described = wire(Network(rate_hz=500, bench=packaged_bench(name)))
    bench = Bench([nodes.build(node, described)[0] for node in described.nodes])
    with BowdenBus(name, bench=bench) as bus:
        link = Link(bus, bus.time_ns)
        bring_up(link, described, Log(None, None, described.target_frames[0].cob_id))
        link.sync_start(described.period_ns)
        unpacks = {cob_id: plan.unpack_si for cob_id, plan in described.tpdo.items()}
        frames = [(plan, [0.0] * len(plan.keys)) for plan in described.target_frames]

        def unit() -> None:
            missing = len(unpacks)
            while missing:
                message = link.receive(bus.time_ns() + 2 * described.period_ns)
                assert message is not None
                if (unpack := unpacks.get(message.arbitration_id)) is not None:
                    unpack(bytes(message.data))
                    missing -= 1
            for plan, targets in frames:
                link.send(plan.cob_id, plan.pack_si(*targets))

        repeated(turn, unit, 200)


def by_nodes() -> Iterator[Row]:
    """The exchange of a cycle on a declared bench of four nodes, and on one of eight."""
    yield compare("exchange of a cycle, 4 nodes (wire, devices, inputs, targets; no plant), µs",
                  partial(exchanged, "bench"), "the same with 8 nodes", partial(exchanged, "bench_two_legs"),
                  units=200, turns=30)


def wire_load() -> Iterator[Row]:
    """Measure the share of the wire that a control cycle occupies, beside its bound."""
    bound = bus_load.refuse(wire(Network()))
    with tempfile.TemporaryDirectory() as folder:
        opened = simulated(5, Path(folder) / "trial.mcap")
        first, last = opened.time_ns[0], opened.time_ns[-1]
        inside = opened.frames[(opened.frames["time_ns"] > first) & (opened.frames["time_ns"] <= last)]
        bits = bits_of(inside["can_id"], inside["dlc"], inside["data"], inside["flags"] & 1, inside["flags"] & 2)
        figures = float((bits.sum() + INTERMISSION_BITS * len(bits)) * 1_000 * 100 / (last - first))
    yield ("load of the wire at 1 kHz and 1 Mbit/s, %", f"{figures:.1f}", "its bound, every frame at worst stuffing",
           f"{bound.load_percent:.1f}", f"{bound.load_percent / figures:.2f}")


def content() -> tuple[list[list[float]], list[list[bytes]]]:
    """Return rows and frames that compress as a bench's do: motions with sensor noise, statuswords, zeros."""
    random = np.random.default_rng(1)
    row = np.arange(1000)
    table = np.zeros((len(trial.SIGNALS), 1000))
    for column in range(13):
        table[column] = np.round(np.sin(row / 150 + column) * 40 + random.normal(0, 0.02, 1000), 3)
    counts = random.integers(0, 1 << 12, (1000, FRAMES))
    frames = [[struct.pack("<HIH", 0x1237, 100_000 + count, 0) for count in line] for line in counts.tolist()]
    return table.T.tolist(), frames


def recorded(recorder: Recorder) -> Step:
    """Return a function that records one control cycle as the master does."""
    def step(time_ns: int, values: list[float], frames: list[bytes]) -> None:
        for number, data in enumerate(frames):
            recorder.frame(time_ns + number * 60_000, 0x181 + number, data)
        recorder.cycle(time_ns, values)
    return step


def recorded_by_mcap(writer: Writer) -> Step:
    """Return a function that records one control cycle with mcap's own writer."""
    names = [signal.name for signal in trial.SIGNALS]
    frame_schema = writer.register_schema(cdr.FRAME_SCHEMA_NAME, "ros2msg", cdr.FRAME_SCHEMA.encode())
    cycle_schema = writer.register_schema(cdr.CYCLE_SCHEMA_NAME, "ros2msg", cdr.cycle_schema(names).encode())
    frame_channel = writer.register_channel(cdr.FRAMES, "cdr", frame_schema)
    cycle_channel = writer.register_channel(cdr.CYCLE, "cdr", cycle_schema)
    frame_struct, cycle_struct = struct.Struct("<IiII8sI3?B8s"), struct.Struct(f"<IiI{len(names)}d")

    def step(time_ns: int, values: list[float], frames: list[bytes]) -> None:
        for number, data in enumerate(frames):
            stamp = time_ns + number * 60_000
            seconds, rest = divmod(stamp, 1_000_000_000)
            writer.add_message(frame_channel, stamp, frame_struct.pack(
                cdr.LITTLE_ENDIAN, seconds, rest, 8, b"can0/rx", 0x181 + number, False, False, False, 8, data), stamp)
        seconds, rest = divmod(time_ns, 1_000_000_000)
        writer.add_message(cycle_channel, time_ns, cycle_struct.pack(cdr.LITTLE_ENDIAN, seconds, rest, *values),
                           time_ns)
    return step


def record() -> Iterator[Row]:
    """Record a cycle: eight frames and a row."""
    rows, frames = content()

    def stepped(step: Step, turn: Turn) -> None:
        number = 0

        def unit() -> None:
            nonlocal number
            step(number * 1_000_000, rows[number % 1000], frames[number % 1000])
            number += 1

        repeated(turn, unit, 500)

    def own(turn: Turn) -> None:
        with tempfile.TemporaryDirectory() as folder:
            recorder = Recorder(Path(folder) / "a.mcap", metadata={}, attachments={}, threaded=False)
            stepped(recorded(recorder), turn)

    def peer(turn: Turn) -> None:
        with tempfile.TemporaryFile() as file:
            writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
            writer.start("ros2")
            stepped(recorded_by_mcap(writer), turn)

    yield compare("a cycle recorded, compressed and written, µs", own, "mcap's own writer, the same bytes", peer,
                  units=500, turns=30)


def read() -> Iterator[Row]:
    """Read a trial of about 3 s, every message of it."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "read.mcap"
        opened = simulated(3, path)

        def own() -> None:
            again = trial.open(path)
            _ = len(again.time_ns) + len(again.frames)

        def peer() -> None:
            with path.open("rb") as file:
                for _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
                    pass

        yield compare("a message read from a trial, µs", partial(repeated, unit=own, units=1),
                      "mcap's reader with the ROS 2 decoder", partial(repeated, unit=peer, units=1),
                      units=len(opened.time_ns) + len(opened.frames), turns=7)


def size() -> Iterator[Row]:
    """Size of a trial, every frame and 45 columns, beside its frames alone in BLF."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        opened = simulated(10, folder / "trial.mcap")
        with can.BLFWriter(folder / "frames.blf") as blf:
            for frame in opened.frames:
                blf.on_message_received(can.Message(
                    timestamp=float(frame["time_ns"]) * 1e-9, arbitration_id=int(frame["can_id"]),
                    data=frame["data"][:frame["dlc"]].tobytes(), is_extended_id=False))
        own, peer = ((folder / file).stat().st_size / 1e6 for file in ("trial.mcap", "frames.blf"))
        columns, kind = _columns_mb(opened, folder / "columns.mf4")
    yield ("size of 10 s: frames and columns, MB", f"{own:.2f}", f"frames in BLF, and the columns {kind}",
           f"{peer:.2f} + {columns:.2f}", f"{(peer + columns) / own:.1f}")


def _columns_mb(opened: trial.read.Trial, path: Path) -> tuple[float, str]:
    """Size of a trial's columns, MB, in MDF 4.10 with its compression; without asammdf as bare float64."""
    try:
        asammdf = importlib.import_module("asammdf")
    except ImportError:
        return 8e-6 * sum(len(column) for column in opened.columns.values()), "as bare float64"
    seconds = (opened.time_ns - opened.time_ns[0]) * 1e-9
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(column, seconds, name=name) for name, column in opened.columns.items()])
        file.save(path, overwrite=True, compression=2)
    return path.stat().st_size / 1e6, "in MF4, compressed"


def simulated(seconds: int, path: Path) -> trial.read.Trial:
    """Run a trial about that long into a file and return it."""
    asked = bowden.Experiment(cycles=max(1, (seconds - 4) // 2), settle=0)
    return bowden.run(asked, output=path).recorded


IMPORTS = ("from bowden.bench import light_imports; light_imports.load(); "
           "import can, canopen, mcap, numba, numpy, typer; numba.njit('int64(int64)')(lambda a: a)")
"""Import of the libraries that a simulated trial needs, as it imports them, and one function compiled by numba."""


def start() -> Iterator[Row]:
    """Measure `bowden --help`, a short trial and the imports of its libraries, and the first compilation."""
    bare = "import typer; a = typer.Typer(); a.command('a')(lambda: None); a.command('b')(lambda: None); a()"
    with tempfile.TemporaryDirectory() as folder:
        short = f"trial --cycles 1 --overwrite -o {folder}/1.mcap"
        for line, digits, name, code, times in (
                ("--help", 2, "a bare Typer program of two commands", bare, 15),
                (short, 1, "import of its libraries, and one function compiled by numba", IMPORTS, 5)):
            own, peer = np.array([[used(line)[0], spent([sys.executable, "-c", code, "--help"])[0]]
                                  for _ in range(times)]).T
            yield (f"`bowden {line.partition(' --overwrite')[0]}`, s of CPU", f"{np.median(own):.{digits}f}", name,
                   f"{np.median(peer):.{digits}f}", quartiles(own, peer, 2))
        code = "from bowden.trials.session import compile_laws; compile_laws(simulated=True)"
        first, later = (spent([sys.executable, "-c", code], NUMBA_CACHE_DIR=folder)[0] for _ in range(2))
    yield ("laws compiled on a new machine, s of CPU", f"{first:.1f}", "loaded from the cache", f"{later:.1f}", "–")


MEMORY = {
    "bowden trial": "trial --period 2 --cycles {cycles} -o {at}.mcap", "bowden info": "info {at}.mcap",
    "bowden report": "report {at}.mcap -o {at}.html", "bowden export, CSV": "export {at}.mcap -o {at}.csv",
    "bowden export, Parquet": "export {at}.mcap -o {at}.parquet", "bowden export, BLF": "export {at}.mcap -o {at}.blf",
}
"""Commands whose memory does not depend on the length of a trial, in the order in which they run."""
HEALTHY = "trial --period 2 --cycles 10 --peak 45 --seed 1 -o {healthy}.mcap"
BOUNDED = {"bowden diagnose": "diagnose {at}.mcap --healthy {healthy}.mcap",
           "bowden watch": "watch {at}.mcap --healthy {healthy}.mcap"}
"""Commands that fit windows of a trial, 120 s together, and whose memory does not depend on the length of a longer one.
"""
HOUR_CYCLES = 1800
"""Gait cycles of 2 s in an hour."""


def memory() -> Iterator[Row]:
    """Measure the peak memory of commands with a trial of an hour, beside one of 240 s."""
    with tempfile.TemporaryDirectory() as folder:
        used(MEMORY["bowden trial"], at=f"{folder}/compiles", cycles=2)
        used(HEALTHY, healthy=f"{folder}/healthy")
        for name, line in {**MEMORY, **BOUNDED}.items():
            short, long = (used(line, at=f"{folder}/{cycles}", cycles=cycles, healthy=f"{folder}/healthy")[1]
                           for cycles in (120, HOUR_CYCLES))
            yield (f"peak memory of `{name}`, a trial of an hour at 1 kHz, MB", f"{long:.0f}", "one of 240 s",
                   f"{short:.0f}", f"{short / long:.2f}")


def watch() -> Iterator[Row]:
    """Measure a watch of a trial of 280 s, of which suspected cycles are diagnosed, beside one of 140 s."""
    with tempfile.TemporaryDirectory() as folder:
        used(HEALTHY, healthy=f"{folder}/healthy")
        measured = []
        for cycles in (70, 140):
            used(MEMORY["bowden trial"], at=f"{folder}/{cycles}", cycles=cycles)
            measured.append(used(BOUNDED["bowden watch"], at=f"{folder}/{cycles}", healthy=f"{folder}/healthy"))
    for what, short, long in zip(("`bowden watch`, a trial of 280 s, s of CPU",
                                  "peak memory of `bowden watch`, a trial of 280 s at 1 kHz, MB"),
                                 *measured, strict=True):
        yield what, f"{long:.0f}", "one of 140 s", f"{short:.0f}", f"{short / long:.2f}"


ROWS: dict[str, Callable[[], Iterator[Row]]] = {
    "cycle": whole_cycle, "nodes": by_nodes, "pdo": pdos, "load": wire_load, "record": record, "read": read,
    "size": size, "plant": plant, "diagnosis": diagnosis, "discovery": discovery,
    "start": start, "memory": memory, "watch": watch,
}


def spent(command: Sequence[str], **environment: str) -> tuple[float, float]:
    """Run a command; return its processor time, s, and its largest resident memory, MB."""
    code = ("import json, resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=2); "
            "print(json.dumps([*resource.getrusage(resource.RUSAGE_CHILDREN)]))")
    done = subprocess.run([sys.executable, "-c", code, *command], check=True, capture_output=True, text=True, cwd=ROOT,
                          env={**os.environ, **environment})
    user_s, system_s, peak_kb, *_ = json.loads(done.stdout)
    return user_s + system_s, peak_kb / 1024


def used(line: str, **places: object) -> tuple[float, float]:
    """Run a command line of `bowden`, its places filled in; return what `spent` returns."""
    return spent([BOWDEN, *line.format(**places).split()])


def main() -> None:
    """Print the rows; all of them go into the page too."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="*", choices=list(ROWS), default=list(ROWS))
    chosen = parser.parse_args().rows
    lines = [f"| {' | '.join(HEAD)} |", "|---|---|---|---|---|"]
    print("\n".join(lines), flush=True)
    for name in chosen:
        for row in ROWS[name]():
            lines.append(f"| {' | '.join(row)} |")
            print(lines[-1], flush=True)
    if chosen == list(ROWS):
        put(PAGE, "table", "\n".join(lines))


if __name__ == "__main__":
    main()
