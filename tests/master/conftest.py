"""A composed bench for the master's tests: virtual bus, tap, recorder and link, as the command line joins them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from master import settings
from master.cycle.log import CycleSink
from master.motion.experiment_run import ExperimentSetup, Result, run
from master.network.link import Link
from physics.reference import paper_reference
from trial import read
from trial.metrics import figures
from trial.record import Recorder
from virtual_bus.bus import BowdenBus

CHANNELS = itertools.count()
Wrap = Callable[[Recorder], CycleSink]


@dataclass(frozen=True)
class Ran:
    """A finished run: its result, its trial, and the truth beside it."""

    result: Result
    trial: read.Trial
    truth: read.Trial

    def figures(self, peak_n: float, cycles: int, settle: int = 1, rate_hz: float = 1000) -> dict[str, float | None]:
        true_end = np.interp(self.trial.time_ns, self.truth.time_ns, self.truth.columns["true_end_n"])
        return figures(self.trial.columns, peak_n=peak_n, rate_hz=rate_hz, cycles=cycles, settle=settle,
                       true_end_n=true_end)

    def sent(self, can_id: int) -> np.ndarray[Any, Any]:
        """Payloads of the frames with `can_id`, in order."""
        frames = self.trial.frames
        return np.asarray(frames["data"][frames["can_id"] == can_id])

    def said(self, kind: str) -> list[str]:
        """Texts of the events of one kind."""
        return [event.text for event in self.trial.events if event.kind == kind]


class Composer:
    """Opens benches, runs experiments on them, and closes what is left open."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.open: list[can.BusABC] = []

    def link(self, **options: Any) -> tuple[Link, BowdenBus]:
        """A link on a fresh bench, and the recorder's tap."""
        channel = f"master-test-{next(CHANNELS)}"
        bus = BowdenBus(channel, **options)
        tap = BowdenBus(channel)
        self.open += [tap, bus]
        return Link(bus, bus.time_ns), tap

    def run(
        self, peak_n: float = 40.0, period_s: float = 1.1, cycles: int = 2, wrap: Wrap = lambda recorder: recorder,
        limits: settings.Limits | None = None, experiment: dict[str, Any] | None = None, controller: str = "paper",
        soft_start: int = 0, **options: Any,
    ) -> Ran:
        """Run one short experiment; `options` are the simulated bench's."""
        number = next(CHANNELS)
        path, truth = self.folder / f"{number}.mcap", self.folder / f"{number}.truth.mcap"
        link, tap = self.link(truth=str(truth), **options)
        recorder = Recorder(path, metadata={}, attachments={}, threaded=False)
        chosen = ExperimentSetup(
            paper_reference(peak_n, period_s),
            gait=settings.Gait(
                peak_n=peak_n, period_s=period_s, cycles=cycles, controller=controller, soft_start=soft_start),
            limits=limits or settings.Limits(),
            **(experiment or {}),
        )
        result = run(link, tap, wrap(recorder), chosen)
        recorder.close({})
        self.close()
        return Ran(result, read.open(path), read.open_table(truth, "/truth"))

    def close(self) -> None:
        while self.open:
            self.open.pop().shutdown()


@pytest.fixture
def composer(tmp_path: Path) -> Iterator[Composer]:
    made = Composer(tmp_path)
    yield made
    made.close()


@pytest.fixture(scope="module")
def module_composer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Composer]:
    made = Composer(tmp_path_factory.mktemp("module"))
    yield made
    made.close()
