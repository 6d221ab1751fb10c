"""Cost of a logbook of 100,000 trials, in SQLite and DuckDB; alarms and detection limits of drawn benches.

Commands:

    python -m benchmarks.logbook            performance; DuckDB only where it is installed
    python -m benchmarks.logbook --alarms DIR     false alarms on 500 drawn healthy benches, time to detection of drifts
    python -m benchmarks.logbook --shuffled DIR   false alarms on recorded sessions of a healthy bench in random orders
    python -m benchmarks.logbook --limits DIR     detection limit of each effect: ten sessions against two trials
"""

from __future__ import annotations

import argparse
import sqlite3
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from logbook.change_search import ALARM_NATS, candidates, search_changes
from logbook.session_model import CONSTANTS, SessionData, fit_sessions, measured_sd, sessions_of
from scipy.stats import binomtest

from diagnosis.evidence.detection_limits import least_size
from logbook import bench_page, database
from logbook.bench_state import NEWEST, state_of
from logbook.database import Estimate, NewTrial, open_logbook
from physics.path_constants import BENCH_SD, FREE, SESSION_SD, TABLE

TRIALS, PER_SESSION = 100_000, 10
SESSIONS, BENCHES = 60, 500
PUBLISHED = SESSION_SD[list(FREE)]
STIFFER = (("stiffness", 1.0), ("curve2", 0.4), ("curve3", 0.2))
"""Direction of the effect `stiffness` at the population's middle."""
DRIFTS: dict[str, Callable[[int], dict[str, float]]] = {
    "friction +10 % over 50 sessions": lambda k: {"cable": np.log(1.0 + 0.1 * min(max(k - 10, 0), 50) / 50)},
    "backlash 26 mrad": lambda k: {"play": 0.013 if k >= 20 else 0.0},
    "stiffness -10 %": lambda k: {name: np.log(0.9) * share for name, share in STIFFER if k >= 20},
    "START gain +3 %": lambda k: {"start_gain": 0.03 if k >= 20 else 0.0},
    "creep +0.01 mm/N": lambda k: {"creep": 1e-5 if k >= 20 else 0.0},
}
"""Departures by session, in coordinates; all begin after session 10 or at session 20."""


def main() -> None:
    """Print the measurements that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--alarms", type=Path, metavar="LOGBOOK",
                        help="logbook whose newest estimate gives the accuracy of a session")
    parser.add_argument("--shuffled", type=Path, metavar="LOGBOOK", help="logbook of a bench without a change")
    parser.add_argument("--limits", type=Path, metavar="LOGBOOK", help="logbook with at least ten sessions")
    parser.add_argument("--benches", type=int, default=BENCHES)
    given = parser.parse_args()
    if given.alarms:
        alarms(given.alarms, given.benches)
    elif given.shuffled:
        shuffled(given.shuffled, given.benches)
    elif given.limits:
        print(limits(given.limits))
    else:
        performance()


def performance() -> None:
    """Print the seconds of each operation on a logbook of `TRIALS` trials."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "book"
        database.create(folder, "large")
        _filled(folder)
        random = np.random.default_rng(1)
        size = len(CONSTANTS)
        found = Estimate(0.1 * random.normal(size=size) * PUBLISHED, np.diag(PUBLISHED**2), 8.0 * PUBLISHED, 0.1)

        def add(k: int = 0) -> None:
            with open_logbook(folder) as book:
                number, _ = book.enter_trial(_trial(TRIALS + k), f"day {TRIALS // PER_SESSION}")
                book.enter_estimate(number, 1, found)

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
    """Fill a logbook in one transaction; what entries cost is measured afterwards."""
    size = len(CONSTANTS)
    with open_logbook(folder) as book:
        book.enter_reference(CONSTANTS, [], np.zeros(len(TABLE)), b"", None)
    db = sqlite3.connect(folder / database.FILE)
    random = np.random.default_rng(0)
    upper = np.diag(PUBLISHED**2)[np.triu_indices(size)].tobytes()
    sessions = TRIALS // PER_SESSION
    db.executemany("INSERT INTO session VALUES (?, ?, '2026')", ((k + 1, f"day {k}") for k in range(sessions)))
    one = _trial(0)
    db.executemany("INSERT INTO trial VALUES (?, ?, ?, ?, '2026', 'gait', 'completed', 20.0, ?, ?, 'commit')", (
        (k + 1, k // PER_SESSION + 1, f"digest {k}", f"{k}.mcap", str(one.conditions).replace("'", '"'),
         str(one.figures).replace("'", '"')) for k in range(TRIALS)))
    db.executemany("INSERT INTO estimate VALUES (?, 1, '', ?, ?, ?, 0.1)", (
        (k + 1, (PUBLISHED * random.normal(size=size)).tobytes(), upper, (8.0 * PUBLISHED).tobytes())
        for k in range(0, TRIALS, PER_SESSION)))
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


