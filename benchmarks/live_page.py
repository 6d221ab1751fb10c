"""By how much the live page's server delays a control thread: `python -m benchmarks.live_page [--seconds 5]`.

A thread that is prepared as the master's own (`master.network.host_computer`: real-time priority where permitted) wakes
each millisecond of wall time and hands over what a control cycle records (ten frames and a row), while another process
reads eight streams and loads the page again and again.  Printed for no page, for a server on threads of this process
and for the page's own process: how late the work of a cycle was done after its millisecond, in `--rounds` that
alternate; `--page` writes the table into docs/safety.md.
"""

from __future__ import annotations

import argparse
import http.client
import multiprocessing
import select
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np

from benchmarks import marked
from bowden.live import feeds
from bowden.live.page_process import PageProcess
from bowden.live.web import MOST_WATCHERS, LivePage
from eds.bench.bench_network import Network
from master.network import host_computer
from trial.convert.frames import rows_of

PERIOD_NS: Final = 1_000_000
FRAMES: Final = 10
NO_PAGE, THREADS, PROCESS = "no page", "server on threads of the same process", "page in a process of its own"
PAGE: Final = Path(__file__).parents[1] / "docs" / "safety.md"


def read_stream(host: str, port: int) -> None:
    """Read a stream of the page until it ends."""
    with socket.create_connection((host, port)) as stream:
        stream.sendall(f"GET /stream HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
        while stream.recv(65536):
            pass


def visit(url: str, ready: Any) -> None:
    """Read every stream that the page allows, and load the page again and again."""
    split = urlsplit(url)
    host, port = split.hostname or "", split.port or 0
    for _ in range(MOST_WATCHERS):
        threading.Thread(target=read_stream, args=(host, port), daemon=True).start()
    ready.set()
    while True:
        client = http.client.HTTPConnection(host, port)
        client.request("GET", "/")
        client.getresponse().read()
        client.close()


@contextmanager
def visited(url: str) -> Iterator[None]:
    """Visitors of the page in another process."""
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=visit, args=(url, ready), daemon=True)
    process.start()
    ready.wait()
    yield
    process.kill()
    process.join()


def delays(seconds: float, take: Callable[[int, bytes], None]) -> Any:
    """Return by how many µs after its millisecond the work of each cycle was done."""
    rows = rows_of([(0, 0x181, 0, 8, 0, False, bytes(8))] * FRAMES).tobytes()
    late = np.empty(round(seconds * 1e9 / PERIOD_NS))
    with host_computer.prepared() as refused:
        for sentence in refused:
            print(sentence, file=sys.stderr)
        due = time.monotonic_ns()
        for n in range(len(late)):
            due = max(due + PERIOD_NS, time.monotonic_ns())
            while (left := due - time.monotonic_ns()) > 0:
                select.select((), (), (), left * 1e-9)
            take(due, rows)
            late[n] = (time.monotonic_ns() - due) * 1e-3
    return late


def measured(kind: str, seconds: float) -> Any:
    """Return the delays with one kind of page."""
    if kind == NO_PAGE:
        return delays(seconds, lambda due, rows: None)
    network = Network()
    page: Any = (LivePage(feeds.state("bench", "trial", network), "0", lambda: None) if kind == THREADS
                 else PageProcess(feeds.setup("bench", network), "0", lambda: None))
    shown = page.state if kind == THREADS else page

    def take(due: int, rows: bytes) -> None:
        shown.frames(rows)
        shown.force(due, 30.0, 31.0, 29.0)

    with visited(page.url):
        found = delays(seconds, take)
    page.close()
    return found


def main() -> int:
    """Measure and print."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--seconds", type=float, default=5.0)
    asked.add_argument("--rounds", type=int, default=3)
    asked.add_argument("--page", action="store_true")
    given = asked.parse_args()
    kinds = (NO_PAGE, THREADS, PROCESS)
    found: dict[str, list[Any]] = {kind: [] for kind in kinds}
    for _ in range(given.rounds):
        for kind in kinds:
            found[kind].append(measured(kind, given.seconds))
    lines = ["| eight watchers and a visitor who reloads | median | 99 % | 99.9 % | beyond 0.5 ms |",
             "|---|---|---|---|---|"]
    for kind in kinds:
        late = np.concatenate(found[kind])
        low, high, most = np.percentile(late, (50.0, 99.0, 99.9))
        lines.append(f"| {kind} | {low:.0f} µs | {high:.0f} µs | {most:.0f} µs | "
                     f"{100.0 * np.mean(late > 500.0):.2f} % |")
    text = "\n".join(lines)
    print(text)
    if given.page:
        marked.put(PAGE, "live page", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
