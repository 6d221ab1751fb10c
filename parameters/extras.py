"""Libraries that an extra of the distribution installs, and the sentence for one that is missing.

The base distribution has devices, `bowden.testing`, node access, recording and reading; compiled simulation, SciPy and
pictures are extras.
"""

from types import MappingProxyType
from typing import Final

from parameters.declared import InputError

EXTRAS: Final = MappingProxyType({
    "numba": "bench", "llvmlite": "bench", "scipy": "bench", "threadpoolctl": "diagnosis", "matplotlib": "report",
})
"""Extra of pyproject.toml by the library that it installs; the extra diagnosis includes bench."""


def missing(error: ImportError) -> str | None:
    """Return one sentence with the command that installs a missing library; None if the library is of no extra."""
    name = (error.name or "").partition(".")[0]
    extra = EXTRAS.get(name) if isinstance(error, ModuleNotFoundError) else None
    if extra is None:
        return None
    return f"this needs {name}, which is not installed; say pip install 'bowden-bench[{extra}]' ([all] for everything)."


def refusal(error: ImportError) -> Exception:
    """Return `InputError` with that sentence, or the error itself if the library is of no extra."""
    sentence = missing(error)
    return error if sentence is None else InputError(sentence)
