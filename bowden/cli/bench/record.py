"""`bowden record`: everything on a bus into MCAP, listening only.

It never sends a frame, so a master may run or not; every file is complete whenever the command ends.
"""

from __future__ import annotations

from typing import Annotated

import typer

from bowden.cli import options, terminal
from bowden.cli.app import app
from bowden.cli.option_groups import Bus, grouped

Interface = Annotated[str, typer.Option(
    metavar="NAME", help="python-can interface, such as socketcan, udp_multicast or virtual.")]
Seconds = Annotated[float | None, typer.Option("--for", metavar="S", help="End after so many seconds.")]
Frames = Annotated[int | None, typer.Option(metavar="N", min=1, help="End after so many frames.")]
MaxSize = Annotated[float | None, typer.Option(metavar="MB", min=0.01, help="A new file after so many MB.")]
MaxTime = Annotated[float | None, typer.Option(metavar="S", min=0.001, help="A new file after so many s of bus time.")]


@app.command()
@grouped
def record(
    output: options.Output,
    interface: Interface,
    channel: options.Channel = None,
    bitrate: options.Bitrate = None,
    option: options.Extra = None,
    *,
    seconds: Seconds = None,
    frames: Frames = None,
    max_size: MaxSize = None,
    max_time: MaxTime = None,
    config: options.Config = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
) -> int:
    """Record a bus, listening only.

    Every frame and the control cycles that they make, until Ctrl-C; the master may be any.  With --max-size or
    --max-time FILE-001, FILE-002 … follow each other, each whole; bowden merge makes them one.

    Example: bowden record --interface virtual --channel bench --for 1 -o bus.mcap
    """
    import can

    from bowden import output_files
    from bowden.bench import buses
    from bowden.trials.recording import BusRecording
    from eds.bench.bench_network import wire

    reached = Bus(interface, channel, bitrate, option)
    network = reached.sections(config)["network"]
    output_files.refuse_ending(output, ".mcap", what="a recording")
    chosen = reached.chosen()
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
            _tell(made.as_json(), json=json)
            raise
    _tell(made.as_json(), json=json)
    if failure is not None:
        terminal.remark(f"the bus has failed: {failure}; what it gave is recorded.")
    return 0 if failure is None else 1


def _tell(told: dict[str, object], *, json: bool) -> None:
    if json:
        terminal.emit(told)
        return
    files = told["files"]
    assert isinstance(files, list)
    left = f", {told['left_out']} CAN FD frames left out" if told["left_out"] else ""
    print(f"{', '.join(files)}: {told['frames']} frames, {told['cycles']} control cycles{left}.")
