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
from master import settings
from master.motion import experiment_run as trials
from master.network.link import Link
from physics.reference import paper_reference
from tests.faults import plants
from tests.faults.argument import LYING_TENSION, UnsafeAction
from trial.signals import INDEX
from virtual_bus.bench import Bench
from virtual_bus.bus import BowdenBus
from virtual_bus.kernel import TIMER
from virtual_bus.wire import outages
from virtual_bus.wire.faults import OF_A_FRAME, OF_A_NODE, OF_TIME, Fault, InjectedFaults
from virtual_bus.wire.station import Station

PEAK_N, SEED = 40.0, 3


class Walk(NamedTuple):
    """The gait that a row breaks: its period, s, controller and number of gait cycles.

    `moments`, where there are any: rows begin in this gait at those of their moments alone.
    """

    period_s: float = 1.1
    controller: str = "paper"
    cycles: int = 2
    moments: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.controller}, {self.period_s:g} s"


WALK = Walk()
MOMENTS = {"start": -1.0, "ramp": 14.5, "peak": 20.0, "release": 26.0, "idle": 60.0}
"""Per cent of the first gait cycle at which a row's fault begins; "start": before the trial."""
CYCLE, PERCENT = INDEX["cycle"], INDEX["gait_percent"]
COMMAND_NS = 600_000
"""The master's turnaround, the controlword's frame and a drive's tick: no command acts sooner."""
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
            bench.wire._judge = InjectedFaults([fault], SEED)  # the trial began with faults that let everything pass
        elif kind in OF_A_NODE | {"babble"}:
            outages.arrange(bench.kernel, lambda: bench.medium, (bench.host, *bench.nodes.values()), [fault],
                            bench.wire.bit_ns)
            outages.wired(bench.kernel, [fault], bench.machine.trouble)  # type: ignore[attr-defined, union-attr]


@dataclass
class Row:
    """One fault of the matrix.

    `named`: the names (`names.name_of`) that are right in the stop's reason or, with `event`, in an event.
    `silent`: why no signal could show it, where it is allowed to go unsaid.  `needs_sto`: the servo's stage conducts by
    itself, and only the emergency stop ends that.  `gradual`: it may go unsaid as long as END and the leg keep their
    bounds; `beyond`: why they cannot keep them.  `action`: what the fault makes unsafe.  `experiment` alters what is
    run, for rows that begin at the start.
    """

    name: str
    act: Callable[[Scene], None]
    named: tuple[str, ...]
    moments: tuple[str, ...] = ("ramp", "peak", "idle")
    event: bool = False
    silent: str = ""
    needs_sto: bool = False
    slow: bool = False
    experiment: Callable[[trials.ExperimentSetup], trials.ExperimentSetup] = field(default=lambda given: given)
    run: dict[str, Any] = field(default_factory=dict)
    walks: tuple[Walk, ...] = (WALK,)
    gradual: bool = False
    beyond: str = ""
    action: UnsafeAction = LYING_TENSION


class Sink:
    """A recorder in memory that also says when a moment has come."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, tuple[float, ...]]] = []
        self.events: list[tuple[int, str, str, str]] = []
        self.frames = 0
        self.moment: Callable[[str], None] = lambda moment: None
        self.stopping: Callable[[], None] = lambda: None
        self.raising: Exception | None = None
        self._due = [name for name in MOMENTS if name != "start"]

    def frame(self, time_ns: int, can_id: int, data: bytes, flags: int = 0, channel: int = 0, sent: bool = False
              ) -> None:
        self.frames += 1

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        self.rows.append((time_ns, tuple(values)))
        while self._due and values[CYCLE] == 0.0 and values[PERCENT] >= MOMENTS[self._due[0]]:
            self.moment(self._due.pop(0))
        if self.raising is not None:
            error, self.raising = self.raising, None
            raise error

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        first = kind == "safety" and all(known[1] != "safety" for known in self.events)
        self.events.append((time_ns, kind, source, text))
        if first:
            self.stopping()


@dataclass
class Told:
    """What a row's process found: times in ns on the bus's clock."""

    name: str
    moment: str
    fault_ns: int
    reason: str | None
    events: list[tuple[int, str, str, str]]
    true: Any
    leg: Any
    rows: int
    whole: bool
    last_ns: int
    off_ns: int
    crashed: str = ""
    floor_n: float = 0.0
    """Greatest true tension from the stop's decision on with a servo that gives no torque from `COMMAND_NS` after
    it on: what momentum and the knee bring, whatever a stop does."""


def trial(rows: Sequence[Row], jobs: int = 2, walk: Walk = WALK, **bench: Any) -> tuple[list[Told], Told]:
    """Run the trial and every row of it; returns the rows' findings and the twin."""
    with tempfile.TemporaryDirectory() as folder:
        stage = _Stage(Path(folder), [row for row in rows if walk in row.walks], jobs, bench, walk)
        twin = stage.run()
        return stage.collected(), twin


