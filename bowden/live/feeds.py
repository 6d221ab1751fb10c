"""Sources of the live page: a trial that runs in this process, and a recorded one that is played.

The trial's recorder comes first and receives everything, whatever happens to the page.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, Protocol

from bowden.live.page_process import PageProcess, PageSetup
from bowden.live.state import LiveState
from bowden.live.viewer import Viewer
from bowden.live.web import LivePage
from eds.bench.bench_network import Network, wire
from trial.mcap_file import cdr
from trial.playback import Playback, PlayerStatus
from trial.signals import INDEX

FORCES: Final = ("desired_force_n", "tension_start_n", "tension_end_n")
ALL: Final = frozenset((cdr.CYCLE, cdr.FRAMES, cdr.EVENTS))
STATUS: Final = {PlayerStatus.READY: "waiting", PlayerStatus.PLAYING: "running", PlayerStatus.PAUSED: "paused",
                 PlayerStatus.ENDED: "ended"}
FRAME: Final = struct.Struct("<I3?B8s")
FRAME_AT: Final = 24
"""Offset of the identifier in a `/can/frames` payload: after encapsulation, stamp and frame_id."""
ROW_AT: Final = 12
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
    return PageSetup(name, network.bitrate, tuple(wire(network).nodes), network.heartbeat_timeout_ms * 1e-3)


def state(name: str, kind: str, network: Network, *, decode_events: bool = False) -> LiveState:
    """Return the state of a page for a bench with this network, by this process's clock."""
    return LiveState(name, kind, time.monotonic, *setup(name, network)[1:], decode_events=decode_events)


class TrialFeed:
    """Stream of a trial to its live page and to Foxglove."""

    def __init__(self, page: PageProcess) -> None:
        self._page = page

    def beside(self, recording: Any) -> Any:
        """Return a recorder that also feeds the page."""
        return _Beside(recording, self._page)

    def suspected(self, sentence: str) -> None:
        """Show the present suspicion of the diagnosis during the trial."""
        self._page.suspected(sentence)

    def ended(self, sentence: str) -> None:
        """Show the outcome of the trial."""
        self._page.status("ended", sentence)


class _Beside:
    """A trial's recorder with the page beside it: frames, rows and events go to both, the recorder first.

    A stop that the page has asked for is recorded as an event, from the trial's own thread.
    """

    def __init__(self, recording: TrialRecorder, page: PageProcess) -> None:
        self._record, self._page, self._told_stop = recording, page, False
        self._places = tuple(INDEX[name] for name in FORCES)

    def frame(self, time_ns: int, can_id: int, data: bytes, flags: int = 0, channel: int = 0, sent: bool = False
              ) -> None:
        self._record.frame(time_ns, can_id, data, flags, channel, sent)
        self._page.frame(time_ns, can_id, data, flags)

    def frames(self, rows: Any, count: int, last_ns: int) -> None:
        self._record.frames(rows, count, last_ns)
        self._page.frames(rows)

    def cycle(self, time_ns: int, values: Sequence[float]) -> None:
        self._record.cycle(time_ns, values)
        desired, start, end = self._places
        self._page.force(time_ns, values[desired], values[start], values[end])
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
    from master.cycle import stop_request

    with stop_request.armed() as stop:
        page = PageProcess(setup(name, network), where, stop)
        say(page.url)
        feed = TrialFeed(page)
        try:
            yield feed
        except BaseException as error:
            feed.ended(f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)
            raise
        finally:
            page.close()


class PagedViewer:
    """The page beside a Foxglove server (or alone): takes what `TrialPlayback` sends, in place of a `Viewer`."""

    def __init__(self, viewer: Viewer | None, page: LivePage, columns: Sequence[str]) -> None:
        self._viewer, self._page = viewer, page
        self._places = [columns.index(name) if name in columns else None for name in FORCES]

    def wanted(self) -> frozenset[str]:
        """Return the topics with a subscriber: all of them while a page is open."""
        others = frozenset[str]() if self._viewer is None else self._viewer.wanted()
        return others | (ALL if self._page.state.watchers else frozenset())

    def publish(self, topic: str, payload: bytes, time_ns: int) -> None:
        """Send one message to the page and to Foxglove."""
        if self._viewer is not None:
            self._viewer.publish(topic, payload, time_ns)
        shown = self._page.state
        if topic == cdr.CYCLE:
            desired, start, end = (float("nan") if place is None else float(
                struct.unpack_from("<d", payload, ROW_AT + 8 * place)[0]) for place in self._places)
            shown.force(time_ns, desired, start, end)
        elif topic == cdr.FRAMES:
            can_id, remote, extended, error, size, data = FRAME.unpack_from(payload, FRAME_AT)
            flags = remote * cdr.REMOTE | extended * cdr.EXTENDED | error * cdr.ERROR
            shown.frame(time_ns, can_id, data[:size], flags)
        else:
            shown.event(time_ns, *cdr.event_strings(payload))

    def time(self, time_ns: int) -> None:
        """Send the time to Foxglove; the page reads it from its messages."""
        if self._viewer is not None:
            self._viewer.time(time_ns)

    def state(self, player: Playback, *, sought: bool = False) -> None:
        """Send the player's position to the page and to Foxglove."""
        if self._viewer is not None:
            self._viewer.state(player, sought=sought)
        self._page.state.status(STATUS[player.status], "the recording has been played"
                                if player.status is PlayerStatus.ENDED else "")
