"""Makes the goldens of `test_replay_golden.py`: a short walk of every controller, stripped to what its steps need.

Run it where a controller was changed on purpose: `python tests/replay/golden.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

FOLDER = Path(__file__).parent / "golden"
WALK = ("--rate", "100", "--period", "1.2", "--cycles", "2", "--settle", "0", "--json")
ATTACHED = ("bench.toml", "calibration.toml")


def make(controller: str, folder: Path) -> None:
    """Run one walk on the simulated bench and keep the rows of its gait, with the frames of targets."""
    from bowden.cli.app import run
    from bowden.replay.onto_controller import INPUTS, OUTPUTS, walked
    from eds.bench.bench_network import TARGETS_COB_ID
    from trial import read
    from trial.record import TrialContent, write
    from trial.signals import PDO_NAMES

    path = folder / f"{controller}.mcap"
    if run(["trial", "--controller", controller, *WALK, "-o", str(path)]):
        raise SystemExit(f"{controller}: the trial did not complete")
    trial = read.open(path)
    rows = walked(trial)
    kept = slice(rows.start - 1, rows.stop)  # the row before has the targets that the first one may hold
    names = ("time_s", *INPUTS, *OUTPUTS, *(f"{name}_pdo_age_ns" for name in PDO_NAMES), "missed_outputs")
    frames = trial.frames[trial.frames["can_id"] == TARGETS_COB_ID]
    first, last = trial.time_ns[rows.start], trial.time_ns[kept.stop - 1]
    frames = frames[(frames["time_ns"] > first) & (frames["time_ns"] < last + trial.time_ns[1] - trial.time_ns[0])]
    write(
        FOLDER / path.name, TrialContent(trial.time_ns[kept], {name: trial.columns[name][kept] for name in names},
                                         frames),
        metadata={key: text for key, text in trial.metadata.items() if key != "commit"}, result=trial.result or {},
        attachments={name: trial.attachments[name] for name in ATTACHED}, overwrite=True)


def main() -> None:
    """Make all of them."""
    sys.path.insert(0, str(Path(__file__).parents[2]))
    from master.control.controller import CONTROLLERS

    FOLDER.mkdir(exist_ok=True)
    with TemporaryDirectory() as folder:
        for controller in CONTROLLERS:
            make(controller, Path(folder))


if __name__ == "__main__":
    main()
