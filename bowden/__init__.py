"""The drive stack of a Bowden cable–fabric force-transfer bench, as a library.

    import bowden

    trial = bowden.run(bowden.Experiment(peak_n=40, controller="extended"), bus=bowden.simulated(serial=3))
    model = bowden.identify(bus=bowden.simulated(serial=3))
    finder = bowden.Diagnosis(model).fit(healthy)
    found = finder.diagnose(trial)

`docs/library.md` explains it with examples that run.  The rule of this package: a name is imported when it is first
used, so that `import bowden` and `bowden --help` stay quick; nothing here prints or ends the process.  Bad input
raises `InputError`, whose text is one sentence: file, key, value, expected values and remedy.

Start reading in `bowden.trials.experiment` or a command of `bowden.cli`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from bowden import own_packages

if TYPE_CHECKING:
    from bowden import replay, sweep, testing
    from bowden.bench.any_node import Lss, Node
    from bowden.bench.buses import BusSettings, bus, simulated
    from bowden.bench.examination import doctor
    from bowden.mending.mended_bench import MendedBench
    from bowden.mending.supervisor import mend
    from bowden.model_files import BenchModel, nominal
    from bowden.model_files import read as read_model
    from bowden.model_files import write as write_model
    from bowden.models.diagnosing import Diagnosis, DiagnosisResult, DiscoveryResult, discover
    from bowden.models.experiment_plan import WalkPlan, plan
    from bowden.models.identification import StoppedError, fit, identify
    from bowden.models.simulating import Simulation, simulate
    from bowden.progress import Progress
    from bowden.trials.experiment import Experiment, Verified, run, verify
    from bowden.trials.recorded_trial import Trial, compare, export
    from bowden.trials.recorded_trial import read_trial as read
    from bowden.trials.recording import record
    from parameters import InputError

_HOMES = {
    "BenchModel": "bowden.model_files", "BusSettings": "bowden.bench.buses", "Diagnosis": "bowden.models.diagnosing",
    "DiagnosisResult": "bowden.models.diagnosing", "Experiment": "bowden.trials.experiment", "InputError": "parameters",
    "Lss": "bowden.bench.any_node", "MendedBench": "bowden.mending.mended_bench", "mend": "bowden.mending.supervisor",
    "Node": "bowden.bench.any_node", "Progress": "bowden.progress",
    "Simulation": "bowden.models.simulating", "StoppedError": "bowden.models.identification",
    "Trial": "bowden.trials.recorded_trial",
    "Verified": "bowden.trials.experiment", "WalkPlan": "bowden.models.experiment_plan", "bus": "bowden.bench.buses",
    "compare": "bowden.trials.recorded_trial", "discover": "bowden.models.diagnosing",
    "DiscoveryResult": "bowden.models.diagnosing", "doctor": "bowden.bench.examination",
    "export": "bowden.trials.recorded_trial", "fit": "bowden.models.identification",
    "identify": "bowden.models.identification", "nominal": "bowden.model_files",
    "plan": "bowden.models.experiment_plan",
    "read": "bowden.trials.recorded_trial:read_trial", "read_model": "bowden.model_files:read",
    "record": "bowden.trials.recording", "replay": "bowden.replay", "run": "bowden.trials.experiment",
    "simulate": "bowden.models.simulating", "simulated": "bowden.bench.buses", "sweep": "bowden.sweep",
    "testing": "bowden.testing", "verify": "bowden.trials.experiment", "write_model": "bowden.model_files:write",
}
"""Each public name and the module that it is imported from when it is first used."""

__all__ = [
    "BenchModel", "BusSettings", "Diagnosis", "DiagnosisResult", "DiscoveryResult", "Experiment", "InputError", "Lss",
    "MendedBench", "Node", "Progress", "Simulation", "StoppedError", "Trial", "Verified", "WalkPlan", "bus", "compare",
    "discover", "doctor", "export", "fit", "identify", "mend", "nominal", "plan", "read", "read_model", "record",
    "replay", "run", "simulate", "simulated", "sweep", "testing", "verify", "write_model",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'bowden' has no attribute {name!r}")
    hidden = own_packages.hidden()
    if hidden is not None:
        raise ImportError(f"bowden.{name}: {hidden}")
    module, _, attribute = _HOMES[name].partition(":")
    try:
        found: Any = importlib.import_module(module)
    except ModuleNotFoundError as error:
        from parameters import extras

        raise extras.refusal(error) from None
    if module != f"{__name__}.{name}":
        found = getattr(found, attribute or name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return list(__all__)
