"""Which of the paper's claims about B and K hold, and what its printed approximations cost: docs/impedance.md.

    python -m benchmarks.impedance_study

The rule of this file: a number on the page is computed when the page is written, by `impedance_loop` and `printed`
or from trials of the nominal bench; the verdicts are those of the numbers (tests/bowden/test_impedance_study.py).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks import impedance_loop as loop
from benchmarks import impedance_rendered as rendered
from benchmarks import printed
from benchmarks.results_page import markdown, number
from bowden.bench import configuration
from bowden.sweep import rows as sweep_rows
from bowden.sweep import run
from bowden.sweep.rows import Row, Value
from bowden.sweep.sweep_table import SweepTable
from bowden.trials import session
from physics import laws

ROOT = Path(__file__).resolve().parent.parent
DAMPINGS, STIFFNESSES = (50.0, 100.0, 200.0, 400.0), (100.0, 300.0, 1000.0, 3000.0)
B, K = laws.IMPEDANCE_B, laws.IMPEDANCE_K
EXPONENT = 0.228
"""μ1θ + μ2φ at the peak on the nominal bench."""
BENCH: dict[str, dict[str, Value]] = {
    "no friction compensation, without impedance": {"gait.controller": "none"},
    "no friction compensation, B 0.1, K 0.3": {"gait.controller": "impedance"},
    "friction compensation, without impedance": {"gait.controller": "friction"},
    "friction compensation, B 0.1, K 0.3": {"gait.controller": "paper"},
    "the same, B 0.2": {"impedance.damping_n_s_m": 200.0},
    "the same, B 0.4": {"impedance.damping_n_s_m": 400.0},
    "the same, B 0.8": {"impedance.damping_n_s_m": 800.0},
    "the same, K 0.1": {"impedance.stiffness_n_m": 100.0},
    "the same, K 1": {"impedance.stiffness_n_m": 1000.0},
    "the same, K 3": {"impedance.stiffness_n_m": 3000.0},
}


def by_damping() -> str:
    """The loop by B, K as printed."""
    return markdown(
        ["B (N·s/mm)", "time to 63 % (ms)", "overshoot (%)", "error left (%)", "jitter (µm per N of noise)",
         "gain margin", "gain margin, rope stuck"],
        [[f"{b / 1e3:g}", *_answer(loop.response(loop.AT_40_N, b, K)), f"{1e6 * loop.noise_gain(b, K):.0f}",
          number(loop.margin(loop.AT_40_N, b, K)), number(loop.margin(loop.STUCK, b, K))] for b in DAMPINGS])


def by_stiffness() -> str:
    """The loop by K, B as printed."""
    return markdown(
        ["K (N/mm)", "time to 63 % (ms)", "overshoot (%)", "error left (%)", "Δx by Fe, at rest (mm/N)"],
        [[f"{k / 1e3:g}", *_answer(loop.response(loop.AT_40_N, B, k)), number(1e3 / k)] for k in STIFFNESSES])


def _answer(found: loop.Response) -> list[str]:
    return [f"{1e3 * found.rise_s:.0f}", f"{100 * max(found.overshoot, 0.0):.1f}", f"{100 * found.left:.1f}"]


def costs() -> str:
    """The printed approximations, by peak."""
    rows = []
    for name in printed.APPROXIMATIONS:
        found = [printed.cost(name, peak) for peak in (40.0, 50.0, 60.0)]
        rows.append([name, *(f"{c.rms_n:.2f} / {c.largest_n:.1f}" for c in found), number(found[0].relative_percent)])
    return markdown(
        ["used as printed", "40 N: rms / largest (N)", "50 N", "60 N", "RMSE at 40 N (% of the peak)"], rows)


def stuck() -> str:
    """Stability against a stuck rope, in words with their numbers."""
    released = loop.STUCK * float(laws.capstan(1.0, EXPONENT))
    return (
        f"While friction holds the rope, START meets {loop.STUCK / 1e3:.0f} N/mm instead of "
        f"{loop.AT_40_N / 1e3:.1f} N/mm. The loop needs B ≥ {loop.least_damping(loop.STUCK, K) / 1e3:.3f} N·s/mm "
        f"there; B = 0.1 has a gain margin of {loop.margin(loop.STUCK, B, K):.2f}: unstable. Releasing is worse, since "
        f"the estimate divides START by e^−{EXPONENT}: margin {loop.margin(released, B, K):.2f}. Once the "
        f"rope slides, the spring is soft again and the margin {loop.margin(loop.AT_40_N, B, K):.1f}.")


def claims() -> dict[str, bool]:
    """The text's claims about B and K, and whether 1/(B·s + K) bears them out in the loop."""
    small, large = (loop.response(loop.AT_40_N, b, K) for b in (50.0, 400.0))
    soft, stiff = (loop.response(loop.AT_40_N, B, k) for k in (100.0, 3000.0))
    return {
        "A larger B answers faster.": large.rise_s < small.rise_s,
        "A larger B overshoots more.": large.overshoot > small.overshoot,
        "A larger B brings jitter.": loop.noise_gain(400.0, K) > loop.noise_gain(50.0, K),
        "A larger K overshoots longer near zero.": stiff.overshoot > 1.05 * soft.overshoot,
        "K is the rigidity that contact feels: Δx = Fe/K at rest.":
            abs(laws.impedance_response(0j).real * K - 1.0) < 1e-9,
        "B = 0.1, K = 0.3 suit the loop while the rope slides.": loop.margin(loop.AT_40_N, B, K) > 2.0,
        "They suit it while the rope is stuck.": loop.margin(loop.STUCK, B, K) > 1.0,
    }


