"""One trial that is broken in many ways: at each moment a child of this process goes on with one row's fault in it.

The rule of this file: the trial itself goes on unharmed and is the twin that every row is compared with, from the same
seed and the same bits up to the fault; a row's process ends with its numbers in a file.  It is one thread, so that
forking it is safe.
"""

from __future__ import annotations

import itertools
import os
import pickle
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np

from eds.bench.bench_network import MASTER
from eds.cia301 import Frame
from master.motion import experiment_run as trials
from master.network.link import Link
from tests.faults import motions, plants
from tests.faults.argument import LYING_TENSION, UnsafeAction
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.kernel import TIMER
from virtual_bus.wire import faults as wire_faults
from virtual_bus.wire.faults import OF_A_FRAME, OF_A_NODE, OF_TIME, Fault, InjectedFaults
from virtual_bus.wire.station import Station

PEAK_N, SEED = 40.0, 3


class Walk(NamedTuple):
    """The motion that a row breaks: gait period, s, controller and number of gait cycles.

    `moments`, where there are any: rows begin in this gait at those of their moments alone.  `shape`: the packaged
    declaration of the bench.  `motion`: the gait, or what a person runs before it.
    """

    period_s: float = 1.1
    controller: str = "paper"
    cycles: int = 2
    moments: tuple[str, ...] = ()
    shape: str = "bench"
    motion: str = "gait"

    def __str__(self) -> str:
        motion = f"{self.controller}, {self.period_s:g} s" if self.motion == "gait" else self.motion
        return motion if self.shape == "bench" else f"{motion}, {self.shape}"


WALK = Walk()
OF_GAIT = tuple(f"{percent} %" for percent in range(0, 100, 5))
OF_MOTION = tuple(f"{tenths / 10:g} s" for tenths in range(2, 60, 6))
MOMENTS = {"start": -1.0, "ramp": 14.5, "peak": 20.0, "release": 26.0, "idle": 60.0,
           **{moment: float(moment[:-2]) for moment in OF_GAIT}}
"""Per cent of the first gait cycle at which a row's fault begins; "start": before the trial."""
TIMES = {moment: float(moment[:-2]) for moment in OF_MOTION}
"""Time from the first row of another motion at which a row's fault begins, s."""
STAND_S = 1.0
"""Time for which the bench is watched after the program's end, s: a leg without torque has come to rest."""
_CHANNELS = itertools.count()


class Intruder(Station):
    """Somebody else on the wire: says what it is told, when it is told."""

    def __init__(self, bench: Bench) -> None:
        super().__init__("intruder", lambda frame, now_ns: None, filters=frozenset(), limit=8)
        self._kernel = bench.kernel
        bench.wire.attach(self)

    def say(self, can_id: int, data: bytes = b"", *, extended: bool = False, remote: bool = False) -> None:
        """Send one frame now."""
        self.submit(Frame(can_id, data, remote=remote, extended=extended), self._kernel.now_ns)

    def repeat(self, period_ns: int, frame: Callable[[], tuple[int, bytes]], times: int = 100_000) -> None:
        """Send a frame every so often."""
        if times and self.wire is not None:
            self.say(*frame())
            self._kernel.at(self._kernel.now_ns + period_ns, TIMER, lambda: self.repeat(period_ns, frame, times - 1))


class Scene(NamedTuple):
    """What a row may lay hands on."""

    bench: Bench
    plant: plants.Breakable
    bus: Any
    tap: Any
    sink: Sink

    @property
    def now_ns(self) -> int:
        return self.bench.kernel.now_ns

    def intruder(self) -> Intruder:
        """Somebody else on the wire, from now on."""
        return Intruder(self.bench)

    def fault(self, kind: str, for_s: float = 1e6, **fields: Any) -> None:
        """A fault of the virtual bus, from now on."""
        now_s = self.now_ns * 1e-9
        fault = Fault(kind, start_s=now_s, stop_s=now_s + for_s, **fields)
        bench = self.bench
        if kind in OF_A_FRAME | OF_TIME:
            bench.wire._judge = InjectedFaults([fault], SEED)
        elif kind in OF_A_NODE | {"babble"}:
            wire_faults.arrange(bench.kernel, lambda: bench.medium, (bench.host, *bench.nodes.values()), [fault],
                                bench.wire.bit_ns)
            for machine in getattr(bench.machine, "machines", (bench.machine,)):
                if fault.node in machine.felt:
                    wire_faults.wired(bench.kernel, [fault], machine.trouble)


