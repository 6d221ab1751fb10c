"""Alarms, dates and names of a logbook on recorded sessions; cost of a logbook of 100,000 trials.

Commands:

    python -m benchmarks.logbook            performance; DuckDB only where it is installed
    python -m benchmarks.logbook --recorded DIR [--serials 0,1] [--healthy 20] [--sessions 8] [--changes NAMES]
                                            benches recorded into DIR: alarms without a change, changes dated and named

Serials with serial % 3 == 2 are set aside: nothing is tuned on them (`tests.plants.draws`).  A session is six gait
cycles (`benchmarks.recorded_sessions`); sessions are entered as `bowden logbook add` does, in the order that
`--order` states.
"""

from __future__ import annotations

import argparse
import sqlite3
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.recorded_sessions import BEGINS, CHANGES, KINDS, record
from bowden.models import logbook_entries
from bowden.models.change_diagnosis import diagnosed_state
from estimation.linear_sums import SessionSums
from logbook import bench_page, database
from logbook.bench_state import BenchState, state_of
from logbook.database import NewTrial, open_logbook
from physics.effects.hypotheses import HYPOTHESES

TRIALS, PER_SESSION = 100_000, 10


class Outcome(NamedTuple):
    """What a logbook states of one bench: changed, first session of the change, effects and part of the bench."""

    changed: bool
    since: str | None
    effects: tuple[str, ...]
    part: str | None


def main() -> None:
    """Print the measurements that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recorded", type=Path, metavar="DIR", help="folder of the recorded sessions")
    parser.add_argument("--kinds", default=",".join(KINDS), help="methods of the family and the packaged plant")
    parser.add_argument("--serials", default="0", help="serials of each kind, with commas")
    parser.add_argument("--healthy", type=int, default=20, help="sessions of a bench without a change")
    parser.add_argument("--sessions", type=int, default=8, help="changed sessions of a bench with a change")
    parser.add_argument("--changes", default=",".join(CHANGES), help="changes, with commas")
    parser.add_argument("--order", choices=("dates", "reversed"), default="dates", help="order of entry")
    given = parser.parse_args()
    if given.recorded is None:
        performance()
        return
    benches = [(kind, int(serial)) for kind in given.kinds.split(",") for serial in given.serials.split(",")]
    alarms(given.recorded, benches, given.healthy, given.order)
    for change in filter(None, given.changes.split(",")):
        changes(given.recorded, benches, change, given.sessions, given.order)


def alarms(folder: Path, benches: Sequence[tuple[str, int]], sessions: int, order: str) -> None:
    """Print how many benches without a change alarm after any of their sessions."""
    raised = 0
    for kind, serial in benches:
        found = _followed(folder, kind, serial, sessions, None, order, every=True)
        alarmed = [one for one in found if one.changed]
        raised += bool(alarmed)
        print(f"healthy {kind} {serial}: " + (f"alarm of {', '.join(alarmed[0].effects)}, since session "
                                              f"{alarmed[0].since}" if alarmed else "no alarm"), flush=True)
    print(f"healthy: {raised} of {len(benches)} benches alarm in {sessions} sessions", flush=True)


def changes(folder: Path, benches: Sequence[tuple[str, int]], change: str, sessions: int, order: str) -> None:
    """Print how many changes are stated, dated within a session, and named in the right part of the bench."""
    case, stated, dated, right = CHANGES[change], 0, 0, 0
    for kind, serial in benches:
        found = _followed(folder, kind, serial, BEGINS + sessions, change, order)[-1]
        near = found.since is not None and abs(int(found.since) - BEGINS) <= 1
        stated, dated, right = stated + found.changed, dated + near, right + (near and found.part == case.part)
        print(f"{change} {kind} {serial}: since {found.since}, {', '.join(found.effects) or 'nothing'} ({found.part})",
              flush=True)
    print(f"{change}: {stated} of {len(benches)} stated, {dated} dated within a session, {right} of these in the right "
          "part", flush=True)


def _followed(folder: Path, kind: str, serial: int, sessions: int, change: str | None, order: str, *,
              every: bool = False) -> list[Outcome]:
    """Enter a bench's sessions in a logbook; return what is stated at the end, or after every session."""
    with tempfile.TemporaryDirectory() as place:
        book = Path(place) / "book"
        database.create(book, f"{kind} {serial}")
        numbers = range(sessions) if order == "dates" else range(sessions)[::-1]
        found = []
        for k in numbers:
            logbook_entries.add(book, record(folder, kind, serial, k, change), str(k))
            if every or k == numbers[-1]:
                with open_logbook(book) as opened:
                    found.append(_outcome(state_of(opened) if every else diagnosed_state(opened)))
        return found


def _outcome(state: BenchState) -> Outcome:
    if not state.alarms:
        return Outcome(False, None, (), None)
    names = state.named()
    part = state.cause.part if state.cause is not None and state.cause.named else (
        HYPOTHESES[names[0]].part if names else None)
    return Outcome(True, state.labels.get(state.alarms[0].since), names, part)


