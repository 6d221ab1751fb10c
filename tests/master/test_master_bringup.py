"""Bring-up against nodes that are not as they should be: named node, named reason, no drive enabled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import can
import pytest

from eds.bench.bench_network import Network, WireLayout, wire
from eds.cia301 import NmtCommand, NmtState
from master.cycle import drives
from master.cycle.exchange import Exchange
from master.cycle.log import Log
from master.cycle.run_safely import run_safely
from master.network import bringup
from master.network.sdo import SdoError
from master.settings import Limits
from virtual_bus.bus import BowdenBus

if TYPE_CHECKING:
    from conftest import Composer


def brought_up(composer: Composer, described: WireLayout | None = None, **options: Any) -> dict[int, int]:
    link, tap = composer.link(**options)
    described = described or wire(Network())
    return bringup.bring_up(link, described, Log(tap, None, described.targets.cob_id))


def test_every_node_comes_up(composer: Composer) -> None:
    link, tap = composer.link()
    described = wire(Network())
    serials = bringup.bring_up(link, described, Log(tap, None, 0x201))
    assert set(serials) == {1, 2, 3, 4}
    assert {link.beats[node].state for node in serials} == {NmtState.OPERATIONAL}


def test_a_second_bring_up_takes_over_what_the_first_left(composer: Composer) -> None:
    """Nodes already OPERATIONAL, with a PDO plan of their own: leftovers of an aborted run."""
    link, tap = composer.link()
    described = wire(Network())
    log = Log(tap, None, 0x201)
    bringup.bring_up(link, described, log)
    bringup.bring_up(link, described, log)
    assert int.from_bytes(link.sdo_read(1, 0x6041), "little") & 0x0004 == 0


def test_a_missing_node_is_named(composer: Composer) -> None:
    with pytest.raises(bringup.BringUpError, match=r"start \(node 3\) does not answer"):
        brought_up(composer, faults=[{"kind": "power_off", "node": 3}])


def test_a_late_node_is_waited_for(composer: Composer) -> None:
    assert brought_up(composer, faults=[{"kind": "power_off", "node": 2, "stop_s": 1.5}])


def test_another_devices_identity_is_refused(composer: Composer) -> None:
    right = wire(Network())
    swapped = {**right.nodes, 2: right.nodes[2]._replace(dictionary=right.nodes[1].dictionary)}
    with pytest.raises(bringup.BringUpError, match=r"knee \(node 2\): (device type|product code) is 0x"):
        brought_up(composer, WireLayout(Network(), swapped))


def test_a_second_master_is_refused(composer: Composer) -> None:
    link, tap = composer.link()
    heartbeat = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
    tap.send_periodic(heartbeat, 0.1)
    with pytest.raises(bringup.BringUpError, match="another master"):
        bringup.bring_up(link, wire(Network()), Log(None, None, 0x201))


def test_an_object_that_is_refused_is_named_with_the_abort(composer: Composer) -> None:
    link, _ = composer.link()
    link.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, 0)
    with pytest.raises(SdoError, match=r"node 1, object 0x1234:00: refused with 0x06020000, object does not exist"):
        link.sdo_read(1, 0x1234)
    with pytest.raises(SdoError, match=r"node 1, object 0x1000:00: refused with 0x0601000[02]"):
        link.sdo_write(1, 0x1000, 0, bytes(4))
    assert bytes(link.sdo_read(1, 0x1008)).startswith(b"Bowden servo")


def test_a_node_that_is_not_there_does_not_answer(composer: Composer) -> None:
    link, _ = composer.link()
    with pytest.raises(SdoError, match="node 9, object 0x1000:00: no answer"):
        link.sdo_read(9, 0x1000)


def test_a_refused_trial_says_nothing_to_another_masters_bench(composer: Composer) -> None:
    link, tap = composer.link()
    tap.send_periodic(can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False), 0.1)
    third = BowdenBus(tap.channel_info.split()[-1])
    composer.open.append(third)
    outcome = run_safely(link, None, None, Network(), Limits(), lambda exchange: None)
    assert outcome.reason is not None
    assert "another master" in outcome.reason
    heard = set()
    while (message := third.recv(0)) is not None:
        heard.add(message.arbitration_id)
    assert not heard & {0x000, 0x080, 0x201, 0x301, *range(0x601, 0x67F)}


def test_a_mistake_in_what_is_performed_still_lets_the_rope_go(composer: Composer) -> None:
    link, tap = composer.link()

    def mistaken(exchange: Exchange) -> None:
        drives.enable(exchange)
        raise ZeroDivisionError

    outcome = run_safely(link, tap, None, Network(), Limits(), mistaken)
    assert outcome.reason == "program failed: ZeroDivisionError (test_master_bringup.py, line 108)"
    assert int.from_bytes(link.sdo_read(1, 0x6041), "little") & 0x0004 == 0
    assert int.from_bytes(link.sdo_read(2, 0x6041), "little") & 0x0004 == 0