@dataclass
class Row:
    """One fault of the matrix.

    `named`: the names (`names.name_of`) that are right in the stop's reason or, with `event`, in an event.
    `silent`: why no signal could show it, where it is allowed to go unsaid.  `unstoppable`: the physical reason why no
    stop of the master keeps the bounds, or those of the measures `excused` alone.  `quiet`: it may go unsaid where it
    does no harm.  `gradual`: it may go unsaid as long as END and the leg keep their
    bounds; `beyond`: why they cannot keep them.  `action`: what the fault makes unsafe.  `experiment` alters what is
    run, for rows that begin at the start.
    """

    name: str
    act: Callable[[Scene], None]
    named: tuple[str, ...]
    moments: tuple[str, ...] = ("ramp", "peak", "idle")
    event: bool = False
    silent: str = ""
    unstoppable: str = ""
    excused: tuple[str, ...] = ()
    quiet: bool = False
    experiment: Callable[[trials.ExperimentSetup], trials.ExperimentSetup] = field(default=lambda given: given)
    run: dict[str, Any] = field(default_factory=dict)
    walks: tuple[Walk, ...] = (WALK,)
    gradual: bool = False
    beyond: str = ""
    action: UnsafeAction = LYING_TENSION


class Sink:
    """A recorder in memory that also says when a moment has come; `at`: the column of a signal of the first path."""

    def __init__(self, walk: Walk, at: dict[str, int]) -> None:
        self.rows: list[tuple[int, tuple[float, ...]]] = []
        self.events: list[tuple[int, str, str, str]] = []
        self.frames = 0
        self.moment: Callable[[str], None] = lambda moment: None
        self.raising: Exception | None = None
        self._gait, self._cycle, self._percent = walk.motion == "gait", at["cycle"], at["gait_percent"]
        moments = MOMENTS if self._gait else TIMES
        self._due = sorted((name for name in moments if name != "start"), key=moments.__getitem__)

    def frame(self, time_ns: int, can_id: int, data: bytes, flags: int = 0, channel: int = 0, sent: bool = False
              ) -> None:
        self.frames += 1

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        self.rows.append((time_ns, tuple(values)))
        while self._due and self._come(time_ns, values):
            self.moment(self._due.pop(0))
        if self.raising is not None:
            error, self.raising = self.raising, None
            raise error

    def _come(self, time_ns: int, values: Sequence[float]) -> bool:
        if self._gait:
            return values[self._cycle] == 0.0 and values[self._percent] >= MOMENTS[self._due[0]]
        return (time_ns - self.rows[0][0]) * 1e-9 >= TIMES[self._due[0]]

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        self.events.append((time_ns, kind, source, text))


@dataclass
class Told:
    """What a row's process found: times in ns on the bus's clock; `paths` has the truth of each force path."""

    name: str
    moment: str
    fault_ns: int
    reason: str | None
    events: list[tuple[int, str, str, str]]
    paths: list[Any]
    rows: int
    whole: bool
    last_ns: int
    crashed: str = ""

    @property
    def true(self) -> Any:
        """Truth of the path that is broken."""
        return self.paths[0]


def trial(rows: Sequence[Row], jobs: int = 2, walk: Walk = WALK, **bench: Any) -> tuple[list[Told], Told]:
    """Run the trial and every row of it; returns the rows' findings and the twin."""
    with tempfile.TemporaryDirectory() as folder:
        stage = _Stage(Path(folder), [row for row in rows if walk in row.walks], jobs, bench, walk)
        twin = stage.run()
        return stage.collected(), twin