def figure_13(bench: Mapping[str, Mapping[str, str]]) -> dict[str, bool]:
    """What Fig. 13 shows of impedance, and whether the bench's trials do, with friction compensated."""
    without, law = (bench[f"friction compensation, {case}"] for case in ("without impedance", "B 0.1, K 0.3"))
    return {
        "With impedance the force is closer to the desired one (Fig. 13).":
            float(law["true_relative_rmse_percent"]) < float(without["true_relative_rmse_percent"]),
        "With impedance the force is smoother at the peak (Fig. 13).":
            float(law["true_peak_jump_n"]) < 0.95 * float(without["true_peak_jump_n"]),
    }


def page(bench: Sequence[tuple[str, Mapping[str, str]]], found: str) -> str:
    """Return docs/impedance.md; `bench` are the trials by name, `found` the tables of the rendered impedance."""
    parts = [
        "# The impedance law: what the paper says of B and K, and what its approximations cost",
        "`python -m benchmarks.impedance_study` writes this page. The law is (15) with M neglected, 1/(B·s + K). "
        "The loop is linear: 1 kHz, targets taken over at the next SYNC and led to in a straight line, a drive of "
        "25 Hz, START's converter, the rope as a spring "
        f"({loop.AT_40_N / 1e3:.1f} N/mm at 40 N). A step of 1 N in the desired force:",
        "## Damping B, at K = 0.3 N/mm\n\n" + by_damping(),
        "## Stiffness K, at B = 0.1 N·s/mm\n\n" + by_stiffness(),
        "## The claims\n\n" + markdown(["the text", "here"], [
            [claim, "holds" if holds else "**does not hold**"]
            for claim, holds in (claims() | figure_13(dict(bench))).items()]),
        "1/(B·s + K) moves at first by Fe/B a second: a larger B is slower, calmer, and passes less noise on. A larger "
        "K leaves K/(K + k) of the error where it was, k the spring of rope and fabric; it shortens the time "
        "constant and does not lengthen an overshoot. What the text describes is what a *gain* does, 1/B in place of "
        "B.",
        "## Against a stuck rope\n\n" + stuck(),
        "## What the bench renders at END\n\nThe whole bench is the device under test. 40 N are desired, and the leg "
        f"moves by {1e3 * rendered.MOVED_RAD:.0f} mrad (effective value of nine sines, not fed forward). The rope's "
        "answer by the force error at true END is divided by the commanded 1/(B·s + K). The column without friction "
        "has none in plant and calibration; the prediction is this page's linear loop.\n\n" + found,
        "Without friction, the loop's delay and the drive limit the bandwidth, and the law does not. On the nominal "
        f"bench END may rise by {rendered.FORCE_N * math.expm1(2.0 * EXPONENT):.0f} N over a START that stays as it "
        "is, before the rope slides the other way. Changes of 2 N stay within that, so the bench renders its stuck "
        "rope and not the commanded impedance.",
        "## On the bench\n\nThe nominal bench (serial 0), nominal calibration, 40 N, 2.0 s, true END; units of B and K "
        "as above.\n\n" + markdown(
            ["controller", "relative RMSE (%)", "jump at the peak (N)"],
            [[name, number(float(told["true_relative_rmse_percent"])), number(float(told["true_peak_jump_n"]))]
             for name, told in bench]),
        "## What the printed approximations cost\n\nEverything else exact, statics, nominal bench: the error of END by "
        "itself.\n\n" + costs(),
        f"At exponents of 0.157 and 0.1 the separate losses drop {100 * dropped(0.157, 0.1):.1f} % of the desired "
        f"force. The zeros of (10) and (11) are {1e3 * printed.zero_error_m():.2f} mm apart, "
        f"{printed.zero_error_m() / laws.stiffness_slope(40.0):.1f} N at 40 N. (10) turns over at "
        f"{laws.STIFFNESS_TURNING_N:.1f} N: 60 N at END with an exponent of 0.257 needs "
        f"{float(laws.capstan(60.0, 0.257)):.1f} N at START, beyond the 60 N that (10) was fitted to.",
    ]
    return "\n\n".join(parts) + "\n"


def rendered_tables() -> str:
    """Measure the rendered impedance at the paper's B and K; returns its tables."""
    free, rubbing = (rendered.measure(B, K, plant) for plant in (rendered.NO_FRICTION, {}))
    return rendered.section(free, rubbing, B, K)


def dropped(cable: float, fabric: float) -> float:
    """Return the share of the desired force that fL + fT leaves out against the series product."""
    series = float(laws.series_input(1.0, cable, 1.0, fabric, 1.0))
    return series - (1.0 + laws.cable_loss(1.0, cable, 1.0) + laws.fabric_loss(1.0, fabric, 1.0))


def rows() -> list[Row]:
    """The trials of the bench's table."""
    base: dict[str, Value] = {"bench.serial": 0, "gait.controller": "paper", "gait.cycles": 3}
    return [sweep_rows.rows(configuration.read(None), {**base, **more}, [])[0] for more in BENCH.values()]


def main() -> None:
    """Run the trials that are missing and write the page."""
    (ROOT / "out").mkdir(exist_ok=True)
    wanted = rows()
    session.compile_laws(simulated=True)
    with SweepTable(ROOT / "out" / "impedance.csv", list(wanted[0])) as table, run.local() as crew:
        run.sweep(wanted, table, crew, ROOT / "out" / "impedance.calibrations")
        bench = [(name, table.found(row) or {}) for name, row in zip(BENCH, wanted, strict=True)]
    (ROOT / "docs" / "impedance.md").write_text(page(bench, rendered_tables()), encoding="utf-8")


if __name__ == "__main__":
    main()
