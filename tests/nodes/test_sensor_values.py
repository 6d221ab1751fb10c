"""CiA 404: from the converter's counts to newtons on the wire, by two points, an offset, decimals and a filter."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eds.bench.bench_network import END, START
from eds.cia301 import SIGNATURE_SAVE, SIGNATURE_ZERO, NmtCommand
from nodes import TensionSensor
from nodes.sensors import channel_law
from nodes.sensors.channel_law import INTEGER16, INTEGER32, FilterType, filter_settings, integer, invalid, two_point
from parameters import InputError
from physics.converter import FULL_COUNTS, SensorParameters
from tests.nodes.drive_rig import NodeBus

COUNTS_PER_N = FULL_COUNTS / SensorParameters().full_scale_n


class Gauge(NodeBus):
    """A sensor fed with newtons, through the converter's nominal line."""

    application: TensionSensor

    def __init__(self, node_id: int = START) -> None:
        super().__init__(node_id)
        assert isinstance(self.application, TensionSensor)

    def feel(self, newton: float, times: int = 1, status: int = 0) -> Gauge:
        for _ in range(times):
            self.bus.run(1e-9 * self.application.interval_ns)
            self.node.sample(round(newton * COUNTS_PER_N), status)
        return self


def test_the_nominal_line_is_the_converters() -> None:
    gauge = Gauge().feel(40.0)
    assert gauge.read(0x6130, 1) == pytest.approx(40.0, abs=1e-4)
    assert gauge.read(0x7130, 1) == 4000
    assert gauge.read(0x9130, 1) == 4000
    assert gauge.read(0x6150, 1) == 0
    assert gauge.read(0x9100, 1) == round(40.0 * COUNTS_PER_N)
    assert gauge.read(0x6100, 1) == pytest.approx(40.0 * COUNTS_PER_N, rel=1e-6)


@pytest.mark.parametrize("node_id", [START, END])
def test_the_bench_s_tpdo_carries_hundredths_of_newton_at_sync(node_id: int) -> None:
    gauge = Gauge(node_id)
    gauge.setup()
    gauge.feel(-12.34)
    frames = [f for f in gauge.sync() if f.cob_id == 0x180 + node_id]
    assert [struct.unpack("<h", f.data) for f in frames] == [(-1234,)]


def test_two_point_scaling() -> None:
    gauge = Gauge()
    for index, value in ((0x6120, 1000.0), (0x6121, 5.0), (0x6122, 3000.0), (0x6123, 15.0)):
        gauge.write(index, 1, value)
    assert gauge.read(0x6126, 1) == pytest.approx(0.005)
    assert gauge.read(0x6127, 1) == pytest.approx(0.0, abs=1e-6)
    gauge.node.sample(2000)
    assert gauge.read(0x6130, 1) == pytest.approx(10.0)


def test_a_falling_line_is_a_line() -> None:
    gauge = Gauge()
    gauge.write(0x6123, 1, -200.0)
    gauge.feel(-50.0)
    assert gauge.read(0x7130, 1) == 5000
    assert gauge.read(0x6150, 1) == 0


def test_points_that_give_no_line_are_refused() -> None:
    gauge = Gauge()
    assert gauge.refused(0x6122, 1, 0.0) == 0x06090030
    assert gauge.refused(0x6123, 1, 0.0) == 0x06090030
    assert gauge.refused(0x6121, 1, math.nan) == 0x06090030
    assert gauge.refused(0x6124, 1, math.inf) == 0x06090030
    with pytest.raises(InputError, match="two different"):
        two_point(1.0, 0.0, 1.0, 2.0)


def test_autozero_takes_the_present_value_into_the_offset() -> None:
    gauge = Gauge().feel(3.21)
    gauge.write(0x6125, 1, SIGNATURE_ZERO)
    assert gauge.read(0x7130, 1) == 0
    assert gauge.read(0x6124, 1) == pytest.approx(-3.21, abs=1e-4)
    gauge.feel(13.21)
    assert gauge.read(0x7130, 1) == 1000
    gauge.write(0x6125, 1, SIGNATURE_ZERO)
    assert gauge.read(0x7130, 1) == 0


