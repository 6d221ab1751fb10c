"""Measured scalars and discrepancy of a calibration, as JSON and as a table: of `bowden identify` and `bowden fit`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bowden.cli import terminal
from parameters import declarations

if TYPE_CHECKING:
    from physics.calibration import Calibration


def as_json(found: Calibration | None) -> dict[str, Any]:
    """Return `scalars`, those that a trial determined, and `discrepancy`; empty and None without a calibration."""
    beyond = None if found is None else found.discrepancy
    return {"scalars": {} if found is None else _rows(found),
            "discrepancy": None if beyond is None else {"prior": beyond.prior, "residual": beyond.residual}}


def show(title: str, found: Calibration) -> None:
    """Print the scalars with their 95 % intervals, and the discrepancy."""
    terminal.table(title, ("scalar", "unit", "value", "95 % low", "high", "R²"), [
        (name, row["unit"] or "1", f"{row['value']:.4g}",
         *("–" if row[key] != row[key] else f"{row[key]:.4g}" for key in ("low", "high", "r_squared")))
        for name, row in _rows(found).items()])
    if found.discrepancy is not None:
        print(f"Discrepancy START → END in the gait trials: {100.0 * found.discrepancy.prior:.1f} % of END, its model "
              f"leaves {100.0 * found.discrepancy.residual:.1f} %.")


def _rows(found: Calibration) -> dict[str, dict[str, Any]]:
    return {
        name: {"value": getattr(found, name), "unit": declared.unit, "low": proof.low, "high": proof.high,
               "r_squared": proof.r_squared}
        for name, _, declared in declarations(type(found))
        if (proof := found.evidence.get(name)) is not None and proof.trial
    }
