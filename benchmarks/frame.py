"""Frame of the measures of this folder: processes that alternate, tables, and places in pages of docs.

Two pieces of work are compared in two processes that pass a token: only one runs at a time, in short turns, and counts
its own processor time.  What else runs on the machine strikes neighbouring turns alike, and their ratio stays.
"""

import csv
import json
import math
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
DOCS, OUT = ROOT / "docs", ROOT / "out"
Row = tuple[str, str, str, str, str]
"""Cells of a comparison: what, own figure, peer, the peer's figure, ratio with quartiles."""


def put(page: Path, name: str, text: str) -> None:
    """Replace the text between `<!-- name: begin -->` and `<!-- name: end -->`; ValueError without the marks."""
    page.write_text(filled(page, {name: text}), encoding="utf-8")


def filled(page: Path, tables: Mapping[str, str]) -> str:
    """Return the text of a page with each table between the marks of its name."""
    whole = page.read_text(encoding="utf-8")
    for name, text in tables.items():
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        before, first, behind = whole.partition(begin)
        _, second, after = behind.partition(end)
        if not (first and second):
            raise ValueError(f"{page}: lacks {begin} … {end}")
        whole = f"{before}{begin}\n{text.rstrip()}\n{end}{after}"
    return whole


def rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a table whose last column is a JSON object; none if the file does not exist."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [json.loads(line[-1]) for line in csv.reader(file)]


def write_rows(path: Path, keys: Sequence[str], found: Iterable[Mapping[str, Any]], mode: str = "w") -> None:
    """Write rows as JSON objects behind the values of `keys`; mode "a" appends them."""
    with path.open(mode, newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([*(row[key] for key in keys), json.dumps(row)] for row in found)


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (header, ["---"] * len(header), *rows))


def number(value: float, digits: int = 2) -> str:
    """Return a figure; "–" where it is not known, "stopped" where a trial did not complete."""
    return "–" if math.isnan(value) else "stopped" if math.isinf(value) else f"{value:.{digits}f}"


def quartiles(own: Sequence[float], peer: Sequence[float], digits: int = 1) -> str:
    """Return the median of peer / own, turn by turn, with its quartiles."""
    low, middle, high = np.quantile(np.array(peer) / np.array(own), (0.25, 0.5, 0.75))
    return f"{middle:.{digits}f} ({low:.{digits}f} … {high:.{digits}f})"


Turn = Callable[[], None]
"""To be called by a piece of work at the end of each turn; returns when the next one begins."""
Work = Callable[[Turn], None]
"""Sets itself up, then works turn after turn until `turn()` raises `DoneError`."""


class DoneError(BaseException):
    """Enough turns were measured; no trial ends safely for it."""


def repeated(turn: Turn, unit: Callable[[], object], units: int) -> None:
    """Do so many units of work in each turn."""
    while True:
        turn()
        for _ in range(units):
            unit()


def compare(name: str, own: Work, against: str, peer: Work, *, units: int, turns: int, warm: int = 5) -> Row:
    """Run both in processes of their own, `turns` turns each of `units` units, the first `warm` not counted; µs."""
    own_us, peer_us = np.array(_alternate((own, peer), turns + warm))[:, warm:] / units * 1e-3
    middle = float(np.median(own_us))
    return (name, f"{middle:.{1 if middle >= 1.0 else 2}f}", against, f"{np.median(peer_us):.1f}",
            quartiles(own_us, peer_us))


def _alternate(works: tuple[Work, Work], turns: int) -> list[list[int]]:
    context = multiprocessing.get_context("fork")
    ends = [context.Pipe() for _ in works]
    processes = [context.Process(target=_serve, args=(work, theirs, turns)) for work, (_, theirs) in
                 zip(works, ends, strict=True)]
    for process in processes:
        process.start()
    for ours, _ in ends:
        ours.recv()
    spent: list[list[int]] = [[], []]
    for _ in range(turns):
        for place, (ours, _) in enumerate(ends):
            ours.send(None)
            spent[place].append(ours.recv())
    for process in processes:
        process.join()
    return spent


def _serve(work: Work, pipe: Any, turns: int) -> None:
    turns_left, began = turns, -1

    def turn() -> None:
        nonlocal turns_left, began
        now = time.process_time_ns()
        pipe.send(None if began < 0 else now - began)
        if began >= 0:
            turns_left -= 1
        if not turns_left:
            raise DoneError
        pipe.recv()
        began = time.process_time_ns()

    with suppress(DoneError):
        work(turn)
    os._exit(0)


def map_pdo(pdo: Any, planned: Any) -> None:
    """Write the bench's mapping into a PDO of canopen."""
    pdo.clear()
    for word in planned.mapping:
        pdo.add_variable(word >> 16, word >> 8 & 0xFF, word & 0xFF)
    pdo.cob_id, pdo.enabled = planned.cob_id, True
    pdo.subscribe()
