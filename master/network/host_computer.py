"""The computer of the cycle: requests to the kernel, and those it refused.

A trial runs without any of these; each refusal gives one sentence with the command to type, and the trial goes on.
The priority is requested last, since slow requests would otherwise delay another cycle on this processor.
"""

import ctypes
import gc
import os
import socket
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

PRIORITY: Final = 80
"""SCHED_FIFO priority of the cycle's thread: above everything but the kernel's own threads that carry the interrupts of
the CAN controller."""
SWITCH_S: Final = 100e-6
"""Longest time that another thread of this process may hold the interpreter when the cycle needs it."""
ISOLATED: Final = Path("/sys/devices/system/cpu/isolated")
_MCL_CURRENT_FUTURE_ONFAULT: Final = 1 | 2 | 4
_PR_SET_THP_DISABLE: Final = 41
IS_LINUX: Final = hasattr(os, "sched_setscheduler")
"""Whether the requests of a real-time cycle exist here; macOS and Windows have none of them."""
HARDWARE_STAMPS: Final = 1 << 2 | 1 << 6
"""Flags of SO_TIMESTAMPING: received frames are stamped by the adapter, and its stamps are handed over raw."""
_SIOCETHTOOL, _ETHTOOL_GET_TS_INFO = 0x8946, 0x41
PERMIT: Final = "sudo setcap cap_sys_nice,cap_ipc_lock=ep"


@contextmanager
def prepared() -> Iterator[list[str]]:
    """Prepare the calling thread for a cycle in wall time; yields the requests that were refused, one sentence each."""
    refused: list[str] = []
    with ExitStack() as stack:
        stack.enter_context(collector_frozen())
        for ask in (_interpreter, *((_pages, _memory, _affinity, _scheduling) if IS_LINUX else ())):
            try:
                stack.callback(ask())
            except OSError as error:
                refused.append(f"{_NAMES[ask]} is not permitted ({error.strerror}); type "
                               f"{PERMIT} {os.path.realpath(sys.executable)}, or run as root.")
        if not IS_LINUX:
            refused.append("This system has no real-time scheduling: cycles are late whenever other programs run.")
        yield refused


@contextmanager
def collector_frozen() -> Iterator[None]:
    """Disable garbage collection in the context; objects that exist are exempt until its end.

    A program that has exempted objects itself keeps them exempt: Python ends all exemptions or none.
    """
    enabled, frozen = gc.isenabled(), gc.get_freeze_count()
    gc.collect()
    if not frozen:
        gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        if not frozen:
            gc.unfreeze()
        if enabled:
            gc.enable()


def _interpreter() -> Callable[[], object]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    return lambda: sys.setswitchinterval(before)


def _pages() -> Callable[[], object]:
    """Disable transparent huge pages; return how to undo it. Their daemon locks the address space, for long if the
    cycle has a higher priority."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_THP_DISABLE, 1, 0, 0, 0)
    return lambda: libc.prctl(_PR_SET_THP_DISABLE, 0, 0, 0, 0)


def _scheduling() -> Callable[[], object]:
    """Schedule the calling thread in real time (SCHED_FIFO); return how to undo it."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    return lambda: os.sched_setscheduler(0, policy, parameters)


def _memory() -> Callable[[], object]:
    """Lock touched memory pages; return how to undo it. No page is touched in advance."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_FUTURE_ONFAULT):
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return lambda: libc.munlockall()


def _affinity() -> Callable[[], object]:
    """Bind the cycle to a processor that the kernel keeps free (isolcpus), if one exists; return how to undo it."""
    before = os.sched_getaffinity(0)
    isolated = processors(ISOLATED.read_text(encoding="ascii")) if ISOLATED.exists() else set()
    if isolated:
        os.sched_setaffinity(0, {min(isolated)})
    return lambda: os.sched_setaffinity(0, before)


_NAMES: Final[dict[Callable[[], Callable[[], object]], str]] = {
    _interpreter: "a short switch interval", _pages: "doing without huge pages",
    _scheduling: f"SCHED_FIFO {PRIORITY}", _memory: "mlockall", _affinity: "an isolated processor",
}


def processors(text: str) -> set[int]:
    """Return the numbers of a kernel's list such as "2-3,6"."""
    found: set[int] = set()
    for part in text.strip().split(","):
        first, _, last = part.partition("-")
        if first:
            found.update(range(int(first), int(last or first) + 1))
    return found


def hardware_stamps(channel: str) -> bool:
    """Return whether the driver of an interface offers time stamps of its hardware (ethtool -T)."""
    if sys.platform != "linux":
        return False
    import fcntl

    answer = ctypes.create_string_buffer(struct.pack("=I40x", _ETHTOOL_GET_TS_INFO))  # struct ethtool_ts_info
    request = struct.pack("16sQ16x", channel.encode()[:15], ctypes.addressof(answer))  # struct ifreq
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as asked:
            fcntl.ioctl(asked, _SIOCETHTOOL, request)
    except OSError:
        return False
    (offered,) = struct.unpack_from("=4xI", answer.raw)
    return bool(offered & HARDWARE_STAMPS == HARDWARE_STAMPS)
