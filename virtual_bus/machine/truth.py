"""The side file with the true signals that no device measures.

It is written beside the trial, never into it, and writing changes no simulated value: the values are those of the
last drive tick before the SYNC that stamps them. A full disk ends the file, and the bench goes on.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eds.cia301 import Frame
from physics.plant.bench_plant import Plant
from trial.record import Recorder, RecordingError
from trial.signals import Signal
from virtual_bus.wire.station import Station

SYNC: Final = 0x080
TABLE: Final = "/truth"
UNITS: Final = {
    "_n": "N", "_m": "m", "_rad": "rad", "_m_s": "m/s", "_rad_s": "rad/s", "_a": "A", "_v": "V", "_nm": "N·m",
}


class Truth(Station):
    """Listens for SYNC and writes a row of `plant.truth()` at each, to table `/truth` of the file at `path`."""

    def __init__(self, path: str, plants: Mapping[str, Plant], metadata: Mapping[str, str]) -> None:
        super().__init__("truth", self._latch, filters=frozenset({SYNC}), listen_only=True)
        self._plants = tuple(plants.values())
        self._recorder = Recorder(
            path, metadata=metadata, attachments={}, threaded=False, overwrite=True,
            signals=signals_of(plants), table=TABLE,
        )

    def _latch(self, frame: Frame, now_ns: int) -> None:
        with suppress(RecordingError):
            self._recorder.cycle(now_ns, [value for plant in self._plants for value in plant.truth().values()])

    def rows(self, times_ns: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Write rows of true signals at n SYNCs: n times, (n, columns) values."""
        with suppress(RecordingError):
            self._recorder.cycles(times_ns, values)

    def close(self) -> None:
        """Close the file."""
        with suppress(RecordingError):
            self._recorder.close({})


def signals_of(plants: Mapping[str, Plant]) -> tuple[Signal, ...]:
    """Return the truth's columns, each behind its plant's prefix, their unit read from the name's ending."""
    return tuple(Signal(prefix + name, _unit(name), "true value, from the plant")
                 for prefix, plant in plants.items() for name in plant.truth())


def _unit(name: str) -> str:
    ending = max((end for end in UNITS if name.endswith(end)), key=len, default="")
    return UNITS.get(ending, "1")
