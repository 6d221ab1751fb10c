"""Controller on benches that nothing was tuned on: the family of tests/plants, beside the own plant.

    python -m benchmarks.family [--set-aside] [--serials 0,1,3] [--own 1,3] [--again] [--workers N] [--page]

The rule of this file: a bench is identified on day 0 and walked on day 1, through the wire, by the controller as it
ships; each bench is a row of docs/unseen.csv, so that what was interrupted goes on, and docs/unseen.md is made from it
alone (`--page` does only that).  Serials with serial % 3 == 2 are set aside: nothing is tuned on them, they are run
once, by --set-aside.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.family_page import page
from benchmarks.family_walks import DEVELOPMENT, OWN, SET_ASIDE, append, compact, measure, read
from benchmarks.frame import DOCS


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the benches that the table lacks, and write and print the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.family")
    parser.add_argument("--set-aside", action="store_true", help="the serials that nothing was tuned on, once")
    parser.add_argument("--serials", help="serials of the family, with commas")
    parser.add_argument("--own", help="serials of the own plant, with commas")
    parser.add_argument("--count", type=int, help="only so many of them")
    parser.add_argument("--again", action="store_true", help=(
        "walk benches of the table again: gait trials anew, scalars as they were identified"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--page", action="store_true", help="only print the tables of what has been run")
    options = parser.parse_args(arguments)
    path = DOCS / "unseen.csv"
    done = read(path)
    if not options.page:
        chosen = _serials(options.serials, SET_ASIDE if options.set_aside else DEVELOPMENT)[:options.count]
        wanted = [("family", s) for s in chosen] + [("own", s) for s in _serials(options.own, OWN)]
        lacking = [each for each in wanted if options.again or each not in done]
        _run([(*each, done.get(each)) for each in lacking], path, options.workers)
        done = compact(path)
    text = page(list(done.values()))
    (DOCS / "unseen.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


def _short(value: Any) -> Any:
    """Return a figure, or each figure of a dict or list, with five digits; None if it is not finite."""
    if isinstance(value, float):
        return float(f"{value:.5g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items() if key not in ("date", "trial", "unit")}
    return [_short(each) for each in value] if isinstance(value, list) else value


def _serials(given: str | None, otherwise: Sequence[int]) -> list[int]:
    return list(otherwise) if given is None else [int(text) for text in given.split(",") if text]


def _run(wanted: Sequence[tuple[str, int, Mapping[str, Any] | None]], path: Path, workers: int) -> None:
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as crew:
        for future in as_completed([crew.submit(measure, *each) for each in wanted]):
            found = future.result()
            append(path, _short(found))
            sys.stderr.write(f"{found['kind']} {found['serial']}: {found.get('failed', 'done')}\n")


if __name__ == "__main__":
    main()
