"""The result of a diagnosis: verdict, causes, ambiguity set, figures, and what the figures were drawn from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from diagnosis.data.compared_signals import Compared
from diagnosis.judgement.verdict import Figures
from diagnosis.search.search import SearchResult
from physics.bench_model import BenchModel


@dataclass(frozen=True)
class Findings:
    """The verdict and its figures; `as_json` gives exactly the published keys.

    `seconds` is for the caller that has a clock: nothing here reads one.  `split`: an experiment beside the gait has
    split the class, by `verdict`'s thresholds for that.  `rate_hz`: the rate at which the trials were looked at.
    `bench`: what is known of the bench, by its healthy trials or its calibration; None of another rig.  Of the evidence
    core: `part` of the bench that changed, `evidence` that the answer rests on, `traces` by output, on each trial and
    `held_traces` on each held-out trial.  Of a rig of another kind: how its `session` differs from the healthy ones.
    `undecided`: one sentence on an experiment among the trials that did not split the class.
    """

    verdict: str
    causes: list[dict[str, Any]] = field(default_factory=list)
    rivals: list[str] = field(default_factory=list)
    experiment: str | None = None
    relations: dict[str, Figures] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    detection_limit: dict[str, Any] | None = None
    seconds: float | None = None
    lowpass_hz: float | None = None
    reference: str = "none"
    found: SearchResult | None = field(default=None, repr=False)
    split: bool = False
    simulation: dict[str, Any] | None = None
    rate_hz: float | None = None
    candidates: list[dict[str, Any]] = field(default_factory=list)
    bench: BenchModel | None = field(default=None, repr=False)
    part: str | None = None
    evidence: dict[str, Any] | None = None
    traces: Mapping[str, Sequence[Compared]] = field(default_factory=dict, repr=False)
    held_traces: Mapping[str, Sequence[Compared]] = field(default_factory=dict, repr=False)
    session: dict[str, Any] | None = None
    undecided: str | None = None

    def unnamed(self) -> Findings:
        """Return it without a cause named: the bench was never identified, which may remove them; see `candidates`."""
        if not self.causes:
            return self
        return replace(self, causes=[], rivals=[], experiment=None, detection_limit=None, candidates=[
            *self.causes, *({"effect": name} for name in self.rivals
                            if name not in {cause["effect"] for cause in self.causes})])

    def as_json(self) -> dict[str, Any]:
        """Return what `bowden diagnose --json` prints: undefined is None."""
        return {
            "verdict": self.verdict, "causes": self.causes, "class": self.rivals, "experiment": self.experiment,
            "relations": {name: asdict(figures) for name, figures in self.relations.items()},
            "warnings": self.warnings, "detection_limit": self.detection_limit, "seconds": self.seconds,
            "lowpass_hz": self.lowpass_hz, "simulation": self.simulation,
            **({"session": self.session} if self.session is not None else {}),
            **({"undecided": self.undecided} if self.undecided is not None else {}),
            **({"candidates": self.candidates} if self.candidates else {}),
            **({"part": self.part, "evidence": self.evidence} if self.evidence is not None else {})}
