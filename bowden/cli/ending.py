"""Signals that end a command: Ctrl-C, SIGTERM and SIGHUP alike.

SIGTERM and SIGHUP act as Ctrl-C would at that moment, so a trial stops safely and its file is complete; the exit
status is 128 and the signal's number.
"""

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

LIKE_CTRL_C = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
CTRL_C = 128 + signal.SIGINT
INTERRUPTED = "interrupted"
"""Beginning of the stop reason of a run that the operator stopped."""


class Ending:
    """The signal that ended the command, if any."""

    def __init__(self) -> None:
        self.number: int | None = None

    def status(self, status: int) -> int:
        """Return the exit status of the process: 128 + signal number after a signal, else `status`."""
        return status if self.number is None or not status else 128 + self.number

    def sentence(self) -> str:
        """Return which signal ended the command, as a sentence."""
        name = "" if self.number is None else f" by {signal.Signals(self.number).name}"
        return f"bowden: interrupted{name}."


@contextmanager
def interrupted() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C has come, in place of an exception."""
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _frame: came.append(number))
    try:
        yield lambda: bool(came)
    finally:
        signal.signal(signal.SIGINT, before)


def after(seconds: float | None) -> Callable[[], bool]:
    """Return a function that returns whether so many seconds have passed since now; never without a number."""
    deadline = math.inf if seconds is None else time.monotonic() + seconds
    return lambda: time.monotonic() >= deadline


@contextmanager
def as_ctrl_c() -> Iterator[Ending]:
    """Treat SIGTERM and SIGHUP as Ctrl-C inside this context."""
    ending = Ending()
    if threading.current_thread() is not threading.main_thread():
        yield ending
        return

    def act(number: int, frame: FrameType | None) -> None:
        ending.number = number
        handler = signal.getsignal(signal.SIGINT)
        if callable(handler):
            handler(signal.SIGINT, frame)
        else:  # a shell lets what it starts in the background ignore Ctrl-C
            raise KeyboardInterrupt

    before = {number: signal.signal(number, act) for number in LIKE_CTRL_C
              if signal.getsignal(number) is not signal.SIG_IGN}  # nohup stays nohup
    try:
        yield ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def status_of(reason: str | None) -> int:
    """Return the exit status of a run: 0 completed (no reason), 128 + n stopped by signal n, 1 stopped otherwise."""
    if reason is None:
        return 0
    if not reason.startswith(INTERRUPTED):
        return 1
    named = [word for word in reason.split() if word in signal.Signals.__members__]
    return 128 + signal.Signals[named[0]] if named else CTRL_C


def quiet_libraries() -> None:
    """Keep what python-can and canopen remark off the terminal; BOWDEN_LOG=FILE keeps it in a file."""
    import logging
    import os

    path = os.environ.get("BOWDEN_LOG")
    try:
        handler: logging.Handler = logging.FileHandler(path) if path else logging.NullHandler()
    except OSError as error:
        print(f"bowden: BOWDEN_LOG {path}: cannot be written ({error.strerror}); nothing is logged.", file=sys.stderr)
        handler = logging.NullHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s: %(message)s"))
    for name in ("can", "canopen"):
        logger = logging.getLogger(name)
        if not any(getattr(one, "bowden", False) for one in logger.handlers):
            handler.bowden = True  # type: ignore[attr-defined]
            logger.addHandler(handler)
