"""A safe stop asked for by another thread of the process that runs the bench: the stop button of the live page.

The rule of this file: a request holds from `armed` to its end and is read by the cycle; it never touches the bus.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_asked = threading.Event()


@contextmanager
def armed() -> Iterator[Callable[[], None]]:
    """Context of a run: yields a function by which any thread may request the safe stop."""
    _asked.clear()
    try:
        yield _asked.set
    finally:
        _asked.clear()


def requested() -> int:
    """Return the signal that a request corresponds to (SIGINT: the same end as Ctrl-C), 0 without a request."""
    return int(signal.SIGINT) if _asked.is_set() else 0
