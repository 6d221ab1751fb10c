"""Outcome of an unattended repair, and its page."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from trial.report.page import Page, Tile, number
from trial.report.plot import Plot, Series
from trial.report.words import words


@dataclass(frozen=True)
class MendedBench:
    """Outcome of a run: `ending` in words; `kept` if the extension gained; the extension's `equations` and names.

    `before`, `after`: END's error, % of the peak, in the trials A and B: RMS of its mean cycle from that of the
    reference trial, or from the desired force where that ran by another controller.  `gain`: mean of their
    differences, in points of percent, with its 95 % `interval`.  `folder` has the trials, the journal, the extension
    and the page.
    """

    ending: str
    folder: Path
    verdict: str = ""
    names: Sequence[str] = ()
    equations: Sequence[str] = ()
    before: Sequence[float] = ()
    after: Sequence[float] = ()
    kept: bool = False
    steps: Sequence[dict[str, Any]] = field(default_factory=tuple)

    @property
    def gain(self) -> float | None:
        """Mean fall of END's error, points of percent; None without trials."""
        return float(np.mean(np.subtract(self.before, self.after))) if self.before else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """95 % interval of the mean fall, by Student's t over the pairs; None with fewer than two."""
        return paired_interval(self.before, self.after) if len(self.before) > 1 else None

    @property
    def scatter(self) -> str:
        """Interval of the mean fall, in words; a single pair has no interval."""
        low, high = self.interval or (None, None)
        return "one pair of trials, so no interval" if low is None else f"95 %: {low:.3g} … {high:.3g}"

    def as_json(self) -> dict[str, Any]:
        """Return the object that `bowden mend --json` prints."""
        return {"ending": self.ending, "verdict": self.verdict, "names": list(self.names),
                "equations": list(self.equations), "before_percent": list(self.before),
                "after_percent": list(self.after), "gain_points": self.gain,
                "interval": None if self.interval is None else list(self.interval), "kept": self.kept,
                "folder": str(self.folder)}


def paired_interval(before: Sequence[float], after: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `before` less `after`, by Student's t over the pairs."""
    fall = np.subtract(before, after)
    half = float(student.ppf(0.975, fall.size - 1) * fall.std(ddof=1) / math.sqrt(fall.size))
    return float(fall.mean()) - half, float(fall.mean()) + half


def write_page(result: MendedBench, path: Path) -> None:
    """Write the story of a run as one HTML page without network."""
    badge = ("mended", "good") if result.kept else ("not mended", "plain")
    page = Page("A bench repaired overnight", f"{result.ending}.", badge=badge)
    page.section("Outcome")
    page.text(_sentence(result))
    if result.gain is not None:
        page.tiles([
            Tile(number(float(np.mean(result.before)), 3), "%", "END without the extension", "error, of the peak"),
            Tile(number(float(np.mean(result.after)), 3), "%", "END with it", "error, of the peak"),
            Tile(number(result.gain, 3), "points", "gain", result.scatter)])
        pairs = np.arange(1.0, len(result.before) + 1.0)
        page.plot(Plot("END's error by pair of trials", pairs, [
            Series("A: without it", result.before, "#d97706", points=True),
            Series("B: with it", result.after, "#2563eb", points=True)], "pair", "%"))
    page.section("Steps")
    page.table(["step", "what happened"], [(line["step"], _step_sentence(line["result"])) for line in result.steps[1:]])
    page.section("Files")
    page.text(f"Trials, journal.jsonl and, where it was kept, extended.toml are in {result.folder}.")
    page.write(path, overwrite=True)


def _sentence(result: MendedBench) -> str:
    """Return the named causes and the ending as text."""
    cause = ", ".join(map(words, result.names)) or "; ".join(result.equations)
    if not cause:
        return f"{result.ending[:1].upper()}{result.ending[1:]}."
    return f"Named: {cause}. {result.ending[:1].upper()}{result.ending[1:]}."


def _step_sentence(result: dict[str, Any]) -> str:
    """Return a step's result in words: a trial, a diagnosis or a plan."""
    if "file" in result:
        percent = "END not measured" if result["percent"] is None else f"END off by {number(result['percent'], 3)} %"
        stopped = f" ({result['stop_reason']})" if result["stop_reason"] else ""
        return f"{result['file']}: {result['outcome']}{stopped}, {result['seconds']:.0f} s, {percent}"
    if "verdict" in result:
        among = ", ".join(map(words, result["class"]))
        return "; ".join([str(result["verdict"]) + (f": {among}" if among else ""), *result["equations"]])
    return str(result["experiment"] or "no experiment is likely to decide")
