"""Content of the live page, gathered from a bus, a trial that runs or a trial that is played.

The functions for the control thread (`frame`, `cycle`, `event`) only append to a queue; the page's own thread counts,
decodes and discards. Times are those of the bus, ages those of the clock that is handed in.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bowden.pages.load_prediction import frame_bits
from eds.bench.bench_network import NAMES
from trial.decode import events as events_of
from trial.mcap_file import cdr

FORCES: Final = ("desired_force_n", "tension_start_n", "tension_end_n")
"""Columns of a trial that a page plots."""
WINDOW_S: Final = 20.0
"""Length of the force plot of the page, s."""
ROW_NS: Final = 5_000_000
"""At most one row of force in so much bus time (200 a second)."""
LOAD_NS: Final = 1_000_000_000
"""Window over which the bus load is computed."""
EVENTS_KEPT: Final = 200
QUEUE: Final = 1 << 16
HEARTBEATS: Final = np.arange(0x701, 0x780)
NMT_STATES: Final[Mapping[int, str]] = {0x00: "boot-up", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}

Force = tuple[int, tuple[float, ...]]
"""Time (ns), then desired, START and END force (N) of each force path; NaN for an unknown value."""


class LiveState:
    """The state of one page; `clock` gives seconds that only rise, `bitrate` is in bit/s.

    `nodes` are the expected node-IDs; `silent_s` is the age from which a heartbeat counts as lost; `paths` names the
    force paths of a bench of several. `kind`: trial (runs in this process), bus (only listened to) or recorded.
    `decode_events`: NMT, EMCY and boot-up frames are decoded into events; False if the source sends events itself.
    """

    def __init__(
        self, name: str, kind: str, clock: Callable[[], float], bitrate: int, nodes: Sequence[int], silent_s: float,
        paths: Sequence[str] = ("",), *, decode_events: bool = False,
    ) -> None:
        self.changed = threading.Condition()
        self._about = {"name": name, "kind": kind, "silent_s": silent_s, "window_s": WINDOW_S, "paths": list(paths)}
        self.paths = tuple(paths)
        self._clock, self._bitrate, self._decode_events = clock, bitrate, decode_events
        self._blocks: deque[bytes] = deque(maxlen=QUEUE)
        self._forces: deque[Force] = deque(maxlen=QUEUE)
        self._new_events: deque[tuple[int, str, str, str]] = deque(maxlen=QUEUE)
        self._heard_at: float | None = None
        self._now_ns: int | None = None
        self.first_ns: int | None = None
        """Zero of the page's time; None: the first message sets it."""
        self._row_ns: int | None = None
        self._frame_ns: int | None = None
        self._epoch = self._row_count = self._event_count = 0
        self._rows: deque[tuple[float | None, ...]] = deque(maxlen=round(WINDOW_S * 1e9 / ROW_NS))
        self._events: deque[tuple[float, str, str, str]] = deque(maxlen=EVENTS_KEPT)
        self._beats: dict[int, tuple[int, int] | None] = dict.fromkeys(nodes)
        self._loads: deque[tuple[int, int]] = deque()
        self.present_status, self._sentence, self._suspicion = "waiting", "", ""
        self.watchers = 0
        self.player: dict[str, float] | None = None
        """Position, length (s) and speed of a recorded trial; None where nothing is played."""

    def frame(self, time_ns: int, can_id: int, data: bytes, flags: int = 0) -> None:
        """Record one frame of the bus; callable from any thread."""
        self.frames(cdr.FRAME_STRUCT.pack(time_ns, can_id, flags, min(len(data), 8), 0, False, data[:8]))

    def frames(self, rows: bytes) -> None:
        """Add frames: bytes of `cdr.FRAME_ROW`s; callable from any thread."""
        self._heard_at = self._clock()
        self._blocks.append(rows)

    def force(self, time_ns: int, *forces_n: float) -> None:
        """Add desired, START and END force of each path in one control cycle, NaN for unknown ones; from any thread."""
        self.forces([(time_ns, forces_n)])

    def forces(self, rows: Iterable[Force]) -> None:
        """Add the forces of several control cycles; callable from any thread."""
        self._heard_at = self._clock()
        self._forces.extend(rows)

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        """Add an event, as one sentence; callable from any thread."""
        self._new_events.append((time_ns, kind, source, text))

    def suspected(self, sentence: str) -> None:
        """Set the present suspicion of a diagnosis; callable from any thread."""
        self._suspicion = sentence

    def begin_again(self) -> None:
        """Forget all content but the zero of time, for a seek; callable from any thread."""
        with self.changed:
            for queue in (self._blocks, self._forces, self._new_events):
                queue.clear()
            self._forget(None)

    def status(self, status: str, sentence: str = "") -> None:
        """Set the trial's status (waiting, running, paused or ended) and the sentence shown with it."""
        with self.changed:
            self.present_status, self._sentence = status, sentence
            self.changed.notify_all()

    def digest(self) -> None:
        """Add the queued messages to the page's content and wake its viewers, ten times a second."""
        with self.changed:
            if blocks := _emptied(self._blocks):
                self._frames(np.frombuffer(b"".join(blocks), cdr.FRAME_ROW))
            for time_ns, forces in _emptied(self._forces):
                self._row(time_ns, *forces)
            for event in _emptied(self._new_events):
                self._happened(*event)
            if self.present_status == "waiting" and self._heard_at is not None:
                self.present_status = "running"
            self.changed.notify_all()

    def message(self, seen: tuple[int, int, int]) -> tuple[dict[str, Any], tuple[int, int, int]]:
        """Return the new content for a page that has `seen` (epoch, rows, events), and its next `seen`.

        Call it with `changed` held.
        """
        epoch, rows, events = seen
        if epoch != self._epoch:
            rows = events = 0
        age = None if self._heard_at is None else self._clock() - self._heard_at
        told = {
            **self._about, "player": self.player, "status": self.present_status, "sentence": self._sentence,
            "suspicion": self._suspicion, "epoch": self._epoch, "age_s": age, "now_s": self._seconds(self._now_ns),
            "load_percent": self._load(), "nodes": self._nodes(), "rows": _last(self._rows, self._row_count - rows),
            "events": _last(self._events, self._event_count - events)}
        return told, (self._epoch, self._row_count, self._event_count)

    def _frames(self, rows: NDArray[np.void]) -> None:
        rows = rows[rows["flags"] & cdr.ERROR == 0]
        for time_ns in rows["time_ns"].tolist():
            self._frame_ns = self._at(time_ns, self._frame_ns)
        self._loads.extend(zip(rows["time_ns"].tolist(), frame_bits(rows).tolist(), strict=True))
        beats = rows[(rows["flags"] == 0) & (rows["dlc"] == 1) & np.isin(rows["can_id"], HEARTBEATS)]
        for time_ns, can_id, state in zip(beats["time_ns"].tolist(), beats["can_id"].tolist(),
                                          beats["data"][:, 0].tolist(), strict=True):
            self._beats[can_id & 0x7F] = (time_ns, state & 0x7F)
        while self._loads and self._now_ns is not None and self._loads[0][0] <= self._now_ns - LOAD_NS:
            self._loads.popleft()
        if self._decode_events:
            for event in events_of(rows):
                self._happened(*event)

    def _at(self, time_ns: int, before_ns: int | None) -> int:
        """Set the present bus time and return it; a message older than the last of its kind, `before_ns`, by more than
        `LOAD_NS` comes after a seek and clears the content."""
        if self.first_ns is None:
            self.first_ns = time_ns
        if before_ns is not None and time_ns < before_ns - LOAD_NS:
            self._forget(time_ns)
        self._now_ns = time_ns if self._now_ns is None else max(self._now_ns, time_ns)
        return time_ns

    def _forget(self, now_ns: int | None) -> None:
        self._epoch += 1
        self._rows.clear()
        self._events.clear()
        self._loads.clear()
        self._beats = dict.fromkeys(self._beats)
        self._row_ns = self._frame_ns = None
        self._row_count = self._event_count = 0
        self._now_ns = now_ns

    def _row(self, time_ns: int, *forces: float) -> None:
        self._at(time_ns, self._row_ns)
        if self._row_ns is not None and 0 <= time_ns - self._row_ns < ROW_NS:
            return
        self._row_ns = time_ns
        seconds = self._seconds(time_ns)
        self._rows.append((seconds, *(round(one, 3) if np.isfinite(one) else None for one in forces)))
        self._row_count += 1

    def _happened(self, time_ns: int, kind: str, source: str, text: str) -> None:
        self._at(time_ns, None)
        self._events.append((self._seconds(time_ns) or 0.0, kind, source, text))
        self._event_count += 1

    def _seconds(self, time_ns: int | None) -> float | None:
        return None if time_ns is None or self.first_ns is None else round((time_ns - self.first_ns) * 1e-9, 4)

    def _load(self) -> float | None:
        """Return the share of the last second that the frames took, %; None before there was one."""
        if not self._loads or self._now_ns is None:
            return None
        span = min(LOAD_NS, self._now_ns - (self.first_ns or 0))
        return None if span < LOAD_NS // 5 else 100.0 * sum(b for _, b in self._loads) / (self._bitrate * span * 1e-9)

    def _nodes(self) -> list[dict[str, Any]]:
        told = []
        for node, beat in sorted(self._beats.items()):
            state = None if beat is None else NMT_STATES.get(beat[1], f"state 0x{beat[1]:02X}")
            age = None if beat is None or self._now_ns is None else (self._now_ns - beat[0]) * 1e-9
            told.append({"id": node, "name": NAMES.get(node, f"node {node}"), "state": state, "age_s": age})
        return told


def _emptied(queue: deque[Any]) -> list[Any]:
    """Take all entries out of a queue that another thread may fill."""
    return [queue.popleft() for _ in range(len(queue))]


def _last(kept: deque[Any], count: int) -> list[Any]:
    """Return the last `count` entries, or all if there are fewer."""
    return list(kept)[max(len(kept) - count, 0):]
