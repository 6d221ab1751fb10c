"""Waits in virtual time: of any length, in asyncio programs, and python canopen's own LSS master."""

from __future__ import annotations

import asyncio
import queue
import random
import time

import can
import canopen
import pytest

from bowden.testing import CanBus


def test_ten_thousand_random_time_outs_end(can_bus: CanBus) -> None:
    starts = random.Random(48)
    with can_bus.virtual_time():
        box: queue.Queue[int] = queue.Queue()
        for _ in range(10_000):
            can_bus.kernel.run(can_bus.now_ns + starts.randrange(1_000_000_000))
            timeout, began_ns = starts.choice((0.3, 1e-10, starts.random())), can_bus.now_ns
            with pytest.raises(queue.Empty):
                box.get(timeout=timeout)
            assert 0 < can_bus.now_ns - began_ns <= timeout * 1e9 + 1e-3 + 1000


def test_stock_lss_master_finds_a_device(can_bus: CanBus) -> None:
    can_bus.add_node("knee_drive", 255, serial=0x2A)
    with can_bus.virtual_time():
        network = canopen.Network(can_bus.open())
        assert network.lss.fast_scan() == (True, [0xB0DE00, 2, 0x10000, 0x2A])
        network.disconnect()


def test_an_asyncio_program_waits_in_bus_time(can_bus: CanBus) -> None:
    can_bus.add_node("knee_drive", 5)
    stamps: list[float] = []

    async def program() -> list[can.Message]:
        bus = can_bus.open()
        reader = can.AsyncBufferedReader()

        async def heard(message: can.Message) -> None:
            await asyncio.sleep(0.25)
            stamps.append(time.monotonic())

        with can.Notifier(bus, [reader, heard], loop=asyncio.get_running_loop()):
            boot = await reader.get_message()
            await asyncio.sleep(0.5)
            can_bus.after(1.0, lambda: can_bus.send(0x605, bytes.fromhex("4000100000000000")))
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(reader.get_message(), timeout=0.9)
            request, answer = await reader.get_message(), await asyncio.wait_for(reader.get_message(), 0.1)
        return [boot, request, answer]

    with can_bus.virtual_time():
        messages = asyncio.run(program())
    assert [message.arbitration_id for message in messages] == [0x705, 0x605, 0x585]
    assert can_bus.now_ns == pytest.approx(1_500_300_000, abs=200_000)
    assert stamps == [pytest.approx(0.250055, abs=1e-6)]


def test_an_asyncio_wait_that_can_never_end_is_a_sentence(can_bus: CanBus) -> None:
    with can_bus.virtual_time(), pytest.raises(RuntimeError, match="a wait without time-out can never end"):
        asyncio.run(asyncio.Event().wait())
