"""Replay of recorded commands on a simulated bench: its responses, and the residuals of the recording."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bowden import output_files
from bowden.bench.buses import BusSettings, opened_one, simulating
from bowden.progress import SILENT, Progress
from bowden.replay.player import Outlet, Player, Rows, Selection, plan, play_out, wait_until
from bowden.trials import provenance, session
from bowden.trials.recorded import sections
from eds.bench.bench_network import MASTER, WireLayout, wire
from eds.cia301 import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID
from parameters import InputError
from trial import decode
from trial.convert.frames import FrameRows
from trial.mcap_file import cdr
from trial.read import Trial
from trial.record import TrialContent, write
from trial.signals import SIGNALS, Signal, of_bench

Floats = NDArray[np.float64]

SECOND_NS = 1_000_000_000
BOOT_NS = 50_000_000
"""Time, ns, between the power-on of a bench and the first command."""
PREFIX = "residual_"
_KEPT = ("time_s", "gait_percent", "cycle", "desired_force_n")
"""Signals of the trial that a file of residuals keeps, as far as they exist."""
_NOT_COMPARED = ("time_s",)


@dataclass(frozen=True)
class SignalResidual:
    """Recorded − simulated of one signal: over all rows and over the gait, where it is largest (s), and in how many
    rows it is not zero; `one_sided` rows have a value on one side only."""

    unit: str
    rows: int
    differing: int
    one_sided: int
    rms: float
    gait_rms: float
    mean: float
    largest: float
    largest_at_s: float


@dataclass(frozen=True)
class Residuals:
    """By signal: figures, and the columns they come from, at the recorded times of SYNC, ns.

    `columns` are `recorded` − `simulated`; float64, one value a control cycle, NaN where a side has none.
    """

    time_ns: NDArray[np.int64]
    recorded: Mapping[str, Floats]
    simulated: Mapping[str, Floats]
    columns: Mapping[str, Floats]
    figures: Mapping[str, SignalResidual]

    @property
    def same(self) -> bool:
        """True if every signal equals the recorded one in every row, bit for bit."""
        return not any(figure.differing or figure.one_sided for figure in self.figures.values())

    def as_json(self) -> dict[str, Any]:
        """Return the figures as values that JSON can hold; an undefined one is NaN."""
        return {"same": self.same, "rows": len(self.time_ns),
                "residuals": {name: dataclasses.asdict(figure) for name, figure in self.figures.items()}}


def commands(described: WireLayout) -> Selection:
    """Return the frames that a master sends: NMT, SYNC, targets, controlwords, SDO requests and its heartbeat."""
    requests = {SDO_REQUEST_BASE + node for node in described.nodes}
    return Selection(cob_ids=frozenset({
        NMT_COB_ID, SYNC_COB_ID, *(plan.cob_id for _, plan, _ in described.master_frames()), HEARTBEAT_BASE + MASTER,
        *requests}))


def origin_ns(first_ns: int, first_command_ns: int) -> int:
    """Return the bus time at which the recording's first frame is played: shifted by whole seconds, so that every phase
    is kept.

    `first_command_ns` counts from that frame; the bench is to have booted by then.
    """
    origin = first_ns % SECOND_NS
    return origin if origin + first_command_ns >= BOOT_NS else origin + SECOND_NS


def residuals(recorded: Trial, simulated: Rows, described: WireLayout) -> Residuals:
    """Compare the nodes' signals in a trial with those in `simulated` frames, row by row."""
    frames = recorded.frames
    channel = decode.bench_channel(frames, described)
    then = decode.cycles(frames[frames["channel"] == channel], described)
    again = decode.cycles(simulated, described)
    count = min(len(then.time_ns), len(again.time_ns))
    if not count:
        raise InputError(f"{recorded.path}: no SYNC was recorded, so there are no control cycles to compare.")
    time_ns = then.time_ns[:count]
    gait = _gait(recorded, time_ns)
    sides: tuple[dict[str, Floats], dict[str, Floats]] = ({}, {})
    columns: dict[str, Floats] = {}
    figures: dict[str, SignalResidual] = {}
    for signal in of_bench(described.network.bench):
        one, other = then.columns.get(signal.name), again.columns.get(signal.name)
        if (one is None and other is None) or signal.name.rpartition(".")[2] in _NOT_COMPARED:
            continue
        nothing = np.full(count, np.nan)
        one = nothing if one is None else one[:count]
        other = nothing if other is None else other[:count]
        sides[0][signal.name], sides[1][signal.name] = one, other
        columns[signal.name] = one - other
        figures[signal.name] = figure(signal, one, other, time_ns, gait)
    return Residuals(time_ns, *sides, columns, figures)


