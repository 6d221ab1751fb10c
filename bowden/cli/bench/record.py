"""`bowden record`: everything on a bus into MCAP, listening only.

It never sends a frame, so a master may run or not; every file is complete whenever the command ends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from bowden import output_files
from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus
from bowden.cli.terminal import CommandAnswer

if TYPE_CHECKING:
    from bowden.trials.recording import BusRecording

Frames = Annotated[int | None, typer.Option(metavar="N", min=1, help="End after so many frames.")]
MaxSize = Annotated[float | None, typer.Option(metavar="MB", min=0.01, help="A new file after so many MB.")]
MaxTime = Annotated[float | None, typer.Option(metavar="S", min=0.001, help="A new file after so many s of bus time.")]


@app.command()
def record(
    output: options.Output, interface: options.AnyInterface, channel: options.Channel = None,
    bitrate: options.Bitrate = None, option: options.Extra = None, *, seconds: options.Seconds = None,
    frames: Frames = None, max_size: MaxSize = None, max_time: MaxTime = None, config: options.Config = None,
    overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Record a bus, listening only.

    Every frame and the control cycles that they make, until Ctrl-C; the master may be any.  With --max-size or
    --max-time FILE-001, FILE-002 … follow each other, each whole; bowden merge makes them one.

    Example: bowden record --interface virtual --channel bench --for 1 -o bus.mcap
    """
    import can

    from bowden.bench import buses
    from bowden.trials.recording import BusRecording
    from eds.bench.bench_network import wire

    reached = Bus(interface, channel, bitrate, option, config=config)
    network, chosen = reached.network(), reached.chosen()
    output_files.refuse_ending(output, ".mcap", what="a recording")
    made = BusRecording(output, wire(network), overwrite=overwrite, about={
        "interface": interface, "channel": channel or "", "bitrate": str(bitrate or network.bitrate)},
        max_bytes=None if max_size is None else round(max_size * 1e6),
        max_ns=None if max_time is None else round(max_time * 1e9))
    failure = None
    with buses.opened_one(chosen, network.bitrate) as heard, made:
        terminal.remark(f"recording {interface} {channel or ''}; Ctrl-C ends it.")
        try:
            made.listen(heard, seconds, frames)
        except (can.CanError, OSError) as error:
            failure = str(error)
        except KeyboardInterrupt:
            made.close()
            terminal.show(_answer(made, None))
            raise
    return _answer(made, failure)


def _answer(made: BusRecording, failure: str | None) -> CommandAnswer:
    result: dict[str, Any] = made.as_json()
    if failure is not None:
        terminal.remark(f"the bus has failed: {failure}; what it gave is recorded.")
    left = f", {result['left_out']} CAN FD frames left out" if result["left_out"] else ""
    return CommandAnswer(result, f"{', '.join(result['files'])}: {result['frames']} frames, {result['cycles']} control "
                         f"cycles{left}.", 0 if failure is None else 1)
