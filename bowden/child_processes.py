"""Start of processes that the signals of a terminal do not reach; the parent decides how they end."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def unsignalled() -> Iterator[None]:
    """Block Ctrl-C, SIGHUP and SIGQUIT in this thread during a `with` block, and in processes that start in it.

    A process that blocks them itself would end in a traceback while it still imports.  A signal that comes meanwhile is
    delivered to this thread at the end.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # what starts it later unblocks these signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