def _without_servo(stage: plants.Stage | None) -> plants.Stage:
    """The same stages, the servo's giving nothing."""
    return lambda now_ns, servo, knee: (0.0, knee if stage is None else stage(now_ns, servo, knee)[1])


class _Stage:
    def __init__(self, folder: Path, rows: Sequence[Row], jobs: int, options: dict[str, Any], walk: Walk) -> None:
        self.folder, self.rows, self.jobs, self.options, self.walk = folder, rows, jobs, options, walk
        self.children: list[int] = []
        self.numbers = itertools.count()
        self.me: tuple[Row, str, int, Path] | None = None
        self.scene: Scene | None = None
        self.floor: Callable[[], None] | None = None

    def run(self) -> Told:
        """The unharmed trial, from bring-up to its end; in a child: that row's."""
        run = trials.ExperimentSetup(
            paper_reference(PEAK_N, self.walk.period_s),
            gait=settings.Gait(peak_n=PEAK_N, period_s=self.walk.period_s, cycles=self.walk.cycles, settle=0,
                               controller=self.walk.controller))
        for row in self.rows:
            if "start" in row.moments and self._fork(row, "start", 0):
                run = row.experiment(run)
                break
        self._wait(0)
        return self._one(run)

    def _one(self, run: trials.ExperimentSetup) -> Told:
        channel = f"faults-{os.getpid()}-{next(_CHANNELS)}"
        given: dict[str, Any] = {
            "plant": "tests.faults.plants:breakable", "seed": SEED, "serial": 1,
            "faults": [{"kind": "drop", "cob_id": 0x7FF, "start_s": 1e8}], **self.options}
        if self.me is not None:
            given.update(self.me[0].run)
        bus = BowdenBus(channel, **given)
        tap = BowdenBus(channel)
        sink = Sink()
        self.scene = Scene(bus.bench, plants.made[-1], bus, tap, sink)
        sink.moment = self._moment
        sink.stopping = self._floor
        if self.me is not None:
            self.me[0].act(self.scene)
        try:
            result = trials.run(Link(bus, bus.time_ns), tap, sink, run)
            told = self._told(sink, result.stop_reason, "")
        except BaseException as error:
            told = self._told(sink, None, f"{type(error).__name__}: {error}")
            if self.me is None:
                raise
        if self.floor is not None:
            self.floor()
        if self.me is not None:
            self._wait(0)
            floor = self.me[3].with_suffix(".floor")
            if floor.exists():
                told.floor_n = float(floor.read_text())
            with self.me[3].open("wb") as file:
                pickle.dump(told, file)
            sys.stdout.flush()
            os._exit(0)
        tap.shutdown()
        bus.shutdown()
        return told

    def _floor(self) -> None:
        """Go on in one more process with a servo stage that is dead from now on."""
        if self.me is None or self.scene is None:
            return
        sys.stdout.flush()
        child = os.fork()
        if child:
            self.children.append(child)
            return
        scene, path = self.scene, self.me[3].with_suffix(".floor")
        since = len(scene.plant.true)
        kernel, stage = scene.bench.kernel, scene.plant.stage

        def die() -> None:
            scene.plant.stage = _without_servo(stage)

        def end() -> None:
            path.write_text(str(max((max(row[1:]) for row in scene.plant.true[since:]), default=0.0)))
            os._exit(0)

        self.floor = end
        kernel.at(kernel.now_ns + COMMAND_NS, TIMER, die)

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

    def _told(self, sink: Sink, reason: str | None, crashed: str) -> Told:
        scene = self.scene
        assert scene is not None
        row, moment, fault_ns = (self.me[0].name, self.me[1], self.me[2]) if self.me else ("twin", "", 0)
        times = [time_ns for time_ns, _values in sink.rows]
        gaps = np.diff(times) if len(times) > 1 else np.ones(1)
        whole = not crashed and bool(np.all(gaps > 0)) and (reason is None or any(
            kind == "safety" for _t, kind, _s, _x in sink.events) or not times)
        servo = [values[INDEX["servo_statusword"]] for _t, values in sink.rows]
        off = next((times[i] for i in range(len(times) - 1, -1, -1) if int(servo[i]) & 0x6F == 0x27), 0)
        return Told(row, moment, fault_ns, reason, sink.events, np.array(scene.plant.true), np.array(scene.plant.leg),
                    len(times), whole, scene.now_ns, off, crashed)

    def collected(self) -> list[Told]:
        """Every row's findings, after all have ended."""
        self._wait(0)
        found = []
        for path in sorted(self.folder.glob("*.pickle"), key=lambda path: int(path.stem)):
            with path.open("rb") as file:
                found.append(pickle.load(file))
        return found


__all__ = ["MASTER", "MOMENTS", "Intruder", "Row", "Scene", "Told", "can", "re", "replace", "trial"]
