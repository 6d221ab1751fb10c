"""A simulated bench that wears, session by session through the command line: no alarm before, an alarm dated after.

The effect is not asserted: among sessions a backlash of the plant is told as a lag, by the linear model of sessions.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

BEGINS, SESSIONS = 20, 22


@pytest.mark.exhaustive
def test_a_backlash_of_the_plant_raises_an_alarm_that_is_dated(here: Path, browser: Any, bowden: Callable[..., Any]
                                                               ) -> None:
    def told(*words: object) -> dict[str, Any]:
        status, out, err = bowden(*words, "--json")
        assert status == 0, err
        found: dict[str, Any] = json.loads(out)
        return found

    told("logbook", "init", "book")
    Path("worn.toml").write_text("[effects.knee_backlash]\nknee_backlash = 0.026\n", encoding="utf-8")
    for k in range(SESSIONS):
        if k == BEGINS:
            assert told("logbook", "show", "book")["alarms"] == []
        worn = ("--plant-model", "worn.toml") if k >= BEGINS else ()
        told("trial", "--serial", 5, "--day", k, "--cycles", 2, "--period", 1.0, "--settle", 0, *worn,
             "--logbook", "book", "-o", f"{k}.mcap")
    alarm = told("logbook", "show", "book")["alarms"][0]
    assert alarm["since_interval"][0] == f"day {BEGINS}"  # no session before it; of two worn ones either may be it
    told("logbook", "report", "book", "-o", "page.html")
    browser.open(here / "page.html")
    assert browser.complaints == []
    assert browser.run("document.querySelector('p.calm') === null")
