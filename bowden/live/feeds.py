"""Sources of the live page: a trial that runs in this process, and a bus that is listened to.

The trial's recorder comes first and receives everything, whatever happens to the page.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, Protocol

from bowden.live.page_process import PageProcess, PageSetup
from bowden.live.state import FORCES, LiveState
from eds.bench.bench_network import Network, wire
from trial.follow import Follower
from trial.mcap_file import cdr
from trial.signals import of_bench, of_paths

OTHER_PROCESS: Final = ("This process only listens to the bus. To stop: press Ctrl-C where the trial runs, the button "
                        "of its own page (bowden trial --web), or the emergency stop.")
RECORDED: Final = "This is a recorded trial: there is nothing to stop."


class TrialRecorder(Protocol):
    """Interface of a trial's recorder."""

    frame: Callable[..., None]
    frames: Callable[..., None]
    event: Callable[..., None]
    cycle: Callable[..., None]


def setup(name: str, network: Network) -> PageSetup:
    """Return the settings for the page of a bench with this network."""
    return PageSetup(name, network.bitrate, tuple(wire(network).nodes), network.heartbeat_timeout_ms * 1e-3,
                     network.bench.path_prefixes)


def state(name: str, kind: str, network: Network, paths: Sequence[str] | None = None, *, decode_events: bool = False
          ) -> LiveState:
    """Return the state of a page for a bench with this network, by this process's clock; `paths`: of a recorded trial.
    """
    made = setup(name, network)
    made = made if paths is None else made._replace(paths=tuple(paths))
    return LiveState(name, kind, time.monotonic, *made[1:], decode_events=decode_events)


class TrialFeed:
    """Stream of a trial to its live page."""

    def __init__(self, page: PageProcess, places: Sequence[int]) -> None:
        self._page, self._places = page, places

    def beside(self, recording: Any) -> Any:
        """Return a recorder that also feeds the page."""
        return _LiveRecorder(recording, self._page, self._places)

    def suspected(self, sentence: str) -> None:
        """Show the present suspicion of the diagnosis during the trial."""
        self._page.suspected(sentence)

    def ended(self, sentence: str) -> None:
        """Show the outcome of the trial."""
        self._page.status("ended", sentence)


class _LiveRecorder:
    """A trial's recorder with the page beside it: frames, rows and events go to both, the recorder first.

    A stop that the page has asked for is recorded as an event, from the trial's own thread. `places`: of the forces in
    a row.
    """

    def __init__(self, recording: TrialRecorder, page: PageProcess, places: Sequence[int]) -> None:
        self._record, self._page, self._places, self._told_stop = recording, page, places, False

    def frame(self, time_ns: int, can_id: int, data: bytes, flags: int = 0, channel: int = 0, sent: bool = False
              ) -> None:
        self._record.frame(time_ns, can_id, data, flags, channel, sent)
        self._page.frame(time_ns, can_id, data, flags)

    def frames(self, rows: Any, count: int, last_ns: int) -> None:
        self._record.frames(rows, count, last_ns)
        self._page.frames(rows)

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        self._record.cycle(time_ns, values)
        self._page.force(time_ns, *[values[place] for place in self._places])
        if self._page.stop_asked and not self._told_stop:
            self._told_stop = True
            self.event(time_ns, "stop", "master", "safe stop requested by the live page's button.")

    def event(self, time_ns: int, kind: str, source: str, text: str) -> None:
        self._record.event(time_ns, kind, source, text)
        self._page.event(time_ns, kind, source, text)


@contextmanager
def of_trial(where: str, name: str, network: Network, say: Callable[[str], None]) -> Iterator[TrialFeed]:
    """Serve the page of a trial that runs inside this context, at `where` ([HOST:]PORT).

    `say` receives the address before the trial begins. Raises `InputError` if the address cannot be used.
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
        time_ns = getattr(message, "time_ns", None) or round(message.timestamp * 1e9)
        flags = (message.is_remote_frame * cdr.REMOTE | message.is_extended_id * cdr.EXTENDED
                 | message.is_error_frame * cdr.ERROR)
        data = bytes(message.data)
        self._shown.frame(time_ns, message.arbitration_id, data, flags)
        ended = None if flags else self._follow(time_ns, message.arbitration_id, data)
        if ended is not None:  # no PDO carries the desired force
            at, values = ended
            forces = (values[place] for place in self._places)
            self._shown.force(at, *(force for start in forces for force in (math.nan, start, next(forces))))
