"""Rows of `benchmarks.performance`: an operation of this package, and the same operation by another library.

Both work on the same data; the row's text states any difference.  The gain of several processes is time on the wall,
measured in turns with one process; a machine that is busy has no second processor to give.
"""

from __future__ import annotations

import importlib
import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

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
from benchmarks import cycle
from benchmarks.frame import Row, Turn, compare, quartiles, repeated
from bowden.sweep import row_trial, rows
from bowden.sweep import run as sweep_run
from diagnosis.finder import Finder
from eds.bench import bus_load
from eds.bench.bench_network import FILES, SERVO, Network, wire
from eds.declaration import packaged as packaged_bench
from eds.dictionary import packaged
from eds.pdo_plan import JoinedUnpacker
from estimation.data import table
from master.cycle.log import Log
from master.network.bringup import bring_up
from master.network.link import Link
from physics.plant.bench_plant import create
from physics.plant.components import KNEE_AT_FIT
from tests.hidden import cases
from tests.physics.test_physics_plant_accuracy import KNEE_NM, SECONDS, SERVO_NM, Equations
from trial.mcap_file import cdr
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.compiled.compiled_cycles import SWITCH
from virtual_bus.wire.bit_counts import bits_of
from virtual_bus.wire.bits import INTERMISSION_BITS

SEED = 60_000
"""Seed of the diagnosed trials in `tests.hidden`."""
SWEPT, DIAGNOSED, TURNS = 8, 6, 3
"""Trials of a sweep, of a diagnosis of many, and how often each is timed."""
Crew = Callable[[int], AbstractContextManager[sweep_run.Workers]]


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


def processes() -> Iterator[Row]:
    """A sweep and a diagnosis of many trials on two processes, and on two Dask workers."""
    with tempfile.TemporaryDirectory() as name:
        planned = rows.rows({}, {"files.calibration": rows.NOMINAL}, [("bench.serial", list(range(1, SWEPT + 1)))])
        kept = [row_trial.perform(row, "", "", name)["trial"] for row in planned[:2]]
        trials = [Path(kept[i % 2]) for i in range(DIAGNOSED)]
        given = sweep_run.DiagnosisSettings(None, (), (), None)

        def sweep(crew: sweep_run.Workers) -> None:
            for each in [crew.executor.submit(row_trial.perform, row, "", "", None) for row in planned]:
                each.result()

        def diagnose(crew: sweep_run.Workers) -> None:
            for each in [crew.executor.submit(sweep_run.diagnose, trial, given) for trial in trials]:
                each.result()

        for work, what, count in ((sweep, "sweep", SWEPT), (diagnose, "diagnosis", DIAGNOSED)):
            for crew, who in ((sweep_run.local, "processes"), (_cluster, "Dask workers")):
                yield _in_parallel(crew, work, f"{what} of {count} trials on two {who}, s on the wall")


@contextmanager
def _cluster(count: int) -> Iterator[sweep_run.Workers]:
    from distributed import LocalCluster

    with (LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=":0") as made,
          sweep_run.cluster(made.scheduler_address) as workers):
        yield workers


def _in_parallel(crew: Crew, work: Callable[[sweep_run.Workers], None], name: str) -> Row:
    spent: list[list[float]] = [[], []]
    with crew(1) as one, crew(2) as two:
        for workers in (one, two, two):  # both of two have imported and compiled before it counts
            work(workers)
        for _ in range(TURNS):
            for place, workers in enumerate((two, one)):
                began = time.perf_counter()
                work(workers)
                spent[place].append(time.perf_counter() - began)
    own, peer = spent
    return name, f"{np.median(own):.1f}", "on one", f"{np.median(peer):.1f}", quartiles(own, peer, 2)


FRAMES = 8
Step = Callable[[int, list[float], list[bytes]], None]


def whole_cycle() -> Iterator[Row]:
    """The whole simulated cycle beside stock canopen, and beside canopen without its threads."""
    for name, peer in (("stock canopen, µs", cycle.stock), ("canopen pumped by hand, µs", cycle.pumped)):
        yield compare("one simulated control cycle, µs", cycle.ours, name, peer, units=cycle.UNITS, turns=60)


