"""The matrix with the safety monitor: `python -m tests.faults.monitor_alone [--guards alone master both] [--drive …]
[--rows PATTERN] [--moments …] [--gait WORDS] [--every N] [--csv FILE] [--page FILE]`. A run replaces its own runs in
the CSV and keeps the others.

Supervisions of one fault: the monitor alone (the master's checks are switched off here, in this process; the product
has no such switch), the master without a monitor, and both. `--drive bought`: a drive that protects nothing by itself.
The bounds are those of the issue "Safe through the stop"; the exit status is 1 if one is broken.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import itertools
import math
import re
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import numpy as np

import safety_monitor
from eds.cia301 import Emcy
from master.cycle.guard import Guard
from master.cycle.safety import StopError
from nodes.drives import axis_law
from nodes.drives.drive import Drive
from nodes.drives.servo import ServoDrive
from tests.faults import judge
from tests.faults.rows import ROWS
from tests.faults.stage import Row, Told, Walk, trial

BEYOND_DEG: Final = 5.0
"""Degrees by which a fault may take the leg beyond the person's range."""
SINGLE, PRESENT = (120.0, 80.0), (judge.OVER * judge.START_LIMIT_N, judge.OVER * judge.END_LIMIT_N)
BOUNDS_N: Final = {"alone": SINGLE, "master": PRESENT, "both": PRESENT}
"""Bounds of true START and END, N: those of a single fault without the master, and those of the matrix with it."""
GUARDS: Final = ("alone", "master", "both")
WORDS: Final = {"alone": "monitor alone", "master": "master, no monitor", "both": "both"}
BY: Final = {int(code): code.text.partition(": ")[2] for code in Emcy if code.name.startswith("MONITOR_")}
BEGIN, END = "<!-- monitor: begin -->", "<!-- monitor: end -->"
WORST: Final = 12
"""Rows of each supervision that the page shows; the CSV has all of them."""


class Supervised(NamedTuple):
    """One fault under one supervision: greatest true tensions, N, range of the leg, degrees, and who stopped it."""

    drive: str
    guard: str
    fault: str
    moment: str
    walk: str
    start_n: float
    end_n: float
    low_deg: float
    high_deg: float
    stopped_by: str
    within: bool


def supervised(row: Row, told: Told, guard: str, drive: str, walk: Walk, bounds: safety_monitor.Bounds) -> Supervised:
    """Return what a fault did to the limb, from its beginning to the end of the recording."""
    paths = [true[true[:, 0] > told.fault_ns] for true in told.paths]
    start_n, end_n = (max(float(true[:, place].max(initial=0.0)) for true in paths) for place in (1, 2))
    legs = np.degrees(np.concatenate([true[:, 3] for true in paths]))
    low, high = float(legs.min(initial=0.0)), float(legs.max(initial=-90.0))
    most_start_n, most_end_n = BOUNDS_N[guard]
    within = (start_n <= most_start_n and end_n <= most_end_n and low >= bounds.knee_low_deg - BEYOND_DEG
              and high <= bounds.knee_high_deg + BEYOND_DEG)
    return Supervised(drive, guard, row.name, told.moment, str(walk), round(start_n, 1), round(end_n, 1),
                      round(low, 1), round(high, 1), _stopped_by(told), within)


def _stopped_by(told: Told) -> str:
    """Return the monitor's cause if it opened the line, else the master's reason."""
    texts = [text for _time, kind, _source, text in told.events if kind == "emcy"]
    cause = next((name for code, name in BY.items() for text in texts if f"0x{code:04X}" in text), None)
    if cause is not None:
        return f"monitor: {cause}"
    return (told.crashed or told.reason or "nobody")[:80]


def unchecked() -> Any:
    """Make the master's checks conclude nothing while this context lasts; what they learn and record stays."""
    return patch.multiple(Guard, **{name: _concluding_nothing(getattr(Guard, name))
                                    for name in ("check", "check_gait", "heed", "heed_strangers")})


