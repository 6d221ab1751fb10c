"""The short set that runs with every change: fixed seeds, shorter trials, no second question.

The rule of this file: its seeds are ones on which the finder was right when the set was fixed, so it guards and does
not measure (`make hidden` does); a file of tests asks its part once, and a failure shows what was hidden and what was
said.

    python -m tests.hidden.quick [--more N]     every case and its answer; N further seeds where it is not right
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence

from tests.hidden.answers import Answer, answer
from tests.hidden.cases import Job

CYCLES, HEALTHY = 8, 2
PATH = {
    "cable_bend": 53000, "cable_friction": 50001, "drum_eccentricity": 51002, "fabric_creep": 51003,
    "fabric_friction": 50004, "fabric_wrap": 51005, "friction_drift": 50006, "knee_backlash": 50007,
    "load_dependent_friction": 50008, "moment_arm": 51009, "presliding": 51010, "slack": 51011, "stiffness": 52012,
    "stribeck": 50013, "viscous_friction": 56014}
SENSED = {
    "drive_asymmetry": 52100, "drive_coulomb": 52101, "drive_inertia": 50102, "drive_offset": 50103,
    "drive_viscous": 50104, "end_delay": 50105, "end_drift": 50106, "end_filter": 50107, "end_gain": 50108,
    "end_mass": 50109, "end_offset": 50110, "start_drift": 50111, "start_gain": 50112, "start_offset": 50113,
    "timestamp_skew": 50114}
HEALTHY_SEEDS = (50200, 50201, 50202, 50203, 50204, 50205, 50206, 50207, 50208, 50209, 50211, 50212)
OUTSIDE = {"thump": 50300, "temperature": 52301, "resonance": 50302}
PAIRS = (50400, 50401, 50402, 50403)
WIRE = {"lost_pdo": 50500, "late_pdo": 50501, "quantisation": 50502}


def one(seeds: Mapping[str, int], kind: str = "one") -> list[Job]:
    """Return a case of each name; odd seeds have an altered structure."""
    return [Job(kind, seed, (name,), seed % 2 == 1) for name, seed in seeds.items()]


def drawn(seeds: Sequence[int], kind: str) -> list[Job]:
    """Return a case of each seed, what is hidden drawn by it."""
    return [Job(kind, seed, (), seed % 2 == 1) for seed in seeds]


def ask(asked: Sequence[Job]) -> list[Answer]:
    """Return the answers, in order."""
    return [answer(job, CYCLES, HEALTHY, again=False) for job in asked]


def right(a: Answer) -> bool:
    """Say whether an answer is as it should be: all that was hidden is in the class, or no name where none is.

    What is too small to count may be missed, and not be called by another name.
    """
    if a.job.kind in ("none", "outside"):
        return a.verdict == {"none": "none", "outside": "unexplained"}[a.job.kind]
    return set(a.hidden) <= set(a.rivals) or (not a.counts and a.verdict == "none")


def wrong(a: Answer) -> bool:
    """Say whether a name was given and none of what was hidden is among them."""
    return a.named and not set(a.hidden) & set(a.rivals)


def of(told: Sequence[Answer], holds: Callable[[Answer], bool]) -> list[str]:
    """Return, as text, the answers of which something holds."""
    return [f"{a.job.seed}: {' + '.join(a.hidden) or 'nothing'} → {a.verdict} {', '.join(a.rivals)} ({a.ratio:.2f})"
            for a in told if holds(a)]


def main() -> None:
    """Print every case and its answer."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--more", type=int, default=0)
    more = parser.parse_args().more
    for job in (*one(PATH), *one(SENSED), *drawn(HEALTHY_SEEDS, "none"), *one(OUTSIDE, "outside"), *drawn(PAIRS, "two"),
                *one(WIRE, "wire")):
        for seed in range(job.seed, job.seed + 1000 * more + 1, 1000):
            told = ask([Job(job.kind, seed, job.names, seed % 2 == 1)])
            print("right" if right(told[0]) else "  not", *of(told, lambda a: True), flush=True)
            if right(told[0]):
                break


if __name__ == "__main__":
    main()
