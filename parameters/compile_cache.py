"""Caches of numba and matplotlib where neither the packages nor the home folder can be written, as in containers.

numba looks for a place when a function is declared, so this runs before the first room that declares one.
"""

import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

VARIABLE, FONTS = "NUMBA_CACHE_DIR", "MPLCONFIGDIR"


def prepare(packages: Path, environment: Mapping[str, str] | None = None) -> Path | None:
    """Return a temporary folder for compiled functions and name it in the environment; None where none is needed.

    `packages`: a folder of the installed packages.  One sentence on stderr states what to set.  matplotlib's list of
    fonts goes to a temporary folder, too, without a home folder.
    """
    given = os.environ if environment is None else environment
    if any(map(_writable, _homes(given))):
        return None
    folder = Path(tempfile.gettempdir(), f"bowden-compiled-{os.getuid() if hasattr(os, 'getuid') else 0}")
    folder.mkdir(mode=0o700, exist_ok=True)
    if not given.get(FONTS):
        os.environ[FONTS] = str(folder)
    if given.get(VARIABLE) or _writable(packages):
        return None
    os.environ[VARIABLE] = str(folder)
    print(f"bowden: neither the packages nor a home folder can be written, so compiled functions go to {folder}; set "
          f"{VARIABLE} to a folder that stays, or compile into the image with bowden doctor --compile.",
          file=sys.stderr)
    return folder


def _homes(environment: Mapping[str, str]) -> list[Path]:
    home = environment.get("HOME", "")
    return [Path(path) for path in (environment.get("XDG_CACHE_HOME", ""), f"{home}/.cache" if home else "") if path]


def _writable(folder: Path) -> bool:
    """Return whether a file can be made in `folder`, which is made if it is missing, as numba does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
