"""Alarms, dates and names of a logbook on recorded sessions, without a change and with one.

    python -m benchmarks.logbook --recorded DIR [--kinds NAMES] [--serials 0,1] [--healthy 20] [--sessions 8]
                                 [--changes NAMES]

Serials with serial % 3 == 2 are set aside: nothing is tuned on them but on 50 (decision 61; `tests.plants.draws`).  A
session is six gait cycles, recorded once into DIR and entered as `bowden logbook add` does.  The constants of a
session are drawn anew within the tolerance of like benches, or, for the packaged plant, are those of another `--day`.
A change begins in session `BEGINS`; the sessions before it are the bench's own without a change, fitted once for all
its logbooks.
"""

import argparse
import math
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

import bowden
from bowden.bench import buses
from bowden.models import logbook_entries
from bowden.models.logbook_entries import diagnosed_state
from logbook import database
from logbook.bench_state import BenchState, averaged_nats
from logbook.database import open_logbook
from physics.parameters import PARAMETERS
from tests.hidden.family import like
from tests.plants import draws, imposed
from tests.plants.bench import IMPLEMENTATIONS, Bench, replaced
from virtual_bus.build import nominal
from virtual_bus.machine.scatter import scattered

PACKAGED: Final = "packaged"
KINDS: Final = (*IMPLEMENTATIONS, PACKAGED)
BEGINS: Final = 3
"""First changed session, counted from 0: the fourth one."""
WEAR_SESSIONS: Final = 8
"""Sessions over which wear raises the friction of the cable."""
CYCLES, PERIOD_S, PEAK_N, RATE_HZ, NOISE_N = 6, 1.2, 40.0, 500, 0.1


class ChangeCase(NamedTuple):
    """A change of a bench, by number of the session since it began, and its right answer.

    `family`: the changed bench of the family; `packaged`: effect and parameter of the packaged plant, and its value
    from the one of that session.  `part`: the part of the bench that the diagnosis should name.
    """

    family: Callable[[Bench, int], Bench]
    packaged: tuple[str, str, Callable[[float, int], float]]
    part: str


def _worn(since: int, most: float) -> float:
    return 1.0 + most * min(since + 1, WEAR_SESSIONS) / WEAR_SESSIONS


CHANGES: Final[Mapping[str, ChangeCase]] = {
    "START gain +4 %": ChangeCase(
        lambda b, k: replaced(b, start_gain=1.04 * b.start_gain), ("start_gain", "start_gain", lambda v, k: 1.04 * v),
        "elasticity and gains"),
    "stiffness -12 %": ChangeCase(
        lambda b, k: replaced(b, stiffness=0.88 * b.stiffness), ("stiffness", "stiffness_scale", lambda v, k: 0.88 * v),
        "elasticity and gains"),
    "friction +30 %": ChangeCase(
        lambda b, k: replaced(b, mu1=1.3 * b.mu1), ("cable_friction", "mu1", lambda v, k: 1.3 * v),
        "friction path"),
    "backlash 26 mrad": ChangeCase(
        lambda b, k: replaced(b, play=b.play + 0.026), ("knee_backlash", "knee_backlash", lambda v, k: v + 0.026),
        "geometry"),
    "wear +30 % over 8": ChangeCase(
        lambda b, k: replaced(b, mu1=_worn(k, 0.3) * b.mu1), ("cable_friction", "mu1", lambda v, k: _worn(k, 0.3) * v),
        "friction path"),
}


@cache
def _motion(kind: str, serial: int) -> imposed.Motion:
    return imposed.gait(draws.draw(serial, implementation=kind), PEAK_N, PERIOD_S, CYCLES)


def record(folder: Path, kind: str, serial: int, session: int, change: str | None = None) -> Path:
    """Record one session of a bench and return its file; a file that is there already is not recorded again."""
    changed = change is not None and session >= BEGINS
    name = "healthy" if not changed else "".join(c if c.isalnum() else "_" for c in str(change))
    path = folder / f"{kind}-{serial}-{name}-{session}{'.mcap' if kind == PACKAGED else '.csv'}"
    if path.exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    case = CHANGES[change] if changed and change is not None else None
    if kind == PACKAGED:
        _run(path, serial, session, {} if case is None else _stated(case, serial, session))
        return path
    rng = np.random.default_rng((serial, session, 17))
    bench = like(draws.draw(serial, implementation=kind), rng)
    bench = bench if case is None else case.family(bench, session - BEGINS)
    columns = imposed.trial(bench, 1000 * serial + session, motion=_motion(kind, serial), noise_n=NOISE_N,
                            rate_hz=RATE_HZ).columns
    np.savetxt(path, np.stack(list(columns.values()), axis=1), fmt="%.8g", delimiter=",", header=",".join(columns),
               comments="")
    return path


