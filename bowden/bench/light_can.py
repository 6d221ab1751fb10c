"""python-can without its reader of MDF files, which imports asammdf and pandas: more than a short trial computes.

`trial.convert.python_can` loads that reader again where a file needs it.
"""

from __future__ import annotations

import importlib
import sys

MDF = "asammdf"


def load() -> None:
    """Import python-can without asammdf, unless one of them is there already."""
    if "can" in sys.modules or MDF in sys.modules:
        return
    sys.modules[MDF] = None  # type: ignore[assignment]  # an import of it then fails as if it were not installed
    try:
        importlib.import_module("can")
    finally:
        del sys.modules[MDF]