def test_autozero_wants_its_signature_and_a_valid_value() -> None:
    gauge = Gauge()
    assert gauge.refused(0x6125, 1, SIGNATURE_ZERO) == 0x08000022
    gauge.feel(3.0)
    assert gauge.refused(0x6125, 1, 0) == 0x06090030
    assert gauge.read(0x7130, 1) == 300


@pytest.mark.parametrize(("decimals", "counts"), [(0, 41), (1, 412), (3, 41_234)])
def test_decimals_set_what_a_count_means(decimals: int, counts: int) -> None:
    gauge = Gauge().feel(41.234)
    gauge.write(0x6132, 1, decimals)
    assert gauge.read(0x9130, 1) == counts


def test_a_16_bit_value_is_held_at_its_end_short_of_invalid() -> None:
    gauge = Gauge().feel(41.234)
    gauge.write(0x6132, 1, 3)
    assert gauge.read(0x7130, 1) == 32_767
    gauge.feel(-41.234, times=1)
    assert gauge.read(0x7130, 1) == -32_767


@given(value=st.floats(-1e12, 1e12), bits=st.sampled_from([INTEGER16, INTEGER32]))
def test_no_value_reads_as_invalid(value: float, bits: int) -> None:
    assert invalid(bits) < integer(value, bits) < -invalid(bits)


def test_the_sampling_interval_is_an_object() -> None:
    gauge = Gauge()
    gauge.write(0x6114, 1, 250)
    assert gauge.application.interval_ns == 250_000
    assert gauge.refused(0x6114, 1, 99) == 0x06090032


# ---- filters ----


@pytest.mark.parametrize(("kind", "expected"), [
    (FilterType.NONE, [10, 20, 30, 40, 50]),
    (FilterType.MOVING_AVERAGE, [10, 15, 20, 30, 40]),
    (FilterType.REPEATING_AVERAGE, [10, 10, 20, 20, 20]),
])
def test_filters(kind: int, expected: list[int]) -> None:
    gauge = Gauge()
    gauge.write(0x61A0, 1, kind)
    gauge.write(0x61A1, 1, 3)
    read = []
    for newton in (10, 20, 30, 40, 50):
        gauge.feel(newton)
        read.append(round(gauge.read(0x6130, 1), 3))
    assert read == expected


def test_a_filter_that_is_changed_begins_anew() -> None:
    gauge = Gauge()
    gauge.write(0x61A1, 1, 255)
    gauge.feel(10.0, times=300).feel(20.0)
    assert gauge.read(0x7130, 1) < 1100
    gauge.write(0x61A1, 1, 2)
    assert gauge.read(0x6150, 1) == 1
    gauge.feel(20.0)
    assert gauge.read(0x7130, 1) == 2000


@pytest.mark.parametrize(("index", "value"), [(0x61A0, 3), (0x61A1, 0)])
def test_filters_the_channel_lacks_are_refused(index: int, value: int) -> None:
    assert Gauge().refused(index, 1, value) in (0x06090031, 0x06090032)


@settings(max_examples=50)
@given(samples=st.lists(st.integers(-FULL_COUNTS, FULL_COUNTS - 1), min_size=1, max_size=300),
       length=st.integers(1, 255))
def test_a_moving_average_is_the_mean_of_its_window(samples: list[int], length: int) -> None:
    channel = channel_law.channel(*filter_settings(FilterType.MOVING_AVERAGE, length))
    for n, sample in enumerate(samples, 1):
        channel_law.add(channel, float(sample))
        window = samples[max(0, n - length):n]
        assert channel[channel_law.MEAN] == sum(window) / len(window)


def test_settings_go_by_reset_node_unless_stored() -> None:
    gauge = Gauge()
    for stored, after in ((False, 0), (True, 500)):
        gauge.write(0x6124, 1, 5.0)
        if stored:
            gauge.write(0x1010, 1, SIGNATURE_SAVE)
        gauge.feel(0.0)
        assert gauge.read(0x7130, 1) == 500
        gauge.nmt(NmtCommand.RESET_NODE)
        gauge.feel(0.0)
        assert gauge.read(0x7130, 1) == after
