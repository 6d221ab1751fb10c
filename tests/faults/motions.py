"""Motions of the matrix: the gait, and what a person runs before it, on every packaged shape of a bench."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import eds
from bowden.bench import buses, configuration
from bowden.trials import session
from eds.bench.bench_network import Network
from eds.declaration import as_tables
from master.control import controller
from master.cycle.run_safely import run_safely
from master.identification import identify
from master.motion import commission
from master.motion import experiment_run as trials
from master.network.link import Link
from physics.calibration import nominal
from physics.reference import paper_reference
from trial.signals import of_bench

JOG_RAD, JOG_RAD_S = 0.5, 0.25
Alter = Callable[[trials.ExperimentSetup], trials.ExperimentSetup]


class Motion(NamedTuple):
    """A motion that can be run: its network, the bus's options, the columns of the first path, and the run itself."""

    network: Network
    options: dict[str, Any]
    at: dict[str, int]
    run: Callable[[Link, Any, Any], str | None]


def planned(walk: Any, peak_n: float, alter: Alter) -> Motion:
    """Plan the motion of a walk; `alter` changes the experiment of a gait on a bench of one path."""
    sections = configuration.read(Path(eds.__file__).parent / f"{walk.shape}.toml")
    network = sections["network"]
    options = {} if walk.shape == "bench" else {"declaration": as_tables(network.bench)}
    kind = controller.find(walk.controller, where="gait")
    columns: dict[str, int] = {}
    for place, signal in enumerate(of_bench(network.bench, controller.signals(kind))):
        columns.setdefault(signal.name.rpartition(".")[2], place)
    run = _gait(walk, sections, peak_n, alter) if walk.motion == "gait" else _other(walk, sections)
    return Motion(network, options, columns, run)


def _gait(walk: Any, sections: dict[str, Any], peak_n: float, alter: Alter) -> Callable[[Link, Any, Any], str | None]:
    gait = dataclasses.replace(sections["gait"], peak_n=peak_n, period_s=walk.period_s, cycles=walk.cycles, settle=0,
                               controller=walk.controller)
    prepared = session.prepare(sections | {"gait": gait}, paper_reference(peak_n, walk.period_s), None,
                               buses.simulated(), dry_run=False)
    prepared = dataclasses.replace(prepared, experiment=alter(prepared.experiment))
    return lambda link, tap, sink: prepared.planned().run(link, tap, sink).stop_reason


def _other(walk: Any, sections: dict[str, Any]) -> Callable[[Link, Any, Any], str | None]:
    network, limits, homing = sections["network"], sections["limits"], sections["homing"]
    if walk.motion == "identify":
        asked = identify.Identification("stiffness", network=network, limits=limits, homing=homing)
        return lambda link, tap, sink: identify.run(link, tap, sink, asked)[0].reason
    procedure: Callable[[Any], Any] = {
        "home": commission.home(nominal(), homing, sections["gait"].idle_slack_m),
        "jog": commission.jog("knee", -JOG_RAD, JOG_RAD_S, limits)}[walk.motion]

    def perform(exchange: Any) -> None:
        procedure(exchange)

    return lambda link, tap, sink: run_safely(link, tap, sink, network, limits, perform).reason
