"""python-can and numba without what they import beside their work: more than a short trial computes.

python-can's reader of MDF files imports asammdf and pandas; `trial.convert.python_can` loads that reader again where a
file needs it.  numba imports `scipy.linalg` to learn whether it is installed; only its `np.convolve` heeds the answer.
"""

import gc
import importlib
import sys
from typing import Final

SPARED: Final = {"can": "asammdf", "numba.np.arraymath": "scipy.linalg.cython_blas"}
"""Modules by the one that they can do without."""


def load() -> None:
    """Import each module of `SPARED` while the heavy one that it can do without is hidden, unless either is loaded."""
    missing = {name: spared for name, spared in SPARED.items() if not {name, spared} & sys.modules.keys()}
    if not missing:
        return
    gc.disable()  # an import creates objects that stay: to look for garbage among them takes a tenth of its time
    try:
        for name, spared in missing.items():
            sys.modules[spared] = None  # type: ignore[assignment]  # an import of it then fails as if it were absent
            try:
                importlib.import_module(name)
            finally:
                del sys.modules[spared]
    finally:
        gc.freeze()
        gc.enable()