def alarms(folder: Path, benches: int) -> None:
    """Print false alarms of drawn healthy benches and the time to detection of each drift.

    A session is drawn: published scatter about the bench, accuracy of the newest estimate of `folder`.  Each bench is
    searched after every tenth session, as if its report was written then; a session counts as one bench hour.
    """
    with open_logbook(folder) as book:
        kept = book.reference()
        assert kept is not None
        accuracy = book.estimates(kept.id, 1)[-1].estimate
        references = book.references
    information = np.linalg.inv(accuracy.covariance) - np.diag(accuracy.prior_sd**-2.0)
    lengths, axes = np.linalg.eigh(0.5 * (information + information.T))
    root = axes * np.sqrt(np.maximum(lengths, 0.0))
    information = root @ root.T
    worst, raised = [], 0
    for seed in range(benches):
        sessions = _drawn(seed, information, root, lambda k: {})
        best = max((search_changes(fit_sessions(sessions[:n], [], references), kept.bench)[0].nats
                    for n in range(references + 10, SESSIONS + 1, 10)), default=0.0)
        worst.append(best)
        raised += best >= ALARM_NATS
    _print_rate(raised, benches, benches * (SESSIONS - references), worst)
    for name, course in DRIFTS.items():
        delays, size = [], 20
        for seed in range(size):
            sessions = _drawn(10_000 + seed, information, root, course)
            first = next((n for n in range(12, SESSIONS + 1) if search_changes(
                fit_sessions(sessions[:n], [], references), kept.bench)[0].nats >= ALARM_NATS), None)
            delays.append(np.inf if first is None else first - (10 if "50" in name else 20))
        seen = [d for d in delays if np.isfinite(d)]
        median = float(np.median(delays))
        print(f"{name:34} detected {len(seen)} of {size}"
              + (f", median {median:.0f} sessions after its begin" if np.isfinite(median) else ""), flush=True)


def _print_rate(raised: int, benches: int, sessions: int, worst: Sequence[float]) -> None:
    """Print the share of benches that alarm and the alarms by session, each with its 95 % interval."""
    low, high = binomtest(raised, benches).proportion_ci()
    print(f"healthy: {raised} of {benches} benches alarm ({100.0 * low:.1f} … {100.0 * high:.1f} %), "
          f"{1000.0 * raised / sessions:.2f} in 1,000 sessions ({1000.0 * low * benches / sessions:.2f} … "
          f"{1000.0 * high * benches / sessions:.2f}, goal 1); largest evidence {max(worst):.1f} nats, 99 % "
          f"{np.quantile(worst, 0.99):.1f}, alarm from {ALARM_NATS:g}", flush=True)


