"""The complete control cycle: all inputs of one SYNC received, and nothing but SYNC, inputs, targets and heartbeats.

A separate module, because the master uses it and two buses that do not import each other provide it: the simulated
bus (`virtual_bus.compiled.compiled_cycles`) and the kernel's CAN (`master.network.recorded_bus`).
"""

from typing import Any, NamedTuple, Protocol


class CompleteCycle(NamedTuple):
    """One complete cycle, from the master's targets to the last input of the next SYNC; its bytes hold until the next.

    `sync_ns` and `target_ns` are the time stamps of SYNC and of the targets' frame, ns.  `inputs` has a time stamp and
    data for each input in the order asked for, as `eds.pdo_plan.JoinedUnpacker` reads them.  `heartbeats` has the
    identifier, time stamp (ns) and NMT state of each heartbeat, the master's own with the time at which it was sent.
    `frames` has the `frame_count` frames received since the last call up to this SYNC, as rows of
    `trial.mcap_file.cdr.FRAME_ROW`.
    """

    sync_ns: int
    target_ns: int
    inputs: Any
    heartbeats: tuple[tuple[int, int, int], ...]
    frames: Any
    frame_count: int


class CompleteCycles(Protocol):
    """Interface of a bus that runs complete cycles; its method `cycles` returns one, or None."""

    def run(self, data: bytes, beat_ns: int, after_ns: int) -> CompleteCycle | bool:
        """Send the targets `data`, and a heartbeat at `beat_ns`, and go on to the last input of the next SYNC.

        That SYNC has to end after `after_ns`: an earlier one belongs to the cycle before.  False: nothing was sent, and
        the master runs this cycle frame by frame.  True: the targets were sent, and every frame that came waits to be
        received.  Raises `can.CanError` if the bus failed.
        """
