"""A CiA 401 module of inputs and outputs behind any EDS; its outputs are wired back to its inputs.

Digital bytes 0x6200 → 0x6000 and analogue 16-bit values 0x6411 → 0x6401, sub-index by sub-index; a lost connection
sets the outputs as 0x6206, 0x6207, 0x6443 and 0x6444 select.
"""

from typing import Final

from eds.cia301 import Emcy, NmtState
from eds.datatype import Value
from nodes.core.application import Application, ProfileHost

DIGITAL: Final = (0x6200, 0x6000)
ANALOGUE: Final = (0x6411, 0x6401)
_OUT_POLARITY, _IN_POLARITY, _ERROR_MODE, _ERROR_VALUE = 0x6202, 0x6002, 0x6206, 0x6207
_ANALOGUE_ERROR_MODE, _ANALOGUE_ERROR_VALUE = 0x6443, 0x6444


class IoModule(Application):
    """Inputs that show the module's own outputs; `loopback` False leaves the inputs to the test."""

    def __init__(self, loopback: bool = True) -> None:
        self.loopback = loopback

    def attach(self, device: ProfileHost) -> None:
        """Listen to all outputs."""
        super().attach(device)
        outputs = (DIGITAL[0], ANALOGUE[0])
        self.watched = frozenset(at for at in device.objects.entries if at >> 8 in outputs and at & 0xFF)
        self.unstored = self.watched

    def written(self, key: int, value: Value, now_ns: int) -> None:
        """Copy a written output to its input."""
        self._wire(key)

    def reset(self, now_ns: int) -> None:
        """Copy the initial outputs to their inputs."""
        for at in self.watched:
            self._wire(at)

    def nmt_changed(self, state: NmtState, now_ns: int) -> None:
        """Set the outputs to their error values in STOPPED."""
        if state is NmtState.STOPPED:
            self._set_error_values()

    def communication_lost(self, reason: Emcy, now_ns: int) -> None:
        """Set the outputs to their error values."""
        self._set_error_values()

    def _set_error_values(self) -> None:
        """Set each output to its error value: the bits of 0x6206, and analogue outputs whose 0x6443 is 1."""
        for at in sorted(self.watched):
            index, sub = at >> 8, at & 0xFF
            value = self.number(index, sub)
            if index == DIGITAL[0]:
                chosen = self.number(_ERROR_MODE, sub, 0xFF)
                self.values[at] = value & ~chosen | self.number(_ERROR_VALUE, sub) & chosen
            elif self.number(_ANALOGUE_ERROR_MODE, sub, 1):
                self.values[at] = self.number(_ANALOGUE_ERROR_VALUE, sub)
            self._wire(at)

    def _wire(self, at: int) -> None:
        index, sub = at >> 8, at & 0xFF
        target = (DIGITAL[1] if index == DIGITAL[0] else ANALOGUE[1]) << 8 | sub
        if not self.loopback or target not in self.device.objects.entries:
            return
        value = self.number(index, sub)
        if index == DIGITAL[0]:
            value ^= self.number(_OUT_POLARITY, sub) ^ self.number(_IN_POLARITY, sub)
        self.values[target] = value