def _concluding_nothing(check: Any) -> Any:
    def checked(*given: Any, **named: Any) -> None:
        with suppress(StopError):
            check(*given, **named)
    return checked


class _Bought:
    """While it lasts, drives have no tension limit, no step limit and no comparison of velocity with position
    and with the torque's sign."""

    ABSENT: Final = frozenset({0x2012, 0x2013, 0x2017, 0x2018})

    def __enter__(self) -> None:
        configure, number, absent = ServoDrive.configure, Drive.number, self.ABSENT
        plain = Drive.configure

        def of_servo(drive: Any) -> None:
            configure(drive)
            drive.axis.g[[axis_law.TENSION_LIMIT, axis_law.HOLD_TORQUE, axis_law.UNTRUSTED_TORQUE]] = math.inf

        def of_any(drive: Any) -> None:
            plain(drive)
            drive.axis.g[[axis_law.APART_LIMIT, axis_law.GAINED_LIMIT]] = math.inf

        self._patches = [
            patch.object(ServoDrive, "configure", of_servo), patch.object(Drive, "configure", of_any),
            patch.object(Drive, "number", lambda drive, index, sub=0: 0 if index in absent else number(
                drive, index, sub))]
        for one in self._patches:
            one.start()

    def __exit__(self, *_error: object) -> None:
        for one in reversed(self._patches):
            one.stop()


def bench(guard: str, person: Path, bounds: safety_monitor.Bounds) -> dict[str, Any]:
    """Return the options of a bench whose mechanical end stops are set to the person's range."""
    stops = {"stop_low_rad": math.radians(bounds.knee_low_deg), "stop_high_rad": math.radians(bounds.knee_high_deg)}
    monitor = {} if guard == "master" else {"monitor": str(person)}
    return {"plant_model": {"plant": stops}, **monitor}


def ran(rows: Mapping[Walk, Sequence[Row]], guard: str, drive: str, person: Path, jobs: int) -> Iterator[Supervised]:
    """Run the rows of each walk under one supervision."""
    bounds = safety_monitor.read(person)
    for walk, mine in rows.items():
        by_name = {row.name: row for row in mine}
        with ExitStack() as switched:
            if guard == "alone":
                switched.enter_context(unchecked())
            if drive == "bought":
                switched.enter_context(_Bought())
            found, twin = trial(mine, jobs, walk, **bench(guard, person, bounds))
        if twin.reason is not None or _stopped_by(twin) != "nobody":
            raise SystemExit(f"the twin stopped ({walk}, {guard}): {_stopped_by(twin)}")
        for told in found:
            yield supervised(by_name[told.name], told, guard, drive, walk, bounds)


def chosen(pattern: str, moments: Sequence[str], every: int, gait: str = "") -> dict[Walk, list[Row]]:
    """Return the rows that match, at these moments or their own, one in `every` of the runs, by the walk they break.

    A slow fault is run in one gait alone, its shortest or the first of its walks that has the words of `gait`.
    """
    count = itertools.count()
    found: dict[Walk, list[Row]] = {}
    for row in ROWS:
        walk = next((walk for walk in row.walks if gait in str(walk)), row.walks[0])
        own = walk.moments or row.moments
        at = tuple(m for m in own if (not moments or m in moments or m == "start") and next(count) % every == 0)
        if at and re.search(pattern, row.name):
            found.setdefault(walk, []).append(dataclasses.replace(row, moments=at, walks=(walk,)))
    return found


# ---- output ----


