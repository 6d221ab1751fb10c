"""CiA 404: what a sensor says when its value cannot be trusted: status, EMCY, and the value itself."""

from __future__ import annotations

import math
import struct

import pytest

from eds.bench.bench_network import END, START
from eds.cia301 import NmtCommand
from physics.converter import FULL_COUNTS
from tests.nodes.drive_rig import NodeBus
from tests.nodes.test_sensor_values import Gauge

NOT_VALID, POSITIVE, NEGATIVE = 1, 2, 4


def test_before_its_first_sample_there_is_no_value() -> None:
    gauge = Gauge()
    assert gauge.read(0x6150, 1) == NOT_VALID
    assert gauge.read(0x7130, 1) == -32_768
    assert gauge.read(0x9130, 1) == -(1 << 31)
    assert math.isnan(gauge.read(0x6130, 1))
    assert gauge.emergencies() == []


def test_a_broken_wire_is_status_emcy_and_no_value() -> None:
    gauge = Gauge()
    gauge.setup()
    gauge.feel(30.0).feel(30.0, status=NOT_VALID, times=3)
    assert gauge.emergencies() == [0x5030]
    assert gauge.read(0x6150, 1) == NOT_VALID
    assert struct.unpack("<h", gauge.sync()[0].data) == (-32_768,)
    assert gauge.read(0x1001) & 0x21 == 0x21
    gauge.feel(31.0, times=300)
    assert gauge.emergencies() == [0x0000]
    assert gauge.read(0x6150, 1) == 0
    assert gauge.read(0x7130, 1) == 3100
    assert gauge.read(0x1001) == 0


def test_a_mended_wire_leaves_nothing_old_in_the_filter() -> None:
    gauge = Gauge()
    gauge.write(0x61A1, 1, 100)
    gauge.feel(30.0, times=100).feel(0.0, status=NOT_VALID).feel(10.0)
    assert gauge.read(0x7130, 1) == 1000


@pytest.mark.parametrize(("newton", "status"), [(199.9, 0), (-19.9, 0), (-20.1, NEGATIVE)])
def test_outside_the_span_is_over_range(newton: float, status: int) -> None:
    gauge = Gauge().feel(newton)
    assert gauge.read(0x6150, 1) == status
    assert gauge.emergencies() == ([0xF001] if status else [])
    assert gauge.read(0x7130, 1) == round(100 * newton)


@pytest.mark.parametrize(("counts", "status"), [(FULL_COUNTS - 1, POSITIVE), (-FULL_COUNTS, NEGATIVE)])
def test_a_converter_at_its_end_is_over_range(counts: int, status: int) -> None:
    gauge = Gauge()
    gauge.write(0x6148, 1, -1000.0)
    gauge.write(0x6149, 1, 1000.0)
    gauge.node.sample(counts)
    assert gauge.read(0x6150, 1) == status
    assert gauge.emergencies() == [0xF001]


def test_over_range_passes() -> None:
    gauge = Gauge().feel(-25.0, times=2).feel(5.0)
    assert gauge.emergencies() == [0xF001, 0x0000]
    assert gauge.read(0x6150, 1) == 0


def test_from_one_trouble_to_another() -> None:
    gauge = Gauge().feel(-25.0).feel(0.0, status=NOT_VALID).feel(-25.0).feel(0.0)
    codes = gauge.emergencies()
    assert codes[0] == 0xF001
    assert 0x5030 in codes
    assert codes[-1] == 0x0000
    assert gauge.read(0x1001) == 0


def test_span_is_one_value_in_two_types() -> None:
    gauge = Gauge()
    assert (gauge.read(0x6148, 1), gauge.read(0x6149, 1)) == (-20.0, 200.0)
    gauge.write(0x6149, 1, 50.5)
    assert gauge.read(0x9149, 1) == 5050
    gauge.write(0x9148, 1, -100)
    assert gauge.read(0x6148, 1) == -1.0
    gauge.feel(50.6)
    assert gauge.read(0x6150, 1) == POSITIVE
    gauge.feel(-1.1)
    assert gauge.read(0x6150, 1) == NEGATIVE
    assert gauge.refused(0x6149, 1, -1.0) == 0x06090036
    assert gauge.refused(0x9148, 1, 5050) == 0x06090036


def test_the_span_outlives_other_settings() -> None:
    gauge = Gauge()
    gauge.write(0x6149, 1, 50.125)
    gauge.write(0x61A0, 1, 1)
    assert gauge.read(0x6149, 1) == 50.125
    gauge.write(0x6132, 1, 3)
    assert (gauge.read(0x6149, 1), gauge.read(0x9149, 1)) == (50.125, 50_125)
    gauge.feel(50.0)
    assert gauge.read(0x6150, 1) == 0


def test_a_channel_that_is_off_has_no_value_and_no_trouble() -> None:
    gauge = Gauge().feel(10.0)
    gauge.write(0x6112, 1, 0)
    gauge.feel(20.0).feel(0.0, status=NOT_VALID)
    assert gauge.read(0x6150, 1) == NOT_VALID
    assert gauge.read(0x7130, 1) == -32_768
    assert gauge.emergencies() == []
    gauge.write(0x6112, 1, 1)
    gauge.feel(20.0)
    assert gauge.read(0x7130, 1) == 2000


@pytest.mark.parametrize(("newton", "status", "code"), [(0.0, NOT_VALID, 0x5030), (-20.1, 0, 0xF001)])
def test_turning_a_channel_off_ends_its_trouble(newton: float, status: int, code: int) -> None:
    gauge = Gauge().feel(newton, status=status)
    gauge.write(0x6112, 1, 0)
    assert gauge.emergencies() == [code, 0x0000]
    assert gauge.read(0x1001) == 0


def test_values_go_out_every_100_ms_until_configured_otherwise() -> None:
    gauge = Gauge()
    gauge.nmt(NmtCommand.START)
    gauge.forget()
    for _ in range(10):
        gauge.feel(10.0, times=100)
    counts = [struct.unpack("<iB", data)[0] for data in gauge.frames(0x180 + START)]
    assert counts[1:] == [1000] * (len(counts) - 1)
    assert len(counts) in (10, 11)


def test_a_broken_wire_is_said_again_after_a_reset() -> None:
    gauge = Gauge().feel(0.0, status=NOT_VALID)
    gauge.emergencies()
    gauge.nmt(NmtCommand.RESET_NODE)
    gauge.feel(0.0, status=NOT_VALID)
    assert gauge.emergencies() == [0x5030]


def test_a_change_of_status_is_an_event_of_its_pdo() -> None:
    gauge = Gauge()
    gauge.nmt(NmtCommand.START)
    gauge.feel(10.0)
    gauge.forget()
    gauge.feel(10.0, status=NOT_VALID)
    assert [struct.unpack("<iB", data) for data in gauge.frames(0x180 + START)] == [(-(1 << 31), NOT_VALID)]


def test_the_identity_says_what_profile() -> None:
    bus = NodeBus(END)
    assert bus.read(0x1000) == 0x00020194
    assert bus.read(0x6131, 1) == 0x00210000
    assert bus.read(0x6110, 1) == 0x46
