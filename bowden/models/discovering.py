"""Discovery of a law in recorded trials: terms that extend the model where the catalogue has no name."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bowden.model_files import BenchModel
from bowden.models.diagnosing import Given, several, table_of
from parameters import InputError

if TYPE_CHECKING:
    from diagnosis.laws.law_result import Laws


def discover(trials: Given | Iterable[Given], healthy: Given | Iterable[Given], *, lowpass_hz: float | None = None,
             path: str | None = None) -> DiscoveryResult:
    """Return the terms that extend the model of `healthy`, trials in the reference condition, in `trials`.

    `trials`: of one session.  `lowpass_hz`, `path`: as of `bowden.Diagnosis`.  Raises `InputError` for unusable files.
    """
    from diagnosis.finder import Finder

    chosen = several(trials)
    tables = [table_of(trial, path) for trial in chosen]
    finder = Finder(None, lowpass_hz).examine([table_of(trial, path) for trial in several(healthy)])
    laws, bench = finder.discover(tables)
    return DiscoveryResult(laws, bench, [table.source for table in tables])


class DiscoveryResult:
    """Result of a discovery: `laws`, with terms and errors, and the bench model that they extend (None: a rig)."""

    def __init__(self, laws: Laws, bench: BenchModel | None, trials: Sequence[str]) -> None:
        self.laws, self._bench, self.trials = laws, bench, list(trials)
        self.terms, self.errors = laws.terms, laws.errors

    def __repr__(self) -> str:
        return f"Discovered({'; '.join(term.equation for term in self.terms) or 'no law'})"

    def as_json(self) -> dict[str, Any]:
        """Return the object that `bowden discover --json` prints."""
        return {"trials": self.trials, **self.laws.as_json()}

    @property
    def model(self) -> BenchModel:
        """Bench model with the terms, for `bowden.simulated` and `Experiment`.

        Raises `InputError` if no term was found, or for a rig of another kind, which nothing simulates.
        """
        if not self.terms:
            raise InputError(f"{', '.join(self.trials)}: no law was found, so nothing extends the model.")
        if self._bench is None:
            raise InputError(f"{', '.join(self.trials)}: a rig of another kind, which nothing simulates; read the "
                             "terms with --json.")
        found = {"verdict": "law", "on": [Path(name).name for name in self.trials],
                 "gain_percent": self.laws.gains}
        return dataclasses.replace(self._bench, terms=tuple(self.terms), found=found)
