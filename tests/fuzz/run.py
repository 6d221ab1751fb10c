"""Feeds the surfaces: `python -m tests.fuzz.run [--surface NAME…] [--inputs N] [--seconds S] [--from N]`.

The rule of this file: it stops at `--inputs` or `--seconds` for each surface, whichever comes first, says which, and
writes what it found to `tests/fuzz/found/SURFACE.txt`, a number a line, which the tests run for ever after.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
import traceback
import warnings
from pathlib import Path

from tests.fuzz.surfaces import BURST, SURFACES, chance_of

FOUND = Path(__file__).parent / "found"
FRAMES = {"device": BURST, "sdo": BURST}
"""Frames in one input of the surfaces that take frames."""


def feed(job: tuple[str, int, int, float]) -> tuple[str, int, float, list[tuple[int, str]]]:
    """Feed one surface; returns its name, how many inputs, the seconds, and what was found."""
    name, first, inputs, seconds = job
    warnings.simplefilter("error")
    surface, found, began, number = SURFACES[name], [], time.monotonic(), first
    while number < first + inputs and time.monotonic() - began < seconds:
        try:
            surface(chance_of(name, number))
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            found.append((number, f"{type(error).__name__}: {str(error)[:160]} ({Path(where.filename).name}, "
                                  f"line {where.lineno})"))
        number += 1
    return name, number - first, time.monotonic() - began, found


def main() -> int:
    """Feed, print, keep what was found."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--surface", nargs="*", default=list(SURFACES), choices=list(SURFACES))
    asked.add_argument("--inputs", type=int, default=1_000_000)
    asked.add_argument("--seconds", type=float, default=1200.0)
    asked.add_argument("--from", dest="first", type=int, default=0)
    asked.add_argument("--jobs", type=int, default=2)
    given = asked.parse_args()
    jobs = [(name, given.first, given.inputs, given.seconds) for name in given.surface]
    total = 0
    with multiprocessing.Pool(given.jobs) as pool:
        for name, count, seconds, found in pool.imap_unordered(feed, jobs):
            kinds = {text.split(" (", 1)[-1] + text.split(":", 1)[0]: (number, text) for number, text in found}
            frames = f", {count * FRAMES[name]} frames" if name in FRAMES else ""
            print(f"{name:8} {count} inputs{frames} in {seconds:.0f} s, {len(found)} findings of {len(kinds)} kinds")
            for number, text in kinds.values():
                print(f"         {number}: {text}")
            if kinds:
                with (FOUND / f"{name}.txt").open("a", encoding="utf-8") as file:
                    file.writelines(f"{number}\n" for number, _text in kinds.values())
            total += len(found)
            sys.stdout.flush()
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
