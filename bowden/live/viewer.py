"""A Foxglove WebSocket server with the topics of a trial, whatever they come from.

The rule of this file: this is where foxglove-sdk is known, and only here; payloads are those of an MCAP trial.
Its callbacks come from its own threads, so what they touch is the caller's to guard.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from parameters import InputError
from trial.mcap_file import cdr
from trial.playback import Playback, PlayerControl, PlayerStatus

BACKLOG = 1 << 16  # messages a client may be behind; at ten times real time a span of 16 ms has 1 200


def installed() -> bool:
    """True if foxglove-sdk is installed."""
    import importlib.util

    try:
        return importlib.util.find_spec("foxglove") is not None
    except ValueError:  # a module that was taken away while this process ran
        return False


class PlayerRequest(NamedTuple):
    """Request of a viewer's player controls."""

    control: PlayerControl
    speed: float
    seek_ns: int | None


class Viewer:
    """The server; `asked` is called when a client plays, pauses, seeks or changes speed.

    `units` are the columns of /cycle; `span_ns`, first and last time of a recording, gives the client its controls.
    """

    def __init__(
        self, name: str, host: str, port: int, units: Mapping[str, str], *,
        span_ns: tuple[int, int] | None = None, asked: Callable[[PlayerRequest], Playback] | None = None,
    ) -> None:
        try:
            import foxglove
            from foxglove import websocket
        except ImportError:
            raise InputError("bowden live needs foxglove-sdk; say pip install 'bowden-bench[live]'.") from None
        self._sdk, self._context = websocket, foxglove.Context()
        listener = None if asked is None else _listener(asked, self._state)
        try:
            self._server = foxglove.start_server(
                name=name, host=host, port=port, server_listener=listener, context=self._context,
                capabilities=[websocket.Capability.Time], playback_time_range=span_ns, message_backlog_size=BACKLOG)
        except (RuntimeError, OSError, ValueError) as error:
            raise InputError(
                f"--host {host} --port {port}: cannot listen there ({error}); give another port.") from None
        self._channels = {
            topic: foxglove.Channel(
                topic, schema=foxglove.Schema(name=schema, encoding="ros2msg", data=text.encode()),
                message_encoding="cdr", metadata=dict(metadata), context=self._context)
            for topic, schema, text, metadata in (
                (cdr.CYCLE, cdr.CYCLE_SCHEMA_NAME, cdr.cycle_schema(list(units)), units),
                (cdr.FRAMES, cdr.FRAME_SCHEMA_NAME, cdr.FRAME_SCHEMA, {}),
                (cdr.EVENTS, cdr.EVENT_SCHEMA_NAME, cdr.EVENT_SCHEMA, {}))}
        self.port: int = self._server.port
        self.loopback = host in ("localhost", "::1") or host.startswith("127.")
        self.url = f"ws://{host}:{self.port}"
        self.app_url = str(self._server.app_url())

    def wanted(self) -> frozenset[str]:
        """Return the topics that somebody has subscribed to."""
        return frozenset(topic for topic, channel in self._channels.items() if channel.has_sinks())

    def publish(self, topic: str, payload: bytes, time_ns: int) -> None:
        """Send one message to its subscribers."""
        self._channels[topic].log(payload, log_time=time_ns)

    def time(self, time_ns: int) -> None:
        """Send the time of the shown data to every client."""
        self._server.broadcast_time(time_ns)

    def state(self, player: Playback, *, sought: bool = False) -> None:
        """Send the player's position to every client."""
        self._server.broadcast_playback_state(self._state(player, sought, None))

    def _state(self, player: Playback, sought: bool, request: str | None) -> Any:
        status = self._sdk.PlaybackStatus
        shown = {PlayerStatus.PLAYING: status.Playing, PlayerStatus.ENDED: status.Ended}.get(player.status,
                                                                                             status.Paused)
        return self._sdk.PlaybackState(shown, min(player.at_ns, player.last_ns), player.speed, sought, request)

    def close(self) -> None:
        """Stop listening."""
        self._server.stop()


def _listener(asked: Callable[[PlayerRequest], Playback], state: Callable[[Playback, bool, str | None], Any]) -> Any:
    from foxglove.websocket import PlaybackCommand, ServerListener

    class Listener(ServerListener):
        def on_playback_control_request(self, playback_control_request: Any) -> Any:
            told = playback_control_request
            control = PlayerControl.PLAY if told.playback_command == PlaybackCommand.Play else PlayerControl.PAUSE
            return state(asked(PlayerRequest(control, told.playback_speed, told.seek_time)), told.seek_time is not None,
                         told.request_id)

    return Listener()