class _Stage:
    def __init__(self, folder: Path, rows: Sequence[Row], jobs: int, options: dict[str, Any], walk: Walk) -> None:
        self.folder, self.rows, self.jobs, self.options, self.walk = folder, rows, jobs, options, walk
        self.children: list[int] = []
        self.numbers = itertools.count()
        self.me: tuple[Row, str, int, Path] | None = None
        self.scene: Scene | None = None
        self.by_hand = False

    def run(self) -> Told:
        """The unharmed trial, from bring-up to its end; in a child: that row's."""
        alter: Callable[[trials.ExperimentSetup], trials.ExperimentSetup] = lambda given: given  # noqa: E731
        for row in self.rows:
            if "start" in row.moments and self._fork(row, "start", 0):
                alter = row.experiment
                break
        self._wait(0)
        return self._one(motions.planned(self.walk, PEAK_N, alter))

    def _one(self, motion: motions.Motion) -> Told:
        channel = f"faults-{os.getpid()}-{next(_CHANNELS)}"
        options: dict[str, Any] = {
            "seed": SEED, "serial": 1, "rate_hz": motion.network.rate_hz,
            "faults": [{"kind": "drop", "cob_id": 0x7FF, "start_s": 1e8}], **motion.options, **self.options}
        if self.me is not None:
            options.update(self.me[0].run)
        before = len(plants.made)
        with plants.in_place():
            bus = BowdenBus(channel, **options)
        bus.bench.wire._judge = None  # declared faults make a bench run event by event; none of them is judged
        tap = BowdenBus(channel)
        self.by_hand = not motion.network.bench.joints[0].driven_by
        sink = Sink(self.walk, motion.at)
        self.scene = Scene(bus.bench, plants.made[before], bus, tap, sink)
        sink.moment = self._moment
        if self.me is not None:
            self.me[0].act(self.scene)
        reason, crashed = None, ""
        try:
            reason = motion.run(Link(bus, bus.time_ns), tap, sink)
        except BaseException as error:
            crashed = f"{type(error).__name__}: {error}"
            if self.me is None:
                raise
        ended_ns = self.scene.now_ns
        while self.me is not None and self.scene.now_ns < ended_ns + round(STAND_S * 1e9):
            bus.recv(STAND_S)
        told = self._told(sink, reason, crashed, ended_ns, plants.made[before:])
        if self.me is not None:
            self._wait(0)
            with self.me[3].open("wb") as file:
                pickle.dump(told, file)
            sys.stdout.flush()
            os._exit(0)
        tap.shutdown()
        bus.shutdown()
        return told

    def _moment(self, moment: str) -> None:
        if self.me is not None:
            return
        for row in self.rows:
            due = moment in row.moments and moment in (self.walk.moments or row.moments)
            if due and self._fork(row, moment, self._now_ns()):
                assert self.scene is not None
                row.act(self.scene)
                return

    def _now_ns(self) -> int:
        assert self.scene is not None
        return self.scene.now_ns

    def _fork(self, row: Row, moment: str, now_ns: int) -> bool:
        self._wait(self.jobs - 1)
        path = self.folder / f"{next(self.numbers)}.pickle"
        sys.stdout.flush()
        child = os.fork()
        if child:
            self.children.append(child)
            return False
        self.me, self.children = (row, moment, now_ns, path), []
        return True

    def _wait(self, left: int) -> None:
        while len(self.children) > left:
            child, _status = os.wait()
            self.children.remove(child)

    def _told(self, sink: Sink, reason: str | None, crashed: str, ended_ns: int,
              made: Sequence[plants.Breakable]) -> Told:
        row, moment, fault_ns = (self.me[0].name, self.me[1], self.me[2]) if self.me else ("twin", "", 0)
        times = [time_ns for time_ns, _values in sink.rows]
        gaps = np.diff(times) if len(times) > 1 else np.ones(1)
        whole = not crashed and bool(np.all(gaps > 0)) and (reason is None or any(
            kind == "safety" for _t, kind, _s, _x in sink.events) or not times)
        paths = [np.array(plant.true) for plant in made]
        for plant, path in zip(made, paths, strict=True):
            if plant.led:  # an antagonist's joint is that of the path before it
                path[:, 3] = np.interp(path[:, 0], paths[0][:, 0], paths[0][:, 3])
            if self.by_hand:
                path[:, 5] = 0.0
        return Told(row, moment, fault_ns, reason, sink.events, paths, len(times), whole, ended_ns, crashed)

    def collected(self) -> list[Told]:
        """Every row's findings, after all have ended."""
        self._wait(0)
        found = []
        for path in sorted(self.folder.glob("*.pickle"), key=lambda path: int(path.stem)):
            with path.open("rb") as file:
                found.append(pickle.load(file))
        return found


__all__ = ["MASTER", "MOMENTS", "Intruder", "Row", "Scene", "Told", "can", "re", "replace", "trial"]
