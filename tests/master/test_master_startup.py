"""Start-up on a bench that somebody left: nothing is enabled by surprise, and what was left is no hindrance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import can
import pytest

from eds.bench.bench_network import KNEE, SERVO, Network, WireLayout, wire
from eds.cia402 import State, state_of
from eds.dictionary import key
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.guard import Guard
from master.cycle.inputs import Inputs
from master.cycle.log import Log
from master.cycle.run_safely import run_safely
from master.network import bringup
from master.network.acknowledge import acknowledge
from master.network.link import Link
from master.settings import Limits
from virtual_bus.bus import BowdenBus

if TYPE_CHECKING:
    from conftest import Composer

MS = 1_000_000
DRIVES = {SERVO: "servo", KNEE: "knee"}


def aborted(
    composer: Composer, until: Callable[[Inputs], bool] = lambda inputs: True, **options: Any
) -> tuple[Link, BowdenBus]:
    """A link on a bench whose master has enabled both drives and, once `until` says so, is no more."""
    link, tap = composer.link(**options)
    described = wire(Network())
    log = Log(tap, None, described.targets.cob_id)
    bringup.bring_up(link, described, log)
    link.sync_start(described.period_ns)
    guard = Guard(link, described, log, Limits(), 250 * MS)
    exchange = Exchange(link, described, log, guard, 600_000)
    exchange.begin()
    drives.enable(exchange)
    guard.active = False
    while not until(exchange.hold()):
        pass
    link.sync_stop()
    return Link(link.bus, link.clock), tap


def states(link: Link) -> set[State | None]:
    return {state_of(int.from_bytes(link.sdo_read(node, 0x6041), "little")) for node in DRIVES}


def test_a_drive_that_an_aborted_run_left_enabled_loses_its_torque_first(composer: Composer) -> None:
    link, tap = aborted(composer)
    assert states(link) == {State.OPERATION_ENABLED}
    bringup.bring_up(link, wire(Network()), Log(tap, None, 0x201))
    assert State.OPERATION_ENABLED not in states(link)


def test_a_drive_that_an_aborted_run_left_in_fault_comes_up(composer: Composer) -> None:
    """Its emergency stop is free again and acknowledged; the fault itself is reset at start-up."""
    stop = {"kind": "emergency_stop", "node": KNEE, "start_s": 3.0, "stop_s": 3.05}
    link, tap = aborted(composer, lambda inputs: state_of(inputs.knee_status) is State.FAULT, faults=[stop])
    link.wait(300 * MS)
    assert acknowledge(link, wire(Network()))[1].became == "released"
    assert State.FAULT in states(link)
    seen: list[State | None] = []

    def enabled(exchange: Exchange) -> None:
        drives.enable(exchange)
        seen.append(state_of(exchange.inputs.knee_status))

    outcome = run_safely(link, tap, None, Network(), Limits(), enabled)
    assert outcome.reason is None
    assert seen == [State.OPERATION_ENABLED]


def test_sync_that_somebody_sends_is_no_bench_to_start_on(composer: Composer) -> None:
    link, tap = composer.link()
    tap.send_periodic(can.Message(arbitration_id=0x080, is_extended_id=False), 0.01)
    outcome = run_safely(link, None, None, Network(), Limits(), lambda exchange: None)
    assert outcome.reason is not None
    assert "somebody sends SYNC already" in outcome.reason


@pytest.fixture(params=[1, 2, 3], ids=["vendor-ID", "product code", "revision number"])
def other_edition(request: pytest.FixtureRequest) -> tuple[str, WireLayout]:
    """A wire whose knee's EDS has another number in 0x1018."""
    right = wire(Network())
    knee, at = right.nodes[KNEE], key(0x1018, request.param)
    entry = knee.dictionary.entries[at]
    entries = {**knee.dictionary.entries, at: replace(entry, default=int(entry.default or 0) + 1)}
    other = knee._replace(dictionary=replace(knee.dictionary, entries=entries))
    return request.node.callspec.id, WireLayout(Network(), {**right.nodes, KNEE: other})


def test_another_edition_of_the_device_is_refused_by_its_number(
    composer: Composer, other_edition: tuple[str, WireLayout]
) -> None:
    name, described = other_edition
    link, tap = composer.link()
    with pytest.raises(bringup.BringUpError, match=rf"knee \(node 2\): {name} is 0x[0-9A-F]+, its EDS .* says 0x"):
        bringup.bring_up(link, described, Log(tap, None, 0x201))
    assert State.OPERATION_ENABLED not in states(link)


def test_a_node_that_stalls_as_the_exchange_begins_is_waited_for(composer: Composer) -> None:
    """Half as many cycles again as stop a trial that runs; all that is told of it is that it was so."""
    began_s = composer.run(experiment={"dry_run": True}).trial.time_ns[0] * 1e-9
    stalled = (Limits().stale_cycles * 1.5) * 1e-3
    ran = composer.run(experiment={"dry_run": True}, faults=[
        {"kind": "drop", "cob_id": 0x184, "start_s": began_s - 0.0005, "stop_s": began_s + stalled}])
    assert ran.result.stop_reason is None
    assert ran.result.missed_cycles == 0
    assert next(event.text for event in ran.trial.events if event.kind == "miss") == "no inputs of end."
