"""Known changes and repeats of measured rigs, diagnosed by evidence: `python -m benchmarks.rig_changes [--other]`.

The recordings are in `../shared/data`.  Half of the cases was used for development, and `--other` runs the other half.
A change is right if its cause is in the answer's set and every name is allowed; a repeat is right if the answer is
`none`.
"""

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


def _asked(finder: EvidenceFinder, case: RigCase) -> tuple[bool, bool]:
    """Diagnose one case and print it; return whether it is right and whether a wrong name was given."""
    try:
        found = finder.diagnose(case.trials)
    except InputError as error:
        print(f"{case.kind:7} {case.name:28} refused: {error}")
        return False, False
    named = set(found.rivals)
    wrong = bool(named - case.allowed)
    right = (bool(named & case.cause) and not wrong) if case.cause else found.verdict == "none"
    print(f"{case.kind:7} {case.name:28} {'right' if right else 'WRONG' if wrong else 'missed':6} {found.verdict:11} "
          f"{', '.join(found.rivals)}", flush=True)
    return right, wrong


def main(arguments: Sequence[str]) -> None:
    """Print one half of the cases, and how many changes and repeats were right."""
    finders: dict[tuple[Path, ...], EvidenceFinder] = {}
    outcomes: dict[str, list[tuple[bool, bool]]] = {}
    for case in cases()["--other" in arguments::2]:
        if case.reference not in finders:
            reference = [read(path) for path in case.reference]
            finders[case.reference] = EvidenceFinder(reference, model=RigModel(reference))
        outcomes.setdefault(case.kind, []).append(_asked(finders[case.reference], case))
    for kind, pairs in outcomes.items():
        print(f"{kind}: {sum(r for r, _ in pairs)} of {len(pairs)} right, {sum(w for _, w in pairs)} wrong names")


if __name__ == "__main__":
    main(sys.argv[1:])
