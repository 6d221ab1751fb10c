"""Known changes and repeats of measured rigs through the evidence core: `python -m benchmarks.rig_changes [--other]`.

The recordings are those beside the repository (`../shared/data`).  Half of the cases was used for development, and
`--other` asks the rest.  A change is right if its cause is in the answer's set and every name is allowed; a repeat is
right if the answer is `none`.  Last, the changes are counted that exceed three times what repeats differ by, both by
hand: the friction of a seal as half of what its strokes are apart, the gravity of the pendulum by linear regression
where it moves.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from diagnosis.evidence.evidence_finder import EvidenceFinder
from estimation.data.table import Table, read
from estimation.rig_model import RigModel
from parameters import InputError

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FRICTION = frozenset({"cable_friction", "viscous_friction", "load_dependent_friction", "stribeck", "presliding"})
MASS = frozenset({"unbalance", "demand_gain"})
"""Names that a mass may have: a force that is off by a factor differs from a mass in friction alone.

The torque of gain 400 is off by 1.18 against gain 200; `tests/diagnosis/test_diagnosis_pendulum.py` computes it."""
LEVER_M, GRAVITY = 0.1, 9.81
SESSIONS = ("rerun1", "reconnected3", "rerun3", "reconnected2")


class RigCase(NamedTuple):
    """Recordings of a rig before and after a change that is known.

    `kind`: sort of the change; `reference`, `files`: recordings before and after it; `change`: applied to each of
    `files`; `cause`: effects of which the diagnosis must name one (empty: nothing has changed); `allowed`: effects that
    it may name too.
    """

    kind: str
    reference: tuple[Path, ...]
    name: str
    files: tuple[Path, ...]
    cause: frozenset[str] = frozenset()
    allowed: frozenset[str] = frozenset()
    change: Callable[[Table], Table] = lambda trial: trial

    @property
    def trials(self) -> tuple[Table, ...]:
        """Recordings after the change, read from their files."""
        return tuple(self.change(read(path)) for path in self.files)


def _files(pattern: str) -> tuple[Path, ...]:
    return tuple(sorted(DATA.glob(pattern)))


def _rubs(given: Table, share: float) -> Table:
    """Return a recording whose friction is times `share`; the mean of both directions belongs to the sensors."""
    apart = given["tension_start_n"] - given["tension_end_n"]
    return replace(given, digest=f"{given.digest}{share}", columns={
        **given.columns, "tension_start_n": given["tension_start_n"] + (share - 1.0) * (apart - apart.mean())})


def heavier(given: Table, mass_kg: float) -> Table:
    """Return a recording of the pendulum with a mass beside its own one."""
    angle, step = given["servo_position_m"], float(np.median(np.diff(given["time_s"])))
    turns = savgol_filter(angle, 11, 3, deriv=2, delta=step)
    more = mass_kg * (LEVER_M**2 * turns + GRAVITY * LEVER_M * np.sin(angle))
    return replace(given, digest=f"{given.digest}{mass_kg}", columns={
        **given.columns, "servo_force_n": given["servo_force_n"] + more})


def cases() -> list[RigCase]:
    """Return every case, the pairs of a kind in turns: one for development, one set aside."""
    seal, same = "pneumatic_seal/", _files("pneumatic_seal/oring257_*_fit*") + _files("pneumatic_seal/oring257_*_hold*")
    made = [RigCase("seal", _files(f"{seal}{a}_*"), f"{a} → {b}", _files(f"{seal}{b}_*"), FRICTION, FRICTION)
            for a, b in (("circle", "napn"), ("napn", "circle"), ("napn", "pk"), ("pk", "napn"), ("circle", "pk"),
                         ("pk", "circle"))]
    again = {name: _files(f"{seal}oring257_{name}_*") for name in SESSIONS}
    made += [RigCase("repeat", same, f"oring → {name}", files) for name, files in again.items()]
    made += [RigCase("seal", same, f"oring {name} × {share}", again[name], FRICTION, FRICTION,
                     partial(_rubs, share=share))
             for share in (0.5, 2.0, 0.7, 1.4, 3.0) for name in ("rerun3", "reconnected2")]
    gains = {gain: _files(f"servo_pendulum/{gain}*") for gain in ("kp200", "kp400")}
    for own, other in (("kp200", "kp400"), ("kp400", "kp200")):
        made.append(RigCase("repeat", gains[own], f"{own} → {other}", gains[other]))
        made += [RigCase("mass", gains[own], f"{own} → {other} + {mass} kg",
                         gains[other], frozenset({"unbalance"}), MASS, partial(heavier, mass_kg=mass))
                 for mass in (0.1, 0.2, 0.4)]
    made.append(RigCase("repeat", _files("cable_drive/fit/*"), "cable drive", _files("cable_drive/check/*")))
    made.append(RigCase("repeat", _files("tribometer/fit*"), "tribometer", _files("tribometer/holdout*")))
    return made


def by_hand(kind: str, trials: Sequence[Table]) -> float:
    """Return the size of what may have changed: friction of a seal, N, or gravity of the pendulum, N·m."""
    return float(np.mean([rigid_body(t)[0] if kind == "servo_pendulum" else _friction(t) for t in trials]))


def _friction(given: Table) -> float:
    apart, speed = given["tension_start_n"] - given["tension_end_n"], np.gradient(given["servo_position_m"])
    fast = 0.3 * np.quantile(np.abs(speed), 0.9)
    return 0.5 * abs(float(apart[speed > fast].mean() - apart[speed < -fast].mean()))


def rigid_body(given: Table) -> tuple[float, float]:
    """Return gravity, N·m, and inertia, kg·m², of the pendulum by linear regression where it moves."""
    angle, step = given["servo_position_m"], float(np.median(np.diff(given["time_s"])))
    speed, turns = (savgol_filter(angle, 31, 3, deriv=k, delta=step) for k in (1, 2))
    moves = np.abs(speed) > 0.15
    columns = np.stack([np.sin(angle), np.cos(angle), turns, np.sign(speed), speed], axis=1)
    found = np.linalg.lstsq(columns[moves], given["servo_force_n"][moves], rcond=None)[0]
    return float(found[0]), float(found[2])


def plain(told: Sequence[tuple[RigCase, bool, bool]], rig: str, times: float = 3.0) -> tuple[int, int]:
    """Return how many changes of a rig exceed `times` what all its repeats differ by (RMS), and how many are right."""
    def size(case: RigCase) -> float:
        return abs(float(np.log(by_hand(rig, case.trials) / by_hand(rig, [read(p) for p in case.reference]))))

    repeats = [size(case) for case in cases() if case.kind == "repeat" and case.reference[0].parent.name == rig]
    least = times * np.sqrt(np.mean(np.square(repeats)))
    beyond = [right for case, right, _ in told
              if case.cause and case.reference[0].parent.name == rig and size(case) > least]
    return len(beyond), sum(beyond)


def _asked(finder: EvidenceFinder, case: RigCase) -> tuple[bool, bool]:
    """Print one case; return whether it is right and whether a wrong name was given."""
    try:
        found = finder.diagnose(case.trials)
    except InputError as error:
        print(f"{case.kind:7} {case.name:28} refused: {error}")
        return False, False
    named = set(found.rivals)
    wrong = bool(named - case.allowed)
    right = (bool(named & case.cause) and not wrong) if case.cause else found.verdict == "none"
    best = next(iter((found.evidence or {}).get("log_bayes_factors", {}).items()), ("", 0.0))
    errors = (found.evidence or {}).get("error_n", {})
    print(f"{case.kind:7} {case.name:28} {'right' if right else 'WRONG' if wrong else 'missed':6} {found.verdict:11} "
          f"{', '.join(found.rivals):40} {best[0]} {best[1]:.1f} nats; "
          + " → ".join(f"{errors.get(n, 0.0):.3g}" for n in ("reference", "before", "after")), flush=True)
    return right, wrong


def main(arguments: Sequence[str]) -> None:
    """Print the table of one half of the cases, and the share of changes and repeats that were right."""
    half = int("--other" in arguments)
    finders: dict[tuple[Path, ...], EvidenceFinder] = {}
    told: list[tuple[RigCase, bool, bool]] = []
    for case in cases()[half::2]:
        if case.reference not in finders:
            reference = [read(path) for path in case.reference]
            finders[case.reference] = EvidenceFinder(reference, model=RigModel(reference))
        told.append((case, *_asked(finders[case.reference], case)))
    for kind in dict.fromkeys(case.kind for case, _, _ in told):
        mine = [(right, wrong) for case, right, wrong in told if case.kind == kind]
        print(f"{kind}: {sum(r for r, _ in mine)} of {len(mine)} right, {sum(w for _, w in mine)} wrong names")
    for rig in ("pneumatic_seal", "servo_pendulum"):
        many, right = plain(told, rig)
        print(f"{rig}: {right} of {many} changes beyond three times what repeats differ by are right")


if __name__ == "__main__":
    main(sys.argv[1:])
