"""Sources of the live page: a trial that runs in this process, a bus that is listened to, a recording that is played.

The trial's recorder comes first and receives everything, whatever happens to the page. Threads of the page only
change the playback of a recording, under its lock; `TrialPlayer.look` alone adds messages.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

from bowden.live.page_process import PageProcess, PageSetup
from bowden.live.state import FORCES, ROW_NS, WINDOW_S, LiveState
from eds.bench.bench_network import Network, wire
from master.cycle.log import CycleSink
from trial.convert.python_can import flags_of, time_ns_of
from trial.decode import Follower
from trial.playback import Playback, PlayerControl, PlayerStatus, ready
from trial.read import Trial
from trial.signals import of_bench, of_paths

OTHER_PROCESS: Final = ("This process only listens to the bus. To stop: press Ctrl-C where the trial runs, the button "
                        "of its own page (bowden trial --web), or the emergency stop.")
FRAME_S: Final = 1 / 60  # between two looks at the clock
RECORDED: Final = "This is a recorded trial: there is nothing to stop."


def setup(name: str, network: Network) -> PageSetup:
    """Return the settings for the page of a bench with this network."""
    return PageSetup(name, network.bitrate, tuple(wire(network).nodes), network.heartbeat_timeout_ms * 1e-3,
                     network.bench.path_prefixes)


def state(name: str, kind: str, network: Network, paths: Sequence[str] | None = None, *, decode_events: bool = False
          ) -> LiveState:
    """Return the state of a page that this process serves for a bench; `paths`: force paths of a recorded trial."""
    own = setup(name, network)
    return LiveState(name, kind, time.monotonic, *own[1:4], paths or own.paths, decode_events=decode_events)


class TrialFeed:
    """Recorder of a trial that shows it on its live page too: frames, rows and events go to both, the recorder first.

    A stop that the page has asked for is recorded as an event, from the trial's own thread. `places`: of the forces in
    a row.
    """

    def __init__(self, page: PageProcess, places: Sequence[int]) -> None:
        self._page, self._places, self._stop_recorded = page, places, False
        self.suspected = page.suspected
        self._record: CycleSink

    def beside(self, recording: CycleSink) -> CycleSink:
        """Return this feed in place of the trial's recorder `recording`, which receives everything first."""
        self._record = recording
        return self

    def ended(self, sentence: str) -> None:
        """Show the outcome of the trial."""
        self._page.status("ended", sentence)

    def frame(self, time_ns: int, can_id: int, data: bytes, flags: int = 0, channel: int = 0, sent: bool = False
              ) -> None:
        """Record and show one CAN frame."""
        self._record.frame(time_ns, can_id, data, flags, channel, sent)
        self._page.frame(time_ns, can_id, data, flags)

    def frames(self, rows: Any, count: int, last_ns: int) -> None:
        """Record and show `count` frames, bytes of `cdr.FRAME_ROW`s."""
        self._record.frames(rows, count, last_ns)
        self._page.frames(rows)

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        """Record one control cycle and show its forces."""
        self._record.cycle(time_ns, values)
        self._page.force(time_ns, *[values[place] for place in self._places])
        if self._page.stop_asked and not self._stop_recorded:
            self._stop_recorded = True
            self.event(time_ns, "stop", "master", "safe stop requested by the live page's button.")

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        """Record and show an event."""
        self._record.event(time_ns, kind, source, text)
        self._page.event(time_ns, kind, source, text)