def event_by_event() -> Iterator[Row]:
    """The cycle where something else may happen in it."""
    def slowly(turn: Turn) -> None:
        os.environ[SWITCH] = "0"
        cycle.ours(turn)

    yield compare("one simulated control cycle, µs", cycle.ours,
                  "the same event by event, as with faults and plug-in plants", slowly, units=cycle.UNITS, turns=30)


def pdos() -> Iterator[Row]:
    """Decode four TPDOs, encode the targets."""
    described = wire(Network())
    plans = [plan for _, plan in sorted(described.tpdo.items())]
    frames = [plan.pack(*range(1, 1 + len(plan.keys))) for plan in plans]
    together, block = JoinedUnpacker(plans), b"".join(struct.pack("<q8s", 0, frame) for frame in frames)
    unpack, pack = together.unpack, described.targets.pack
    unpacks = [plan.unpack for plan in plans]
    to_si, from_si = together.unpack_si, described.targets.pack_si

    def own() -> None:
        unpack(block)
        pack(10_000, -11_459)

    def own_singly() -> None:
        for each, frame in zip(unpacks, frames, strict=True):
            each(frame)
        pack(10_000, -11_459)

    def own_si() -> None:
        to_si(block)
        from_si(0.01, -0.2)

    network = canopen.Network()
    known = {n: network.add_node(n, str(packaged(name))) for n, name in FILES.items()}
    for number, node in known.items():
        cycle.map_pdo(node.tpdo[1], described.pdos(number)[0])
    cycle.map_pdo(known[SERVO].rpdo[1], described.pdos(SERVO)[1])
    inputs, targets = [node.tpdo[1] for node in known.values()], known[SERVO].rpdo[1]

    def peer() -> None:
        for pdo, frame in zip(inputs, frames, strict=True):
            pdo.data = bytearray(frame)
            _ = [variable.raw for variable in pdo.map]
        targets.map[0].raw, targets.map[1].raw = 10_000, -11_459

    for name, unit in (("decoded and encoded", own), ("the same frame by frame", own_singly),
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


def recorded(recorder: trial.Recorder) -> Step:
    """Return a function that records one control cycle as the master does."""
    def step(time_ns: int, values: list[float], frames: list[bytes]) -> None:
        for number, data in enumerate(frames):
            recorder.frame(time_ns + number * 60_000, 0x181 + number, data)
        recorder.cycle(time_ns, values)
    return step


def recorded_by_mcap(writer: Writer) -> Step:
    """Return the same with mcap's own writer."""
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


def written(path: Path, cycles: int) -> Path:
    """Write a trial of `cycles` cycles."""
    rows, frames = content()
    recorder = trial.Recorder(path, metadata={}, attachments={}, threaded=False)
    for at in range(cycles):
        recorded(recorder)(at * 1_000_000, rows[at % 1000], frames[at % 1000])
    recorder.close({})
    return path


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
            recorder = trial.Recorder(Path(folder) / "a.mcap", metadata={}, attachments={}, threaded=False)
            stepped(recorded(recorder), turn)

    def peer(turn: Turn) -> None:
        with tempfile.TemporaryFile() as file:
            writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
            writer.start("ros2")
            stepped(recorded_by_mcap(writer), turn)

    yield compare("a cycle recorded, compressed and written, µs", own, "mcap's own writer, the same bytes", peer,
                  units=500, turns=30)


def read() -> Iterator[Row]:
    """Read a trial of 2000 cycles."""
    with tempfile.TemporaryDirectory() as name:
        path = written(Path(name) / "read.mcap", 2000)

        def own() -> None:
            opened = trial.open(path)
            _ = len(opened.time_ns) + len(opened.frames)

        def peer() -> None:
            with path.open("rb") as file:
                for _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
                    pass

        yield compare("a message read from a trial, µs", partial(repeated, unit=own, units=1),
                      "mcap's reader with the ROS 2 decoder", partial(repeated, unit=peer, units=1), units=18_000,
                      turns=7)


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