def _gait(recorded: Trial, time_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the rows in a gait cycle, all if the trial has no numbers of gait cycles."""
    cycle = next((column for name, column in recorded.columns.items() if name.rpartition(".")[2] == "cycle"), None)
    if cycle is None:
        return np.ones(len(time_ns), np.bool_)
    return np.isin(time_ns, recorded.time_ns[cycle >= 0])


def figure(
    signal: Signal, one: Floats, other: Floats, time_ns: NDArray[np.int64], gait: NDArray[np.bool_]
) -> SignalResidual:
    """Return the figures of one signal from recorded values, `one`, and simulated ones, `other`, NaN where unknown."""
    error = one - other
    known = np.flatnonzero(np.isfinite(error))
    one_sided = int(np.count_nonzero(np.isnan(one) != np.isnan(other)))
    if not len(known):
        return SignalResidual(signal.unit, 0, 0, one_sided, math.nan, math.nan, math.nan, math.nan, math.nan)
    values, walked = error[known], error[known[gait[known]]]
    worst = known[np.abs(values).argmax()]
    return SignalResidual(
        signal.unit, len(known), int(np.count_nonzero(values)), one_sided, _rms(values), _rms(walked),
        float(values.mean()), float(abs(error[worst])), float(time_ns[worst] - time_ns[0]) / 1e9)


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(values**2))) if len(values) else math.nan


def table(recorded: Trial, found: Residuals) -> tuple[tuple[Signal, ...], dict[str, Floats]]:
    """Return signals and columns of a file of residuals: each under its own name with `PREFIX`, and the place in the
    gait."""
    declared = {signal.name: signal for signal in SIGNALS}
    kept = {name: np.full(len(found.time_ns), np.nan) for name in _KEPT if name in recorded.columns}
    _, ours, theirs = np.intersect1d(found.time_ns, recorded.time_ns, return_indices=True)
    for name, column in kept.items():
        column[ours] = recorded.columns[name][theirs]
    signals = [declared[name] for name in kept]
    for name in found.columns:
        path, dot, own = name.rpartition(".")
        unit, text = declared[own].unit, declared[own].text
        signals.append(Signal(f"{path}{dot}{PREFIX}{own}", unit, f"recorded − simulated: {text}", derived=True))
    return tuple(signals), kept | dict(
        zip([signal.name for signal in signals[len(kept):]], found.columns.values(), strict=True))


def replay(
    recorded: Trial, chosen: BusSettings, output: Path | None = None, *, overwrite: bool = False,
    progress: Progress = SILENT,
) -> Residuals:
    """Play the master's commands to a simulated bench, and compare its nodes' responses with the recording.

    `output` gets the residuals as a separate trial.
    """
    output_files.refuse([output], overwrite=overwrite, inputs=[recorded.path])
    described = wire(sections(recorded)["network"])
    session.compile_laws(simulated=True, progress=progress)
    found = residuals(recorded, simulate(recorded, chosen, described, progress), described)
    if output is not None:
        _write(recorded, found, output, overwrite=overwrite)
    return found


def simulate(recorded: Trial, chosen: BusSettings, described: WireLayout, progress: Progress = SILENT) -> Rows:
    """Return every frame of a simulated bench under the recorded commands, at the same bus times."""
    frames = recorded.frames
    bitrate = described.network.bitrate
    with opened_one(chosen, bitrate, **simulating(described.network), receive_own_messages=True) as bus:
        lead_ns = lengths_ns(frames, bitrate) + bus.bench.master_turnaround_ns
        schedule = plan(frames, commands(described), lead_ns)
        heard = FrameRows()
        player = Player(schedule, Outlet({}, bus).send)
        begin_ns = origin_ns(int(frames["time_ns"].min()), int(schedule.times[0]))

        def hear(message: Any) -> None:
            data = bytes(message.data)
            heard.add((message.time_ns, message.arbitration_id, 0, len(data), 0, not message.is_rx, data))

        with progress.running("plant") as update:
            wait_until(bus, bus.time_ns, begin_ns, hear)
            player.play(begin_ns)
            play_out(player, bus, bus.time_ns, hear, update)
    return heard.rows()


def lengths_ns(frames: Rows, bitrate: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the duration of each recorded frame on the wire, ns."""
    from virtual_bus.wire.bit_counts import bits_of

    flags = frames["flags"]
    bits = bits_of(frames["can_id"], frames["dlc"], frames["data"], flags & cdr.REMOTE != 0, flags & cdr.EXTENDED != 0)
    return bits * (1_000_000_000 // bitrate)


def _write(recorded: Trial, found: Residuals, output: Path, *, overwrite: bool) -> None:
    signals, columns = table(recorded, found)
    write(output, TrialContent(found.time_ns, columns, signals=signals),
          metadata={**recorded.metadata, "experiment": "residuals", "commit": provenance.commit()},
          result={}, attachments=recorded.attachments, overwrite=overwrite)
