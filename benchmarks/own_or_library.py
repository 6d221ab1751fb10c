"""Own code beside the library that could take its place, for docs/decisions/0032-own-code-beside-libraries.md and 0035.

    python -m benchmarks.own_or_library

Times are processor time, the least of several repetitions.  `benchmarks.performance` has the rows of MCAP.  clevercsv
is no dependency: its rows are printed if it is installed (pip install clevercsv).
"""

from __future__ import annotations

import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib import metadata, resources
from importlib.util import find_spec
from multiprocessing import Process
from pathlib import Path
from typing import Any

import can
import numpy as np
import pandas

from bowden.live import feeds
from bowden.live.relay import Relay
from bowden.live.viewer import Viewer
from eds.bench.bench_network import Network, wire
from tests.bowden.test_bowden_live import Client
from trial.convert import csv_file
from trial.follow import Follower
from trial.mcap_file import cdr
from virtual_bus.bus import BowdenBus

Row = tuple[str, str, str, str]

TABLES = {
    "comma, point": "time,force\n0.0,1.5\n0.1,2.5\n0.2,3.5\n",
    "semicolon, decimal comma": "time;force\n0,0;1,5\n0,1;2,5\n0,2;3,5\n",
    "tab, row of units": "time\tforce\ns\tN\n0.0\t1.5\n0.1\t2.5\n0.2\t3.5\n",
    "comment lines before the header": "# bench 3\n# 2024-05-01\ntime,force\n0.0,1.5\n0.1,2.5\n0.2,3.5\n",
    "CP1252 with a µ": "time;dehnung [µm]\n0,0;1,5\n0,1;2,5\n0,2;3,5\n",
    "blanks of any width": "time   force\n0.0    1.5\n0.1   2.5\n0.2 3.5\n",
}
"""One small table for each dialect: two columns, three rows, 0 … 0.2 and 1.5 … 3.5."""


def least_s(work: Callable[[], object], times: int) -> float:
    """Return the least processor time of some repetitions, in s."""
    taken = []
    for _ in range(times):
        before = time.process_time()
        work()
        taken.append(time.process_time() - before)
    return min(taken)


def _right(values: list[np.ndarray]) -> bool:
    wanted = np.array([0.0, 0.1, 0.2]), np.array([1.5, 2.5, 3.5])
    return len(values) == 2 and all(
        one.shape == right.shape and np.allclose(one, right) for one, right in zip(values, wanted, strict=True))


def _by_pandas(path: Path) -> pandas.DataFrame:
    return pandas.read_csv(path, sep=None, engine="python")


def _by_clevercsv(path: Path) -> pandas.DataFrame:
    import clevercsv

    return clevercsv.read_dataframe(path)


def _reads(read: Callable[[Path], pandas.DataFrame], path: Path) -> bool:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = read(path)
        return _right([found[name].to_numpy(dtype=np.float64) for name in found])
    except (ValueError, pandas.errors.ParserError):
        return False


def reading() -> Iterator[Row]:
    """Yield how many dialects are read right without being told, and the time of a table of 20,000 rows."""
    libraries = {"pandas.read_csv(sep=None)": _by_pandas}
    if find_spec("clevercsv"):
        libraries[f"clevercsv {metadata.version('clevercsv')}"] = _by_clevercsv
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for number, (name, text) in enumerate(TABLES.items()):
            paths.append(Path(folder, f"{number}.csv"))
            paths[-1].write_bytes(text.encode("cp1252" if "CP1252" in name else "utf-8"))
        long, rows = Path(folder, "long.csv"), np.arange(80_000.0).reshape(-1, 4) / 7.0
        np.savetxt(long, rows, delimiter=",", header="time_s,a,b,c", comments="")
        own = sum(_right([np.asarray(column, dtype=np.float64) for column in csv_file.read(path).values])
                  for path in paths)
        mine = least_s(lambda: csv_file.read(long), 3)
        for library, read in libraries.items():
            right = sum(_reads(read, path) for path in paths)
            yield f"CSV dialects of {len(TABLES)} read right", str(own), str(right), library
            theirs = least_s(lambda: read(long), 3)  # noqa: B023
            yield "CSV of 20000 rows, 4 columns, ms", f"{1e3 * mine:.0f}", f"{1e3 * theirs:.0f}", library


BUS_S = 5
"""Time of the bus that a live view is fed, s."""


def _heard() -> list[Any]:
    """Return the messages of some seconds of the bench's bus at 1 kHz, without a trial on it."""
    heard = []
    with BowdenBus("own-or-library") as bus:
        bus.send(can.Message(arbitration_id=0, data=b"\1\0", is_extended_id=False))
        bus.send_periodic(can.Message(arbitration_id=0x080, is_extended_id=False), 0.001)
        while bus.time_ns() < BUS_S * 1_000_000_000:
            message = bus.recv(0.1)
            if message is not None:
                heard.append(message)
    return heard


def _watch(port: int) -> None:
    """Subscribe to every topic and read what comes, in a process of its own."""
    client = Client(port)
    client.subscribe(cdr.CYCLE, cdr.FRAMES, cdr.EVENTS)
    while True:
        client.receive()


def _bytes(package: str) -> int:
    return sum(each.stat().st_size for each in Path(str(resources.files(package))).rglob("*") if each.is_file())


def showing() -> Iterator[Row]:
    """Yield what a bus at 1 kHz costs to show on the own page and in Foxglove, and what each shows."""
    heard, network = _heard(), Network()
    wired = wire(network)

    def paged() -> None:
        state = feeds.state("bus", "bus", network, decode_events=True)
        relay = Relay(Follower(wired), None, state)
        for message in heard:
            relay.take(message)
        state.digest()

    def served() -> None:
        for message in heard:
            relay.take(message)

    with closing(Viewer("bus", "127.0.0.1", 0, Follower(wired).units)) as viewer:
        client = Process(target=_watch, args=(viewer.port,))
        client.start()
        while len(viewer.wanted()) < 3:
            time.sleep(0.01)
        relay = Relay(Follower(wired), viewer)
        theirs = least_s(served, 3)
        client.terminate()
        client.join()
    which = f"foxglove-sdk {metadata.version('foxglove-sdk')}, one client, all topics"
    mine = least_s(paged, 3)
    yield "CPU for a second of a bus at 1 kHz, ms", f"{1e3 * mine / BUS_S:.0f}", f"{1e3 * theirs / BUS_S:.0f}", which
    yield "signals shown", "3", str(len(Follower(wired).names)), which
    yield "to install, MB", f"{_bytes('bowden.live') / 1e6:.2f}", f"{_bytes('foxglove') / 1e6:.1f}", which


def main() -> None:
    """Print the table."""
    print("| what | here | library | which |\n|---|---|---|---|")
    for rows in (reading, showing):
        for row in rows():
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