def shuffled(folder: Path, benches: int) -> None:
    """Print false alarms of recorded sessions without a change, in `benches` random orders.

    The order of such sessions means nothing, so that each order is a bench without a change whose sessions were
    recorded and fitted, not drawn from the linear model.  A session counts as one bench hour.
    """
    with open_logbook(folder) as book:
        kept = book.reference()
        assert kept is not None
        sessions, references = sessions_of(book.estimates(kept.id, NEWEST)), book.references
    random, worst = np.random.default_rng(0), []
    for _ in range(benches):
        order = random.permutation(len(sessions))
        bench = [sessions[at]._replace(id=k + 1) for k, at in enumerate(order)]
        worst.append(max(search_changes(fit_sessions(bench[:n], [], references), kept.bench)[0].nats
                         for n in range(references + 10, len(bench) + 1, 20)))
    _print_rate(sum(v >= ALARM_NATS for v in worst), benches, benches * (len(sessions) - references), worst)


def limits(folder: Path) -> str:
    """Return the table of detection limits: sizes of one session's departure whose expected evidence is `ALARM_NATS`.

    By two reference trials under the published session deviations, and by the first ten sessions under the deviations
    that they measure; accuracy of a session: median of the logbook's.  A bench is known by n sessions with the
    precision P = P0 + n·M, M = (Λ⁻¹ + diag σ²)⁻¹; a size of a·σ_a has g = a·G, G = eᵀ(M − M(P + M)⁻¹M)e.
    """
    with open_logbook(folder) as book:
        kept = book.reference()
        assert kept is not None
        sessions = sessions_of(book.estimates(kept.id, NEWEST))
    few = _limits(sessions, PUBLISHED, 2, kept.bench)
    many = _limits(sessions, measured_sd(sessions[:10]), 10, kept.bench)
    rows = ["| effect | constant | two reference trials | ten sessions | ratio |", "| --- | --- | --- | --- | --- |"]
    for (name, constant, size), (_, _, less) in zip(few, many, strict=True):
        unit = TABLE[FREE[CONSTANTS.index(constant)]]
        by = "ln " if unit.form == "log" else ""
        rows.append(f"| {name} | {by}{constant} ({unit.unit or '1'}) | {size:.3g} | {less:.3g} | {less / size:.2f} |")
    ratios = [less / size for (_, _, size), (_, _, less) in zip(few, many, strict=True)]
    return "\n".join([*rows, "", f"Median ratio {np.median(ratios):.2f}; {sum(r < 1.0 for r in ratios)} of "
                      f"{len(ratios)} limits fall."])


def _limits(sessions: Sequence[SessionData], sd: Any, known: int, bench: Any) -> list[tuple[str, str, float]]:
    """Return effect, its largest constant in published deviations and the limit in it, by effects of the catalogue."""
    information = np.median([one.information for one in sessions], axis=0)
    lengths, axes = np.linalg.eigh(information)
    root = axes * np.sqrt(np.maximum(lengths, 0.0))
    information = root @ root.T
    one = np.linalg.solve(np.eye(sd.size) + information * sd**2, information)
    bench_precision = np.diag(BENCH_SD[list(FREE)] ** -2.0) + known * one
    seen = one - one @ np.linalg.solve(bench_precision + one, one)
    found = {}
    for candidate in (c for c in candidates(bench) if c.known):
        e = candidate.columns[:, 0]
        g = float(e @ seen @ e)
        at = int(np.argmax(np.abs(e) / PUBLISHED))
        found.setdefault(candidate.name, (candidate.name, CONSTANTS[at], least_size(g, ALARM_NATS) * abs(float(e[at]))))
    return list(found.values())


def _drawn(seed: int, information: Any, root: Any, course: Callable[[int], dict[str, float]]) -> list[SessionData]:
    random = np.random.default_rng(seed)
    found = []
    for k in range(SESSIONS):
        q = PUBLISHED * random.normal(size=PUBLISHED.size)
        for name, size in course(k).items():
            q[CONSTANTS.index(name)] += size
        found.append(SessionData(k + 1, information, information @ q + root @ random.normal(size=q.size)))
    return found


if __name__ == "__main__":
    main()
