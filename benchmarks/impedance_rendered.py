"""Impedance that the bench renders at END, measured with the simulated bench as a device under test.

    python -m benchmarks.impedance_study

The desired force is constant.  The leg moves by a sum of sines, which perturbs the force at END, and the rope answers.
All of it runs through the wire.  The rendered admittance is the spectrum of rope position by that of the force error at
true END; the commanded admittance is 1/(B·s + K), equation (15) with M neglected.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import impedance_loop as loop
from benchmarks.results_page import markdown
from bowden.bench import configuration
from bowden.sweep import row_trial
from bowden.sweep import rows as sweep_rows
from bowden.sweep.rows import Value, table
from bowden.trials import session
from master.control.controller_io import ControllerInput, ControllerOutput, Trace
from master.control.packaged import PaperController
from master.control.paper import PaperState
from physics import laws
from physics.calibration import nominal, write
from physics.closure import CYCLE_POINTS
from physics.laws import Array
from physics.reference import Reference
from trial import read

PERIOD_S, CYCLES, SETTLE = 10.0, 3, 1
"""Time between two pulls, s; pulls, and those left out at the beginning."""
UP, DOWN, FROM, TO = (0.02, 0.12), (0.92, 0.98), 0.4, 0.9
"""Shares of `PERIOD_S`: the force rises, it falls, and the part of it at rest that the spectrum is taken of."""
LINES: tuple[int, ...] = (2, 4, 6, 10, 16, 26, 42, 68, 110)
"""Frequencies of the sines, in units of 1/`PERIOD_S`, even so that each is whole in the part: 0.2 … 11 Hz."""
FORCE_N = 40.0
"""Desired force, N: constant."""
KNEE_RAD = float(laws.knee_angle(laws.STIFFNESS_KNEE_PERCENT))
MOVED_RAD = 0.01
"""Effective value of the leg's motion: 0.4 mm of rope; above 1.2° at a time plausibility stops the trial."""
WITHIN = 0.1
"""Relative departure from the commanded admittance that the bandwidth permits."""
NO_FRICTION: Mapping[str, Value] = {"plant.mu1": 0.0, "plant.mu2": 0.0}


class Rendered(NamedTuple):
    """By line: frequency, Hz; rendered by commanded admittance; effective value of the force error at END, N."""

    frequency_hz: Array
    ratio: NDArray[np.complex128]
    error_n: float

    def bandwidth_hz(self, *, with_phase: bool) -> float:
        """Frequency up to which every line is within `WITHIN` of the command, Hz; 0 if the first is not."""
        away = np.abs(self.ratio - 1.0) if with_phase else np.abs(np.abs(self.ratio) - 1.0)
        broken = np.flatnonzero(away > WITHIN)
        held = int(broken[0]) if broken.size else away.size
        return float(self.frequency_hz[held - 1]) if held else 0.0


class KneeUnseen(PaperController):
    """The paper's controller with the knee angle of the reference, so that the leg's motion is not fed forward."""

    def step(self, seen: ControllerInput, state: PaperState) -> tuple[ControllerOutput, PaperState, Trace]:
        """Return one control cycle's targets at the knee angle of the reference."""
        return super().step(seen._replace(knee_angle_rad=KNEE_RAD), state)


def held() -> tuple[Array, Array, Array]:
    """Desired force, N, and its slopes per %: from 0 to `FORCE_N` and back by half a cosine, at rest between."""
    phase = np.linspace(0.0, 1.0, CYCLE_POINTS + 1)
    rising, falling = (np.clip((phase - low) / (high - low), 0.0, 1.0) for low, high in (UP, DOWN))
    force = FORCE_N * 0.5 * (np.cos(np.pi * falling) - np.cos(np.pi * rising))
    slope = np.gradient(force, 100.0 / CYCLE_POINTS)
    return force, slope, slope


def sines() -> tuple[Array, Array]:
    """Knee angle, rad, and its slope per % of one period of the sum of sines, phases by Schroeder."""
    phase = np.linspace(0.0, 1.0, CYCLE_POINTS + 1)
    angle, slope = np.zeros_like(phase) + KNEE_RAD, np.zeros_like(phase)
    for i, line in enumerate(LINES):
        turn = 2.0 * np.pi * line * phase - math.pi * i * (i + 1) / len(LINES)
        size = MOVED_RAD * math.sqrt(2.0 / len(LINES))
        angle += size * np.sin(turn)
        slope += size * np.cos(turn) * 2.0 * np.pi * line / 100.0
    return angle, slope