def _stated(case: ChangeCase, serial: int, session: int) -> dict[str, dict[str, float]]:
    """Return the effect of a case on the packaged plant, whose parameter is that of the serial and session, changed."""
    effect, parameter, value = case.packaged
    group, field = PARAMETERS[parameter].plant.split(".")
    own = scattered(nominal(None), serial, session)[group][field]
    return {effect: {parameter: value(own, session - BEGINS)}}


def _run(path: Path, serial: int, session: int, effects: Mapping[str, Mapping[str, float]]) -> None:
    """Run the packaged plant's gait on the day of a session, through the wire."""
    bus = buses.simulated(serial=serial, day=session, plant_model={"effects": dict(effects)} if effects else None)
    asked = bowden.Experiment(peak_n=PEAK_N, period_s=PERIOD_S, cycles=CYCLES, settle=0)
    result = bowden.run(asked, bus=bus, output=path).figures
    if result["outcome"] != "completed" or not math.isfinite(result["simulated_s"]):
        raise RuntimeError(f"{path}: {result['stop_reason']}")


class Outcome(NamedTuple):
    """A logbook's answer on one bench: log Bayes factor of a change, nats, whether it is stated, its first session, its
    effects and the part of the bench."""

    nats: float
    changed: bool
    since: str | None
    effects: tuple[str, ...]
    part: str | None

    def __str__(self) -> str:
        """Return the outcome as one line."""
        return (f"{', '.join(self.effects) or 'no effect'} ({self.part}), since session {self.since}, "
                f"{self.nats:.1f} nats" if self.changed else f"no change, {self.nats:.1f} nats")


def main() -> None:
    """Print the measurements that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recorded", type=Path, metavar="DIR", required=True, help="folder of the recorded sessions")
    parser.add_argument("--kinds", default=",".join(KINDS), help="methods of the family and the packaged plant")
    parser.add_argument("--serials", default="0", help="serials of each kind, with commas")
    parser.add_argument("--healthy", type=int, default=20, help="sessions of a bench without a change")
    parser.add_argument("--sessions", type=int, default=8, help="changed sessions of a bench with a change")
    parser.add_argument("--changes", default=",".join(CHANGES), help="changes, with commas")
    given = parser.parse_args()
    benches = [(kind, int(serial)) for serial in given.serials.split(",") for kind in given.kinds.split(",")]
    names = [name for name in given.changes.split(",") if name]
    found: dict[str | None, list[Outcome]] = {name: [] for name in (None, *names)}
    for kind, serial in benches:
        for name, outcome in followed(given.recorded, kind, serial, given.healthy, given.sessions, names):
            found[name].append(outcome)
            print(f"{kind} {serial}, {name or 'no change'}: {outcome}", flush=True)
    print(f"\n| change | benches | stated | dated within a session | of these in the right part |\n|{'---|' * 5}")
    for name, outcomes in found.items():
        case = CHANGES[name] if name else None
        near = [one for one in outcomes if one.since is not None and abs(int(one.since) - BEGINS) <= 1]
        last = (len(near), sum(one.part == case.part for one in near)) if case else ("–", "–")
        stated = sum(one.changed for one in outcomes)
        print(f"| {name or f'none, {given.healthy} sessions'} | {len(outcomes)} | {stated} | {last[0]} | {last[1]} |")


def followed(folder: Path, kind: str, serial: int, healthy: int, sessions: int, names: Sequence[str]
             ) -> Iterator[tuple[str | None, Outcome]]:
    """Yield the answer on a bench without a change, after the session with the most evidence, and with each change."""
    with tempfile.TemporaryDirectory() as place:
        begun = Path(place) / "begun"
        database.create(begun, f"{kind} {serial}")
        logbook_entries.add(begun, {record(folder, kind, serial, k): str(k) for k in range(BEGINS)})
        for number, name in enumerate((None, *names)):
            book = Path(shutil.copytree(begun, Path(place) / str(number)))
            last, found = BEGINS + sessions if name else healthy, []
            for k in range(BEGINS, last):
                logbook_entries.add(book, {record(folder, kind, serial, k, name): str(k)})
                if name is None or k == last - 1:
                    with open_logbook(book) as opened:
                        found.append(_outcome(diagnosed_state(opened)))
            if found:
                yield name, max(found, key=lambda one: (one.changed, one.nats))


def _outcome(state: BenchState) -> Outcome:
    nats = averaged_nats(state.changes) if state.changes else -math.inf
    if not state.alarms:
        return Outcome(nats, False, None, (), None)
    return Outcome(nats, True, state.labels.get(state.alarms[0].since), state.named(), state.caused()["part"])


if __name__ == "__main__":
    main()
