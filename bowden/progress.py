"""Progress of a long call: a protocol that the caller implements, and a silent implementation.

The library prints nothing; a caller may hand in a `Progress`.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

Update = Callable[[float], None]
"""Function of the completed share, 0 … 1."""


def ignore(share: float) -> None:
    """Ignore the completed share."""


class Progress(Protocol):
    """Receiver of a call's progress."""

    def running(self, what: str) -> AbstractContextManager[Update]:
        """Enter around work whose share done is known; yields what takes that share."""

    def waiting(self, what: str) -> AbstractContextManager[None]:
        """Return a context for work of unknown length."""

    def remark(self, sentence: str) -> None:
        """Show a sentence that a user should see, though it is no error."""


class Silent:
    """A `Progress` without output: the default of every call."""

    def running(self, what: str) -> AbstractContextManager[Update]:
        """Return a context that ignores the share done."""
        return nullcontext(ignore)

    def waiting(self, what: str) -> AbstractContextManager[None]:
        """Return a context that does nothing."""
        return nullcontext()

    def remark(self, sentence: str) -> None:
        """Ignore the remark."""


SILENT = Silent()
