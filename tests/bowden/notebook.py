"""The notebook of docs/library.md, as a script: it runs outside the repository against the installed library."""

import sys

import numpy as np

import bowden

walk = bowden.Experiment(peak_n=40, period_s=1.1, cycles=4, controller="extended")
trial = bowden.run(walk, bus=bowden.simulated(serial=3))
assert trial.outcome == "completed", trial.stop_reason
frame = trial.to_pandas()
assert np.array_equal(frame["tension_start_n"], trial.columns["tension_start_n"])
assert frame.attrs["units"]["tension_start_n"] == "N"
assert trial.metadata["controller"] == "extended"
assert "calibration.toml" in trial.attachments

again = bowden.run(walk, bus=bowden.simulated(serial=3), output="trial.mcap")
assert again.digest() == trial.digest()

model = bowden.identify("sensors", bus=bowden.simulated(serial=3), date="2026-01-01")
assert model.calibration.bench == "virtual 3"

healthy = [bowden.run(walk, bus=bowden.simulated(serial=3, seed=seed)) for seed in (1,)]
finder = bowden.Diagnosis().fit(healthy)
wrong = bowden.simulated(serial=3, seed=3, plant_model={"effects": {"start_gain": {"start_gain": 1.08}}})
found = finder.diagnose(bowden.run(walk, bus=wrong))
assert (found.verdict, [cause["effect"] for cause in found.causes]) == ("found", ["start_gain"]), found
assert found.report("page.html").read_text(encoding="utf-8").startswith("<!doctype html>")

kept = bowden.Trial("trial.mcap")
simulation = bowden.simulate(found.model, kept)
assert simulation.measured["tension_start_n"].shape == simulation.simulated["tension_start_n"].shape
told = bowden.run(bowden.Experiment(period_s=1.1, cycles=2, settle=0, model=found.model), bus=wrong)
assert told.metadata["controller_model"] == "start_gain"

try:
    bowden.run(bowden.Experiment(peak_n=-1.0))
except bowden.InputError as error:
    assert "peak_n" in str(error)
else:
    raise AssertionError("a peak below 0 is refused")
print("the notebook ran", file=sys.stderr)
