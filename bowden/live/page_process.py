"""The live page of a trial in a separate process, so that no request to it takes time from the control cycle.

The control thread packs its records and sends them without waiting: records that a page cannot take are dropped
there, never in the recording. The page's process answers requests; only the stop button's request comes back.
"""

import contextlib
import json
import multiprocessing
import os
import pickle
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from bowden.child_processes import unsignalled
from bowden.live.state import Force, LiveState
from bowden.live.web import LivePage
from parameters import InputError
from trial.mcap_file.cdr import FRAME_STRUCT

BLOCK: Final = struct.Struct("<I")
"""Length of a block, which is the pickled name and arguments of a method of `LiveState`."""
SEND_NS: Final = 20_000_000
"""Bus time between two transmissions to the page; a longer one makes it lag, a shorter one costs system calls."""
MOST_WAITING: Final = 1 << 22
"""Bytes that wait for the page; further blocks are left out until it has taken them."""
NICENESS: Final = 10
"""Added to the page process's niceness: where processors are short the control thread goes first."""
PATIENCE_S: Final = 3.0
"""Time limit for the last state of the page, s."""


class PageSetup(NamedTuple):
    """Settings of the page of a trial, as `LiveState` takes them."""

    name: str
    bitrate: int
    nodes: tuple[int, ...]
    silent_s: float
    paths: tuple[str, ...] = ("",)


class PageProcess:
    """The page's process from here to `close`; `stop` is called, on another thread, when its button is pressed.

    Every other method is the control thread's and returns at once.  Raises `InputError` where the page cannot listen
    at `where` ([HOST:]PORT).
    """

    def __init__(self, setup: PageSetup, where: str, stop: Callable[[], None]) -> None:
        self.stop_asked = False
        self._stop, self._sent_ns, self._gone = stop, 0, False
        self._frames, self._waiting = bytearray(), bytearray()
        self._forces: list[Force] = []
        self._to_page, their_page = socket.socketpair()
        self._answers, their_answers = socket.socketpair()
        self._process = multiprocessing.get_context("spawn").Process(
            target=serve, args=(their_page, their_answers, setup, where), name="bowden live page", daemon=True)
        with unsignalled():  # the trial stops on them, and ends the page afterwards
            self._process.start()
        their_page.close()
        their_answers.close()
        answers = self._answers.makefile("r", encoding="utf-8")
        first = json.loads(answers.readline() or '{"error": "--web: the page\'s process ended before it served."}')
        if "error" in first:
            self._process.join()
            for opened in (answers, self._answers, self._to_page):
                opened.close()
            raise InputError(first["error"])
        self.url: str = first["url"]
        self._to_page.setblocking(False)
        threading.Thread(target=self._listen, args=(answers,), name="stop button", daemon=True).start()

    def _listen(self, answers: Any) -> None:
        """Wait for the button; a thread that sleeps in the kernel until it is pressed."""
        for _line in answers:
            self.stop_asked = True
            self._stop()

    def frame(self, time_ns: int, can_id: int, data: bytes, flags: int = 0) -> None:
        """Record one frame of the bus."""
        self._frames += FRAME_STRUCT.pack(time_ns, can_id, flags, min(len(data), 8), 0, False, data)
        self._send_due(time_ns)

    def frames(self, rows: Any) -> None:
        """Add frames: bytes of `cdr.FRAME_ROW`s."""
        self._frames += rows

    def force(self, time_ns: int, *forces_n: float) -> None:
        """Add desired, START and END force, N, of each force path in one control cycle; NaN where unknown."""
        self._forces.append((time_ns, forces_n))
        self._send_due(time_ns)

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        """Add an event, as one sentence."""
        self._send("event", time_ns, kind, source, text)

    def status(self, status: str, sentence: str = "") -> None:
        """Show the trial's status, and the sentence with it."""
        self._send("digest")
        self._send("status", status, sentence)

    def suspected(self, sentence: str) -> None:
        """Show the present suspicion of the diagnosis during the trial."""
        self._send("suspected", sentence)

    @property
    def waits(self) -> int:
        """Return the number of bytes that the page has not read yet."""
        return len(self._waiting)

    def close(self) -> None:
        """Make the page send its last state and stop listening."""
        with contextlib.suppress(OSError):
            self._to_page.settimeout(PATIENCE_S)
            self._to_page.sendall(self._waiting)
        self._to_page.close()
        self._process.join(PATIENCE_S)
        self._process.kill()
        self._process.join()
        with contextlib.suppress(OSError):
            self._answers.shutdown(socket.SHUT_RDWR)
        self._answers.close()

    def _send_due(self, time_ns: int) -> None:
        if not 0 <= time_ns - self._sent_ns < SEND_NS:
            self._sent_ns = time_ns
            self._send()

    def _put(self, method: str, *arguments: Any) -> None:
        """Queue a call of a method of the page's state."""
        block = pickle.dumps((method, arguments))
        if not self._gone and len(self._waiting) + len(block) <= MOST_WAITING:
            self._waiting += BLOCK.pack(len(block)) + block

    def _send(self, *call: Any) -> None:
        """Queue frames and forces so far, then a call; send as many queued bytes as the pipe accepts now."""
        # pickled here, not in each control cycle
        if self._frames:
            self._put("frames", bytes(self._frames))
            self._frames.clear()
        if self._forces:
            self._put("forces", self._forces)
            self._forces.clear()
        if call:
            self._put(*call)
        try:
            del self._waiting[:self._to_page.send(self._waiting)]
        except BlockingIOError:
            return
        except OSError:  # the page's process is gone: the trial goes on
            self._gone = True


def serve(calls: socket.socket, answers: socket.socket, setup: PageSetup, where: str) -> None:
    """Serve the page of a trial until the socket `calls` ends; runs in the page's own process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # on Windows it is not blocked
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    state = LiveState(setup.name, "trial", time.monotonic, *setup[1:])
    try:
        page = LivePage(state, where, lambda: answers.sendall(b"stop\n"))
    except InputError as error:
        answers.sendall(json.dumps({"error": str(error)}).encode() + b"\n")
        return
    answers.sendall(json.dumps({"url": page.url}).encode() + b"\n")
    with contextlib.suppress(OSError, EOFError, pickle.UnpicklingError):  # its end may cut the last block
        stream = calls.makefile("rb")
        while len(head := stream.read(BLOCK.size)) == BLOCK.size:
            method, arguments = pickle.loads(stream.read(*BLOCK.unpack(head)))
            getattr(state, method)(*arguments)
    page.close()