def measure(damping: float, stiffness: float, plant: Mapping[str, Value]) -> Rendered:
    """Run the test on the nominal bench with `plant` changed; B, N·s/m, and K, N/m, are commanded.

    Raises `RuntimeError` with the reason if the trial stops.
    """
    row = sweep_rows.rows(configuration.read(None), {
        "bench.serial": 0, "gait.controller": f"{__name__}:KneeUnseen", "gait.period_s": PERIOD_S,
        "gait.peak_n": FORCE_N, "gait.cycles": CYCLES, "gait.settle": SETTLE, "impedance.damping_n_s_m": damping,
        "impedance.stiffness_n_m": stiffness, **plant}, [])[0]
    zeros = np.zeros(CYCLE_POINTS + 1)
    force = held()
    still = Reference(PERIOD_S, (zeros + KNEE_RAD, zeros), force)
    sections = {name: table(row, name) for name in ("network", "impedance", "limits", "homing", "gait")}
    with tempfile.TemporaryDirectory() as folder:
        known = Path(folder, "calibration.toml")
        exponents = {"cable_exponent": 0.0, "fabric_friction": 0.0} if plant else {}
        known.write_text(write(dataclasses.replace(nominal(), **exponents)), encoding="utf-8")
        prepared = session.prepare(sections, still, known, row_trial.chosen(row), dry_run=False)
        moved = dataclasses.replace(prepared.experiment, motion=Reference(PERIOD_S, sines(), force))
        place = Path(folder, "trial.mcap")
        found = session.perform(dataclasses.replace(prepared, experiment=moved), place)
        if found["outcome"] != "completed":
            raise RuntimeError(str(found["stop_reason"]))
        return _spectrum(place, damping, stiffness)


def _spectrum(place: Path, damping: float, stiffness: float) -> Rendered:
    trial, truth = read.open(place), read.open_table(place.with_name(f"{place.stem}.truth.mcap"), "/truth")
    end = np.interp(trial.time_ns, truth.time_ns, truth.columns["true_end_n"])
    cycle, rope = trial.columns["cycle"], trial.columns["servo_position_m"]
    samples = round(PERIOD_S * 1e9 / float(np.median(np.diff(trial.time_ns))))
    part = slice(round(FROM * samples), round(TO * samples))
    lines = np.array(LINES) // round(1.0 / (TO - FROM))
    spectra = []
    for pull in range(SETTLE, CYCLES):
        of = cycle == pull
        spectra.append([np.fft.rfft(column[of][part])[lines] for column in (FORCE_N - end, rope)])
    error, answer = np.mean(spectra, axis=0)
    frequency = np.array(LINES) / PERIOD_S
    rms = math.sqrt(float(np.sum(2.0 * np.abs(error) ** 2))) / (part.stop - part.start)
    return Rendered(frequency, answer / error * (2j * np.pi * frequency * damping + stiffness), rms)


def predicted(damping: float, stiffness: float) -> NDArray[np.complex128]:
    """Return the ratio by line that `impedance_loop` predicts without friction."""
    s = 2j * np.pi * np.array(LINES) / PERIOD_S
    return np.asarray(loop.sampled_law(s, damping, stiffness) * loop.passed(s) * (damping * s + stiffness))


def section(free: Rendered, rubbing: Rendered, damping: float, stiffness: float) -> str:
    """Return the page's tables; `free` is measured without friction, `rubbing` on the nominal bench."""
    rows = [[f"{at:.1f}", *map(_polar, parts)] for at, *parts in zip(
        free.frequency_hz, predicted(damping, stiffness), free.ratio, rubbing.ratio, strict=True)]
    wide = [[name, _hertz(found, with_phase=False), _hertz(found, with_phase=True),
             f"{found.error_n:.1f}"] for name, found in (("without friction", free), ("nominal bench", rubbing))]
    return "\n\n".join([
        markdown(["frequency (Hz)", "loop's prediction", "without friction", "nominal bench"], rows),
        markdown(["bench", f"magnitude within {100 * WITHIN:.0f} % up to (Hz)", "magnitude and phase (Hz)",
                  "force error at END, effective (N)"], wide)])


def _polar(ratio: complex) -> str:
    return f"{abs(ratio):.2f}, {math.degrees(math.atan2(ratio.imag, ratio.real)):.0f}°"


def _hertz(found: Rendered, *, with_phase: bool) -> str:
    bandwidth = found.bandwidth_hz(with_phase=with_phase)
    at_least = "at least " if bandwidth == found.frequency_hz[-1] else ""
    return f"{at_least}{bandwidth:.1f}" if bandwidth else "at no line"
