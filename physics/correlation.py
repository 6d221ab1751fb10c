"""Correlation of a bench's identified values, which completes their intervals to a joint covariance.

Table `[correlation]` of a bench model: `names` of the parameters, and the `rows` of the matrix.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from parameters import InputError
from physics.laws import Array

TABLE: Final = "correlation"


class Correlation(NamedTuple):
    """Parameters by name, and their correlation, row by row."""

    names: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]

    def over(self, names: Sequence[str]) -> Array:
        """Return the correlation of `names`, shape (names, names); a name without one is independent."""
        whole, place = np.eye(len(names)), {name: i for i, name in enumerate(self.names)}
        known = [k for k, name in enumerate(names) if name in place]
        at = [place[names[k]] for k in known]
        whole[np.ix_(known, known)] = np.array(self.rows).reshape(len(self.names), -1)[np.ix_(at, at)]
        return whole


def of_covariance(names: Sequence[str], covariance: Array) -> Correlation:
    """Return the correlation of the covariance of `names`, shape (names, names); a name without a variance is left out.
    """
    variance = np.diag(covariance)
    known = np.flatnonzero(np.isfinite(variance) & (variance > 0.0)).tolist()
    sd: Array = np.sqrt(variance[known])
    rounded = np.round(covariance[np.ix_(known, known)] / np.outer(sd, sd), 4)
    return Correlation(tuple(names[k] for k in known), tuple(tuple(row) for row in rounded.tolist()))


def lines(known: Correlation | None) -> list[str]:
    """Return the lines of the table in a bench model's file; `stated` reads them back."""
    if known is None:
        return []
    names = ", ".join(f'"{name}"' for name in known.names)
    return ["", f"[{TABLE}]  # of the parameters whose intervals were estimated together", f"names = [{names}]",
            "rows = [", *(f"    [{', '.join(map(repr, row))}]," for row in known.rows), "]"]


def stated(tables: Mapping[str, Any], where: str) -> Correlation | None:
    """Return the correlation that a file's tables state, None without one.  Raises `InputError`."""
    table = tables.get(TABLE)
    if table is None:
        return None
    names = table.get("names", ()) if isinstance(table, Mapping) else ()
    try:
        matrix = np.array(table["rows"], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        matrix = np.zeros(0)
    whole = matrix.shape == (len(names), len(names)) and bool(np.isfinite(matrix).all())
    if not whole or np.abs(matrix - matrix.T).max(initial=0.0) > 1e-3 or np.abs(matrix).max(initial=0.0) > 1.0:
        raise InputError(f"{where}: [{TABLE}] rows are no correlation of its {len(names)} names, expected a symmetric "
                         "matrix of numbers within −1 … 1; run bowden identify again.")
    return Correlation(tuple(map(str, names)), tuple(tuple(row) for row in matrix.tolist()))
