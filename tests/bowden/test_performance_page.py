"""Measures of docs/performance.md: two pieces of work alternate in processes of their own; the table is complete."""

from __future__ import annotations

import os
import re
from functools import partial
from pathlib import Path

from benchmarks import performance
from benchmarks.frame import DOCS, Turn, compare

TURNS, WARM = 6, 2


def marked(turn: Turn, path: Path) -> None:
    """Append the number of this process to a file in each turn."""
    while True:
        turn()
        with path.open("a", encoding="ascii") as file:
            file.write(f"{os.getpid()}\n")


def test_own_work_and_its_peer_take_turns_in_two_processes(tmp_path: Path) -> None:
    work = partial(marked, path=tmp_path / "turns")
    row = compare("a mark, µs", work, "the same", work, units=1, turns=TURNS, warm=WARM)
    processes = (tmp_path / "turns").read_text(encoding="ascii").split()
    assert processes == processes[:2] * (TURNS + WARM)
    assert len({*processes, str(os.getpid())}) == 3
    assert (row[0], row[2]) == ("a mark, µs", "the same")
    assert re.fullmatch(r"[\d.]+ \([\d.]+ … [\d.]+\)", row[4])


def test_the_page_states_the_whole_cycle_and_both_peers() -> None:
    table = (DOCS / "performance.md").read_text(encoding="utf-8")
    for peer in ("stock canopen, µs", "canopen pumped by hand, µs"):
        assert re.search(rf"\| one simulated control cycle, µs \| [\d.]+ \| {peer} \| [\d.]+ \| [\d.]+ \(", table)


def test_the_page_states_the_memory_of_each_command_with_a_trial_of_an_hour() -> None:
    table = (DOCS / "performance.md").read_text(encoding="utf-8")
    for name in (*performance.MEMORY, *performance.BOUNDED):
        row = re.search(rf"\| peak memory of `{re.escape(name)}`, a trial of an hour at 1 kHz, MB \| (\d+) \|", table)
        assert row is not None, name
        assert int(row[1]) < 2000
