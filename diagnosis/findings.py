"""Result of a diagnosis: verdict, causes, ambiguity set, figures, and the traces that the figures are computed from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from diagnosis.compared_signals import Figures, SignalResiduals
from diagnosis.laws.law_result import Laws
from physics.bench_model import BenchModel
from physics.effects.hypotheses import Variant


@dataclass(frozen=True)
class Findings:
    """Verdict of a diagnosis with its figures; `as_json` returns exactly the published keys.

    `rivals`: ambiguity set.  `alternatives`: its effects that are not chosen, each fitted alone; without a set, those
    that are likelier than none, likeliest first.  `relations`: figures by output.  `seconds`: run time, which the
    caller measures.
    `reference`: kind of the reference condition: healthy (reference trials), calibration or nominal.  `part`: the part
    of the bench that changed.  `evidence`: Bayes factors, errors and shifts of constants; {} if the wire is at fault,
    None if the trials were refused.  `bench`: the bench as a model, from its reference trials or its calibration; None
    for another rig.  `traces`, `held_traces`: measured signals with both errors by output, one entry per trial and
    held-out trial.  `undecided`: one sentence on an experiment among the trials that did not reduce the ambiguity set.
    `unexplained`: by output, the lack of fit of the best model: mean squared residual over its variance, RMS error and
    reference RMSE; {} if there is none.  It stands with or without causes.
    `variants`: of the causes, as fitted.  `laws`: terms beyond the causes, None if none were sought.
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
    simulation: dict[str, Any] | None = None
    candidates: list[dict[str, Any]] = field(default_factory=list)
    alternatives: list[dict[str, Any]] = field(default_factory=list, repr=False)
    bench: BenchModel | None = field(default=None, repr=False)
    part: str | None = None
    evidence: dict[str, Any] | None = None
    traces: Mapping[str, Sequence[SignalResiduals]] = field(default_factory=dict, repr=False)
    held_traces: Mapping[str, Sequence[SignalResiduals]] = field(default_factory=dict, repr=False)
    undecided: str | None = None
    unexplained: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    variants: tuple[Variant, ...] = field(default=(), repr=False)
    laws: Laws | None = None

    @property
    def of_rig(self) -> bool:
        """Whether the trials are of a rig of another kind than the bench."""
        return self.bench is None and self.reference == "healthy"

    def unnamed(self) -> Findings:
        """Return findings whose causes and ambiguity set are `candidates`, so that no cause is named.

        Used for a bench that was never identified: an identification may remove the causes.
        """
        if not self.causes:
            return self
        return replace(self, causes=[], rivals=[], experiment=None, detection_limit=None, candidates=[
            *self.causes, *({"effect": name} for name in self.rivals
                            if name not in {cause["effect"] for cause in self.causes})])

    def as_json(self) -> dict[str, Any]:
        """Return the dictionary that `bowden diagnose --json` prints; an undefined figure has the value null."""
        return {
            "verdict": self.verdict, "causes": self.causes, "class": self.rivals, "experiment": self.experiment,
            "relations": {name: asdict(figures) for name, figures in self.relations.items()},
            "warnings": self.warnings, "detection_limit": self.detection_limit, "seconds": self.seconds,
            "lowpass_hz": self.lowpass_hz, "simulation": self.simulation,
            "errors": {name: f.as_errors() for name, f in self.relations.items()},
            "unexplained": {name: dict(row) for name, row in self.unexplained.items()},
            **({} if self.laws is None else {"terms": [term.as_json() for term in self.laws.terms],
                                             "law": self.laws.as_json()}),
            **({"undecided": self.undecided} if self.undecided is not None else {}),
            **({"candidates": self.candidates} if self.candidates else {}),
            **({"part": self.part, "evidence": self.evidence} if self.evidence is not None else {})}
