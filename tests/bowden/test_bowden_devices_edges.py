"""Small edges of devices and buses: modes, threads, identities, file objects, missing libraries."""

from __future__ import annotations

import io
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from parameters import InputError
from trial.convert.python_can import McapWriter

Bowden = Callable[..., tuple[int, str, str]]


def test_fd_false_opens_the_bench_and_fd_true_is_refused() -> None:
    with can.Bus("fd", interface="bowden", fd=False) as bus:
        for message in (can.Message(is_fd=True, data=bytes(12)), can.Message(is_error_frame=True)):
            with pytest.raises(can.CanError):
                bus.send(message)
    with pytest.raises(InputError, match="classical CAN"):
        can.Bus("fd", interface="bowden", fd=True)


def test_a_thread_that_waits_without_an_end_lets_another_one_send() -> None:
    with can.Bus("threads", interface="bowden") as waiting, can.Bus("threads", interface="bowden") as sending:
        while waiting.recv(1.0) is not None:
            pass
        waiting.set_filters([{"can_id": 0x123, "can_mask": 0x7FF}])
        found: list[can.Message | None] = []
        thread = threading.Thread(target=lambda: found.append(waiting.recv()))
        # something must happen for ever, or a wait without an end is refused at once
        sending.send_periodic(can.Message(arbitration_id=0x321, is_extended_id=False), 0.001)
        thread.start()
        sending.send(can.Message(arbitration_id=0x123, is_extended_id=False))
        thread.join(30.0)
        assert not thread.is_alive()
        assert found[0] is not None
        assert found[0].arbitration_id == 0x123


def test_a_trial_is_written_into_a_file_object(tmp_path: Path) -> None:
    target = io.BytesIO()
    writer = McapWriter(target)
    writer.on_message_received(can.Message(timestamp=1.0, arbitration_id=0x80, is_extended_id=False))
    writer.stop()
    (tmp_path / "a.mcap").write_bytes(target.getvalue())
    assert [message.arbitration_id for message in can.LogReader(tmp_path / "a.mcap")] == [0x80]


def test_a_backup_counts_what_it_could_not_read_and_another_device_s_file_is_refused(
    here: Path, bowden: Bowden
) -> None:
    assert bowden("node", "backup", "servo", "-o", "servo.dcf")[0] == 0
    status, out, _ = bowden("node", "backup", "knee", "-o", "knee.dcf")
    assert status == 0
    assert "0 could not be read" in out
    for command in ("restore", "compare"):
        status, out, err = bowden("node", command, "start", "servo.dcf")
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert "is of another device than start" in err
        assert "nothing was written" in err


@pytest.mark.parametrize(("interface", "module", "remedy"), [
    ("slcan", "serial", "pip install pyserial"), ("gs_usb", "gs_usb", "pip install gs_usb"),
])
def test_a_missing_library_of_an_interface_is_named(
    bowden: Bowden, monkeypatch: pytest.MonkeyPatch, interface: str, module: str, remedy: str
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr("importlib.util.find_spec", lambda name, package=None: None)
    status, _, err = bowden("home", "--interface", interface, "--channel", "x")
    assert status == 2
    assert remedy in err
    status, out, _ = bowden("doctor", "--interface", interface, "--channel", "x", "--for", "0.1")
    assert status == 1
    assert remedy in out
