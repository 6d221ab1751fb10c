"""Simulated benches that wear, session by session through the command line: no alarm before, then a dated alarm.

Its cause is the diagnosis of recorded trials.  The plant of `tests.hidden.plugin` has the backlash that the evidence
simulates.  In the packaged plant the leg's inertia keeps a loose leg off its flank until the rope is tight, which no
effect of the catalogue predicts.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from trial.report.words import words

BEGINS, SESSIONS = 20, 22


class Wearing(NamedTuple):
    """A bench: options of `bowden trial` in every session, before the change and from it on; verdicts and names."""

    every: Callable[[int], tuple[object, ...]]
    before: tuple[str, ...]
    after: tuple[str, ...]
    verdicts: frozenset[str]
    names: frozenset[str]


BENCHES = {
    "tests' plant": Wearing(
        lambda k: ("--serial", 0, "--seed", 2 * k, "--period", 1.1), ("--plant", "tests.hidden.plugin:healthy"),
        ("--plant", "tests.hidden.plugin:knee_backlash"), frozenset({"found", "ambiguous"}),
        frozenset({"knee_backlash"})),
    "packaged plant": Wearing(
        lambda k: ("--serial", 5, "--period", 1.0), (), ("--plant-model", "worn.toml"),
        frozenset({"found", "ambiguous"}), frozenset({"knee_backlash"})),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", [
    "tests' plant",
    pytest.param("packaged plant", marks=pytest.mark.xfail(
        strict=True, reason="the leg's inertia holds a loose leg off its flank: said to be a creep of the fabric"))])
def test_a_backlash_raises_an_alarm_that_is_dated_and_diagnosed(name: str, here: Path,
                                                                bowden: Callable[..., Any]) -> None:
    def told(*words: object) -> dict[str, Any]:
        status, out, err = bowden(*words, "--json")
        assert status == 0, err
        found: dict[str, Any] = json.loads(out)
        return found

    bench = BENCHES[name]
    told("logbook", "init", "book")
    Path("worn.toml").write_text("[effects.knee_backlash]\nknee_backlash = 0.026\n", encoding="utf-8")
    for k in range(SESSIONS):
        if k == BEGINS:
            assert told("logbook", "show", "book")["alarms"] == []
        told("trial", *bench.every(k), "--day", k, "--cycles", 3, "--settle", 0,
             *(bench.after if k >= BEGINS else bench.before), "--logbook", "book", "-o", f"{k}.mcap")
    alarm = told("logbook", "show", "book")["alarms"][0]
    assert alarm["since_interval"][0] == f"day {BEGINS}"  # no session before it; of two worn ones either may be it
    assert alarm["verdict"] in bench.verdicts
    assert bench.names <= set(alarm["among"])
    assert bench.names or alarm["among"] == []
    assert alarm["session"] == f"day {SESSIONS - 1}"
    for k in range(SESSIONS):
        Path(f"{k}.mcap").unlink()
    assert told("logbook", "show", "book")["alarms"][0] == alarm  # by the kept diagnosis
    told("logbook", "report", "book", "-o", "page.html")
    page = Path("page.html").read_text(encoding="utf-8")
    assert "<p class='alarm'><b>Changed since session" in page
    assert words("knee_backlash") in page