def performance() -> None:
    """Print the seconds of each operation on a logbook of `TRIALS` trials."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "book"
        database.create(folder, "large")
        _filled(folder)
        with open_logbook(folder) as book:
            found = next(iter(book.sums(1, [1]).values()))

        def add(k: int = 0) -> None:
            with open_logbook(folder) as book:
                number, _ = book.enter_trial(_trial(TRIALS + k), f"day {TRIALS // PER_SESSION}")
                book.enter_sums(number, 1, found)

        def listed() -> None:
            with open_logbook(folder) as book:
                book.counts()
                book.trials(20)

        def report() -> None:
            with open_logbook(folder) as book:
                bench_page.write(book, state_of(book), Path(place) / "page.html")

        for name, run, goal in (("add, beside the fit", add, 0.2), ("list", listed, 2.0), ("report", report, 2.0)):
            began = time.perf_counter()
            run()
            print(f"{name:24} {time.perf_counter() - began:7.3f} s   (goal {goal} s)")
        print(f"{'database':24} {(folder / database.FILE).stat().st_size / 1e6:7.0f} MB, {TRIALS} trials")
    peers()


def _trial(k: int) -> NewTrial:
    return NewTrial(Path(f"{k}.mcap"), f"digest {k}", "gait", "completed", 20.0, {"peak_n": "40.0", "rate_hz": "1000"},
                    {"relative_rmse_percent": 1.0}, "commit")


def _filled(folder: Path) -> None:
    """Fill a logbook in one transaction with the sums of a recorded session; what entries cost is measured afterwards.
    """
    recorded = folder.parent / "recorded"
    logbook_entries.add(folder, record(recorded, KINDS[0], 0, 0), "0")
    with open_logbook(folder) as book:
        sums: SessionSums = next(iter(book.sums(1, [1]).values()))
    upper = sums.sums.square[np.triu_indices(sums.sums.pull.size)].tobytes()
    db = sqlite3.connect(folder / database.FILE)
    db.executemany("INSERT INTO session VALUES (?, ?, '2026', ?)", (
        (k + 1, f"day {k}", float(k)) for k in range(1, TRIALS // PER_SESSION)))
    one = _trial(0)
    db.executemany("INSERT INTO trial VALUES (?, ?, ?, ?, '2026', 'gait', 'completed', 20.0, ?, ?, 'commit')", (
        (k + 1, k // PER_SESSION + 1, f"digest {k}", f"{k}.mcap", str(one.conditions).replace("'", '"'),
         str(one.figures).replace("'", '"')) for k in range(1, TRIALS)))
    db.executemany("INSERT INTO estimate VALUES (?, 1, '', ?, ?, ?, 0.1)", (
        (k + 1, upper, sums.sums.pull.tobytes(), sums.growth.tobytes())
        for k in range(PER_SESSION, TRIALS, PER_SESSION) if k > TRIALS - 100 * PER_SESSION))
    db.commit()
    db.close()


def peers() -> None:
    """Print the same three statements on SQLite and on DuckDB, one connection and one durable transaction an entry."""
    rows = [(k, k // PER_SESSION, f"digest {k}", f"{k}.mcap", 20.0) for k in range(TRIALS)]
    with tempfile.TemporaryDirectory() as place:
        for name, connect in (("SQLite", _sqlite), ("DuckDB", _duckdb)):
            try:
                db = connect(Path(place) / name)
            except ImportError:
                print(f"{name}: not installed")
                continue
            db.execute("CREATE TABLE trial (id INTEGER PRIMARY KEY, session INTEGER, digest TEXT UNIQUE, path TEXT, "
                       "seconds DOUBLE)")
            db.execute("BEGIN")
            for first in range(0, TRIALS, 1000):
                part = rows[first:first + 1000]
                db.execute(f"INSERT INTO trial VALUES {','.join(['(?, ?, ?, ?, ?)'] * len(part))}",
                           [value for row in part for value in row])
            db.execute("COMMIT")
            db.close()
            told = {what: _median(lambda k, what=what, connect=connect, name=name: _once(
                connect, Path(place) / name, what, k)) for what in STATEMENTS}
            print(f"{name:8}" + "".join(f"  {what} {1e3 * seconds:8.2f} ms" for what, seconds in told.items()))


STATEMENTS = {
    "open and add": "INSERT INTO trial VALUES (?, 1, ?, 'x', 20.0)",
    "open and list": "SELECT * FROM trial ORDER BY id DESC LIMIT 20",
    "open and sum by session": "SELECT session, count(*), sum(seconds) FROM trial GROUP BY session ORDER BY session",
}


def _once(connect: Callable[[Path], Any], path: Path, what: str, k: int) -> None:
    db = connect(path)
    given = [2 * TRIALS + k, f"new {k}"] if "add" in what else []
    db.execute(STATEMENTS[what], given).fetchall()
    db.close()


def _median(run: Callable[[int], None]) -> float:
    found = []
    for k in range(15):
        began = time.perf_counter()
        run(k)
        found.append(time.perf_counter() - began)
    return float(np.median(found))


def _sqlite(path: Path) -> Any:
    db = sqlite3.connect(path, isolation_level=None)
    db.execute("PRAGMA journal_mode = WAL")
    db.execute("PRAGMA synchronous = FULL")
    return db


def _duckdb(path: Path) -> Any:
    import duckdb  # type: ignore[import-not-found]

    return duckdb.connect(str(path))


if __name__ == "__main__":
    main()
