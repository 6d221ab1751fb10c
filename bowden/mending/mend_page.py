"""Page of an unattended repair: outcome, each step with its result, and the trials without and with the extension."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trial.report.page import Page, Series, Tile, number

if TYPE_CHECKING:
    from bowden.mending.supervisor import MendedBench


def write(result: MendedBench, path: Path) -> None:
    """Write the story of a run as one HTML page without network."""
    badge = ("mended", "good") if result.kept else ("not mended", "plain")
    page = Page("A bench repaired overnight", f"{result.ending}.", badge=badge)
    page.section("Outcome")
    page.text(_sentence(result))
    if result.gain is not None:
        low, high = result.interval or (None, None)
        page.tiles([
            Tile(number(float(np.mean(result.before)), 3), "%", "END without the extension", "error, of the peak"),
            Tile(number(float(np.mean(result.after)), 3), "%", "END with it", "error, of the peak"),
            Tile(number(result.gain, 3), "points", "gain", f"95 %: {number(low, 3)} … {number(high, 3)}")])
        pairs = np.arange(1.0, len(result.before) + 1.0)
        page.plot("END's error by pair of trials", pairs, [
            Series("without", result.before, "#d97706", points=True),
            Series("with", result.after, "#2563eb", points=True)], "pair", "%")
    page.section("Steps")
    page.table(["step", "what happened"], [(line["step"], _words(line["result"])) for line in result.steps[1:]])
    page.section("Files")
    page.text(f"Trials, journal.jsonl and, where it was kept, extended.toml are in {result.folder}.")
    page.write(path, overwrite=True)


def _sentence(result: MendedBench) -> str:
    """Return what was named and what became of it, in one sentence."""
    cause = ", ".join(name.replace("_", " ") for name in result.names) or "; ".join(result.equations)
    if not cause:
        return f"{result.ending[:1].upper()}{result.ending[1:]}."
    return f"Named: {cause}. {result.ending[:1].upper()}{result.ending[1:]}."


def _words(result: dict[str, Any]) -> str:
    """Return a step's result in words: a trial, a diagnosis or a plan."""
    if "file" in result:
        percent = "END not measured" if result["percent"] is None else f"END off by {number(result['percent'], 3)} %"
        stopped = f" ({result['stop_reason']})" if result["stop_reason"] else ""
        return f"{result['file']}: {result['outcome']}{stopped}, {result['seconds']:.0f} s, {percent}"
    if "verdict" in result:
        among = ", ".join(name.replace("_", " ") for name in result["class"])
        return "; ".join([str(result["verdict"]) + (f": {among}" if among else ""), *result["equations"]])
    return str(result["experiment"] or "no experiment is likely to decide")
