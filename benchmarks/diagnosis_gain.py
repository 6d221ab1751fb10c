"""Gain of a diagnosis in the closed loop: `python -m benchmarks.diagnosis_gain [--page] [EFFECT…]`.

It runs the commands of a user: identify a bench, record it healthy, record it with an effect at work, diagnose, and
run again with the controller told the verdict.  Nothing of the effect but
the trial reaches the diagnosis.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from benchmarks.frame import put
from bowden.cli.app import run
from bowden.trials import provenance

SERIAL, PERIOD_S = 3, 1.3
EFFECTS = {
    "cable_friction": {"mu1": 0.16},
    "start_gain": {"start_gain": 1.06},
    "stiffness": {"stiffness_scale": 1.25},
    "moment_arm": {"rope_per_knee_quadratic": 1.8e-3},
    "stribeck": {"stribeck_ratio": 1.8, "stribeck_speed": 0.015},
    "fabric_friction": {"mu2": 0.3},
}
BESIDE: Final[Mapping[str, tuple[str, bool]]] = {
    "moment_arm": ("locked_angles", True),
    "fabric_friction": ("locked_angles", False),
}
"""The experiment that is recorded beside the gait, and whether it is recorded healthy, too: the gait alone shows no
lever arm, since the knee turns by five degrees while the rope pulls."""
PAGE = Path("docs/diagnosis_figures.md")
HEAD = f"""Printed by `python -m benchmarks.diagnosis_gain` at commit COMMIT. Bench {SERIAL} is identified
(`bowden identify all`), recorded healthy, and recorded with an effect at work; `bowden diagnose` sees both trials and
the calibration, and what it finds goes to the extended controller (`bowden verify`). Ten gait cycles of {PERIOD_S} s,
40 N, the first left out; relative RMSE of true END. Beside the gait: an experiment of `bowden trial --experiment`,
recorded with the effect at work, and healthy where that is said.

| at work | beside the gait | verdict | found | not told (%) | told what was found (%) | told the truth (%) | gain (%) |
|---|---|---|---|---|---|---|---|
"""


def command(*arguments: object) -> dict[str, Any]:
    """Run one command line with `--json`."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        status = run([str(argument) for argument in (*arguments, "--json")])
    if status:
        sys.exit(f"{' '.join(map(str, arguments))}: exit status {status}")
    result: dict[str, Any] = json.loads(told.getvalue())
    return result


def recorded(folder: Path, experiment: str, name: str, *options: object) -> Path:
    """One trial of an experiment on the bench."""
    path = folder / f"{name}-{experiment}.mcap"
    command("trial", "--serial", SERIAL, "--calibration", folder / "calibration.toml", "--experiment", experiment,
            *options, "-o", path)
    return path


def row(folder: Path, name: str, values: dict[str, float]) -> str:
    """One effect through the whole chain."""
    model, found = folder / f"{name}.toml", folder / f"{name}-found.toml"
    model.write_text(f"[effects.{name}]\n" + "".join(f"{key} = {value}\n" for key, value in values.items()))
    bench = ("--serial", SERIAL, "--period", PERIOD_S, "--calibration", folder / "calibration.toml")
    measured = folder / f"{name}.mcap"
    command("trial", *bench, "--plant-model", model, "-o", measured)
    beside, healthy = [measured], [folder / "healthy.mcap"]
    experiment, known = BESIDE.get(name, ("", False))
    if experiment:
        beside.append(recorded(folder, experiment, name, "--plant-model", model))
    if known:
        healthy.append(recorded(folder, experiment, "healthy", "--seed", 1))
    verdict = command("diagnose", *beside, *(part for path in healthy for part in ("--healthy", path)),
                      "--calibration", folder / "calibration.toml", "-o", found)
    told = {told_by.stem: command("verify", told_by, *bench, "--plant-model", model, "-o",
                                  folder / f"verify-{told_by.stem}.mcap") for told_by in (found, model)}
    before, after = (told[found.stem][when]["true_relative_rmse_percent"] for when in ("before", "after"))
    causes = "; ".join(f"`{cause['effect']}` " + ", ".join(
        f"{key} {one['value']:.3g} [{one['low']:.3g}, {one['high']:.3g}]" for key, one in cause["parameters"].items())
        for cause in verdict["causes"])
    others = [one for one in verdict["class"] if one not in {cause["effect"] for cause in verdict["causes"]}]
    cells = (
        f"`{name}` " + ", ".join(f"{key} {value:g}" for key, value in values.items()),
        f"{experiment}, healthy too" if known else experiment or "–",
        verdict["verdict"] + (f" with {', '.join(others)}" if others else ""), causes or "nothing",
        f"{before:.2f}", f"{after:.2f}", f"{told[model.stem]['after']['true_relative_rmse_percent']:.2f}",
        str(round(100.0 * (1.0 - after / before))))
    return f"| {' | '.join(cells)} |"


def main(arguments: list[str]) -> None:
    """Print the table, and with `--page` write it into the page; names pick some of the effects."""
    names = [argument for argument in arguments if argument != "--page"]
    head, rows = HEAD.replace("COMMIT", provenance.commit()), []
    with TemporaryDirectory() as given:
        folder = Path(given)
        command("identify", "all", "--serial", SERIAL, "-o", folder / "calibration.toml")
        command("trial", "--serial", SERIAL, "--seed", 1, "--period", PERIOD_S, "--calibration",
                folder / "calibration.toml", "-o", folder / "healthy.mcap")
        print(head, end="")
        for name in names or EFFECTS:
            rows.append(row(folder, name, EFFECTS[name]))
            print(rows[-1], flush=True)
    if "--page" in arguments:
        put(PAGE, "gain", head + "\n".join(rows))


if __name__ == "__main__":
    main(sys.argv[1:])
