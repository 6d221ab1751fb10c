"""Result of a law search: terms with their equations, errors by signal, runners-up, and the confirming motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from diagnosis.compared_signals import Figures
from physics.laws import Array
from physics.terms import MODULATIONS, Term

BINS: Final = 40
"""Bins of the variable over which a picture's means are taken: enough for a bump of a twentieth of the range."""


@dataclass(frozen=True)
class Picture:
    """Residual of one output against the variable of a term's modulation, each of shape (bins,).

    `residual`: without the term.  `law`: the term's part of the output.
    """

    variable: str
    output: str
    unit: str
    at: Array
    residual: Array
    law: Array

    def means(self) -> tuple[Array, Array, Array]:
        """Return the middles of `BINS` equal parts of the variable's range, and mean residual and law in each."""
        edges = np.linspace(self.at.min(), self.at.max(), BINS + 1)
        part = np.clip(np.digitize(self.at, edges) - 1, 0, BINS - 1)
        filled = np.unique(part)
        middles = 0.5 * (edges[1:] + edges[:-1])
        residual, law = (np.array([values[part == k].mean() for k in filled]) for values in (self.residual, self.law))
        return middles[filled], residual, law


@dataclass(frozen=True)
class Laws:
    """Terms found in the trials of one session; none if no term passes.

    `nats`: linear evidence of each term without the cost of the library.  `nearly`: other candidates for the first
    term, with nats.  `library`: number of candidates.  `rejected`: why found terms were not kept, "" if they were.
    """

    terms: Sequence[Term]
    nats: Sequence[float]
    errors: Mapping[str, Figures]
    nearly: Sequence[tuple[str, float]]
    library: int
    rejected: str = ""
    pictures: Sequence[Picture] = field(default_factory=tuple)

    @property
    def experiment(self) -> str | None:
        """Motion that would confirm the first term: the one in which its modulation shows most."""
        return MODULATIONS[self.terms[0].modulation].confirm if self.terms else None

    @property
    def gains(self) -> dict[str, float]:
        """Gain of the terms over the adapted session by output, %."""
        return {name: round(e.gain_percent or 0.0, 2) for name, e in self.errors.items()}

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return {"verdict": "law" if self.terms else "none", "terms": [term.as_json() for term in self.terms],
                "nats": list(self.nats), "errors": {
                    name: {"unit": e.unit, **e.as_errors()} for name, e in self.errors.items()},
                "nearly": [{"term": name, "nats": nats} for name, nats in self.nearly], "library": self.library,
                "rejected": self.rejected, "experiment": self.experiment}
