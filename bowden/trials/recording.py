"""A bus recorded by who only listens: frames, the control cycles they make, and what happens, in one file or several.

The rule of this file: a file that is full is closed whole before the next one begins, and the next begins with the
frame that did not fit; nothing is lost between two.
"""

import math
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bowden import output_files
from bowden.bench import buses, configuration
from bowden.bench.buses import BusSettings
from eds.bench.bench_network import WireLayout, wire
from parameters import InputError
from trial.convert.frames import ChannelNumbers, rows_of
from trial.convert.python_can import flags_of, payload_of, time_ns_of
from trial.decode import Follower, events
from trial.read import paths_metadata
from trial.record import Recorder
from trial.signals import of_bench

RARE = frozenset((0x000, *range(0x081, 0x100), *range(0x701, 0x780)))
"""COB-IDs of NMT, EMCY and boot-up, which can be events."""
LOOK_S = 0.05  # between two looks at the clock
LOOK_FRAMES = 256  # frames between two looks at the size of the file


class BusRecording:
    """Recorder of messages from `can.BusABC.recv`; use it in a `with`, or call `close`.

    `max_bytes` limits the bytes on disk, which a `threaded` writer may bring there later.
    """

    def __init__(
        self, path: Path, wire: WireLayout, *, about: Mapping[str, str], overwrite: bool = False,
        max_bytes: int | None = None, max_ns: int | None = None, threaded: bool = True,
    ) -> None:
        self._path, self._overwrite = path, overwrite
        self._about = {**about, **paths_metadata(wire.network.bench)}
        self._max_bytes, self._max_ns, self._threaded = max_bytes, max_ns, threaded
        self._wire = wire
        self._follower = Follower(wire)
        names = set(self._follower.names)
        self._signals = [signal for signal in of_bench(wire.network.bench) if signal.name in names]
        order = {name: place for place, name in enumerate(self._follower.names)}
        self._order = [order[signal.name] for signal in self._signals]
        self._channels = ChannelNumbers()
        self.files: list[Path] = []
        self.frames = self.cycles = self.left_out = 0
        self._begun_ns, self._last_ns, self._in_file = 0, 0, 0
        self._recorder: Recorder | None = self._open()

    @property
    def _rotates(self) -> bool:
        return self._max_bytes is not None or self._max_ns is not None

    def _open(self) -> Recorder:
        part = len(self.files) + 1
        path = self._path.with_name(f"{self._path.stem}-{part:03}{self._path.suffix}") if self._rotates else self._path
        if path.exists() and not self._overwrite:
            raise InputError(f"{path}: the file exists; give another name or --overwrite.")
        self.files.append(path)
        self._in_file = 0
        told = {**{name: text for name, text in self._about.items() if text}, "source": "bowden record"}
        return Recorder(path, metadata=told | ({"part": str(part)} if self._rotates else {}), attachments={},
                        threaded=self._threaded, overwrite=self._overwrite, signals=self._signals)

    def take(self, message: Any) -> None:
        """Record one message; CAN FD frames are no bench's and are counted as left out."""
        if message.is_fd:
            self.left_out += 1
            return
        time_ns = max(time_ns_of(message), self._last_ns)  # two sockets of a computer may differ by a microsecond
        self._rotate(time_ns)
        assert self._recorder is not None
        flags, data = flags_of(message), payload_of(message)
        number = self._channels.number(message.channel)
        self._recorder.frame(time_ns, message.arbitration_id, data, flags, number, not message.is_rx)
        self.frames += 1
        self._in_file += 1
        self._last_ns = time_ns
        if flags:
            return
        row = self._follower.frame(time_ns, message.arbitration_id, data)
        if row is not None:
            self._recorder.cycle(row[0], [row[1][place] for place in self._order])
            self.cycles += 1
        if message.arbitration_id in RARE:
            for event in events(rows_of([(time_ns, message.arbitration_id, 0, len(data), number, False, data)])):
                self._recorder.event(*event)

    def _rotate(self, time_ns: int) -> None:
        if not self._in_file:
            self._begun_ns = time_ns
            return
        full = self._max_ns is not None and time_ns - self._begun_ns >= self._max_ns
        if self._max_bytes is not None and not self._in_file % LOOK_FRAMES:
            full |= self.files[-1].stat().st_size >= self._max_bytes
        if full:
            self._finish()
            self._recorder = self._open()
            self._begun_ns = time_ns

    def _finish(self) -> None:
        if self._recorder is not None:
            self._recorder.close({"outcome": "recorded", "frames": self._in_file, "channels": self._channels.names})
            self._recorder = None

    def listen(self, bus: Any, seconds: float | None, frames: int | None) -> str | None:
        """Record what `bus` receives until `seconds` of wall time or `frames` frames (None: until it is interrupted).

        A bus failure ends it; returns the failure in words, None without one.
        """
        end_s = math.inf if seconds is None else time.monotonic() + seconds
        return buses.listened(
            bus, self.take, lambda: time.monotonic() >= end_s or (frames is not None and self.frames >= frames), LOOK_S)

    def close(self) -> None:
        """Write pending messages and close the file."""
        self._finish()

    def as_json(self) -> dict[str, object]:
        """Return the counts of the recording."""
        return {"files": [str(path) for path in self.files], "frames": self.frames, "cycles": self.cycles,
                "left_out": self.left_out}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def record(
    bus: BusSettings, output: str | Path, *, seconds: float | None = None, frames: int | None = None,
    config: str | Path | None = None, overwrite: bool = False,
) -> BusRecording:
    """Record a real bus, listening only, until `seconds` of wall time or `frames` frames; return the recording.

    `bus`: `bowden.bus(…)`; a simulated bench moves only while a master asks, and `bowden.run` records that. A bus
    failure ends the recording, with all frames up to it in the file. Raises `InputError`, also if neither limit is
    given.
    """
    if bus.simulated:
        raise InputError("record: a simulated bench is recorded by bowden.run; give a real bus, bowden.bus(…).")
    if seconds is None and frames is None:
        raise InputError("record: nothing says when to end; give seconds or frames.")
    network = configuration.read(None if config is None else Path(config))["network"]
    output_files.refuse_ending(Path(output), ".mcap", what="a recording")
    about = {name: str(bus.arguments.get(name) or "") for name in ("interface", "channel")}
    made = BusRecording(Path(output), wire(network), overwrite=overwrite, about={
        **about, "bitrate": str(network.bitrate)})
    with buses.opened_one(bus, network.bitrate) as heard, made:
        made.listen(heard, seconds, frames)
    return made