@contextmanager
def of_trial(where: str, name: str, network: Network, say: Callable[[str], None]) -> Iterator[TrialFeed]:
    """Serve the live page of the trial `name` at `where` ([HOST:]PORT) until the `with` block ends; yield its feed.

    The caller runs the trial in the block and gives the feed in place of the trial's recorder (`TrialFeed.beside`).
    The page's stop button requests a safe stop of that trial. `say` receives the page's URL before the block begins.
    Raises `InputError` if the address cannot be used.
    """
    from master.cycle.run_safely import stop_button

    with stop_button() as stop:
        page = PageProcess(setup(name, network), where, stop)
        say(page.url)
        feed = TrialFeed(page, places(network, FORCES))
        try:
            yield feed
        except BaseException as error:
            feed.ended(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
            raise
        finally:
            page.close()


def places(network: Network, names: Sequence[str]) -> list[int]:
    """Return the places of `names`, of each force path of a bench, in a row of its trial."""
    row = [signal.name for signal in of_bench(network.bench)]
    return [row.index(name) for name in of_paths(network.bench.path_prefixes, names)]


class BusFeed:
    """Feed of a running bus, which is only listened to: each frame, and the forces of each cycle."""

    def __init__(self, network: Network, shown: LiveState) -> None:
        follower = Follower(wire(network))
        self._follow, self._shown = follower.frame, shown
        self._places = [follower.names.index(name)
                        for name in of_paths(shown.paths, ("tension_start_n", "tension_end_n"))]

    def take(self, message: Any) -> None:
        """Take one message as `can.BusABC.recv` gives it; CAN FD frames are no bench's and are left out."""
        if message.is_fd:
            return
        time_ns, flags, data = time_ns_of(message), flags_of(message), bytes(message.data)
        self._shown.frame(time_ns, message.arbitration_id, data, flags)
        ended = None if flags else self._follow(time_ns, message.arbitration_id, data)
        if ended is not None:  # no PDO carries the desired force
            at, values = ended
            forces = (values[place] for place in self._places)
            self._shown.force(at, *(force for start in forces for force in (math.nan, start, next(forces))))


STATUS: Final = {PlayerStatus.READY: "waiting", PlayerStatus.PLAYING: "running", PlayerStatus.PAUSED: "paused",
                 PlayerStatus.ENDED: "ended"}
PLAYED: Final = "the recording has been played"


class TrialPlayer:
    """Player of a trial: `clock` in ns, the content goes to `shown`; begins when somebody watches."""

    def __init__(self, recorded: Trial, speed: float, clock: Callable[[], int], shown: LiveState) -> None:
        self._shown, self._clock, self._lock, self._sought = shown, clock, threading.Lock(), False
        self._frames = recorded.frames[np.argsort(recorded.frames["time_ns"], kind="stable")]
        self._events = sorted(recorded.events, key=lambda event: event.time_ns)
        missing = np.full(len(recorded.time_ns), np.nan)
        self._forces = np.column_stack([recorded.columns.get(name, missing) for name in of_paths(shown.paths, FORCES)])
        self._times = (recorded.time_ns, np.ascontiguousarray(self._frames["time_ns"]),
                       np.array([event.time_ns for event in self._events], np.int64))
        ends = [int(times[place]) for times in self._times if len(times) for place in (0, -1)]
        self._playback = ready(min(ends, default=0), max(ends, default=0), clock(), speed)
        shown.first_ns = self._playback.first_ns
        self._tell()

    def request(self, control: PlayerControl, speed: float | None, at_s: float | None) -> None:
        """Apply a request of the page's controls; `at_s`: position after the beginning, s.  From any thread."""
        seek_ns = None if at_s is None else self._playback.first_ns + round(min(max(at_s, 0.0), 1e9) * 1e9)
        with self._lock:
            self._sought = self._sought or seek_ns is not None
            self._playback = self._playback.commanded(self._clock(), control, speed=speed, seek_ns=seek_ns)

    def play(self, over: Callable[[], bool]) -> None:
        """Add the messages as they become due, until `over()`."""
        while not over():
            self.look()
            time.sleep(FRAME_S)

    def look(self) -> None:
        """Add the messages that are due; after a seek also those of the window before the position."""
        with self._lock:
            clock = self._clock()
            if self._shown.watchers:
                self._playback = self._playback.watched(clock)
            before, sought, self._sought = self._playback, self._sought, False
            self._playback = now = before.advanced(clock)
        if sought:
            self._shown.begin_again()
        self._add(before.at_ns - sought * round(WINDOW_S * 1e9), now.at_ns)
        self._tell()

    def _add(self, first_ns: int, end_ns: int) -> None:
        """Add the messages from `first_ns` up to, not including, `end_ns`; forces as densely as a page shows."""
        rows, frames, events = (slice(*np.searchsorted(times, (first_ns, end_ns)).tolist()) for times in self._times)
        times = self._times[0][rows]
        shown = np.diff(times // ROW_NS, prepend=-1) != 0
        for at, forces in zip(times[shown].tolist(), self._forces[rows][shown].tolist(), strict=True):
            self._shown.force(at, *forces)
        if frames.stop > frames.start:
            self._shown.frames(self._frames[frames].tobytes())
        for event in self._events[events]:
            self._shown.event(*event)

    def _tell(self) -> None:
        """Show the position, and the status where it has changed."""
        playback: Playback = self._playback
        self._shown.player = {
            "at_s": (min(playback.at_ns, playback.last_ns) - playback.first_ns) * 1e-9,
            "length_s": (playback.last_ns - playback.first_ns) * 1e-9, "speed": playback.speed}
        status = STATUS[playback.status]
        if status != self._shown.present_status:
            self._shown.digest()
            self._shown.status(status, PLAYED if status == "ended" else "")
