"""First lines of a diagnosis by evidence: error of the simulation, changed part, ambiguity set, next experiment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from diagnosis.findings import Findings
from physics.effects.catalogue import CATALOGUE
from physics.effects.separating_experiments import EXPERIMENTS

STRONG: Final = 3.0
"""Least change of a listed constant, in its 1σ between sessions."""
MOST: Final = 3
"""Largest number of listed constants."""


def told(found: Findings) -> Iterator[str]:
    """Yield the sentences of a diagnosis by evidence, most important first."""
    evidence = found.evidence or {}
    if found.undecided is not None:
        yield f"{found.undecided[0].upper()}{found.undecided[1:]}"
    error = evidence.get("error_n")
    if error is not None:
        after = f", {error['after']:.2f} N with what is named below" if found.causes else ""
        yield (f"The simulation of this bench misses START and END by {error['before']:.2f} N{after}, on cycles that "
               f"no fit has seen; reference trials miss each other by {error['reference']:.2f} N.")
    if found.verdict == "unexplained":
        yield "The data depart from the model in a way that no effect of the catalogue explains; no cause is named."
    elif not found.causes:
        yield "The trial agrees with the reference trials: no change of the bench is needed to explain it."
    else:
        yield f"Changed: {found.part}. " + " ".join(_cause(cause) for cause in found.causes)
    among = [name for name in found.rivals if name not in {cause["effect"] for cause in found.causes}]
    if among:
        yield f"These data do not separate it from: {', '.join(among)}."
    if found.experiment is not None:
        yield f"To separate them, record {found.experiment}: {EXPERIMENTS[found.experiment].motion}."
    listed = _shifts(evidence.get("shifts", {}))
    if listed:
        yield f"Constants that moved most: {'; '.join(listed)}."


def _cause(cause: Mapping[str, Any]) -> str:
    values = ", ".join(f"{name} = {p['value']:.3g} {p['unit']}".rstrip() + f" ({p['low']:.3g} … {p['high']:.3g})"
                       for name, p in cause["parameters"].items())
    return f"{cause['effect']} at {cause['site']} ({CATALOGUE[cause['effect']].law}): {values}."


def _shifts(shifts: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the constants that changed by `STRONG` session σ or more, largest change first, as "name from → to unit".
    """
    rated = []
    for name, row in shifts.items():
        if row["sessions"] is not None and abs(row["sessions"]) >= STRONG:
            rated.append((abs(row["sessions"]), f"{name} {row['from']:.3g} → {row['to']:.3g} "
                          f"{row['unit']}".rstrip()))
    return [text for _, text in sorted(rated, reverse=True)[:MOST]]
