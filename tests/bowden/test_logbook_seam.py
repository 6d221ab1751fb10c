"""Seam of logbook and diagnosis: sessions entered in two orders give one answer, which `bowden diagnose` names alike.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from tests.hidden.family import like
from tests.plants import draws, imposed
from tests.plants.bench import Bench, replaced

SESSIONS: Final = 11
BEGINS: Final = 8
"""First session with the gain, counted from 0: the ninth one."""
GAIN: Final = 1.05


def _recorded(path: Path, bench: Bench, seed: int, motion: imposed.Motion) -> Path:
    columns = imposed.trial(bench, seed, motion=motion, noise_n=0.1, rate_hz=500).columns
    np.savetxt(path, np.stack(list(columns.values()), axis=1), fmt="%.8g", delimiter=",", header=",".join(columns),
               comments="")
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Sessions of one bench of the family, whose START gain rises by 5 % in the ninth one."""
    folder = tmp_path_factory.mktemp("sessions")
    own = draws.draw(0, implementation="maxwell")
    motion = imposed.gait(own, 40.0, 1.2, 4)
    paths = []
    for session in range(SESSIONS):
        bench = like(own, np.random.default_rng((5, session)))
        if session >= BEGINS:
            bench = replaced(bench, start_gain=GAIN * bench.start_gain)
        paths.append(_recorded(folder / f"s{session}.csv", bench, session, motion))
    return paths


@pytest.mark.exhaustive
def test_a_change_is_named_as_the_diagnosis_names_it_whatever_the_order_of_entry(
        recorded: list[Path], here: Path, bowden: Callable[..., Any]) -> None:
    def told(*words: object) -> dict[str, Any]:
        status, out, err = bowden(*words, "--json")
        assert status in (0, 1), err
        found: dict[str, Any] = json.loads(out)
        return found

    def entered(book: str, order: Iterable[int]) -> dict[str, Any]:
        told("logbook", "init", book, "--name", "left leg")
        for session in order:
            told("logbook", "add", book, recorded[session], "--session", f"day {session}")
        return told("logbook", "show", book)

    one = entered("dates", range(SESSIONS))
    assert one == entered("mixed", np.random.default_rng(1).permutation(SESSIONS).tolist())
    assert one["verdict"] == "changed"
    alarm = one["alarms"][0]
    whole = told("diagnose", recorded[-1], *(word for path in recorded[:3] for word in ("--healthy", path)))
    assert alarm["since"] == f"day {BEGINS}"
    assert alarm["among"] == whole["class"] == ["start_gain"]
    assert alarm["part"] == whole["part"]
    first = bowden("logbook", "show", "dates").stdout.splitlines()[0]
    assert first.startswith(f"Changed since session day {BEGINS}, as a step: START gain")
    planned = told("plan", "--logbook", "dates")
    assert planned["class"] == alarm["among"]


@pytest.mark.exhaustive
def test_a_change_of_friction_is_stated_where_sessions_are_beyond_the_linear_model(
        here: Path, bowden: Callable[..., Any]) -> None:
    # without the error of the linearisation as noise this bench has -2.3 nats after eight sessions (decision 61)
    own = draws.draw(50, implementation="dahl")
    motion = imposed.gait(own, 40.0, 1.2, 6)
    assert bowden("logbook", "init", "book").status == 0
    for session in range(SESSIONS):
        bench = like(own, np.random.default_rng((50, session, 17)))
        bench = replaced(bench, mu1=1.3 * bench.mu1) if session >= 3 else bench
        path = _recorded(here / f"{session}.csv", bench, 50000 + session, motion)
        assert bowden("logbook", "add", "book", path, "--session", session).status == 0
    shown = json.loads(bowden("logbook", "show", "book", "--json").stdout)
    assert (shown["verdict"], shown["alarms"][0]["since"], shown["alarms"][0]["part"]) == (
        "changed", "3", "friction path")
    assert "friction" in bowden("logbook", "show", "book").stdout.splitlines()[0]


@pytest.mark.exhaustive
@pytest.mark.parametrize("repeat", [3, 5, 8])
def test_a_repeat_in_the_reference_condition_has_no_name_where_reference_trials_have_several_minima(
        here: Path, bowden: Callable[..., Any], repeat: int) -> None:
    # one motion does not determine this bench, and the rope zero differs between its sessions (decision 65)
    own = draws.draw(0, implementation="dahl")
    motion = imposed.gait(own, 40.0, 1.2, 6)
    *healthy, trial = (_recorded(here / f"{k}.csv", like(own, np.random.default_rng((0, k, 17))), k, motion)
                       for k in (0, 1, 2, repeat))
    found = json.loads(bowden("diagnose", trial, "--healthy", *healthy, "--json").stdout)
    assert (found["verdict"], found["causes"]) == ("none", [])