def table(found: Sequence[Supervised]) -> list[str]:
    """Return the page's section: how many runs of each supervision keep the bounds, and the worst of them."""
    lines = ["| drive | supervision | runs | within the bounds | START (N) | END (N) | leg (degrees) |",
             "|---|---|---|---|---|---|---|"]
    for (drive, guard), rows in _grouped(found):
        lines.append(f"| {drive} | {WORDS[guard]} | {len(rows)} | {sum(row.within for row in rows)} | "
                     f"{max(row.start_n for row in rows):.0f} | {max(row.end_n for row in rows):.0f} | "
                     f"{min(row.low_deg for row in rows):.0f} … {max(row.high_deg for row in rows):.0f} |")
    lines += ["", "| drive | supervision | beyond a bound | at | START / END (N) | leg (degrees) | stopped by |",
              "|---|---|---|---|---|---|---|"]
    for (drive, guard), rows in _grouped(found):
        beyond = sorted((row for row in rows if not row.within), key=lambda row: -row.start_n)
        lines += [f"| {drive} | {WORDS[guard]} | {row.fault} | {row.moment} | {row.start_n:.0f} / {row.end_n:.0f} | "
                  f"{row.low_deg:.0f} … {row.high_deg:.0f} | {row.stopped_by} |" for row in beyond[:WORST]]
        if len(beyond) > WORST:
            lines.append(f"| {drive} | {WORDS[guard]} | {len(beyond) - WORST} more in monitor.csv | | | | |")
    return lines


def _grouped(found: Iterable[Supervised]) -> list[tuple[tuple[str, str], list[Supervised]]]:
    groups: dict[tuple[str, str], list[Supervised]] = {}
    for row in found:
        groups.setdefault((row.drive, row.guard), []).append(row)
    return list(groups.items())


def kept(path: Path | None) -> list[Supervised]:
    """Return the rows of a CSV that an earlier run wrote; none where there is no file."""
    if path is None or not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return [Supervised(*row[:5], *map(float, row[5:9]), row[9], row[10] == "True")  # type: ignore[misc, arg-type]
                for row in itertools.islice(csv.reader(file), 1, None)]


def save(path: Path | None, found: Sequence[Supervised]) -> list[Supervised]:
    """Return the rows in the order of the supervisions, the last one of each run, and write them as CSV."""
    last = {(row.drive, row.guard, row.fault, row.moment, row.walk): row for row in found}
    rows = sorted(last.values(), key=lambda row: (row.drive != "own", GUARDS.index(row.guard)))
    if path is not None:
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(Supervised._fields)
            writer.writerows(rows)
    return rows


def main() -> int:
    """Run, print, write."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--guards", nargs="*", choices=GUARDS, default=GUARDS)
    asked.add_argument("--drive", nargs="*", choices=("own", "bought"), default=("own",))
    asked.add_argument("--rows", default="")
    asked.add_argument("--moments", nargs="*", default=())
    asked.add_argument("--every", type=int, default=1, help="one run in so many")
    asked.add_argument("--gait", default="", help="words of a slow fault's gait: extended, 2 s")
    asked.add_argument("--person", type=Path, default=safety_monitor.packaged())
    asked.add_argument("--csv", type=Path)
    asked.add_argument("--page", type=Path)
    asked.add_argument("--jobs", type=int, default=2)
    given = asked.parse_args()
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):  # a shell's background job ignores some of them
        signal.signal(getattr(signal, name), signal.SIG_DFL)
    turns = list(itertools.product(given.drive, given.guards))
    found = kept(given.csv)
    rows = chosen(given.rows, given.moments, given.every, given.gait)
    for drive, guard in turns:
        for row in ran(rows, guard, drive, given.person, given.jobs):
            found.append(row)
            save(given.csv, found)
            print(f"{'      ' if row.within else 'BEYOND'} {row.drive:6} {row.guard:6} {row.fault:42} "
                  f"{row.moment:7} {row.start_n:6.1f}/{row.end_n:6.1f} N {row.low_deg:6.1f}…{row.high_deg:5.1f}°  "
                  f"{row.stopped_by}", flush=True)
    lines = table(found := save(given.csv, found))
    print("\n".join(lines))
    if given.page:
        text = given.page.read_text(encoding="utf-8")
        before, after = text.split(BEGIN)[0], text.split(END)[1]
        given.page.write_text("\n".join([before + BEGIN, *lines, END]) + after, encoding="utf-8")
    return int(any(not row.within for row in found))


if __name__ == "__main__":
    sys.exit(main())
