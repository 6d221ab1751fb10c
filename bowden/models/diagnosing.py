"""Diagnosis of recorded trials: the reference trials are fitted once, then one trial after another is diagnosed.

This module passes trials and models to `diagnosis` and returns its findings; it decides nothing.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from bowden import model_files, output_files
from bowden.deferred import on_first_use
from bowden.model_files import BenchModel, Model
from bowden.trials.force_paths import opened
from bowden.trials.recorded_trial import Trial
from parameters import InputError
from trial.report.words import words

with on_first_use():
    from diagnosis import extension
    from diagnosis.extension import resized
    from diagnosis.finder import Finder
    from diagnosis.findings import Findings
    from diagnosis.laws.law_result import Laws
    from diagnosis.report import diagnosis_page
    from estimation.data import table, windows
    from estimation.data.table import Table
    from physics.effects import own_effects


Given = Trial | str | Path
"""A trial: in memory, or its file (MCAP, or CSV with the canonical headers)."""


class Diagnosis:
    """Diagnosis of trials of one bench, with the interface of a scikit-learn estimator.

    `model`: the identified bench model, or its calibration.toml (None: the one attached to each trial). `lowpass_hz`:
    cut-off of the zero-phase low-pass put on every signal first. `path`: force path of trials of several, or joint of
    tables whose columns are `<joint>.<header>`. `effects`: files of effects of your own, which compete in this
    diagnosis alone. `session_sd`: 1σ of each constant between sessions (None: the published one). `show` receives
    the present work in words.
    """

    def __init__(self, model: Model | None = None, *, lowpass_hz: float | None = None, path: str | None = None,
                 effects: Iterable[str | Path] = (), session_sd: Mapping[str, float] | None = None,
                 show: Callable[[str], object] = lambda work: None) -> None:
        self.model = None if model is None else model_files.given(model)
        known = None if self.model is None else dataclasses.replace(self.model, effects={}, found={})
        self._finder = Finder(None if known is None else model_files.tables(known), lowpass_hz, session_sd,
                              own_effects.read_each(effects))
        self._measured, self._path, self._show = known is not None, path, show

    def fit(self, healthy: Given | Iterable[Given]) -> Diagnosis:
        """Read trials of this or a like bench with nothing wrong; the first diagnosis fits them, once; returns itself.

        Raises `InputError` for unusable files.
        """
        tables = self._tables(several(healthy))
        self._finder.examine(tables)
        self._measured = self._measured or bool(tables)
        return self

    def diagnose(self, trials: Given | Iterable[Given], holdout: Given | Iterable[Given] = (), *, terms: bool = False
                 ) -> DiagnosisResult:
        """Return the causes of faults in `trials`; nothing is fitted on `holdout`.

        `terms`: seek a law, as `bowden.discover` does, where effects do not explain the trials, or not all of it.

        Without a model and reference trials, no cause is named in trials of the packaged calibration, since its values
        are assumed and not measured.  Raises `InputError` for unusable files; inconsistent data give the verdict
        `refused`.
        """
        began, given = time.perf_counter(), several(trials)
        asked, unseen = (self._tables(group) for group in (given, several(holdout)))
        self._show("fitting the reference trials, then the effects")
        found = self._finder.diagnose(asked, unseen, terms=terms)
        if found.verdict != "refused" and not self._measured and all(map(self._on_packaged_calibration, given)):
            found = found.unnamed()
        return DiagnosisResult(found, asked, unseen, self.model, time.perf_counter() - began)

    def _tables(self, trials: Iterable[Given]) -> list[Table]:
        def read(trial: Given) -> Table:
            self._show(f"reading {Path(trial.path if isinstance(trial, Trial) else trial).name}")
            return table_of(trial, self._path)

        return [read(trial) for trial in trials]

    def _on_packaged_calibration(self, trial: Given) -> bool:
        file = Path(trial.path if isinstance(trial, Trial) else trial)
        return file.suffix.lower() == ".mcap" and opened(file, self._path).metadata.get("calibration") == table.NOMINAL


class DiagnosisResult:
    """Result of a diagnosis: the verdict, the effects that it names, and the model errors with and without them.

    - `verdict`: none, found, ambiguous, unexplained or refused.
    - `causes`: the named effects, a dict each: `site`, `parameters` (value, 95 % interval low … high, unit), gain in %.
    - `rivals`: names of the effects that these trials cannot tell apart, those of `causes` first; empty if there are
      none. `experiment`: the experiment that would separate them.
    - `relations`: RMS error of each signal without and with the named effects.
    - `warnings`: sentences for the reader.
    - `terms`: terms of a law fitted to what no effect explains; empty unless `diagnose` was asked for terms.
    - `seconds`: computing time, s.
    """

    def __init__(
        self, found: Findings, trials: Sequence[Table], holdout: Sequence[Table], model: BenchModel | None,
        seconds: float = 0.0,
    ) -> None:
        self.found, self.seconds = found, seconds
        self.verdict, self.causes, self.rivals = found.verdict, found.causes, found.rivals
        self.experiment, self.relations, self.warnings = found.experiment, found.relations, found.warnings
        self.terms = [] if found.laws is None else list(found.laws.terms)
        self._trials, self._holdout, self._model = trials, holdout, model

    @property
    def alternatives(self) -> list[DiagnosisResult]:
        """Each other effect of the ambiguity set, or each that is likelier than none where none is named, fitted alone,
        as if it were the cause."""
        return [DiagnosisResult(dataclasses.replace(self.found, causes=[cause], laws=None), self._trials,
                                self._holdout, self._model) for cause in self.found.alternatives]

    def scaled(self, share: float) -> DiagnosisResult:
        """Return the result with the sizes of all effects, and the coefficients of terms, changed by `share`."""
        def scaled(cause: Mapping[str, Any]) -> dict[str, Any]:
            was = cause.get("was", {}).get(next(iter(cause["parameters"])), 0.0)
            return dict(resized(cause, lambda size: was + share * (size - was)))

        causes = [scaled(cause) for cause in self.found.causes]
        laws = self.found.laws and dataclasses.replace(
            self.found.laws, terms=[term.scaled(share) for term in self.found.laws.terms])
        return DiagnosisResult(dataclasses.replace(self.found, causes=causes, laws=laws), self._trials, self._holdout,
                               self._model)

    def __repr__(self) -> str:
        return f"DiagnosisResult({self.verdict}: {', '.join(words(c['effect']) for c in self.causes) or 'no cause'})"

    def _repr_html_(self) -> str:
        """Return a table for a notebook: verdict, causes with their parameters, ambiguity set, warnings."""
        rows = "".join(
            f"<tr><td>{escape(words(cause['effect']))}</td><td>{escape(cause['site'])}</td>"
            f"<td>{escape(name.replace('_', ' '))}</td><td>{one['value']:.4g} {escape(one['unit'])}</td>"
            f"<td>{one['low']:.4g} … {one['high']:.4g}</td></tr>"
            for cause in self.causes for name, one in cause["parameters"].items())
        table = ("<table><tr><th>cause</th><th>site</th><th>parameter</th><th>value</th><th>95 % interval</th></tr>"
                 f"{rows}</table>" if rows else "")
        sentences = list(self.warnings)
        if len(self.rivals) > 1:
            sentences.insert(0, f"These data cannot separate {', '.join(map(words, self.rivals))}.")
        remarks = "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)
        return f"<p><b>verdict: {escape(self.verdict)}</b></p>{table}{remarks}"

    def as_json(self) -> dict[str, Any]:
        """Return the object that `bowden diagnose --json` prints, without `seconds`."""
        return self.found.as_json()

    def text(self) -> str:
        """Return extended.toml: the bench as this diagnosis fitted it, with the effects found."""
        return extension.text(self.found, self._trials)

    @property
    def model(self) -> BenchModel:
        """Return the bench model with the effects found: for `bowden.simulate`, `bowden.simulated` and `Experiment`.

        Raises `InputError` if the trials were refused.
        """
        return extension.extended(model_files.given(self._model), self.found, self._trials)

    def report(self, path: str | Path, *, tracked: tuple[Path, Path] | None = None, overwrite: bool = False) -> Path:
        """Write one HTML page that needs no network; raises `InputError` where the trials were refused.

        `tracked`: trials without and with the extended controller, shown in it.
        """
        if self.verdict == "refused":
            raise InputError(f"{path}: the trials were refused ({self.warnings[0]}); mend the data first.")
        output_files.refuse([Path(path)], overwrite=overwrite)
        diagnosis_page.write(self.found, self._trials, self._holdout, path, tracked)
        return Path(path)


def several(given: Given | Iterable[Given]) -> list[Given]:
    """Return one trial, or several, as a list."""
    return [given] if isinstance(given, Trial | str | Path) else list(given)


def table_of(given: Given, path: str | None) -> Table:
    """Return the columns of a trial, of a long one in windows; `path`: the force path of a trial of several."""
    return windows.read(given.path if isinstance(given, Trial) else given, path)


def discover(trials: Given | Iterable[Given], healthy: Given | Iterable[Given], *, lowpass_hz: float | None = None,
             path: str | None = None) -> DiscoveryResult:
    """Return the terms that extend the model of `healthy`, trials in the reference condition, in `trials`.

    `trials`: of one session.  `lowpass_hz`, `path`: as of `bowden.Diagnosis`.  Raises `InputError` for unusable files.
    """
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
