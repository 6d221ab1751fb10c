"""The heap: order, time, and stopping."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from virtual_bus.kernel import NEVER, Kernel


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 3))))
def test_events_run_by_time_then_priority_then_order_of_entry(events: list[tuple[int, int]]) -> None:
    kernel, ran = Kernel(), []
    for serial, (time_ns, priority) in enumerate(events):
        kernel.at(time_ns, priority, lambda e=(time_ns, priority, serial): ran.append((kernel.now_ns, *e)))
    kernel.run(100)
    assert [entry[1:] for entry in ran] == sorted((t, p, s) for s, (t, p) in enumerate(events))
    assert all(now == entry for now, entry, *_ in ran)
    assert kernel.now_ns == 100


def test_run_stops_at_the_event_that_fills() -> None:
    kernel, filled = Kernel(), []
    kernel.at(10, 0, lambda: None)
    kernel.at(20, 0, lambda: filled.append(1))
    kernel.at(20, 1, lambda: filled.append(2))
    kernel.run(100, filled)
    assert (filled, kernel.now_ns, kernel.next_ns()) == ([1], 20, 20)


def test_run_without_end_stays_where_the_last_event_was() -> None:
    kernel = Kernel()
    kernel.at(7, 0, lambda: kernel.at(9, 0, lambda: None))
    kernel.run(NEVER)
    assert (kernel.now_ns, kernel.next_ns()) == (9, NEVER)


def test_the_past_is_refused() -> None:
    kernel = Kernel()
    kernel.run(5)
    with pytest.raises(ValueError, match="past"):
        kernel.at(4, 0, lambda: None)
